"""Settings of each chip and the nominal scale of its counts, shared by configuration, drivers and models.

Sensitivities are the data sheets' typical values in counts per unit, not a range divided by a word length, and not the
rounded reciprocals that some tables also print (BMA-78, L3G-43). The actual sensitivity of a sensor is measured by
`calibrate`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from imuarray.facts import (
    adxl345,
    ak8963,
    ak8975,
    bma180,
    bmp180,
    bmp280,
    bmp388,
    hmc5883,
    icm42688,
    l3g4200d,
    lis3mdl,
    lsm6dso,
    mmc5983,
    mpu6050,
    mpu6500,
)
from imuarray.facts.registers import Register
from imuarray.thermometers import THERMOMETERS, ChipThermometer
from imuarray.units import UNIT_OF, Quantity


@dataclass(frozen=True)
class SpiRules:
    """A chip's SPI protocol. The first byte is a register's address, with bit 7 set to read.

    `clock_hz`: the fastest clock for all its registers. `count_on`: the bit that is set for a transfer of several bytes
    (0: none). `address_bits`: the bits of the first byte that are the address. `mode`: clock polarity and phase, 0 to
    3.
    """

    clock_hz: int
    count_on: int = 0x00
    address_bits: int = 0x7F
    mode: int = 3


@dataclass(frozen=True)
class HighResolution:
    """Samples of a chip's queue with `high_resolution = true`: only at this `range`, with `sensitivity` counts per unit
    and `count_bits` bits each.
    """

    range: float
    sensitivity: float
    count_bits: int


@dataclass(frozen=True)
class ExternalClock:
    """Clock input of a chip: the lowest and highest allowed frequency, and the frequency at which its data rates are
    the nominal ones of its registers.
    """

    allowed_hz: tuple[float, float]
    nominal_hz: float


@dataclass(frozen=True)
class PulseInput:
    """Input for synchronisation pulses, which mark the next sample.

    `is_marked`: the sensor's own samples are marked; otherwise only those of the other half of the chip.
    `resolution_s`: resolution of the measured time from the pulse to that sample; 0 for a chip that marks the sample
    only. `least_rate_hz`: the lowest data rate at which the chip can do so. `is_on_clock_pin`: pulses and an external
    clock use the same pin.
    """

    resolution_s: float = 0.0
    least_rate_hz: float = 0.0
    is_on_clock_pin: bool = False
    is_marked: bool = True

    def error_s(self, rate_hz: float) -> float:
        """Return the largest error of the time from a pulse to the next sample at this data rate, with an oscillator
        that is up to one percent off: half the resolution plus a hundredth of the period if the chip measures this
        time, otherwise 0.505 periods.
        """
        return self.resolution_s / 2 + 0.01 / rate_hz if self.resolution_s else 0.505 / rate_hz


@dataclass(frozen=True)
class ChipSpec:
    """The settings of one chip that a configuration may state.

    `sensitivity`: counts per `unit` for each measuring range (in `unit`); empty for a chip without ranges. `rates_hz`:
    data rates that its registers can set (empty: its only rate is `fixed_rate_hz`). `bandwidths_hz`: -3 dB bandwidths
    for each data rate (key 0.0: for every rate); empty if it can't be set. `identity`: the register, with its value,
    that distinguishes the chip from others at its `addresses`. `label`: the name of a sensor of this chip, by number.
    `burst_bytes`: length of one reading (0: more than one transaction).
    """

    quantity: Quantity
    addresses: tuple[int, ...]
    identity: Register
    label: str
    burst_bytes: int
    sensitivity: Mapping[float, float] = field(default_factory=dict)
    rates_hz: tuple[float, ...] = ()
    default_rate_hz: float = 0.0
    fixed_rate_hz: float = 0.0
    bandwidths_hz: Mapping[float, tuple[float, ...]] = field(default_factory=dict)
    default_bandwidth_hz: float = 0.0
    delays_s: Mapping[float, float] = field(default_factory=dict)
    """Delay of the signal in the filter in s, by bandwidth; empty if no data sheet states it."""
    has_fifo: bool = False
    count_bits: int = 16
    """Bits of each axis's counts in a log; with more than 16 the driver decodes to int32, as the log stores them."""
    fifo_has_temperature: bool = False
    high_resolution: HighResolution | None = None
    """Samples of more bits in its queue; None if it has none."""
    external_clocks: tuple[ExternalClock, ...] = ()
    """Ranges of its clock input; empty if it has no supported clock input."""
    pulse_input: PulseInput | None = None
    """Its input for synchronisation pulses; None if it has none."""
    thermometer: ChipThermometer | None = None
    conversions_s: tuple[float, ...] = ()
    """Longest times in s of the conversions of one reading, for a chip that converts only on request."""
    spi: SpiRules | None = None
    """Its SPI protocol; None if it has no SPI."""
    proposed: Mapping[str, Any] = field(default_factory=dict)
    """Settings that suit a box that is held by hand or carried in a vehicle."""

    def external_clock(self, frequency_hz: float) -> ExternalClock | None:
        """Return the clock input that allows this frequency; None without one."""
        for clock in self.external_clocks:
            lowest, highest = clock.allowed_hz
            if lowest <= frequency_hz <= highest:
                return clock
        return None

    @property
    def unit(self) -> str:
        """The unit of its ranges and of its sensitivity (counts per unit)."""
        return UNIT_OF[self.quantity]

    @property
    def on_demand(self) -> bool:
        """True if it converts only on request, so that its driver sets the rate."""
        return bool(self.conversions_s)

    @property
    def has_thermometer(self) -> bool:
        """True if its readings include the temperature of the chip."""
        return self.thermometer is not None

    def rate_hz(self, asked: float | None) -> float:
        """Return the chip's own update rate with a configuration that requests `asked` (None: the default)."""
        return self.fixed_rate_hz or asked or self.default_rate_hz

    def allowed_bandwidths_hz(self, rate_hz: float) -> tuple[float, ...]:
        """Return the bandwidths that can be set at this data rate."""
        return self.bandwidths_hz.get(rate_hz, self.bandwidths_hz.get(0.0, ()))


