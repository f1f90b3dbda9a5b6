"""InvenSense's MPU family: accelerometer and gyroscope of one die, two sensors that share a place.

MPU-6050, and the MPU-9150 that holds one: register map RM-MPU-6000A rev. 4.2; 340 counts per degC, -521 at 35 degC
(INV-20, -42). MPU-6500, and the MPU-9250 that holds one: RM-MPU-9250A rev. 1.4; 333.87 counts per degC, 0 at 21 degC
(INV-70 ... INV-78). A burst is 0x3B ... 0x48, accelerometer, thermometer and gyroscope, whose bytes are of one instant
(INV-30), high byte first. The magnetometers of the MPU-9150 and MPU-9250 are separate sensors (`imuarray.drivers.akm`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes, DecodedBursts
from imuarray.drivers.six_axis import INVENSENSE, HalfTest, QueuedHalf, SixAxisHalf, factory_change
from imuarray.drivers.six_axis_queue import EVERYTHING, DieQueue, MpuQueue
from imuarray.facts import mpu6050, mpu6500
from imuarray.facts.registers import Field, Register, Setting

_WAKE_S = 0.1  # the kernel's driver waits as long for the outputs to settle: INV-36
_GYRO_CLOCK = 1  # more stable than the internal oscillator: INV-25, INV-71
_EXTERNAL_CLOCKS = (4, 5)  # 32.768 kHz and 19.2 MHz: INV-37
_BASE_RATE_HZ = 1000.0  # with the low-pass filter on: INV-11, INV-72
_IN_TEMPERATURE = 1  # its lowest bit marks a sample: INV-38


class _Mpu(SixAxisHalf):
    """The common part of the drivers: set-up, with the registers of `table`, and the places of a burst."""

    table: ClassVar[ModuleType]
    fifo_bytes: ClassVar[int]
    unused: ClassVar[Register | None] = mpu6050.I2C_SLV0_DO  # sent to a slave of a bus that is off: INV-23, INV-71
    first: ClassVar[Register] = mpu6050.ACCEL_XOUT_H
    relatives: ClassVar[Mapping[int, str]] = INVENSENSE
    places: ClassVar[Mapping[str, slice]] = {"acc": slice(0, 6), "gyro": slice(8, 14)}
    temperature: ClassVar[slice] = slice(6, 8)
    settle_s: ClassVar[float] = 0.2

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        facts = self.table
        rate_hz, ranges = sensor.nominal_rate_hz, tuple(sensor.spec.sensitivity)
        self.filter_code = 1 + sensor.spec.allowed_bandwidths_hz(rate_hz).index(sensor.chip_bandwidth_hz)
        external_hz = sensor.external_clock_hz
        source = _GYRO_CLOCK if external_hz is None else _EXTERNAL_CLOCKS[external_hz > 1e6]
        mark = _IN_TEMPERATURE if sensor.sync_pulse else 0
        full_scale, self_test = self.range_fields()
        self.range_setting = full_scale(ranges.index(sensor.range or ranges[0])) | self_test(0)
        self.power = facts.PWR_MGMT_1[7:0](facts.CLOCK(source).value)
        self.common = (
            facts.PWR_MGMT_2[7:0](0),
            facts.SMPLRT_DIV[7:0](round(_BASE_RATE_HZ / rate_hz) - 1),
            facts.CONFIG[7:0]((facts.DLPF(self.filter_code) | facts.EXT_SYNC(mark)).value),
        )

    def range_fields(self) -> tuple[Field, Field]:
        facts = self.table
        if self.half == "acc":
            return facts.ACCEL_RANGE, facts.ACCEL_SELF_TEST
        return facts.GYRO_RANGE, facts.GYRO_SELF_TEST

    def control(self, *, queued: bool) -> Setting:
        facts = self.table
        setting: Setting = facts.USER_CTRL[7:0]((facts.FIFO_ON(int(queued)) | facts.I2C_OFF(int(self.on_spi))).value)
        return setting


class _QueuedMpu(QueuedHalf, _Mpu):
    """One half, read by the queue, whose records have the format of a burst."""

    def _new_queue(self) -> DieQueue:
        control = self.control(queued=True)
        return MpuQueue(self.registers, self.clock, self.rate_hz, self.fifo_bytes, control, vars(self.table))

    def _queue_settings(self) -> tuple[Setting, ...]:
        """Return the settings of a queue that holds everything (INV-27, INV-98)."""
        return self.control(queued=True), self.table.FIFO_EN[7:0](EVERYTHING)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        return self.decode_marked_temperature(super().decode(bursts))


def _accelerometer_range(code: int, self_test: int) -> Setting:
    return mpu6050.ACCEL_CONFIG[7:0]((mpu6050.ACCEL_RANGE(code) | mpu6050.ACCEL_SELF_TEST(self_test)).value)


def _gyroscope_range(code: int, self_test: int) -> Setting:
    return mpu6050.GYRO_CONFIG[7:0]((mpu6050.GYRO_RANGE(code) | mpu6050.GYRO_SELF_TEST(self_test)).value)


class Mpu6050(_Mpu):
    """Driver of one half of an MPU-6050."""

    table: ClassVar[ModuleType] = mpu6050
    fifo_bytes: ClassVar[int] = 1024  # INV-27
    self_tests: ClassVar[Mapping[str, HalfTest]] = {  # within 14 % of the factory's change: INV-45
        half: HalfTest(
            at_rest,
            deflected,
            limits=((1 - 0.14, 1 + 0.14),) * 3,
            allowed="of the factory's; 0.86 to 1.14 allowed",
            is_signed=True,
        )
        for half, at_rest, deflected in (
            ("acc", _accelerometer_range(0b10, 0), _accelerometer_range(0b10, 0b111)),  # 8 g: INV-46
            ("gyro", _gyroscope_range(0, 0), _gyroscope_range(0, 0b111)),  # 250 dps: INV-47
        )
    }

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.settings = (*self.common, self.range_setting, self.control(queued=False))
        self.watched = (self.power, *self.settings)

    def steps(self) -> Iterator[float]:
        """Wake the die, which sleeps after power-on (INV-25), wait until it measures, then write every setting."""
        self.registers.set(self.power)
        yield _WAKE_S
        yield from self.registers.set_step_by_step(*self.settings)
        yield 2 / self.rate_hz

    def self_test_unit(self) -> Floats:
        """Return the change (3,) at the factory in counts, 0 where no code is stored: of the accelerometer 4096 * 0.34
        * (0.92 / 0.34)**((code - 1) / 30) (INV-46), of the gyroscope 25 * 131 * 1.046**(code - 1), y with the other
        sign (INV-47).
        """
        x, y, z, low = self.registers.peek(mpu6050.SELF_TEST_X, 4 if self.half == "acc" else 3).ljust(4, b"\0")
        if self.half == "acc":
            codes = np.array(
                [
                    mpu6050.TRIM_ACCEL_X_HIGH.of(x) << 2 | mpu6050.TRIM_ACCEL_X_LOW.of(low),
                    mpu6050.TRIM_ACCEL_Y_HIGH.of(y) << 2 | mpu6050.TRIM_ACCEL_Y_LOW.of(low),
                    mpu6050.TRIM_ACCEL_Z_HIGH.of(z) << 2 | mpu6050.TRIM_ACCEL_Z_LOW.of(low),
                ]
            )
            return np.where(codes > 0, 4096 * 0.34 * (0.92 / 0.34) ** ((codes - 1) / 30), 0.0)
        codes = np.array([mpu6050.TRIM_GYRO_X.of(x), mpu6050.TRIM_GYRO_Y.of(y), mpu6050.TRIM_GYRO_Z.of(z)])
        return np.where(codes > 0, np.array([25.0, -25.0, 25.0]) * 131 * 1.046 ** (codes - 1), 0.0)


class Mpu6050Fifo(_QueuedMpu, Mpu6050):
    """Driver of one half of an MPU-6050, read by the queue."""


class Mpu6500(_Mpu):
    """Driver of one half of an MPU-6500 or an MPU-9250. Unlike on the MPU-6050, the accelerometer has its own filter
    register (it is set to the same code), and the die is awake after power-on.
    """

    table: ClassVar[ModuleType] = mpu6500
    fifo_bytes: ClassVar[int] = 512  # INV-98
    self_tests: ClassVar[Mapping[str, HalfTest]] = {  # at the smallest range: INV-78
        "acc": HalfTest(
            mpu6500.ACCEL_RANGE(0) | mpu6500.ACCEL_SELF_TEST(0),
            mpu6500.ACCEL_RANGE(0) | mpu6500.ACCEL_SELF_TEST(0b111),
            ((0.5, 1.5),) * 3,
            "of the factory's; 0.5 to 1.5 allowed",
        ),
        "gyro": HalfTest(
            mpu6500.GYRO_RANGE(0) | mpu6500.GYRO_SELF_TEST(0),
            mpu6500.GYRO_RANGE(0) | mpu6500.GYRO_SELF_TEST(0b111),
            ((0.5, np.inf),) * 3,
            "of the factory's; 0.5 and more allowed",
        ),
    }

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.settings = (
            *self.common,
            mpu6500.ACCEL_CONFIG_2[7:0](mpu6500.ACCEL_DLPF(self.filter_code).value),
            mpu6500.GYRO_UNFILTERED(0),  # the divider has no effect otherwise: INV-72
            self.range_setting,
            self.control(queued=False),  # INV-96
        )
        self.watched = (self.power, *self.settings)

    def steps(self) -> Iterator[float]:
        """Wake the die, wait until it measures, then write every setting; bits of the other half keep their value."""
        self.registers.set(self.power)
        yield _WAKE_S
        for setting in self.settings:
            self.registers.store(setting)
            yield 0.0
        yield 2 / self.rate_hz

    def self_test_unit(self) -> Floats:
        """Return the change (3,) at the factory, in counts (INV-78)."""
        trim = mpu6500.SELF_TEST_X_ACCEL if self.half == "acc" else mpu6500.SELF_TEST_X_GYRO
        return factory_change(self.registers.peek(trim, 3))


class Mpu6500Fifo(_QueuedMpu, Mpu6500):
    """Driver of one half of an MPU-6500 or an MPU-9250, read by the queue."""
