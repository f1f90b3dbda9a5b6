"""Bosch barometers: calibration words, pressure noise, and the measurements of chips with forced and normal mode."""

from __future__ import annotations

import random
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal

from firmware_emulator.chip import NEVER_NS, Chip

START_UP_NS = 2_000_000  # BMP-113, BMP-212
SOFT_RESET = 0xB6  # BMP-12, BMP-104, BMP-204
SLEEP, FORCED, FORCED_TOO, NORMAL = range(4)  # BMP-107, BMP-207
FILTERED = 64


class BoschBarometer(Chip):
    """A barometer with calibration words in its registers; its next conversion ends at `_end_ns`.

    `words` are the calibration words, by default those of the data sheet's
    example; `word_bytes` is the size of each in the registers. Commands in the first `start_up_ns` after power-on or
    reset are lost.
    """

    words: Any
    temperature_word: Callable[[Any, float], int]
    """The inverse of the data sheet's formula: the raw word of a temperature in degC, by calibration words."""
    word_bytes: ClassVar[Sequence[int]]
    byte_order: ClassVar[Literal["little", "big"]] = "little"
    start_up_ns = START_UP_NS

    def __init__(
        self,
        *arguments: Any,
        calibration: Mapping[str, int] | None = None,
        generator: random.Random | None = None,
        **switches: Any,
    ) -> None:
        """Create the chip. `calibration` contains the words, by name, that differ from the data sheet's example;
        `generator` draws the pressure noise (None: no noise; temperature noise is not modelled: BMP-77).
        """
        self._generator = generator
        self._ut_at: tuple[float, int] = (float("nan"), 0)
        self.words = self.words._replace(**(calibration or {}))
        super().__init__(*arguments, **switches)

    def power_on(self, at_ns: int) -> None:
        """Set the reset values and this part's calibration words; no conversion is in progress."""
        super().power_on(at_ns)
        calibration = b"".join(
            (word & (1 << 8 * count) - 1).to_bytes(count, self.byte_order)
            for word, count in zip(self.words, self.word_bytes, strict=True)
        )
        first = self.table.CALIBRATION.address
        self.page[first : first + len(calibration)] = calibration
        self._ready_ns = at_ns + self.start_up_ns
        self._end_ns = NEVER_NS

    def ut(self, at_ns: int) -> int:
        """Return the raw word of the temperature at that time, computed once for each temperature."""
        degc = self.element.temperature(at_ns)
        if degc != self._ut_at[0]:
            self._ut_at = degc, self.temperature_word(self.words, degc)
        return self._ut_at[1]

    def pressure_pa(self, at_ns: int, noise_pa: float) -> float:
        """Return the pressure in Pa at that time, with noise of this rms."""
        noise = 0.0 if self._generator is None else self._generator.gauss(0.0, noise_pa)
        return self.element.pressure(at_ns) + noise


class CyclicBarometer(BoschBarometer):
    """A barometer that sleeps, measures once in forced mode, or measures periodically.

    `control` is the address of the register with the mode. BMP280 and BMP388 differ in registers, times and formulas;
    the sequence of their measurements and the memory of their filters are the same. If measurements are not read, only
    the last 64 of them pass through the filter (DEC-91, DEC-222).
    """

    control: int

    def power_on(self, at_ns: int) -> None:
        """Start up asleep, with an empty filter."""
        super().power_on(at_ns)
        self._memory: tuple[float, float] | None = None

    @property
    @abstractmethod
    def duration_ns(self) -> int:
        """Return the time of one measurement with the present settings."""

    @property
    @abstractmethod
    def period_ns(self) -> int:
        """Return the time from one measurement to the next in normal mode."""

    @property
    @abstractmethod
    def filter_divisor(self) -> int:
        """Return the divisor by which the filter weights a new value; 1: no filter."""

    @abstractmethod
    def show(self, at_ns: int) -> None:
        """Measure, and write the result into the data registers."""

    def begin(self, mode: int, at_ns: int) -> None:
        """Start a mode; its first measurement begins now."""
        self._end_ns = NEVER_NS if mode == SLEEP else at_ns + self.duration_ns

    def sync(self, at_ns: int) -> None:
        """Write every measurement that has ended by `at_ns` into the data registers."""
        if at_ns < self._end_ns:
            return
        if self.table.MODE.of(self.page[self.control]) != NORMAL:
            ended_ns, self._end_ns = self._end_ns, NEVER_NS
            self.page[self.control] &= ~self.table.MODE.mask & 0xFF
            self.show(ended_ns)
            return
        period_ns = self.period_ns
        count = (at_ns - self._end_ns) // period_ns + 1
        for number in range(max(0, count - (FILTERED if self.filter_divisor > 1 else 1)), count):
            self.show(self._end_ns + number * period_ns)
        self._end_ns += count * period_ns

    def filtered(self, ut: int, up: int) -> tuple[float, float]:
        """Return both words after the filter, which does not change the first ones."""
        new, divisor = (float(ut), float(up)), self.filter_divisor
        old = self._memory or new
        self._memory = old[0] + (new[0] - old[0]) / divisor, old[1] + (new[1] - old[1]) / divisor
        return self._memory

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read a burst; all its bytes are those at its beginning (BMP-112, BMP-211)."""
        return super().read(count, at_ns, 0)


def nearest(function: Callable[[int], float], low: int, high: int, target: float) -> int:
    """Return the argument in low ... high at which a rising function is closest to `target`; the lower one of two
    equally close ones.
    """
    bottom, top = low, high
    while bottom < top:
        middle = bottom + top >> 1
        if function(middle) < target:
            bottom = middle + 1
        else:
            top = middle
    if bottom > low and target - function(bottom - 1) <= function(bottom) - target:
        return bottom - 1
    return bottom