_ADXL345_RATES_HZ = tuple(3200.0 / 2**octave for octave in range(16))  # exact powers of two: ADX-36

_MPU6050_RATES_HZ = tuple(1000.0 / divider for divider in (1, 2, 4, 5, 8, 10, 16, 20, 25, 40, 50, 100, 125, 200, 250))
"""1 kHz divided by whole numbers of at most 256 (INV-11); these divisors give rates with few digits."""

_MPU_PULSES = PulseInput()  # INV-38
_ICM42688_PULSES = PulseInput(1e-6, 25.0, is_on_clock_pin=True)  # TDK-24, TDK-90: 16 bits of microseconds


def _gyroscope_of(accelerometer: ChipSpec, **own: Any) -> ChipSpec:
    """Return the gyroscope of a die: the data of its accelerometer, with the fields `own` replaced."""
    return replace(accelerometer, quantity="angular_rate", label="IMU{}_gyro", **own)


_MPU6500_ACC = ChipSpec(
    quantity="specific_force",
    addresses=mpu6500.ADDRESSES,
    identity=mpu6500.WHO_AM_I,
    label="IMU{}_acc",
    burst_bytes=14,
    sensitivity={2.0: 16384.0, 4.0: 8192.0, 8.0: 4096.0, 16.0: 2048.0},  # INV-77
    rates_hz=_MPU6050_RATES_HZ,  # INV-72
    default_rate_hz=500.0,
    bandwidths_hz={0.0: (184.0, 92.0, 41.0, 20.0, 10.0, 5.0)},  # INV-74, by filter code from 1 on
    default_bandwidth_hz=41.0,
    delays_s={184.0: 5.8e-3, 92.0: 7.8e-3, 41.0: 11.8e-3, 20.0: 19.8e-3, 10.0: 35.7e-3, 5.0: 66.96e-3},  # INV-79
    thermometer=THERMOMETERS["mpu6500"],
    has_fifo=True,
    fifo_has_temperature=True,
    pulse_input=_MPU_PULSES,
    spi=SpiRules(1_000_000),  # INV-95
    proposed={"range": 4, "rate_hz": 500, "bandwidth_hz": 41},
)
_MPU6500_GYRO = _gyroscope_of(
    _MPU6500_ACC,
    sensitivity={250.0: 131.0, 500.0: 65.5, 1000.0: 32.8, 2000.0: 16.4},  # INV-77
    delays_s={184.0: 2.9e-3, 92.0: 3.9e-3, 41.0: 5.9e-3, 20.0: 9.9e-3, 10.0: 17.85e-3, 5.0: 33.48e-3},  # INV-79
    proposed={"range": 500, "rate_hz": 500, "bandwidth_hz": 41},
)
_MPU9250_IDENTITY = replace(mpu6500.WHO_AM_I, reset=0x71)  # INV-70

