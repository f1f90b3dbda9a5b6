"""`jitter`: every reading is stamped a little off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Reals
from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Instants, Place

_FREE = 0.9


@dataclass(frozen=True)
class Jitter(Effect):
    """instant = stamp + w, independent from row to row: w ~ N(0, rms_s^2) if all rows are off. If only a `share` is,
    these are late: w is exponential, of root mean square `rms_s` and so of mean rms_s / sqrt(2), as far as there is
    time until the next row, of which the other sensors take a tenth; what waits longer delays the rows after it, and
    their stamps say so.

    `rms_s` in seconds: what the scheduler of the logging computer puts between a burst and the reading of its clock;
    late are those before which another program had the processor. Where the times of a log's rows tell which these were
    (`imuarray.simulate.host_latency`), these are late and no others, by `told` of half of each wait: 1 if all of it lay
    before
    the transfer, -1 if behind it; rows that nobody was there to read are lost. In data: nothing at
    rest, unless a late reading is the one that the next row brings once more; under motion noise in proportion to how
    fast the signal changes, rms_s sqrt(share) |dx/dt|.
    """

    name: ClassVar[str] = "jitter"
    rms_s: float = scalar(0.0)
    share: float = scalar(1.0)
    told: float = scalar(0.0)

    def __post_init__(self) -> None:
        """ValueError for a negative or an absurd one, and for no share."""
        super().__post_init__()
        require("rms_s", self.rms_s, 0.0, 1e3)
        require("share", self.share, 0.0, 1.0)
        require("told", self.told, -1.0, 1.0)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Moves every instant by a draw of its own, or those that are told."""
        if self.told and at.waits is not None:
            halves, missed = at.waits(instants.first, instants.first + len(instants.stamp_ns))
            later = np.rint(self.told * halves).astype(np.int64)
            return replace(instants, instant_ns=instants.instant_ns + later, kept=instants.kept & ~missed)
        if not self.rms_s:
            return instants
        off = self._drawn(instants.first, instants.first + len(instants.stamp_ns), at)
        return replace(instants, instant_ns=instants.instant_ns + np.rint(off * (self.rms_s * 1e9)).astype(np.int64))

    def _drawn(self, first: int, stop: int, at: Place) -> Reals:
        """(n,) by how many `rms_s` each row is off."""
        if self.share == 1:
            return np.asarray(at.stream(self.name, width=1).normal(first, stop)[:, 0], float)
        chosen, late = at.streams.of_boot(at.sensor.name, self.name, "late", width=2).uniform(first, stop).T
        longest = _FREE / (at.rows_per_s * self.rms_s)
        within = -np.expm1(-np.sqrt(2) * longest)
        return np.where(chosen < self.share, -np.log1p(-within * late) / np.sqrt(2), 0.0)
