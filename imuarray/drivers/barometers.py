"""Bosch's barometers, which measure once on command and sleep otherwise: BMP180 (data sheet v2.8, 2015; facts BMP-11 to
-99), BMP280 (BST-BMP280-DS001 rev. 1.23; BMP-101 to -126) and BMP388 (BST-BMP388-DS001 rev. 1.0; BMP-201 to -223).

No call waits for a measurement: each call of `fetch` checks whether the time of the measurement in progress is over,
and starts the next one when it is due. Every reading is therefore new, and its time is known. `imuarray.barometer`
converts the words to degrees and pascals.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType, ModuleType
from typing import ClassVar, Literal

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Integers
from imuarray.barometer import BAROMETERS, Words
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import Bytes, ChipDriver, DecodedBursts, SelfTest, barometer_readings
from imuarray.errors import SensorError
from imuarray.facts import bmp180, bmp280, bmp388
from imuarray.facts.registers import Register, Setting

_SOFT_RESET = 0xB6  # BMP-104, BMP-204
_FORCED = 0b01  # BMP-107, BMP-207

_CALLS = 3
"""Number of late calls in a row after which calls are considered rare rather than interrupted."""


class OnDemandBarometer(ChipDriver):
    """The common part of the barometers' drivers: the time at which a result is read, and a check in place of the
    missing self-test.

    `facts` has the registers. `reset`: the register of the reset, which takes `start_up_s`. The calibration
    words have `word_bytes` bytes each and are signed but for those named `unsigned`; the formulas multiply and divide
    by those named `required`. `settings` are written after a reset. `limits_pa`: the operating range of the pressure.
    """

    facts: ClassVar[ModuleType]
    reset: ClassVar[Register]
    start_up_s: ClassVar[float] = 0.002  # BMP-113, BMP-212
    word_bytes: ClassVar[Sequence[int]]
    byte_order: ClassVar[Literal["little", "big"]] = "little"
    unsigned: ClassVar[tuple[str, ...]]
    required: ClassVar[tuple[str, ...]]

    burst: ClassVar[int] = 6
    reading: ClassVar[slice] = slice(0, 6)
    has_data_ready: ClassVar[bool] = True
    conversions_ns: ClassVar[tuple[int, ...]]
    lasting_ns: ClassVar[int] = 100_000_000
    """Age in ns above which a result is not used as a new one, unless calls are rare."""
    limits_pa: ClassVar[tuple[float, float]]

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.period_ns = round(1e9 / sensor.chip_rate_hz)
        self.watched = self.settings
        self.words: Words = {}
        self.arithmetic = BAROMETERS[sensor.chip]
        self._due_ns = 0
        self._done_ns: int | None = None
        self._called_ns: int | None = None
        self._intervals_ns: deque[int] = deque(maxlen=_CALLS)

    @property
    def ready_ns(self) -> int | None:
        """The end of the measurement in progress, in ns; None if there is none."""
        return self._done_ns

    def begin(self) -> None:
        """Discard the measurement in progress: the next call of `fetch` starts another."""
        self._due_ns, self._done_ns = self.clock.now_ns(), None

    def steps(self) -> Iterator[float]:
        """Reset, read the calibration words and write the settings; SensorError for an impossible word."""
        self.registers.poke(self.reset, _SOFT_RESET)
        yield self.start_up_s
        self.words = self.calibration_words(self.registers.peek(self.facts.CALIBRATION, sum(self.word_bytes)))
        for name in self.required:
            if self.words[name] in (0, 0xFFFF, -1):
                raise SensorError(
                    f"{self.registers.label}: calibration word {name} reads {self.words[name]}:"
                    f" not a {type(self).__name__.upper()}"
                )
        self.registers.set(*self.watched)
        self.begin()

    @classmethod
    def calibration_words(cls, block: bytes) -> Words:
        """Return the calibration words from their bytes."""
        words, first = {}, 0
        for name, count in zip(cls.facts.CALIBRATION_WORDS, cls.word_bytes, strict=True):
            part = block[first : first + count]
            words[name] = int.from_bytes(part, cls.byte_order, signed=name not in cls.unsigned)
            first += count
        return words

    def fetch(self) -> bytes:
        """Return a reading when a measurement is over; empty otherwise."""
        raise NotImplementedError

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return UT (n,) and UP (n,)."""
        raise NotImplementedError

    def self_test(self) -> SelfTest:
        """Check that one measurement has values within the operating range; the chip has no self-test."""
        self.configure()
        burst, tries, longest_ns = b"", 0, 0
        while not burst and tries < 100:
            asked_ns = self.clock.now_ns()
            sleep_for(self.clock, 0.005)
            burst, tries = self.fetch(), tries + 1
            longest_ns = max(longest_ns, self.clock.now_ns() - asked_ns)
        if not burst and longest_ns > self.lasting_ns // 2:
            slow = f"the bus takes {longest_ns * 1e-6:.0f} ms per transaction"
            return SelfTest(None, f"no self-test in the chip; {slow}, too slow to wait for a measurement")
        if not burst:
            return SelfTest(False, "no measurement within half a second")
        values = self.decode(np.frombuffer(burst, np.uint8).reshape(1, self.burst)).compensated
        temperature_degc, pressure_pa = float(values["temperature"][0]), float(values["pressure"][0])
        low, high = self.limits_pa
        passed = -40 <= temperature_degc <= 85 and low <= pressure_pa <= high
        return SelfTest(passed, f"no self-test in the chip; reads {temperature_degc:.1f} degC, {pressure_pa:.0f} Pa")

    def _result_due_ns(self, now_ns: int) -> int | None:
        """Return the end of the measurement in progress; None if there is none, or if its result would be too old in
        this call. Where calls are rare, a result may be as old as twice the shortest of the last call intervals.
        """
        seldom_ns = min(self._intervals_ns) if len(self._intervals_ns) == _CALLS else 0
        if self._called_ns is not None:
            self._intervals_ns.append(now_ns - self._called_ns)
        self._called_ns = now_ns
        if self._done_ns is not None and now_ns > self._done_ns + max(self.lasting_ns, 2 * seldom_ns):
            self._done_ns = None
        return self._done_ns

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return UT and UP as counts, with temperature in degC and pressure in Pa."""
        ut, up = self.words_of(bursts)
        temperature_degc, pressure_pa = self.arithmetic.compensate(ut, up, self.words)
        return barometer_readings(ut, up, temperature_degc, pressure_pa)

    def header(self) -> Mapping[str, int]:
        """Return the calibration words, which the conversion of the counts requires."""
        return {**self.words, **self.arithmetic.settings}


class ForcedBarometer(OnDemandBarometer):
    """The common part of drivers of chips that measure temperature and pressure at once ("forced mode").

    `first`: the register at which a read of the chip begins; `head` bytes come before the reading; `busy`: bits of the
    first byte that are set while the chip measures. `force`: the setting that starts a measurement.
    """

    first: ClassVar[Register]
    head: ClassVar[int]
    busy: ClassVar[int] = 0
    force: ClassVar[Setting]

    def is_over(self, head: bytes) -> bool:
        """Return whether the requested measurement is finished, from the bytes before the reading."""
        raise NotImplementedError

    def fetch(self) -> bytes:
        """Return six bytes when a measurement is over; empty otherwise.

        A call that fails with OSError changes nothing and can be repeated, except EIO, where the chip did not measure:
        the next call starts a measurement.
        """
        now_ns = self.clock.now_ns()
        done_ns = self._result_due_ns(now_ns)
        if done_ns is None:
            if now_ns >= self._due_ns:
                self.registers.poke(self.force.register, self.force.value)
                self._done_ns = now_ns + self.conversions_ns[0]
                self._due_ns = max(self._due_ns + self.period_ns, now_ns)
            return b""
        if now_ns < done_ns:
            return b""
        block = self.registers.peek(self.first, self.head + self.burst)
        self._done_ns = None
        if not self.is_over(block[: self.head]):
            raise OSError(errno.EIO, f"{self.registers.label}: measurement not finished in time, or lost")
        return block[self.head :]


_TEMPERATURE = 0x2E  # BMP-40
_PRESSURE = 0xF4  # eight samples, the quietest: BMP-44
_OVERSAMPLING = 3
_TEMPERATURE_NS = 4_500_000  # longest conversions: BMP-40, BMP-44
_PRESSURE_NS = 25_500_000


class Bmp180(OnDemandBarometer):
    """Driver of one BMP180; one reading is an uncompensated temperature and an uncompensated pressure. It converts
    temperature first, then pressure, into the same registers (BMP-48).
    """

    facts: ClassVar[ModuleType] = bmp180
    reset: ClassVar[Register] = bmp180.SOFT_RESET
    start_up_s: ClassVar[float] = 0.010  # BMP-50
    word_bytes: ClassVar[Sequence[int]] = (2,) * 11
    byte_order: ClassVar[Literal["little", "big"]] = "big"
    unsigned: ClassVar[tuple[str, ...]] = ("AC4", "AC5", "AC6")  # BMP-20 ... BMP-30
    required: ClassVar[tuple[str, ...]] = tuple(bmp180.CALIBRATION_WORDS)  # BMP-31
    burst: ClassVar[int] = 5
    reading: ClassVar[slice] = slice(0, 5)
    conversions_ns: ClassVar[tuple[int, ...]] = (_TEMPERATURE_NS, _PRESSURE_NS)
    limits_pa: ClassVar[tuple[float, float]] = (30_000.0, 110_000.0)  # BMP-70
    _converting = 0
    _temperature = b""

    def fetch(self) -> bytes:
        """Return UT and UP, five bytes, when a pair is complete; empty otherwise. A call that fails with OSError
        changes nothing and can be repeated; EIO if a conversion is overdue (BMP-46).
        """
        now_ns = self.clock.now_ns()
        done_ns = self._result_due_ns(now_ns)
        if done_ns is None:
            if now_ns >= self._due_ns:
                self._start(_TEMPERATURE, now_ns + _TEMPERATURE_NS)
                self._due_ns = max(self._due_ns + self.period_ns, now_ns)
            return b""
        if now_ns < done_ns:
            return b""
        if self._converting == _TEMPERATURE:
            temperature = self._result(2)
            self._start(_PRESSURE, self.clock.now_ns() + _PRESSURE_NS)
            self._temperature = temperature
            return b""
        pressure = self._result(3)
        self._done_ns = None
        return self._temperature + pressure

    def _start(self, command: int, done_ns: int) -> None:
        self.registers.poke(bmp180.CTRL_MEAS, command)
        self._converting, self._done_ns = command, done_ns

    def _result(self, count: int) -> bytes:
        """Read `count` bytes of the result, in one burst with the register that shows if the conversion is over."""
        block = self.registers.peek(bmp180.CTRL_MEAS, 2 + count)
        if bmp180.CONVERTING.of(block[0]):
            raise OSError(errno.EIO, f"{self.registers.label}: conversion not finished in time")
        return block[2:]

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return sixteen bits of temperature, then nineteen of pressure (BMP-47)."""
        wide = bursts.astype(np.int64)
        up = (wide[:, 2] << 16 | wide[:, 3] << 8 | wide[:, 4]) >> 8 - _OVERSAMPLING
        return wide[:, 0] << 8 | wide[:, 1], up


