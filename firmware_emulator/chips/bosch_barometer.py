"""The measurements of a Bosch barometer that sleeps, measures once in forced mode, or measures periodically.

BMP280 and BMP388 differ in registers, times and formulas; the times of their measurements and the memory of their
filters are the same. Of measurements that were not read, only the last 64 pass through the filter (DEC-91, DEC-222).
"""

from __future__ import annotations

import random
from abc import abstractmethod
from collections.abc import Mapping
from types import ModuleType
from typing import ClassVar

from firmware_emulator.chip import Chip, Element

FAR_NS = 1 << 62
START_UP_NS = 2_000_000  # BMP-113, BMP-212
SOFT_RESET = 0xB6  # BMP-104, BMP-204
SLEEP, FORCED, FORCED_TOO, NORMAL = range(4)  # BMP-107, BMP-207
FILTERED = 64


class BoschBarometer(Chip):
    """A barometer whose measurements end at the times of its mode.

    `facts` are the registers of the chip, `control` is the address of the one with the mode.
    """

    facts: ClassVar[ModuleType]
    control: int

    def __init__(
        self,
        address: int,
        element: Element,
        powered_on_ns: int = 0,
        *,
        calibration: Mapping[str, int] | None = None,
        generator: random.Random | None = None,
        identity: int | None = None,
    ) -> None:
        """`calibration` holds the words by name that differ from the data sheet's example, `generator` draws the
        pressure noise (without one there is none; temperature noise is left out), `identity` is the content of the
        identity register (None: as the data sheet prints).
        """
        self._generator, self._identity = generator, identity
        self._ut_at: tuple[float, int] = (float("nan"), 0)
        self.take_words(calibration or {})
        super().__init__(address, self.facts, element, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Reset values, this part's identity and calibration words, asleep."""
        super().power_on(at_ns)
        identity = self.facts.CHIP_ID
        self.page[identity.address] = identity.reset if self._identity is None else self._identity
        calibration = self.calibration_bytes()
        first = self.facts.CALIBRATION.address
        self.page[first : first + len(calibration)] = calibration
        self._ready_ns = at_ns + START_UP_NS
        self._end_ns = FAR_NS
        self._memory: tuple[float, float] | None = None

    # What the chips differ in -----------------------------------------------------------------------------------------

    @abstractmethod
    def take_words(self, calibration: Mapping[str, int]) -> None:
        """Set the calibration words, of which `calibration` holds those that differ from the data sheet's example."""

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
        if self.facts.MODE.of(self.page[self.control]) != NORMAL:
            ended_ns, self._end_ns = self._end_ns, FAR_NS
            self.page[self.control] &= ~self.facts.MODE.mask & 0xFF
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
        return 0.0 if self._generator is None else self._generator.gauss(0.0, rms)

    def ut(self, at_ns: int) -> int:
        """The word of the temperature at that time, computed once for each temperature."""
        degc = self.element.temperature(at_ns)
        if degc != self._ut_at[0]:
            self._ut_at = degc, self.ut_of(degc)
        return self._ut_at[1]

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """A burst shows the registers as they are when it begins (BMP-112, BMP-211)."""
        return super().read(count, at_ns, 0)
