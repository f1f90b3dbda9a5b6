"""The measurements of a Bosch barometer that sleeps, measures once in forced mode, or measures periodically.

BMP280 and BMP388 differ in registers, times and formulas; the times of their measurements and the memory of their
filters are the same. Of measurements that were not read, only the last 64 pass through the filter (DEC-91, DEC-222).
"""

from __future__ import annotations

import random
from abc import abstractmethod
from types import ModuleType
from typing import NamedTuple

from firmware_emulator.chip import Chip, Element

FAR_NS = 1 << 62
START_UP_NS = 2_000_000  # BMP-113, BMP-212
SOFT_RESET = 0xB6  # BMP-104, BMP-204
SLEEP, FORCED, FORCED_TOO, NORMAL = range(4)  # BMP-107, BMP-207
FILTERED = 64


class Part(NamedTuple):
    """One part: where its pressure noise is drawn from (without a generator there is none; temperature noise is left
    out), and what its identity register says (None: as the data sheet prints).
    """

    generator: random.Random | None = None
    identity: int | None = None


class BoschBarometer(Chip):
    """A barometer whose measurements end at the times of its mode.

    `control` is the address of the register with the mode.
    """

    control: int

    def __init__(self, address: int, facts: ModuleType, element: Element, powered_on_ns: int, part: Part) -> None:
        self._part = part
        self._facts = facts
        self._ut_at: tuple[float, int] = (float("nan"), 0)
        super().__init__(address, facts, element, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Reset values, this part's identity and calibration words, asleep."""
        super().power_on(at_ns)
        identity = self._facts.CHIP_ID
        self.page[identity.address] = identity.reset if self._part.identity is None else self._part.identity
        calibration = self.calibration_bytes()
        first = self._facts.CALIBRATION.address
        self.page[first : first + len(calibration)] = calibration
        self._ready_ns = at_ns + START_UP_NS
        self._end_ns = FAR_NS
        self._memory: tuple[float, float] | None = None

    # What the chips differ in -----------------------------------------------------------------------------------------

    @abstractmethod
    def calibration_bytes(self) -> bytes:
        """The calibration words as they stand in the registers."""

    @property
    @abstractmethod
    def duration_ns(self) -> int:
        """Time of one measurement with the present settings."""

    @property
    @abstractmethod
    def period_ns(self) -> int:
        """Time from one measurement to the next in normal mode."""

    @property
    @abstractmethod
    def filter_divisor(self) -> int:
        """Divisor by which the filter takes a new value in; 1: no filter."""

    @abstractmethod
    def show(self, at_ns: int) -> None:
        """Measure, and write the result into the data registers."""

    @abstractmethod
    def ut_of(self, degc: float) -> int:
        """The word of a temperature."""

    # What they have in common -----------------------------------------------------------------------------------------

    def begin(self, mode: int, at_ns: int) -> None:
        """Take up a mode: measurements end from now on."""
        self._end_ns = FAR_NS if mode == SLEEP else at_ns + self.duration_ns

    def sync(self, at_ns: int) -> None:
        """Every measurement that has ended by `at_ns` into the data registers."""
        if at_ns < self._end_ns:
            return
        if self._facts.MODE.of(self.page[self.control]) != NORMAL:
            ended_ns, self._end_ns = self._end_ns, FAR_NS
            self.page[self.control] &= ~self._facts.MODE.mask & 0xFF
            self.show(ended_ns)
            return
        period_ns = self.period_ns
        count = (at_ns - self._end_ns) // period_ns + 1
        for number in range(max(0, count - (FILTERED if self.filter_divisor > 1 else 1)), count):
            self.show(self._end_ns + number * period_ns)
        self._end_ns += count * period_ns

    def filtered(self, ut: int, up: int) -> tuple[float, float]:
        """Both words behind the filter, which takes the first ones as they are."""
        new, divisor = (float(ut), float(up)), self.filter_divisor
        old = self._memory or new
        self._memory = old[0] + (new[0] - old[0]) / divisor, old[1] + (new[1] - old[1]) / divisor
        return self._memory

    def noise_pa(self, rms: float) -> float:
        """Noise of the next reading of pressure."""
        return 0.0 if self._part.generator is None else self._part.generator.gauss(0.0, rms)

    def ut(self, at_ns: int) -> int:
        """The word of the temperature at that time, computed once for each temperature."""
        degc = self.element.temperature(at_ns)
        if degc != self._ut_at[0]:
            self._ut_at = degc, self.ut_of(degc)
        return self._ut_at[1]

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """A burst shows the registers as they are when it begins (BMP-112, BMP-211)."""
        return super().read(count, at_ns, 0)