class Bmp280(ForcedBarometer):
    """Driver of one BMP280: sixteen samples of pressure and two of temperature, no filter, which is the measurement
    with the least noise that is independent of earlier ones (BMP-106).
    """

    relatives: ClassVar[Mapping[int, str]] = MappingProxyType({0x55: "a BMP180", 0x60: "a BME280"})  # BMP-102
    facts: ClassVar[ModuleType] = bmp280
    reset: ClassVar[Register] = bmp280.SOFT_RESET
    word_bytes: ClassVar[Sequence[int]] = (2,) * 12
    unsigned: ClassVar[tuple[str, ...]] = ("T1", "P1")  # BMP-103
    required: ClassVar[tuple[str, ...]] = ("T1", "T2", "P1")
    settings = (bmp280.STANDBY(0) | bmp280.FILTER(0) | bmp280.SPI_THREE_WIRE(0),)
    conversions_ns: ClassVar[tuple[int, ...]] = (43_225_000,)  # 1.25 ms + 2.3 ms a sample + 0.575 ms: BMP-109
    first: ClassVar[Register] = bmp280.STATUS
    head: ClassVar[int] = 4  # status, both settings, and a register that does not exist
    busy: ClassVar[int] = bmp280.MEASURING.mask
    force: ClassVar[Setting] = (
        bmp280.TEMPERATURE_OVERSAMPLING(0b010) | bmp280.PRESSURE_OVERSAMPLING(0b101) | bmp280.MODE(_FORCED)
    )
    limits_pa: ClassVar[tuple[float, float]] = (30_000.0, 110_000.0)  # BMP-124

    def is_over(self, head: bytes) -> bool:
        """Return whether the chip sleeps with the configured oversampling: a chip that was reset has none (BMP-105,
        BMP-107).
        """
        asleep = Setting(self.force.register, self.force.mask, self.force.value & ~bmp280.MODE.mask)
        return not bmp280.MEASURING.of(head[0]) and head[1] == asleep.value

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return twenty bits each, the pressure first (BMP-111)."""
        wide = bursts.astype(np.int64)
        up = wide[:, 0] << 12 | wide[:, 1] << 4 | wide[:, 2] >> 4
        return wide[:, 3] << 12 | wide[:, 4] << 4 | wide[:, 5] >> 4, up


class Bmp388(ForcedBarometer):
    """Driver of one BMP388, with the same numbers of samples as the BMP280."""

    relatives: ClassVar[Mapping[int, str]] = MappingProxyType({0x60: "a BMP390"})  # BMP-202
    facts: ClassVar[ModuleType] = bmp388
    reset: ClassVar[Register] = bmp388.CMD
    word_bytes: ClassVar[Sequence[int]] = (2, 2, 1, 2, 2, 1, 1, 2, 2, 1, 1, 2, 1, 1)  # BMP-203
    unsigned: ClassVar[tuple[str, ...]] = ("T1", "T2", "P5", "P6")  # BMP-203
    required: ClassVar[tuple[str, ...]] = ("T1", "T2", "P5")
    settings = (
        bmp388.TEMPERATURE_OVERSAMPLING(0b001) | bmp388.PRESSURE_OVERSAMPLING(0b100),  # BMP-206
        bmp388.FILTER(0),
    )
    conversions_ns: ClassVar[tuple[int, ...]] = (43_000_000,)  # BMP-209: 37.1 ms typically, and 15 % more
    first: ClassVar[Register] = bmp388.STATUS
    head: ClassVar[int] = 1
    force: ClassVar[Setting] = bmp388.MODE(_FORCED) | bmp388.TEMPERATURE_ON(1) | bmp388.PRESSURE_ON(1)
    limits_pa: ClassVar[tuple[float, float]] = (30_000.0, 125_000.0)  # BMP-222

    def is_over(self, head: bytes) -> bool:
        """Return whether both results are ready; a chip that was reset has none (BMP-205)."""
        return bool(bmp388.TEMPERATURE_READY.of(head[0]) and bmp388.PRESSURE_READY.of(head[0]))

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return twenty-four bits each, low byte first, the pressure first (BMP-211)."""
        wide = bursts.astype(np.int64)
        up = wide[:, 0] | wide[:, 1] << 8 | wide[:, 2] << 16
        return wide[:, 3] | wide[:, 4] << 8 | wide[:, 5] << 16, up
