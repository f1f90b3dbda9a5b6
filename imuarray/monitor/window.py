"""The last seconds of one sensor's rows, with counts of delayed and missing rows.

Frames are read in alternating order: a sensor that is first in one frame is last in the next, so that the time to the
next row can be up to two periods, but the row after that is two periods away. Steps over two rows are therefore
evaluated. A missed frame makes two of them longer by one period, and a delayed frame one of them by its delay. If the
log states its frame rate, the number of missing rows is determined from it instead (`imuarray.log.missed_frames`).

`MemoryLog` is a log whose rows are in memory, for functions that read a log.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.errors import LogError
from imuarray.log import Log, SensorLog
from imuarray.log.columns import Column, LiveGroup

Attributes = Mapping[str, Any]


class _SensorsFile:
    """A file that has only sensors."""

    def __init__(self, sensors: Mapping[str, Any]) -> None:
        self.attrs: Attributes = {"source": "imported"}
        self._items = {"sensors": sensors}

    def get(self, name: str) -> Any:
        """Return a group; None if it does not exist."""
        return self._items.get(name)

    def __getitem__(self, name: str) -> Any:
        return self._items[name]

    def close(self) -> None:
        """Do nothing."""


class MemoryLog(Log):
    """A log of rows in memory: `sensors` are attributes and columns by name; LogError for invalid attributes. It has no
    phases, no events and no truth, and can't be sent to another process.
    """

    def __init__(self, path: Path, sensors: Mapping[str, tuple[Attributes, Rows]]) -> None:
        self.path = path
        groups = {}
        for name, (attributes, rows) in sensors.items():
            columns = {key: Column(key, np.ascontiguousarray(values)) for key, values in rows.items()}
            groups[name] = LiveGroup(f"/sensors/{name}", attributes, columns)
        self._opened, self._damaged = cast(h5py.File, _SensorsFile(groups)), []
        self.sensors = {
            name: SensorLog(group, f"{path}, sensor {name}", self, _not_sent) for name, group in groups.items()
        }


def _not_sent(path: Path) -> Log:
    raise LogError(f"{path}: its last rows are in the memory of another process")


Rows = Mapping[str, npt.NDArray[Any]]
"""Columns of equal length by name, as a log has them."""

MOST_ROWS = 1 << 16
"""Largest number of rows of a window, whatever its duration: 20 s at 3200 Hz."""

STRIDE = 2
"""Number of rows from a row to the next that was read in the same order."""

_DELAYED = 0.25
"""Share of a period above which a frame counts as delayed."""
_FEWEST = 8
"""Least number of rows from which a period is determined."""


@dataclass(frozen=True)
class Gaps:
    """Rows that were `delayed`, and twice the number of missing rows (each changes two steps)."""

    delayed: int = 0
    twice_missed: int = 0

    def __add__(self, other: Gaps) -> Gaps:
        return Gaps(self.delayed + other.delayed, self.twice_missed + other.twice_missed)

    @property
    def missed(self) -> int:
        """The number of rows that are missing between others."""
        return max(0, self.twice_missed // STRIDE)


def period_of(time: Times) -> float:
    """Return the usual step in ns between consecutive times (n,); 0 if there are too few."""
    return float(np.median(time[STRIDE:] - time[:-STRIDE])) / STRIDE if len(time) >= _FEWEST else 0.0


def gaps_of(time: Times, period_ns: float) -> Gaps:
    """Return the gaps among the times (n,) of a sensor's rows, which are usually `period_ns` apart."""
    if period_ns <= 0 or len(time) <= STRIDE:
        return Gaps()
    periods = (time[STRIDE:] - time[:-STRIDE]) / period_ns
    whole = np.rint(periods)
    return Gaps(int((periods - whole > _DELAYED).sum()), int((whole - STRIDE).sum()))


class LatestRows:
    """The rows of one sensor of the last `span_ns`: `rows`, columns by name; `period_ns` between two of them (0: too
    few yet); `total` rows of the log so far, those before the window too, `newest` (up to 2,) ns of the last of them;
    `gaps` of all rows that were added, and `peak_lsb`, the largest magnitude of each column of counts in them.
    """

    def __init__(self, span_ns: int) -> None:
        self._span_ns = span_ns
        self.rows: Rows = {}
        self.total = 0
        self.first_ns: int | None = None
        self.gaps = Gaps()
        self.newest: Times = np.empty(0, np.int64)
        self.period_ns = 0.0
        self._earlier_ns = 0.0
        self.peak_lsb: Floats | None = None

    @property
    def time(self) -> Times:
        """(n,) ns of the rows."""
        return np.asarray(self.rows.get("time", np.empty(0, np.int64)))

    @property
    def usual_ns(self) -> float:
        """The usual time between two rows, also of a sensor that fell silent before the window; 0: too few rows."""
        return self.period_ns or self._earlier_ns

    def begins_behind(self, rows: int, column: Any) -> None:
        """Note that the first `rows` of a column of times are before those that will be added."""
        if not rows:
            return
        self.total += rows
        self.first_ns = int(column[0]) if self.first_ns is None else self.first_ns
        last = np.asarray(column[max(0, rows - _FEWEST) : rows], np.int64)
        self.newest, self._earlier_ns = last[-STRIDE:], period_of(last)

    def forget(self, before_ns: int) -> None:
        """Remove older rows, also of a sensor that became silent and adds no new ones."""
        start = int(np.searchsorted(self.time, before_ns))
        if start:
            self.rows = {name: column[start:].copy() for name, column in self.rows.items()}

    def add(self, rows: Rows) -> int:
        """Add rows that are newer than the existing ones, and return their number; others are ignored."""
        new = np.asarray(rows["time"])
        fresh = int(np.searchsorted(new, self.newest[-1], side="right")) if len(self.newest) else 0
        count = len(new) - fresh
        if not count:
            return 0
        self.total += count
        self.first_ns = int(new[fresh]) if self.first_ns is None else self.first_ns
        largest = np.abs(np.asarray(rows["counts"][fresh:], float)).max(axis=0)
        self.peak_lsb = largest if self.peak_lsb is None else np.maximum(self.peak_lsb, largest)
        columns = {
            name: np.concatenate([self.rows[name], rows[name][fresh:]]) if self.rows else rows[name] for name in rows
        }
        self._count(np.asarray(columns["time"]), new[fresh:])
        self.newest = np.concatenate([self.newest, new[fresh:]])[-STRIDE:]
        start = int(np.searchsorted(columns["time"], int(new[-1]) - self._span_ns))
        start = max(start, len(columns["time"]) - MOST_ROWS)
        self.rows = {name: column[start:].copy() for name, column in columns.items()}  # a view would keep all rows
        return count

    def _count(self, time: Times, new: Times) -> None:
        """Count the gaps among the `new` rows; when the period becomes known, among all rows of the window."""
        has_period = self.period_ns > 0
        self.period_ns = period_of(time) or self.period_ns
        self.gaps += gaps_of(np.concatenate([self.newest, new]) if has_period else time, self.period_ns)
