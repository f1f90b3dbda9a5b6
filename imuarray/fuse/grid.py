"""The times of the frames: those of a sensor that is read in the middle of them, and of others while it is silent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.errors import FusionError
from imuarray.fuse.frames import Floats, Times
from imuarray.fuse.rows import FOREVER_NS

FIRST_ROWS = 64
"""Rows of each sensor by which the grid is chosen."""

_APART = 0.9
"""Share of a period within which two rows are of one frame."""
_SILENT = 1.75
"""Periods without a row after which others stand in: more than a frame that takes longer than others."""
_ALIKE = 0.25
"""Share by which periods of sensors that are read once a frame may differ."""
_TIE = 0.001
"""Share of a period by which a sensor must lie nearer to the middle to be taken in place of an earlier one."""


@dataclass(frozen=True)
class Grid:
    """`order`: the sensors (numbers) whose times make the grid, the best first; `period_ns` of a frame."""

    order: tuple[int, ...]
    period_ns: float

    @property
    def ahead_ns(self) -> int:
        """How far beyond a time every row must be known for it to be certain whether it is in the grid."""
        return round(_SILENT * len(self.order) * self.period_ns)

    def times(self, rows: Sequence[Times]) -> Times:
        """The grid over some rows of all sensors: those of the best one, and of each further one those in the pauses of
        the better ones. Certain up to `ahead_ns` from either end.
        """
        kept = rows[self.order[0]]
        for number in self.order[1:]:
            more = rows[number]
            if len(more := self._between(kept, more)):
                kept = np.sort(np.concatenate([kept, more]))
        return kept

    def _between(self, kept: Times, more: Times) -> Times:
        """Those of `more` that stand in the pauses of `kept`; before its first and after its last row is a pause."""
        edges = np.concatenate([[-FOREVER_NS // 2], kept, [FOREVER_NS // 2]])  # their difference is a time too
        pauses = np.flatnonzero(np.diff(edges) >= _SILENT * self.period_ns)
        apart_ns = round(_APART * self.period_ns)
        first = np.searchsorted(more, edges[pauses] + apart_ns)
        last = np.searchsorted(more, edges[pauses + 1] - apart_ns, "right")
        return np.concatenate([more[:0], *(more[start:stop] for start, stop in zip(first, last, strict=True))])


def choose(first: Sequence[Times], groups: Sequence[Sequence[int]], where: Sequence[str]) -> Grid:
    """The grid that costs least, by the `first` rows (at most `FIRST_ROWS` of each sensor); FusionError if there are
    too few.

    What a sensor that is read `late` did meanwhile is taken out with a slope that has noise: a quantity pays for the
    mean delay of its sensors, so that the largest of these (of the quantities' `groups` of sensors) is to be small.
    """
    enough = [number for number, time in enumerate(first) if len(time) >= 3]
    if not enough:
        raise FusionError(f"{where[0]}: {len(first[0])} rows, nothing to fuse")
    periods = {number: _period_ns(first[number]) for number in enough}
    usual = sorted(periods.values())[(len(periods) - 1) // 2]  # of two halves the faster one: no reading is passed over
    regular = [number for number in enough if abs(periods[number] - usual) <= _ALIKE * usual]
    delays = {number: _delay(first[number], first, groups, usual) for number in regular}
    best = sorted(regular, key=lambda number: (round(delays[number] / _TIE), number))
    return Grid(tuple(best), periods[best[0]])


def _period_ns(time: Times) -> float:
    """Over two rows: a sensor that is read from either end of the frames in turn comes early and late in turn."""
    return float(np.median(time[2:] - time[:-2])) / 2


def _delay(grid: Times, first: Sequence[Times], groups: Sequence[Sequence[int]], period_ns: float) -> float:
    """The largest mean delay of a quantity's readings behind `grid`, as a share of the period."""
    means = []
    for group in groups:
        delays = [np.mean(late) for number in group if len(late := _late(grid, first[number], period_ns))]
        means.append(abs(float(np.mean(delays))) if delays else 0.0)
    return max(means, default=0.0)


def _late(grid: Times, time: Times, period_ns: float) -> Floats:
    """Delays of the readings nearest to `grid`, of those within half a period, as shares of it."""
    if len(time) == 0:
        return np.zeros(0)
    late = (time[nearest(time, grid)] - grid) / period_ns
    return np.asarray(late[np.abs(late) <= 0.5])


def nearest(time: Times, grid: Times) -> Times:
    """(n,) the index of the row of `time` (k,), k > 0, that is nearest to each of `grid` (n,)."""
    after = np.minimum(np.searchsorted(time, grid), len(time) - 1)
    before = np.maximum(after - 1, 0)
    return np.asarray(np.where(grid - time[before] <= time[after] - grid, before, after))
