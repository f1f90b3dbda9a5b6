"""`stale_samples`: a reading repeats the previous one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.signal import Codes, Place

_RARE = 1e-12


@dataclass(frozen=True)
class StaleSamples(Effect):
    """With `probability` a reading repeats the previous one: counts and temperature, not fresh.

    Repetitions of repetitions show the last reading that was not a repetition. Chains are cut at a length that all but
    10^-12 of them stay below: a row that would repeat for longer keeps its own reading. In reality, a register that is
    locked while a conversion ends (L3G-50, HMC-33) or a poll that occasionally overtakes the chip causes this. In data:
    identical triads, because all three axes repeat together; the lag-1 correlation of the noise rises to about
    `probability`.
    """

    name: ClassVar[str] = "stale_samples"
    probability: float = scalar(0.0, low=0.0, high=0.99)

    @property
    def longest(self) -> int:
        """Return the largest number of repetitions in a row."""
        return math.ceil(math.log(_RARE) / math.log(self.probability)) if self.probability else 0

    def lookback(self, at: Place) -> int:
        """Return the largest number of rows that affect a stretch: the longest chain and the row before it."""
        return self.longest + 1 if self.probability else 0

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Repeat rows. A row is fresh if a fresh reading arrived since the previous row."""
        if not self.probability:
            return codes
        rows = np.arange(len(codes.counts))
        stream = at.streams.of_boot(at.sensor.name, self.name, width=1)  # double precision: probabilities are small
        stale = stream.uniform(codes.first, codes.first + len(rows))[:, 0] < self.probability
        shown_rows = np.maximum.accumulate(np.where(stale, 0, rows))
        shown_rows = np.where(rows - shown_rows > self.longest, rows, shown_rows)
        arrived = np.cumsum(codes.fresh)[shown_rows]
        fresh = np.concatenate([codes.fresh[:1], arrived[1:] > arrived[:-1]])
        temperature = None if codes.temperature_counts is None else codes.temperature_counts[shown_rows]
        return replace(codes, counts=codes.counts[shown_rows], temperature_counts=temperature, fresh=fresh)
