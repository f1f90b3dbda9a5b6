"""BMP180 barometer. Bosch data sheet v2.8 (2015); facts BMP-*.

It converts only when asked, temperature first, then pressure, into the same registers (BMP-48). No call waits for it:
each call of `fetch` checks whether a conversion that was started earlier must be over by now, and starts the next. The
conversion of its words to degrees and pascals is in `imuarray.barometer`.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.barometer import Words, compensate
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import Bytes, DecodedBursts, SelfTest, barometer_readings, carry_out, registers_for
from imuarray.errors import SensorError
from imuarray.facts import bmp180 as facts
from imuarray.facts.registers import Setting

_SOFT_RESET = 0xB6
_START_UP_S = 0.010  # BMP-50
_TEMPERATURE = 0x2E  # BMP-40
_PRESSURE = 0xF4  # eight samples, the quietest: BMP-44
_OVERSAMPLING = 3
_TEMPERATURE_NS = 4_500_000  # longest conversions: BMP-40, BMP-44
_PRESSURE_NS = 25_500_000
_LASTING_NS = 100_000_000
"""A result that is older is not waited for, nor taken for a new one, unless every call comes so late."""
_CALLS = 3
"""After so many late calls in a row, calls are considered rare, and nothing was interrupted."""
_UNSIGNED = ("AC4", "AC5", "AC6")  # BMP-23 ... BMP-25


class Bmp180:
    """Driver of one BMP180; one reading is an uncompensated temperature and an uncompensated pressure."""

    burst: ClassVar[int] = 5
    reading: ClassVar[slice] = slice(0, 5)
    tells_fresh: ClassVar[bool] = True
    conversions_ns: ClassVar[tuple[int, ...]] = (_TEMPERATURE_NS, _PRESSURE_NS)
    lasting_ns: ClassVar[int] = _LASTING_NS

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        self.registers = registers_for(sensor, bus)
        self.clock = clock
        self.period_ns = round(1e9 / sensor.chip_rate_hz)
        self.watched: tuple[Setting, ...] = ()  # it has no setting that lasts: every conversion is asked for anew
        self.words: Words = {}
        self._due_ns = 0
        self._done_ns = 0
        self._converting = 0
        self._temperature = b""
        self._called_ns: int | None = None
        self._intervals_ns: deque[int] = deque(maxlen=_CALLS)

    @property
    def ready_ns(self) -> int | None:
        """The end of the conversion in progress; None if there is none."""
        return self._done_ns if self._converting else None

    def identify(self) -> None:
        """The identity register holds 0x55 (BMP-11)."""
        self.registers.expect(facts.CHIP_ID)

    def configure(self) -> None:
        """All `steps`."""
        carry_out(self.clock, self.steps())

    def steps(self) -> Iterator[float]:
        """Reset, then read the eleven calibration words; SensorError if one is 0 or 0xFFFF (BMP-31)."""
        self.registers.poke(facts.SOFT_RESET, _SOFT_RESET)
        yield _START_UP_S
        block = self.registers.peek(facts.CALIBRATION, 2 * len(facts.CALIBRATION_WORDS))
        self.words = calibration_words(block)
        if bad := [name for name, word in self.words.items() if word in (0, 0xFFFF, -1)]:
            raise SensorError(
                f"{self.registers.label}: calibration word {bad[0]} reads {self.words[bad[0]]}: not a BMP180"
            )
        self._due_ns, self._converting = self.clock.now_ns(), 0

    def mark(self, code: int) -> bool:
        """Do nothing: it has no byte to spare."""
        return False

    def self_test(self) -> SelfTest:
        """Replace the self-test that it lacks: one conversion, whose temperature and pressure must lie within the
        operating range (BMP-70).
        """
        self.configure()
        burst, tries, longest_ns = b"", 0, 0
        while not burst and tries < 100:
            asked_ns = self.clock.now_ns()
            sleep_for(self.clock, 0.005)
            burst, tries = self.fetch(), tries + 1
            longest_ns = max(longest_ns, self.clock.now_ns() - asked_ns)
        if not burst and longest_ns > _LASTING_NS // 2:
            slow = f"the bus takes {longest_ns * 1e-6:.0f} ms per transaction"
            return SelfTest(None, f"no self-test in the chip; {slow}, too slow to wait for a conversion")
        if not burst:
            return SelfTest(False, "no conversion within half a second")
        values = self.decode(np.frombuffer(burst, np.uint8).reshape(1, self.burst)).compensated
        temperature_degc, pressure_pa = float(values["temperature"][0]), float(values["pressure"][0])
        passed = -40 <= temperature_degc <= 85 and 30_000 <= pressure_pa <= 110_000
        return SelfTest(passed, f"no self-test in the chip; reads {temperature_degc:.1f} degC, {pressure_pa:.0f} Pa")

    def fetch(self) -> bytes:
        """UT and UP, five bytes, when a pair is complete; empty otherwise.

        A call that fails with OSError changes nothing and can be repeated; EIO if a conversion is overdue (BMP-46).
        """
        now_ns = self.clock.now_ns()
        if now_ns > self._done_ns + self._lasting_ns(now_ns):
            self._converting = 0
        if self._converting == 0:
            if now_ns >= self._due_ns:
                self._start(_TEMPERATURE, now_ns + _TEMPERATURE_NS)
                self._due_ns = max(self._due_ns + self.period_ns, now_ns)
            return b""
        if now_ns < self._done_ns:
            return b""
        if self._converting == _TEMPERATURE:
            temperature = self._result(2)
            self._start(_PRESSURE, self.clock.now_ns() + _PRESSURE_NS)
            self._temperature = temperature
            return b""
        pressure = self._result(3)
        self._converting = 0
        return self._temperature + pressure

    def _lasting_ns(self, now_ns: int) -> int:
        """Return how old a result may be in this call: where calls are rare, as old as the call interval."""
        seldom_ns = min(self._intervals_ns) if len(self._intervals_ns) == _CALLS else 0
        if self._called_ns is not None:
            self._intervals_ns.append(now_ns - self._called_ns)
        self._called_ns = now_ns
        return max(_LASTING_NS, 2 * seldom_ns)

    def _start(self, command: int, done_ns: int) -> None:
        self.registers.poke(facts.CTRL_MEAS, command)
        self._converting, self._done_ns = command, done_ns

    def _result(self, count: int) -> bytes:
        """`count` bytes of result, with the register in one burst that says whether the conversion is over."""
        block = self.registers.peek(facts.CTRL_MEAS, 2 + count)
        if facts.CONVERTING.of(block[0]):
            raise OSError(errno.EIO, f"{self.registers.label}: conversion not finished in time")
        return block[2:]

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """UT and UP as counts, temperature in degC and pressure in Pa beside them (BMP-47)."""
        wide = bursts.astype(np.int64)
        ut = wide[:, 0] << 8 | wide[:, 1]
        up = (wide[:, 2] << 16 | wide[:, 3] << 8 | wide[:, 4]) >> 8 - _OVERSAMPLING
        temperature_degc, pressure_pa = compensate(ut, up, self.words, _OVERSAMPLING)
        return barometer_readings(ut, up, temperature_degc, pressure_pa)

    def header(self) -> Mapping[str, int]:
        """The calibration words, without which the counts mean nothing."""
        return {**self.words, "oversampling": _OVERSAMPLING}


def calibration_words(block: bytes) -> Words:
    """The eleven words from the 22 bytes at 0xAA: most significant byte first, AC4 ... AC6 unsigned (BMP-20 ...
    BMP-30).
    """
    return {
        name: int.from_bytes(block[2 * index : 2 * index + 2], "big", signed=name not in _UNSIGNED)
        for index, name in enumerate(facts.CALIBRATION_WORDS)
    }
