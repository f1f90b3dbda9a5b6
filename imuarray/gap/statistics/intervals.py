"""What a log records about its rows besides the values: times, flags, and words that no sensor sends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.characterise.stretch import GAP
from imuarray.gap.recording.source import DOUBTFUL
from imuarray.log.format import FLAGS, STALE

Counts = npt.NDArray[np.int16]

WORDS = (-1, 0)
"""Readings of all axes on a bus that floats high, or is held low (UM10204, 3.1.1)."""

_COUNTED = {**FLAGS, "doubtful": DOUBTFUL}

STALL = 20.0
"""Length of a gap, in usual intervals, from which on it is a stall of the recorder: shorter gaps are lost readings, of
which one or a few are missing at a time.
"""

APART = 16
"""Least distance, in rows, between two stale rows that count as two slips of the polls against the data clock."""

_QUARTILE = 0.75
"""Quantile of the first intervals with which gaps are compared."""

_TYPICAL = 1024
"""Number of first intervals from which this quantile is computed."""

_SHORTEST, _LONGEST, _BINS = 0.75, 1.25, 2048
"""Range of the histogram of intervals, in periods of the sensor's data, and its number of bins; two more bins contain
the intervals below and above the range.
"""


class Lengths(NamedTuple):
    """Histogram of intervals: number (k,) of intervals in each bin that is not empty, and their sum (k,) in s."""

    counts: Floats
    sums_s: Floats


_NO_LENGTHS = Lengths(np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class Intervals:
    """The `count + gaps` intervals between neighbouring rows: `mean_s` and `std_s` of the `count` intervals that are
    not gaps, and the `longest_s` of all; nan without intervals.

    A gap is longer than 1.5 times the upper quartile of the first 1024 intervals; `skips` of the gaps are shorter than
    `STALL` times this quartile. `shorter` of all intervals are shorter than the period of the sensor's data, with a
    mean of `shorter_s`; `lengths` is the histogram of all intervals, empty if that period is not known.
    """

    count: int
    mean_s: float
    std_s: float
    gaps: int
    longest_s: float
    shorter: int = 0
    shorter_s: float = 0.0
    skips: int = 0
    lengths: Lengths = _NO_LENGTHS


class IntervalMoments:
    """Accumulates the first and second moments of intervals, for data with the period `period_s` (0: unknown).
    `imuarray.characterise.IntervalTally` also computes medians, in 5 times the time and with 4 MB.
    """

    def __init__(self, period_s: float = 0.0) -> None:
        self._period_ns = 1e9 * period_s
        self._shorter, self._shorter_ns = 0, 0.0
        self._bins, self._bins_ns = np.zeros(_BINS + 2), np.zeros(_BINS + 2)
        self._last_ns: int | None = None
        self._waiting: list[Floats] = []
        self._typical_ns = self._longest_ns = 0.0
        self._count = self._gaps = self._skips = 0
        self._sum_ns = self._squares_ns2 = 0.0

    def update(self, time_ns: Times) -> None:
        """Add times (n,), ascending."""
        times = time_ns if self._last_ns is None else np.concatenate([[self._last_ns], time_ns])
        intervals = (times[1:] - times[:-1]).astype(float)
        self._last_ns = int(time_ns[-1])
        self._waiting.append(intervals)
        if self._typical_ns or sum(map(len, self._waiting)) >= _TYPICAL:
            self._add()

    def result(self) -> Intervals:
        """Return the moments of all intervals added so far."""
        self._add()
        if self._count == 0:
            return Intervals(0, np.nan, np.nan, self._gaps, np.nan, skips=self._skips)
        mean = self._sum_ns / self._count
        variance = max(self._squares_ns2 / self._count - mean**2, 0.0)
        seconds = ((mean + self._typical_ns) * 1e-9, variance**0.5 * 1e-9)
        shorter_s = 1e-9 * self._shorter_ns / max(self._shorter, 1)
        longest_s = self._longest_ns * 1e-9
        lengths = Lengths(self._bins[self._bins > 0], 1e-9 * self._bins_ns[self._bins > 0])
        return Intervals(self._count, *seconds, self._gaps, longest_s, self._shorter, shorter_s, self._skips, lengths)

    def _add(self) -> None:
        """Separate the pending intervals from gaps and add them to the sums."""
        intervals = np.concatenate([np.zeros(0), *self._waiting])
        self._waiting = []
        if len(intervals) == 0:
            return
        self._typical_ns = self._typical_ns or _quartile(intervals[:_TYPICAL])
        self._longest_ns = max(self._longest_ns, float(intervals.max()))
        if self._period_ns:
            is_shorter = intervals < self._period_ns
            self._shorter += int(np.count_nonzero(is_shorter))
            self._shorter_ns += float(intervals[is_shorter].sum())
            width = (_LONGEST - _SHORTEST) / _BINS
            places = ((intervals / self._period_ns - _SHORTEST) / width + 1).clip(0, _BINS + 1).astype(np.intp)
            self._bins += np.bincount(places, minlength=_BINS + 2)
            self._bins_ns += np.bincount(places, weights=intervals, minlength=_BINS + 2)
        from_typical = intervals - self._typical_ns
        if self._longest_ns > GAP * self._typical_ns:
            is_gap = intervals > GAP * self._typical_ns
            self._skips += int(np.count_nonzero(is_gap & (intervals < STALL * self._typical_ns)))
            from_typical = from_typical[~is_gap]
        self._count += len(from_typical)
        self._gaps += len(intervals) - len(from_typical)
        self._sum_ns += float(from_typical.sum())
        self._squares_ns2 += float(np.einsum("i,i->", from_typical, from_typical))  # einsum uses a single thread


def _quartile(values: Floats) -> float:
    """Return the upper quartile; `numpy.quantile` takes several times as long."""
    place = _QUARTILE * (len(values) - 1)
    low = int(place)
    ordered = np.sort(values)[low : low + 2]
    return float(ordered[0] + (place - low) * (ordered[-1] - ordered[0]))


class StatusTally:
    """Counts flags, and rows in which all axes read the same word of `WORDS`."""

    def __init__(self) -> None:
        self._flags = dict.fromkeys(_COUNTED, 0)
        self._words = self._slips = self._rows = 0
        self._last_stale = -APART

    @property
    def flags(self) -> Mapping[str, int]:
        """Number of rows so far with each flag, by the name of the flag."""
        return dict(self._flags)

    @property
    def words(self) -> int:
        """Number of rows so far whose three axes all read one of `WORDS`."""
        return self._words

    @property
    def slips(self) -> int:
        """Number of rows so far that are flagged as stale or doubtful and follow the previous such row by `APART` rows
        or more.
        """
        return self._slips

    def update(self, status: npt.NDArray[np.uint16], counts: Counts) -> None:
        """Add flags (n,) and counts (n, 3)."""
        if status.any():
            for name, flag in _COUNTED.items():
                self._flags[name] += int(np.count_nonzero(status & flag))
            stale = self._rows + np.flatnonzero(status & (STALE | DOUBTFUL))
            if len(stale):
                self._slips += int(np.count_nonzero(np.diff(stale, prepend=self._last_stale) >= APART))
                self._last_stale = int(stale[-1])
        self._rows += len(status)
        x, y, z = counts.T
        is_equal = (x == y) & (y == z)
        if is_equal.any():
            self._words += int(np.isin(x[is_equal], WORDS).sum())
