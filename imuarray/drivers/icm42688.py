"""ICM-42688-P: accelerometer and gyroscope of one die, two sensors that share a place.

TDK InvenSense DS-000347; facts TDK-*. A burst is 0x1D ... 0x2A, thermometer, accelerometer and gyroscope, high byte
first by INTF_CONFIG0; 132.48 counts a degC, 0 at 25 degC (TDK-12, -32). A count of -32768 means that there is no valid
reading (TDK-13): the sensor is off, or starts. During measurement only range, rate and mode may be written (TDK-22), so
the die is switched off for other settings, unless they are all set already: then the set-up of one half does not
disturb the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers import icm42688_packets as packet_format
from imuarray.drivers.driver import Bytes, DecodedBursts, words16
from imuarray.drivers.six_axis import INVENSENSE, HalfTest, QueuedHalf, SixAxisHalf, factory_change
from imuarray.drivers.six_axis_queue import DieQueue, Icm42688Queue
from imuarray.facts import icm42688 as facts
from imuarray.facts.registers import Field, Register, Setting
from imuarray.log.format import SATURATED, SUSPECT

_START_S = 0.06  # of the gyroscope, the slower half: TDK-21
_LOW_NOISE = 0b11  # TDK-11
_RATE_CODES = {4000.0: 4, 2000.0: 5, 1000.0: 6, 500.0: 15, 200.0: 7, 100.0: 8, 50.0: 9, 25.0: 10, 12.5: 11}  # TDK-15
_SECOND_ORDER = 0b01  # of both filters, as after power-on: TDK-16
_I2C_OFF = 0b11  # otherwise the chip may interpret noise on the lines as I2C: TDK-71
_ADAPTIVE_RANGE_OFF = 0b01  # otherwise the gyroscope stalls near 100 dps: TDK-18
_ANTI_ALIAS = (13, 170, 8)  # 585 Hz, of both: TDK-17
_CLOCK_INPUT, _PULSE_INPUT = 0b10, 0b01  # TDK-24
_STREAM = 0b01  # TDK-80
_INVALID = -32768  # TDK-13
_STAMPS_PER_S = 1e6  # TDK-83, TDK-90
_SELF_TEST_RANGES = {"acc": 0b010, "gyro": 0b011}  # 4 g, 250 dps
_RATES: Mapping[str, Field] = {"acc": facts.ACCEL_RATE, "gyro": facts.GYRO_RATE}
_TRIMS: Mapping[str, Register] = {"acc": facts.XA_ST_DATA, "gyro": facts.XG_ST_DATA}
_IN_PACKET = {"acc": slice(1, 7), "gyro": slice(7, 13)}
_HIGH_RESOLUTION_BITS = {"acc": 18, "gyro": 19}


def _range_and_rate(half: str, range_code: int, rate_hz: float) -> Setting:
    full_scale = facts.ACCEL_RANGE if half == "acc" else facts.GYRO_RANGE
    return full_scale.register[7:0]((full_scale(range_code) | _RATES[half](_RATE_CODES[rate_hz])).value)


_SELF_TESTS = {
    "acc": HalfTest(
        at_rest=_range_and_rate("acc", _SELF_TEST_RANGES["acc"], 1000.0),
        deflected=facts.SELF_TEST_CONFIG[7:0]((facts.ACCEL_SELF_TEST_POWER(1) | facts.ACCEL_SELF_TEST(0b111)).value),
        limits=((0.5, 1.5),) * 3,
        allowed="of the factory's; 0.5 to 1.5 allowed",
    ),
    "gyro": HalfTest(
        at_rest=_range_and_rate("gyro", _SELF_TEST_RANGES["gyro"], 1000.0),
        deflected=facts.SELF_TEST_CONFIG[7:0](facts.GYRO_SELF_TEST(0b111).value),
        limits=((0.5, np.inf),) * 3,
        allowed="of the factory's; 0.5 and more allowed",
    ),
}


class Icm42688(SixAxisHalf):
    """Driver of one half of an ICM-42688-P."""

    first: ClassVar[Register] = facts.TEMP_DATA1
    unused: ClassVar[Register | None] = facts.FIFO_CONFIG2  # the watermark of the queue, which is off: TDK-23
    relatives: ClassVar[Mapping[int, str]] = INVENSENSE
    places: ClassVar[Mapping[str, slice]] = {"acc": slice(2, 8), "gyro": slice(8, 14)}
    temperature: ClassVar[slice] = slice(0, 2)
    self_tests: ClassVar[Mapping[str, HalfTest]] = _SELF_TESTS
    settle_s: ClassVar[float] = 0.2  # TDK-42
    after_self_test: ClassVar[Setting | None] = facts.SELF_TEST_CONFIG[7:0](0)

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.nominal_rate_hz = sensor.nominal_rate_hz
        has_clock = sensor.external_clock_hz is not None
        ranges = sorted(sensor.spec.sensitivity, reverse=True)  # code 0 is the largest: TDK-14
        filter_code = 1 + sensor.spec.allowed_bandwidths_hz(self.nominal_rate_hz).index(sensor.chip_bandwidth_hz)
        filters = facts.ACCEL_FILTER(filter_code) | facts.GYRO_FILTER(filter_code)
        delta, square, shift = _ANTI_ALIAS
        high, low = divmod(square, 256)
        self.power = facts.PWR_MGMT0[7:0]((facts.GYRO_MODE(_LOW_NOISE) | facts.ACCEL_MODE(_LOW_NOISE)).value)
        range_code = ranges.index(sensor.range or ranges[0])
        self.range_setting = _range_and_rate(self.half, range_code, self.nominal_rate_hz)
        interface = facts.SERIAL_INTERFACE(_I2C_OFF if self.on_spi else 0)
        self.settings = (
            facts.INTF_CONFIG0[7:0]((facts.FIFO_COUNT_BIG_ENDIAN(1) | facts.DATA_BIG_ENDIAN(1) | interface).value),
            facts.ADAPTIVE_RANGE(_ADAPTIVE_RANGE_OFF) | facts.RTC_MODE(int(has_clock)),
            facts.GYRO_FILTER_ORDER(_SECOND_ORDER),
            facts.GYRO_ACCEL_CONFIG0[7:0](filters.value),
            facts.ACCEL_FILTER_ORDER(_SECOND_ORDER),
            facts.SELF_TEST_CONFIG[7:0](0),
        )
        self.filters: tuple[Setting, ...] = (
            facts.GYRO_ANTI_ALIAS_OFF(0) | facts.GYRO_NOTCH_OFF(0),
            facts.GYRO_CONFIG_STATIC3[7:0](delta),
            facts.GYRO_CONFIG_STATIC4[7:0](low),
            facts.GYRO_CONFIG_STATIC5[7:0]((facts.GYRO_ANTI_ALIAS_SHIFT(shift)).value | high),
            *((facts.PIN_9(_CLOCK_INPUT),) if has_clock else ()),
            *((facts.PIN_9(_PULSE_INPUT),) if sensor.sync_pulse else ()),
            facts.ACCEL_CONFIG_STATIC2[7:0](facts.ACCEL_ANTI_ALIAS_DELTA(delta).value),
            facts.ACCEL_CONFIG_STATIC3[7:0](low),
            facts.ACCEL_CONFIG_STATIC4[7:0]((facts.ACCEL_ANTI_ALIAS_SHIFT(shift)).value | high),
        )
        """The registers of banks 1 and 2, in this order."""
        self.watched = (self._bank(0), self.power, self.range_setting, *self.settings)

    def _bank(self, number: int) -> Setting:
        return facts.REG_BANK_SEL[7:0](facts.BANK(number).value)

    def steps(self) -> Iterator[float]:
        """Set the common settings of both halves, with the die off, unless they are set; then this half's range and
        rate.

        The die is off only during these transactions.
        """
        self.registers.set(self._bank(0))
        if not self._is_set():
            self.registers.set(facts.PWR_MGMT0[7:0](0))
            for setting in chain(self.settings, self._filters_by_bank()):
                self.registers.store(setting)
        self.registers.set(self.range_setting)
        self.registers.set(self.power)
        yield _START_S
        yield 2 / self.rate_hz

    def _is_set(self) -> bool:
        """Return whether the die measures with all common settings of both halves."""
        if not all(self._holds(setting) for setting in (self.power, *self.settings)):
            return False
        return not [setting for setting in self._filters_by_bank() if not self._holds(setting)]  # to bank 0 again

    def _holds(self, setting: Setting) -> bool:
        return self.registers.peek(setting.register)[0] & setting.mask == setting.value

    def _filters_by_bank(self) -> Iterator[Setting]:
        """Yield each setting of the filters while its bank is selected; bank 0 again after the last."""
        selected = 0
        for setting in self.filters:
            if setting.register.bank != selected:
                selected = setting.register.bank
                self.registers.set(self._bank(selected))
            yield setting
        self.registers.set(self._bank(0))

    def self_test_unit(self) -> Floats:
        """Return the change (3,) measured at the factory, in counts at the range of the self-test. The chip stores it
        for 2 g and 250 dps; at 4 g the counts are half as large (TDK-40).
        """
        trim = _TRIMS[self.half]
        self.registers.set(self._bank(trim.bank))
        codes = self.registers.peek(trim, 3)
        self.registers.set(self._bank(0))
        return factory_change(codes) / 2.0 ** (3 - _SELF_TEST_RANGES[self.half])

    def remark(self) -> str:
        """Report, for the gyroscope, that the adaptive range is on; with it readings freeze near 100 dps (TDK-18)."""
        if self.half != "gyro" or facts.BANK.of(self.registers.peek(facts.REG_BANK_SEL)[0]):
            return ""
        if facts.ADAPTIVE_RANGE.of(self.registers.peek(facts.INTF_CONFIG1)[0]) == _ADAPTIVE_RANGE_OFF:
            return ""
        return "its adaptive range is on, as after power-on, and stalls it near 100 dps; imuarray log switches it off"

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits; a row with -32768 has no reading and is suspect, not saturated."""
        decoded = super().decode(bursts)
        return decoded._replace(status=_status(decoded.counts))