_MPU6050_CLOCKS = (  # INV-37: within 1 % of the two frequencies that are named
    ExternalClock((32_440.0, 33_096.0), 32_000.0),
    ExternalClock((19_008_000.0, 19_392_000.0), 19_200_000.0),
)
_ICM42688_CLOCKS = (ExternalClock((31_000.0, 50_000.0), 32_000.0),)  # TDK-25
_ICM42688_RATES_HZ = (12.5, 25.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 4000.0)  # TDK-15
_ICM42688_BANDWIDTHS_HZ = {  # by filter code from 1 on: TDK-16
    rate_hz: tuple(max(400.0, rate_hz) / share for share in (4, 5, 8, 10, 16, 20, 40)) for rate_hz in _ICM42688_RATES_HZ
}

_LSM6DSO_BANDWIDTHS_HZ = {104.0: 33.0, 208.0: 66.8, 416.0: 135.9, 833.0: 295.5, 1666.0: 1108.1}  # gyroscope: LSM-19

_MPU6050_ACC = ChipSpec(
    quantity="specific_force",
    addresses=mpu6050.ADDRESSES,
    identity=mpu6050.WHO_AM_I,
    label="IMU{}_acc",
    burst_bytes=14,
    sensitivity={2.0: 16384.0, 4.0: 8192.0, 8.0: 4096.0, 16.0: 2048.0},  # INV-40
    rates_hz=_MPU6050_RATES_HZ,
    default_rate_hz=500.0,
    bandwidths_hz={0.0: (184.0, 94.0, 44.0, 21.0, 10.0, 5.0)},  # INV-12, by filter code from 1 on
    default_bandwidth_hz=44.0,
    delays_s={184.0: 2e-3, 94.0: 3e-3, 44.0: 4.9e-3, 21.0: 8.5e-3, 10.0: 13.8e-3, 5.0: 19e-3},  # INV-12
    external_clocks=_MPU6050_CLOCKS,
    pulse_input=_MPU_PULSES,
    thermometer=THERMOMETERS["mpu6050"],
    has_fifo=True,
    fifo_has_temperature=True,
    proposed={"range": 4, "rate_hz": 500, "bandwidth_hz": 44},
)
_MPU6050_GYRO = _gyroscope_of(
    _MPU6050_ACC,
    sensitivity={250.0: 131.0, 500.0: 65.5, 1000.0: 32.8, 2000.0: 16.4},  # INV-41
    bandwidths_hz={0.0: (188.0, 98.0, 42.0, 20.0, 10.0, 5.0)},  # INV-12, by filter code from 1 on
    default_bandwidth_hz=42.0,
    delays_s={188.0: 1.9e-3, 98.0: 2.8e-3, 42.0: 4.8e-3, 20.0: 8.3e-3, 10.0: 13.4e-3, 5.0: 18.6e-3},  # INV-12
    proposed={"range": 500, "rate_hz": 500, "bandwidth_hz": 42},
)
_ICM42688_ACC = ChipSpec(
    quantity="specific_force",
    addresses=icm42688.ADDRESSES,
    identity=icm42688.WHO_AM_I,
    label="IMU{}_acc",
    burst_bytes=14,
    sensitivity={2.0: 16384.0, 4.0: 8192.0, 8.0: 4096.0, 16.0: 2048.0},  # TDK-30
    rates_hz=_ICM42688_RATES_HZ,
    default_rate_hz=1000.0,
    bandwidths_hz=_ICM42688_BANDWIDTHS_HZ,
    default_bandwidth_hz=100.0,
    thermometer=THERMOMETERS["icm42688"],
    has_fifo=True,
    fifo_has_temperature=True,
    high_resolution=HighResolution(16.0, 8192.0, 18),  # TDK-89
    external_clocks=_ICM42688_CLOCKS,
    pulse_input=_ICM42688_PULSES,
    spi=SpiRules(24_000_000),  # TDK-70
    proposed={"range": 4, "rate_hz": 1000, "bandwidth_hz": 100},
)
_ICM42688_GYRO = _gyroscope_of(
    _ICM42688_ACC,
    sensitivity={  # TDK-31
        15.625: 2097.2,
        31.25: 1048.6,
        62.5: 524.3,
        125.0: 262.0,
        250.0: 131.0,
        500.0: 65.5,
        1000.0: 32.8,
        2000.0: 16.4,
    },
    high_resolution=HighResolution(2000.0, 131.0, 19),  # TDK-89
    proposed={"range": 500, "rate_hz": 1000, "bandwidth_hz": 100},
)
_LSM6DSO_ACC = ChipSpec(
    quantity="specific_force",
    addresses=lsm6dso.ADDRESSES,
    identity=lsm6dso.WHO_AM_I,
    label="IMU{}_acc",
    burst_bytes=14,
    sensitivity={2.0: 1000 / 0.061, 4.0: 1000 / 0.122, 8.0: 1000 / 0.244, 16.0: 1000 / 0.488},  # LSM-30
    rates_hz=tuple(_LSM6DSO_BANDWIDTHS_HZ),  # LSM-15
    default_rate_hz=208.0,
    bandwidths_hz={rate_hz: (rate_hz / 2,) for rate_hz in _LSM6DSO_BANDWIDTHS_HZ},  # LSM-19
    thermometer=THERMOMETERS["lsm6dso"],
    has_fifo=True,
    fifo_has_temperature=True,
    pulse_input=PulseInput(is_marked=False),  # LSM-49
    spi=SpiRules(10_000_000),  # LSM-70
    proposed={"range": 4, "rate_hz": 416},
)
_LSM6DSO_GYRO = _gyroscope_of(
    _LSM6DSO_ACC,
    # LSM-31
    sensitivity={
        125.0: 1000 / 4.375,
        250.0: 1000 / 8.75,
        500.0: 1000 / 17.5,
        1000.0: 1000 / 35,
        2000.0: 1000 / 70,
    },
    bandwidths_hz={rate_hz: (bandwidth_hz,) for rate_hz, bandwidth_hz in _LSM6DSO_BANDWIDTHS_HZ.items()},
    pulse_input=PulseInput(),  # LSM-49
    proposed={"range": 500, "rate_hz": 416},
)

