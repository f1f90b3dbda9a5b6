"""Rows that a sensor lost, detected with another sensor that is stamped together with it.

A program that reads two sensors at once, or writes them into one table, gives their rows equal stamps. A stamp that
only one of them has is a lost row of the other, however irregular the stamps are. `imuarray.simulate.timeline.filled`
detects lost rows between regular rows only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Integers
from imuarray.log import Log, SensorLog
from imuarray.simulate.timeline import GapFilledTimes, Timeline

MOST_LOST = 0.2
"""Largest share of the other sensor's rows that may be lost: a sensor with fewer rows is read less often."""

_FIRST_ROWS = 4096
"""Number of first rows that are compared to reject most pairs of sensors without common stamps."""


@dataclass(frozen=True, eq=False)
class RowSelection:
    """Rows `chosen` (n,), ascending, of the timeline `whole`; a timeline."""

    whole: Timeline
    chosen: Integers

    @property
    def rows(self) -> int:
        """The number of chosen rows."""
        return len(self.chosen)

    @property
    def rows_per_s(self) -> float:
        """Mean rate of the chosen rows."""
        return self.whole.rows_per_s * self.rows / self.whole.rows

    def stamps(self, start: int, stop: int) -> Integers:
        """Return (stop - start,) ns since the log's epoch."""
        if stop <= start:
            return np.zeros(0, np.int64)
        first, last = int(self.chosen[start]), int(self.chosen[stop - 1])
        return np.asarray(self.whole.stamps(first, last + 1)[self.chosen[start:stop] - first])


def add_lost_rows(log: Log, lines: Mapping[str, Timeline]) -> dict[str, Timeline]:
    """Return the timelines of sensors with the rows that they lost, where another sensor has these rows and equal
    stamps otherwise.

    Timelines that already have lost rows are not changed. The stamps of sensors with common stamps are read once.
    """
    complete = dict(lines)
    names = [name for name, line in lines.items() if not isinstance(line, GapFilledTimes)]
    by_length = sorted(names, key=lambda name: -len(log[name]))
    for name in names:
        for other in by_length:
            chosen = _rows_of_other(log[name], log[other])
            if chosen is not None:
                steps = np.diff(chosen)
                before = np.flatnonzero(steps > 1) + 1
                complete[name] = GapFilledTimes(RowSelection(lines[other], chosen), before, steps[before - 1] - 1)
                break
    return complete


def _rows_of_other(sensor: SensorLog, other: SensorLog) -> Integers | None:
    """Return the rows (n,) of the other sensor with the same stamps as the n rows of a sensor, which has fewer rows.
    None if a stamp is missing in the other sensor, or if the sensor lost no row between two of its own.
    """
    rows, of_other = len(sensor), len(other)
    if not (1 - MOST_LOST) * of_other <= rows < of_other or rows < 2:
        return None
    if not np.isin(sensor.time[:_FIRST_ROWS], other.time[: 2 * _FIRST_ROWS]).all():
        return None
    stamps, others = np.asarray(sensor.time[:], np.int64), np.asarray(other.time[:], np.int64)
    chosen = np.searchsorted(others, stamps)
    is_shared = (chosen < of_other) & (others[np.minimum(chosen, of_other - 1)] == stamps)
    steps = np.diff(chosen)
    return chosen if is_shared.all() and (steps > 1).any() else None
