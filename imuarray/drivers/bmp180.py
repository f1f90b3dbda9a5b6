"""BMP180 barometer. Bosch data sheet v2.8 (2015); facts BMP-*.

It converts only on command, temperature first, then pressure, into the same registers (BMP-48). No call waits for it:
each call of `fetch` checks whether a conversion that was started earlier must be over by now, and starts the next. The
conversion of its words to degrees and pascals is in `imuarray.barometer`.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from imuarray.arrays import Integers
from imuarray.barometer import Words
from imuarray.drivers.driver import Bytes
from imuarray.drivers.on_demand_barometer import OnDemandBarometer
from imuarray.errors import SensorError
from imuarray.facts import bmp180 as facts

_SOFT_RESET = 0xB6
_START_UP_S = 0.010  # BMP-50
_TEMPERATURE = 0x2E  # BMP-40
_PRESSURE = 0xF4  # eight samples, the quietest: BMP-44
_OVERSAMPLING = 3
_TEMPERATURE_NS = 4_500_000  # longest conversions: BMP-40, BMP-44
_PRESSURE_NS = 25_500_000
_UNSIGNED = ("AC4", "AC5", "AC6")  # BMP-23 ... BMP-25


class Bmp180(OnDemandBarometer):
    """Driver of one BMP180; one reading is an uncompensated temperature and an uncompensated pressure."""

    burst: ClassVar[int] = 5
    reading: ClassVar[slice] = slice(0, 5)
    conversions_ns: ClassVar[tuple[int, ...]] = (_TEMPERATURE_NS, _PRESSURE_NS)
    limits_pa: ClassVar[tuple[float, float]] = (30_000.0, 110_000.0)  # BMP-70
    _converting = 0
    _temperature = b""

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
        self.begin()

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
        self.registers.poke(facts.CTRL_MEAS, command)
        self._converting, self._done_ns = command, done_ns

    def _result(self, count: int) -> bytes:
        """Read `count` bytes of the result, in one burst with the register that shows whether the conversion is
        over.
        """
        block = self.registers.peek(facts.CTRL_MEAS, 2 + count)
        if facts.CONVERTING.of(block[0]):
            raise OSError(errno.EIO, f"{self.registers.label}: conversion not finished in time")
        return block[2:]

    def words_of(self, bursts: Bytes) -> tuple[Integers, Integers]:
        """Return sixteen bits of temperature, then nineteen of pressure (BMP-47)."""
        wide = bursts.astype(np.int64)
        up = (wide[:, 2] << 16 | wide[:, 3] << 8 | wide[:, 4]) >> 8 - _OVERSAMPLING
        return wide[:, 0] << 8 | wide[:, 1], up


def calibration_words(block: bytes) -> Words:
    """Return the eleven words from the 22 bytes at 0xAA: most significant byte first, AC4 ... AC6 unsigned (BMP-20 ...
    BMP-30).
    """
    return {
        name: int.from_bytes(block[2 * index : 2 * index + 2], "big", signed=name not in _UNSIGNED)
        for index, name in enumerate(facts.CALIBRATION_WORDS)
    }