def _status(counts: npt.NDArray[Any], bits: int = 16) -> npt.NDArray[np.uint16]:
    """Return (n,) flags of (n, 3) counts: suspect for the lowest code (-32768 of 16 bits), which means no reading;
    saturated at the other codes that end the range.
    """
    lowest = -1 << bits - 1
    invalid = (counts == lowest).any(axis=1)
    at_end = (np.abs(counts.astype(np.int32)) == -lowest - 1).any(axis=1) & ~invalid
    return (np.where(invalid, SUSPECT, 0) | np.where(at_end, SATURATED, 0)).astype(np.uint16)


class Icm42688Fifo(QueuedHalf, Icm42688):
    """Driver of one half read from the queue: a row is a packet with a temperature of 8 bits, 2.07 counts per degC
    (TDK-82).
    """

    burst: ClassVar[int] = 16

    @property
    def reading(self) -> slice:
        """The triad of this half in a packet."""
        return _IN_PACKET[self.half]

    def _new_queue(self) -> DieQueue:
        rates_hz = self.rate_hz, self.nominal_rate_hz
        return Icm42688Queue(self.registers, self.clock, rates_hz, has_pulses=self.has_pulses)

    def _queue_settings(self) -> tuple[Setting, ...]:
        """Return the queue: packets of the halves that are read, with stamps in microseconds (TDK-83);
        an overflow drops the oldest packets (TDK-80).

        Only packets of both halves have a stamp, and thus the time since a pulse (TDK-90).
        """
        halves = packet_format.HALVES if self.has_pulses else self.die_queue.halves
        both = len(halves) > 1
        stamps = facts.TMST_CONFIG_KEPT(1) | facts.TIMESTAMP_FSYNC(int(self.has_pulses)) | facts.TIMESTAMP_ON(1)
        packets = facts.FIFO_ACCEL(int("acc" in halves)) | facts.FIFO_GYRO(int("gyro" in halves))
        packets |= facts.FIFO_TEMPERATURE(1) | facts.FIFO_TIMESTAMP(int(both))
        return (
            facts.TMST_CONFIG[7:0](stamps.value),
            facts.FIFO_CONFIG1[7:0](packets.value),
            facts.FIFO_CONFIG[7:0](facts.FIFO_MODE(_STREAM).value),
        )

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 16 bits, and the temperature in counts of its register, 64 for each of its own (TDK-82)."""
        counts = words16(bursts[:, self.reading], ">i2")
        coarse = np.ascontiguousarray(bursts[:, 13]).view(np.int8).astype(np.int16)
        temperature = np.where(coarse == -128, _INVALID, coarse * 64).astype(np.int16)  # TDK-82
        decoded = DecodedBursts(counts, temperature, _status(counts))
        if not self.has_pulses:
            return decoded
        stamps = np.ascontiguousarray(bursts[:, 14:16]).view(">u2")[:, 0]
        return self.with_marks(decoded, packet_format.are_after_pulse(bursts[:, 0]), (stamps + 0.5) / _STAMPS_PER_S)


class Icm42688HighResolution(Icm42688Fifo):
    """Driver of one half read from the queue in packets of 20 bytes, which always have the largest range (TDK-89)."""

    burst: ClassVar[int] = packet_format.ROW_BYTES

    @property
    def reading(self) -> slice:
        """The triad of this half in a row, in words of 32 bits."""
        return slice(0, 12)

    def _new_queue(self) -> DieQueue:
        return Icm42688Queue(self.registers, self.clock, (self.rate_hz, self.nominal_rate_hz), high_resolution=True)

    def _queue_settings(self) -> tuple[Setting, ...]:
        """Return the queue: packets always contain both halves (TDK-88)."""
        packets = facts.FIFO_HIGH_RESOLUTION(1) | facts.FIFO_ACCEL(1) | facts.FIFO_GYRO(1)
        packets |= facts.FIFO_TEMPERATURE(1) | facts.FIFO_TIMESTAMP(1)
        return (
            facts.TMST_CONFIG[7:0]((facts.TMST_CONFIG_KEPT(1) | facts.TIMESTAMP_ON(1)).value),
            facts.FIFO_CONFIG1[7:0](packets.value),
            facts.FIFO_CONFIG[7:0](facts.FIFO_MODE(_STREAM).value),
        )

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 18 or 19 bits (the lowest code means no reading), and the temperature register's counts."""
        counts = np.ascontiguousarray(bursts[:, self.reading]).view(">i4").astype(np.int32)
        temperature = words16(bursts[:, 12:], ">i2")[:, 0]
        return DecodedBursts(counts, temperature, _status(counts, _HIGH_RESOLUTION_BITS[self.half]))