_HMC5883_RATES_HZ = (0.75, 1.5, 3.0, 7.5, 15.0, 30.0, 75.0)  # HMC-28

CHIPS: Mapping[str, ChipSpec] = MappingProxyType(
    {
        "adxl345": ChipSpec(
            quantity="specific_force",
            addresses=adxl345.ADDRESSES,
            identity=adxl345.DEVID,
            label="ADXL{}",
            burst_bytes=8,
            sensitivity=dict.fromkeys((2.0, 4.0, 8.0, 16.0), 256.0),  # full resolution at every range: ADX-40
            rates_hz=_ADXL345_RATES_HZ,
            default_rate_hz=100.0,
            has_fifo=True,
            spi=SpiRules(5_000_000, count_on=0x40, address_bits=0x3F),  # ADX-80
            proposed={"range": 16, "rate_hz": 400},  # at 1600 Hz and above all codes are even: ADX-47
        ),
        "bma180": ChipSpec(
            quantity="specific_force",
            addresses=bma180.ADDRESSES,
            identity=bma180.CHIP_ID,
            label="BMA{}",
            burst_bytes=7,
            # BMA-70 ... BMA-76
            sensitivity={1.0: 8192.0, 1.5: 5460.0, 2.0: 4096.0, 3.0: 2730.0, 4.0: 2048.0, 8.0: 1024.0, 16.0: 512.0},
            fixed_rate_hz=2400.0,  # BMA-93
            bandwidths_hz={0.0: (10.0, 20.0, 40.0, 75.0, 150.0, 300.0, 600.0, 1200.0)},  # BMA-81 ... BMA-88
            default_bandwidth_hz=150.0,  # BMA-85: the factory's
            thermometer=THERMOMETERS["bma180"],
            spi=SpiRules(10_000_000),  # BMA-130
            proposed={"range": 4, "bandwidth_hz": 150},
        ),
        "l3g4200d": ChipSpec(
            quantity="angular_rate",
            addresses=l3g4200d.ADDRESSES,
            identity=l3g4200d.WHO_AM_I,
            label="Gyro{}",
            burst_bytes=8,
            sensitivity={250.0: 1 / 0.00875, 500.0: 1 / 0.0175, 2000.0: 1 / 0.07},  # L3G-40 ... L3G-42
            rates_hz=(100.0, 200.0, 400.0, 800.0),
            default_rate_hz=100.0,
            bandwidths_hz={  # L3G-30 ... L3G-33
                100.0: (12.5, 25.0),
                200.0: (12.5, 25.0, 50.0, 70.0),
                400.0: (20.0, 25.0, 50.0, 110.0),
                800.0: (30.0, 35.0, 50.0, 110.0),
            },
            default_bandwidth_hz=25.0,
            has_fifo=True,
            spi=SpiRules(10_000_000, count_on=0x40, address_bits=0x3F),  # L3G-80
            thermometer=THERMOMETERS["l3g4200d"],
            proposed={"range": 500, "rate_hz": 400, "bandwidth_hz": 50},
        ),
        "mpu6050_acc": _MPU6050_ACC,
        "mpu6050_gyro": _MPU6050_GYRO,
        "mpu6500_acc": _MPU6500_ACC,
        "mpu6500_gyro": _MPU6500_GYRO,
        "mpu9250_acc": replace(_MPU6500_ACC, identity=_MPU9250_IDENTITY),
        "mpu9250_gyro": replace(_MPU6500_GYRO, identity=_MPU9250_IDENTITY),
        "icm42688_acc": _ICM42688_ACC,
        "icm42688_gyro": _ICM42688_GYRO,
        "lsm6dso_acc": _LSM6DSO_ACC,
        "lsm6dso_gyro": _LSM6DSO_GYRO,
        "bmp180": ChipSpec(
            quantity="pressure",
            addresses=bmp180.ADDRESSES,
            identity=bmp180.CHIP_ID,
            label="BMP{}",
            burst_bytes=0,
            rates_hz=(1.0, 2.0, 4.0, 8.0),  # rates of requests; it converts only on request (BMP-51)
            default_rate_hz=4.0,
            conversions_s=(0.0045, 0.0255),  # temperature, pressure: BMP-40, BMP-44
        ),
        "bmp280": ChipSpec(
            quantity="pressure",
            addresses=bmp280.ADDRESSES,
            identity=bmp280.CHIP_ID,
            label="BMP{}",
            burst_bytes=10,
            rates_hz=(1.0, 2.0, 4.0, 8.0, 16.0),  # rates of requests (BMP-107)
            default_rate_hz=4.0,
            conversions_s=(0.043225,),  # BMP-109
        ),
        "bmp388": ChipSpec(
            quantity="pressure",
            addresses=bmp388.ADDRESSES,
            identity=bmp388.CHIP_ID,
            label="BMP{}",
            burst_bytes=7,
            rates_hz=(1.0, 2.0, 4.0, 8.0, 16.0),  # rates of requests (BMP-207)
            default_rate_hz=4.0,
            conversions_s=(0.043,),  # BMP-209
        ),
        "lis3mdl": ChipSpec(
            quantity="magnetic_field",
            addresses=lis3mdl.ADDRESSES,
            identity=lis3mdl.WHO_AM_I,
            label="LIS{}",
            burst_bytes=9,
            sensitivity={4.0: 6842.0, 8.0: 3421.0, 12.0: 2281.0, 16.0: 1711.0},  # LIS-10
            rates_hz=(0.625, 1.25, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0, 155.0),  # LIS-11
            default_rate_hz=80.0,
            thermometer=THERMOMETERS["lis3mdl"],
            proposed={"range": 4, "rate_hz": 80},
        ),
        "mmc5983": ChipSpec(
            quantity="magnetic_field",
            addresses=mmc5983.ADDRESSES,
            identity=mmc5983.PRODUCT_ID,
            label="MMC{}",
            burst_bytes=7,
            sensitivity={8.0: 16384.0},  # MMC-11
            count_bits=18,
            rates_hz=(1.0, 10.0, 20.0, 50.0, 100.0, 200.0, 1000.0),  # MMC-16
            default_rate_hz=100.0,
            bandwidths_hz={  # MMC-13: limited by the time of a measurement
                **dict.fromkeys((1.0, 10.0, 20.0, 50.0, 100.0), (100.0, 200.0, 400.0, 800.0)),
                200.0: (200.0, 400.0, 800.0),
                1000.0: (800.0,),
            },
            default_bandwidth_hz=100.0,
            proposed={"range": 8, "rate_hz": 100},
        ),
        "ak8963": ChipSpec(
            quantity="magnetic_field",
            addresses=ak8963.ADDRESSES,
            identity=ak8963.WIA,
            label="AK{}",
            burst_bytes=8,
            sensitivity={49.12: 1 / 0.0015},  # AKM-11
            rates_hz=(8.0, 100.0),  # AKM-13
            default_rate_hz=100.0,
            proposed={"range": 49.12, "rate_hz": 100},
        ),
        "ak8975": ChipSpec(
            quantity="magnetic_field",
            addresses=ak8975.ADDRESSES,
            identity=ak8975.WIA,
            label="AK{}",
            burst_bytes=8,
            sensitivity={12.29: 1 / 0.003},  # AKM-22
            rates_hz=(100.0,),  # AKM-25
            default_rate_hz=100.0,
            proposed={"range": 12.29, "rate_hz": 100},
        ),
        "hmc5883l": ChipSpec(
            quantity="magnetic_field",
            addresses=hmc5883.ADDRESSES,
            identity=hmc5883.IDENTITY_A,
            label="HMC{}",
            burst_bytes=6,
            # HMC-20 ... HMC-27, first column
            sensitivity={
                0.88: 1370.0,
                1.3: 1090.0,
                1.9: 820.0,
                2.5: 660.0,
                4.0: 440.0,
                4.7: 390.0,
                5.6: 330.0,
                8.1: 230.0,
            },
            rates_hz=_HMC5883_RATES_HZ,
            default_rate_hz=15.0,
            proposed={"range": 1.3, "rate_hz": 15},
        ),
        "hmc5883": ChipSpec(
            quantity="magnetic_field",
            addresses=hmc5883.ADDRESSES,
            identity=hmc5883.IDENTITY_A,
            label="HMC{}",
            burst_bytes=6,
            # HMC-20 ... HMC-27, second column
            sensitivity={
                0.9: 1280.0,
                1.2: 1024.0,
                1.9: 768.0,
                2.5: 614.0,
                4.0: 415.0,
                4.6: 361.0,
                5.5: 307.0,
                7.9: 219.0,
            },
            rates_hz=_HMC5883_RATES_HZ,
            default_rate_hz=15.0,
            proposed={"range": 1.2, "rate_hz": 15},
        ),
    }
)

