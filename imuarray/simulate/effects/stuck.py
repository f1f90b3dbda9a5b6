"""`stuck`: the counts stand still for a while."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Codes, Place


@dataclass(frozen=True)
class Stuck(Effect):
    """From `onset_s` for `duration_s` seconds every reading is the last one before, temperature and all, not fresh; and
    again and again where `every_s` is given: free for so long on average, exponentially distributed, then held.

    Rows are counted at their nominal rate, row 0 at 0 s; with an onset of 0 the first reading stays. A chip stands
    still when its registers are locked (L3G-51: one byte of a pair unread; HMC-33: some of six; BMA-100: only high
    bytes read), in standby (ADX-38), or when it hangs. In data: long runs of identical triads.
    """

    name: ClassVar[str] = "stuck"
    onset_s: float = scalar(math.inf)
    duration_s: float = scalar(math.inf)
    every_s: float = scalar(math.inf)

    def __post_init__(self) -> None:
        """ValueError for a negative time."""
        super().__post_init__()
        require("onset_s", self.onset_s, 0.0)
        require("duration_s", self.duration_s, 0.0)
        require("every_s", self.every_s, 1e-3)

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Puts the last reading in the place of those that it outlasts."""
        first, stop = codes.first, codes.first + len(codes.counts)
        for begin, end in self._holds(stop, at):
            if begin < stop and end > first:
                codes = _held(codes, at.reaching(self.name, max(math.ceil(begin) - 1, 0)), begin, end)
        return codes

    def _holds(self, stop: int, at: Place) -> Iterator[tuple[float, float]]:
        """From which row to which readings are held, up to row `stop`."""
        free = at.boot_generator(self.name).exponential if math.isfinite(self.every_s) else lambda _: math.inf
        begin_s = self.onset_s if math.isfinite(self.onset_s) else free(self.every_s)
        while begin_s * at.rows_per_s < stop:
            end_s = begin_s + self.duration_s
            yield round(begin_s * at.rows_per_s, 6), round(end_s * at.rows_per_s, 6)
            begin_s = end_s + free(self.every_s)


def _held(codes: Codes, last: Codes, begin: float, end: float) -> Codes:
    rows = codes.first + np.arange(len(codes.counts))
    still = (rows >= max(begin, 1)) & (rows < end)
    counts = np.where(still[:, None], last.counts, codes.counts)
    temperature = codes.temperature_counts
    if temperature is not None and last.temperature_counts is not None:
        temperature = np.where(still, last.temperature_counts, temperature)
    return replace(codes, counts=counts, temperature_counts=temperature, fresh=codes.fresh & ~still)
