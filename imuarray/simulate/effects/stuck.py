"""`stuck`: the counts stand still for a while."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Codes, Place


@dataclass(frozen=True)
class Stuck(Effect):
    """From `onset_s` for `duration_s` seconds every reading is the last one before, temperature and all, not fresh.

    Rows are counted at their nominal rate, row 0 at 0 s; with an onset of 0 the first reading stays. A chip stands
    still when its registers are locked (L3G-51: one byte of a pair unread; HMC-33: some of six; BMA-100: only high
    bytes read), in standby (ADX-38), or when it hangs. In data: one long run of identical triads.
    """

    name: ClassVar[str] = "stuck"
    onset_s: float = scalar(math.inf)
    duration_s: float = scalar(math.inf)

    def __post_init__(self) -> None:
        """ValueError for a negative time."""
        super().__post_init__()
        require("onset_s", self.onset_s, 0.0)
        require("duration_s", self.duration_s, 0.0)

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Puts the last reading in the place of those that it outlasts."""
        begin, end = (round(time_s * at.rows_per_s, 6) for time_s in (self.onset_s, self.onset_s + self.duration_s))
        rows = codes.first + np.arange(len(codes.counts))
        still = (rows >= max(begin, 1)) & (rows < end)
        if not still.any():
            return codes
        last = at.reaching(self.name, max(math.ceil(begin) - 1, 0))
        counts = np.where(still[:, None], last.counts, codes.counts)
        temperature = codes.temperature_counts
        if temperature is not None and last.temperature_counts is not None:
            temperature = np.where(still, last.temperature_counts, temperature)
        return replace(codes, counts=counts, temperature_counts=temperature, fresh=codes.fresh & ~still)
