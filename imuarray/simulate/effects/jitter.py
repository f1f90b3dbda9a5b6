"""`jitter`: time stamps of readings scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Reals
from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.signal import Instants, Place

_FREE = 0.9


@dataclass(frozen=True)
class Jitter(Effect):
    """instant = stamp + w, independent from row to row. w ~ N(0, rms_s^2) if all rows are affected. If only a `share`
    is, these rows are late: w is exponential with the root mean square `rms_s` and the mean rms_s / sqrt(2). It is
    cut off at the next row, of which the other sensors take a tenth: a longer wait delays the following rows, as
    their stamps show.

    `rms_s` in seconds is the time that the scheduler of the logging computer inserts between a burst and the reading of
    its clock. Rows are late if another program had the processor. If the times of a log's rows show which rows these
    were (`imuarray.simulate.host_latency`), exactly these rows are late, by `wait_share` of half of each wait: 1 if all
    of it was before the transfer, -1 if it was after it. Rows that no process was ready to read are lost.

    At rest nothing changes, unless the next row repeats a late reading. Under motion it is noise in proportion to the
    rate of change of the signal, rms_s sqrt(share) |dx/dt|.
    """

    name: ClassVar[str] = "jitter"
    rms_s: float = scalar(0.0, low=0.0, high=1e3)
    share: float = scalar(1.0, low=0.0, high=1.0)
    wait_share: float = scalar(0.0, low=-1.0, high=1.0)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Shift the times of all readings at random, or those of the rows whose waits are known."""
        if self.wait_share and at.waits is not None:
            halves, missed = at.waits(instants.first, instants.first + len(instants.stamp_ns))
            later = np.rint(self.wait_share * halves).astype(np.int64)
            return replace(instants, instant_ns=instants.instant_ns + later, kept=instants.kept & ~missed)
        if not self.rms_s:
            return instants
        delay = self._drawn(instants.first, instants.first + len(instants.stamp_ns), at)
        return replace(instants, instant_ns=instants.instant_ns + np.rint(delay * (self.rms_s * 1e9)).astype(np.int64))

    def _drawn(self, first: int, stop: int, at: Place) -> Reals:
        """Return (n,) the deviation of each row in units of `rms_s`."""
        if self.share == 1:
            return np.asarray(at.stream(self.name, width=1).normal(first, stop)[:, 0], float)
        chosen, late = at.streams.of_boot(at.sensor.name, self.name, "late", width=2).uniform(first, stop).T
        longest = _FREE / (at.rows_per_s * self.rms_s)
        within = -np.expm1(-np.sqrt(2) * longest)
        return np.where(chosen < self.share, -np.log1p(-within * late) / np.sqrt(2), 0.0)