SENSITIVITIES: Mapping[str, Mapping[float, float]] = MappingProxyType(
    {name: spec.sensitivity for name, spec in CHIPS.items()}
)
"""Counts per unit by range, by chip."""

HALVES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {die: (f"{die}_acc", f"{die}_gyro") for die in ("mpu6050", "mpu6500", "mpu9250", "icm42688", "lsm6dso")}
)
"""Dies that are two sensors, by the name of the die: each half is a chip of `CHIPS`, and both have one address."""


_SOLD_AS: Mapping[str, str] = MappingProxyType({"icm42688p": "icm42688", "mmc5983ma": "mmc5983"})
"""Chips by their names in data sheets that include the letters of a package or a variant."""


def chip_of(name: str) -> str:
    """Return the name of a chip in configurations for its name in the data sheet ("ICM-42688-P"); other names are
    unchanged.
    """
    plain = name.lower().replace("-", "").replace(" ", "")
    plain = _SOLD_AS.get(plain, plain)
    return plain if plain in CHIPS or plain in HALVES else name


def kernel_chip(quantity: Quantity) -> ChipSpec:
    """Return the data of a chip that only a driver in the kernel supports: its quantity, and no settings."""
    return ChipSpec(
        quantity=quantity,
        addresses=(),
        identity=Register(0x00, "r"),  # not used: the registers of this chip are not read
        label="IIO{}",
        burst_bytes=0,
    )


def die_of(chip: str) -> str:
    """Return the name of the die that `chip` is a half of; `chip` itself if it is a whole die."""
    return next((die for die, halves in HALVES.items() if chip in halves), chip)


def half_of(die: str, full_scale: object) -> str:
    """Return the half of `die` that has this range (in g or dps; no number is a range of both halves); `die` if neither
    has it, or if it is no number.
    """
    if not isinstance(full_scale, int | float):
        return die
    return next((half for half in HALVES.get(die, ()) if full_scale in CHIPS[half].sensitivity), die)
