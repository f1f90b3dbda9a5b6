"""`own_clock`: the chip samples by its own clock and answers a poll with its latest reading."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.signal import Instants, Place

AT_ITS_RATE = 0.05
"""Relative tolerance within which rows at the chip's data rate are taken for its own readings, without a poll."""


@dataclass(frozen=True)
class OwnClock(Effect):
    """Reading k is taken at (k - phase_deg / 360) / (rate (1 + rate_error)), counted from the log's epoch.

    `rate_error` is relative. `phase_deg` / 360 is the part of a period that has passed at the epoch since the latest
    reading (nan: drawn at each boot). The oscillator of the BMA180 is within 10 % (BMA-107); the other data sheets
    print no tolerance. The noise does not change, because the filters run on the same clock. If the rows are the chip's
    own readings (a queue, an imported log) nothing happens, because their stamps are the times of the readings. Rows at
    the nominal rate of the chip count as such, unless `polled` (1) says that a host's clock timed them. In data:
    nothing at rest, unless the chip is polled faster than it samples; then more or fewer rows repeat the previous one.
    In motion a reading is 0 to 1 period old: a delay if polls and periods stay in step, otherwise a jitter that beats.
    """

    name: ClassVar[str] = "own_clock"
    rate_error: float = scalar(0.0, low=-0.5, high=0.5)
    phase_deg: float = scalar(0.0)
    polled: float = scalar(0.0)

    def __post_init__(self) -> None:
        """Raise ValueError for an infinite phase, or for a `polled` other than 0 and 1."""
        super().__post_init__()
        if math.isinf(self.phase_deg):
            raise ValueError(f"phase_deg: {self.phase_deg}; a number is required, or nan: drawn at each boot")
        if self.polled not in (0.0, 1.0):
            raise ValueError(f"polled: {self.polled:g}; allowed are 0 and 1")

    def lookback(self, at: Place) -> int:
        """Return the number of rows that may repeat one reading, plus one, if the actual rate is below that of the
        rows.
        """
        real_hz = at.sensor.rate_hz * (1 + self.rate_error)
        if not self.rate_error or not self._is_polled(at) or real_hz >= at.rows_per_s:
            return 0
        return math.ceil(at.rows_per_s / real_hz) + 1

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Set the actual rate, and the phase in periods."""
        if (self.rate_error, self.phase_deg) == (0.0, 0.0) or not self._is_polled(at):
            return instants
        rate_hz = instants.rate_hz * (1 + self.rate_error)
        return replace(instants, rate_hz=rate_hz, phase=instants.phase + self._phase(at))

    def _phase(self, at: Place) -> float:
        if not math.isnan(self.phase_deg):
            return self.phase_deg / 360
        return at.kept((self.name, "phase", at.copy), lambda: float(at.boot_generator(self.name).uniform()))

    def _is_polled(self, at: Place) -> bool:
        """Return whether the chip has a rate and is polled: its rows have another rate, or are known to be polls."""
        rate_hz = at.sensor.rate_hz
        return rate_hz > 0 and (bool(self.polled) or abs(at.rows_per_s / rate_hz - 1) > AT_ITS_RATE)
