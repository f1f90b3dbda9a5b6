"""A survey of a sensor's rows: all statistics in one pass, block by block, in memory that does not grow with the log.

Rows are cut into runs wherever one doesn't continue the one before: at a gap, where readings were lost, where the chip
was configured again or where its state is in doubt; rows in doubt are left out. Spectrum, autocorrelation and repeats
never extend across a cut.

Sampling intervals (`SamplingIntervals`) are counted in a histogram of fixed size. Its bins of 2^-16 of a typical
interval (at least 1 ns) are the resolution of medians. A gap is an interval longer than 1.5 times the upper quartile.
The upper quartile is usually near the median; for alternating intervals it is the longer of the two, however short the
other is.

Sensors that are polled in alternating order have a short and a long interval in turn: mean -+ a. Intervals then
correlate by a^2 at even lags and -a^2 at odd ones. Independent jitter of the intervals or of the time stamps correlates
at most neighbouring intervals, and does not contribute beyond lag 1. Therefore a^2 is half the difference of the
covariances at lags 2 and 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import nlargest
from math import nan, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.characterise.allan import AllanStream, Estimator, allan_deviation_of_runs
from imuarray.characterise.allan_curve import AllanCurve
from imuarray.characterise.codes import NOTHING, Histogram, histogram
from imuarray.characterise.correlation import Autocorrelation, Autocovariance
from imuarray.characterise.repeats import Repeats, RepeatTally
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows, slow_welch
from imuarray.characterise.stretch import GAP, LEAST_RUN, Spans, Timing, broken_rows, flags_of
from imuarray.log import SensorLog
from imuarray.log.format import SUSPECT
from imuarray.robust import MEDIAN_ABSOLUTE

PLACES = 5
"""Number of longest gaps that are listed."""

_TYPICAL = 1024
"""Number of first intervals of which the upper quartile is the typical interval."""

_QUARTILE = 0.75

_FINENESS = 16
_BINS = 4 << _FINENESS
_SURE = 4.0
"""Least square of an alternation in standard errors that is reported; noise exceeds it with a probability of 3e-5."""


class RowGap(NamedTuple):
    """No row for `length_s` after the one at `after_ns`; `row` is the first one after it, counted from 0."""

    length_s: float
    after_ns: int
    row: int


@dataclass(frozen=True)
class SamplingIntervals:
    """Times of `rows` rows; nan with too few of them.

    `median_s`; `mean_s` is that of the intervals that are not gaps. `alternation_s` is a if intervals alternate between
    mean - a and mean + a, otherwise 0. `jitter_rms_s` is the standard deviation of the intervals without this
    alternation, and `jitter_robust_s` the same from the median difference of intervals two rows apart, which outliers
    and slow changes do not affect. `gaps` is the number of gaps, `gaps_s` their total duration, `longest` the longest
    ones.
    """

    rows: int
    median_s: float
    mean_s: float
    alternation_s: float
    jitter_rms_s: float
    jitter_robust_s: float
    gaps: int
    gaps_s: float
    longest: tuple[RowGap, ...]


class IntervalTally:
    """Counts the intervals between times in ns."""

    def __init__(self) -> None:
        self._waiting: list[Times] = []
        self._typical = self._bin_ns = 0
        self._counts = np.zeros(_BINS + 1, np.int64)
        self._changes = np.zeros(_BINS + 1, np.int64)
        self._beyond_ns = 0
        self._before = np.full(3, nan)
        self._products = np.zeros((2, 2))
        self._rows = self._first_ns = self._last_ns = 0
        self._longest: list[RowGap] = []

    def update(self, time_ns: Times) -> None:
        """Add the next times (n,), ascending; ValueError if they are not."""
        if len(time_ns) == 0:
            return
        times = np.asarray(time_ns, np.int64)
        last_time = [np.array([self._last_ns])] if self._rows else []
        intervals = np.diff(np.concatenate([*last_time, times]))
        if len(intervals) and intervals.min() <= 0:
            row = self._rows + 1 - len(last_time) + int(intervals.argmin())
            raise ValueError(f"time does not increase at row {row}")
        first_row = self._rows + 1 - len(last_time)
        self._first_ns = self._first_ns if last_time else int(times[0])
        self._rows, self._last_ns = self._rows + len(times), int(times[-1])
        self._name(intervals, times, first_row)
        self._waiting.append(intervals)
        if self._typical or sum(map(len, self._waiting)) >= _TYPICAL:
            self._count()

    def result(self) -> SamplingIntervals:
        """Return the statistics of all times so far."""
        self._count()
        if not self._counts.any():
            return SamplingIntervals(self._rows, nan, nan, nan, nan, nan, 0, 0.0, ())
        bins, (changes, numbers_of_changes) = np.flatnonzero(self._counts), self._lengths(self._changes)
        values, counts = self._lengths(self._counts)
        median = _quantile(values, counts, 0.5)
        limit = GAP * _quantile(values, counts, _QUARTILE)
        is_gap = (values > limit) | (bins == _BINS)
        is_known = is_gap & (bins < _BINS)
        gaps_ns = _weighted_sum(counts[is_known], values[is_known]) + self._beyond_ns
        usual, numbers = values[~is_gap], counts[~is_gap]
        number = int(numbers.sum())
        mean = (self._last_ns - self._first_ns - gaps_ns) / number
        centred = usual - _weighted_sum(numbers, usual) / number
        variance = _weighted_sum(numbers, centred**2) / number
        square = self._alternation(variance)
        robust = _quantile(changes, numbers_of_changes, 0.5) / MEDIAN_ABSOLUTE / sqrt(2) if len(changes) else nan
        jitter = sqrt(max(variance - square, 0.0))
        longest = tuple(gap for gap in self._longest if gap.length_s * 1e9 > limit)
        seconds = (median * 1e-9, mean * 1e-9, sqrt(square) * 1e-9, jitter * 1e-9, robust * 1e-9)
        return SamplingIntervals(self._rows, *seconds, int(counts[is_gap].sum()), gaps_ns * 1e-9, longest)

    def _lengths(self, counts: Times) -> tuple[Floats, Times]:
        """Return the middles of a histogram's bins that are not empty, in ns, and the numbers of lengths in them."""
        bins = np.flatnonzero(counts)
        return np.asarray(bins * float(self._bin_ns) + (self._bin_ns - 1) / 2, np.float64), counts[bins]

    def _name(self, intervals: Times, times: Times, first_row: int) -> None:
        """Keep the longest intervals with their rows."""
        count = min(PLACES, len(intervals))
        starts = times[-len(intervals) :] - intervals if len(intervals) else times[:0]
        for at in np.argpartition(intervals, -count)[-count:].tolist() if count else ():
            self._longest.append(RowGap(float(intervals[at]) * 1e-9, int(starts[at]), first_row + at))
        self._longest = nlargest(PLACES, self._longest)

    def _count(self) -> None:
        """Add the buffered intervals to the histograms and the products."""
        intervals = np.concatenate(self._waiting) if self._waiting else np.zeros(0, np.int64)
        self._waiting = []
        if len(intervals) == 0:
            return
        if not self._typical:
            self._typical = int(np.quantile(intervals[:_TYPICAL], _QUARTILE))
            self._bin_ns = max(1, self._typical >> _FINENESS)
        self._add_lengths(self._counts, intervals)
        self._beyond_ns += int(intervals[intervals >= _BINS * self._bin_ns].sum())
        jitter = intervals - float(self._typical)
        jitter[intervals > GAP * self._typical] = nan
        line = np.concatenate([self._before, jitter])
        self._before = line[-3:]
        second, third, changes = line[3:] * line[1:-2], line[3:] * line[:-3], np.abs(line[3:] - line[1:-2])
        if not np.isfinite(line).all():
            unbroken = 0 * line[2:-1]
            second, third, changes = second + unbroken, third + unbroken + 0 * line[1:-2], changes + unbroken
            second, third, changes = (part[np.isfinite(part)] for part in (second, third, changes))
        self._products += [[len(second), second.sum()], [len(third), third.sum()]]
        self._add_lengths(self._changes, changes)

    def _add_lengths(self, counts: Times, lengths_ns: Times | Floats) -> None:
        """Count lengths in the bins of a histogram."""
        whole = lengths_ns.astype(np.int64)  # exact, and the division of integers is several times as fast
        bins = np.minimum(whole // self._bin_ns, _BINS)
        if len(bins):
            first = int(bins.min())
            occupied = np.bincount(bins - first)
            counts[first : first + len(occupied)] += occupied

    def _alternation(self, variance: float) -> float:
        """Return a^2 in ns^2; 0 if not significant. Each covariance has a standard error of variance / sqrt(n)."""
        (pairs, second), (others, third) = self._products.tolist()
        if others == 0:
            return 0.0
        square = (second / pairs - third / others) / 2
        error = max(variance - square, 0.0) / sqrt(2 * others)
        return float(square) if square > max(_SURE * error, self._bin_ns**2 / 12) else 0.0


def _weighted_sum(counts: Times, values: Floats) -> float:
    """Return the sum of `values` (b,) that occur `counts` (b,) times each."""
    return float(np.einsum("b,b", counts, values))  # for "@", OpenBLAS would start threads


def _quantile(values: Floats, counts: Times, share: float) -> float:
    """Return a quantile of ascending `values` (b,) that occur `counts` (b,) times: the least value up to which there is
    at least the `share` of all.
    """
    total = np.cumsum(counts)
    return float(values[np.searchsorted(total, share * total[-1])])


MIN_ROWS = LEAST_RUN
"""Fewest rows of a run with an Allan deviation: two octaves."""

EXACT_ROWS = 4_000_000
"""Largest number of rows with the overlapping estimator by default: it holds one column's running sum, 4 bytes per row,
or 8 if the counts drift far.
"""

LAGS = 50

_BLOCK = 1 << 16


@dataclass(frozen=True)
class Survey:
    """Statistics of one sensor's stretch; `curve` is that of `runs_of_curve` (None if too short); the others include
    all rows.

    `slow_spectrum` is that of low frequencies, with longer segments (None if the runs are too short); `histograms` one
    per column; `estimator` of the Allan deviation.
    """

    spectrum: Spectrum
    slow_spectrum: Spectrum | None
    correlation: Autocorrelation
    histograms: tuple[Histogram, ...]
    intervals: SamplingIntervals
    repeats: Repeats
    curve: AllanCurve | None
    estimator: Estimator


def survey(
    sensor: SensorLog,
    rows: slice,
    timing: Timing,
    interval_s: float,
    estimator: Estimator | None = None,
    left_out: Spans = (),
) -> Survey | None:
    """Return all statistics of the `rows` of a sensor, for the runs in `timing`; `interval_s` is the mean interval of
    the longest run. Rows in the spans `left_out` do not count.

    `estimator` None: overlapping for a run of at most `EXACT_ROWS`, else decimated. None without two rows.
    """
    run_rows = timing.run.stop - timing.run.start
    if run_rows < 2:
        return None
    chosen_estimator: Estimator = estimator or ("overlapping" if run_rows <= EXACT_ROWS else "decimated")
    columns = int(sensor.counts.shape[1])
    welch = Welch(1 / interval_s, segment_rows(run_rows), columns)
    slow = slow_welch(1 / interval_s, run_rows, columns)
    covariance = Autocovariance(LAGS, columns)
    intervals, repeats, histograms = IntervalTally(), RepeatTally(), [NOTHING] * columns
    runs = runs_of_curve(timing, chosen_estimator)
    stream = AllanStream(interval_s) if chosen_estimator == "decimated" and run_rows >= MIN_ROWS else None
    tallies = [tally for tally in (welch, slow, covariance, repeats) if tally is not None]
    for begin, starts_run, counts in _pieces(sensor, rows, timing, intervals, left_out):
        if starts_run:
            for tally in tallies:
                tally.end_run()
        for tally in tallies:
            tally.update(counts)
        histograms = [merged.merge(histogram(column)) for merged, column in zip(histograms, counts.T, strict=True)]
        inside = slice(max(timing.run.start - begin, 0), max(timing.run.stop - begin, 0))
        if stream is not None and len(counts[inside]):
            stream.feed(counts[inside])
    curve = stream.curve() if stream else _exact(sensor, runs, interval_s)
    return Survey(
        welch.result(),
        None if slow is None else slow.result(),
        covariance.result(),
        tuple(histograms),
        intervals.result(),
        repeats.result(),
        curve,
        chosen_estimator,
    )


def runs_of_curve(timing: Timing, estimator: Estimator) -> tuple[slice, ...]:
    """Return the runs of rows for the Allan deviation: the longest one, and the next ones by length while all together
    have at most `EXACT_ROWS` rows. The decimated estimator uses only the longest one.
    """
    if estimator == "decimated" or not timing.runs:
        return (timing.run,)
    selected: list[slice] = []
    total = 0
    for run in sorted(timing.runs, key=lambda run: run.start - run.stop):
        total += run.stop - run.start
        if selected and total > EXACT_ROWS:
            break
        selected.append(run)
    return tuple(sorted(selected, key=lambda run: int(run.start)))


def _exact(sensor: SensorLog, runs: Sequence[slice], interval_s: float) -> AllanCurve | None:
    """Return the overlapping Allan deviation of runs with a running sum that fits into memory."""
    lengths = [run.stop - run.start for run in runs]
    if max(lengths) < MIN_ROWS:
        return None
    columns = [_Column(sensor, tuple(runs), column) for column in range(int(sensor.counts.shape[1]))]
    return allan_deviation_of_runs(columns, interval_s, lengths)


@dataclass(frozen=True)
class _Column:
    """One column of the counts of consecutive runs, read on demand."""

    sensor: SensorLog
    runs: tuple[slice, ...]
    column: int

    @property
    def dtype(self) -> np.dtype[np.generic]:
        return self.sensor.counts.dtype

    @cached_property
    def _ends(self) -> npt.NDArray[np.int64]:
        return np.cumsum([run.stop - run.start for run in self.runs])

    def __len__(self) -> int:
        return int(self._ends[-1])

    def __getitem__(self, rows: slice) -> npt.NDArray[np.integer]:
        start, stop, _ = rows.indices(len(self))
        if stop <= start:
            return np.empty(0, self.dtype)
        first, last = (int(np.searchsorted(self._ends, at, "right")) for at in (start, stop - 1))
        offsets = [self.runs[at].start - (int(self._ends[at - 1]) if at else 0) for at in (first, last)]
        begin, end = start + offsets[0], stop + offsets[1]
        counts = np.asarray(self.sensor.counts[begin:end])[:, self.column]  # the rows are kept in memory
        if first == last:
            return counts
        is_used = np.zeros(end - begin, bool)
        for run in self.runs[first : last + 1]:
            is_used[max(run.start - begin, 0) : max(run.stop - begin, 0)] = True
        return counts[is_used]


def _pieces(
    sensor: SensorLog, rows: slice, timing: Timing, intervals: IntervalTally, left_out: Spans
) -> Iterator[tuple[int, bool, npt.NDArray[np.int64]]]:
    """Yield the rows cut into pieces: number of the first row, whether it starts a run, and the counts (n, k)."""
    before_ns, in_doubt = None, False
    for start in range(rows.start, rows.stop, _BLOCK):
        part = slice(start, min(start + _BLOCK, rows.stop))
        time_ns, status = np.asarray(sensor.time[part], np.int64), flags_of(sensor, part, left_out)
        counts = np.array(sensor.counts[part], np.int64, order="F")  # most statistics are faster along columns
        intervals.update(time_ns)
        since_ns = np.diff(time_ns, prepend=time_ns[0] if before_ns is None else before_ns)
        broken = broken_rows(status) | (since_ns > timing.gap_limit_s * 1e9)
        broken[0] |= in_doubt
        cuts = np.flatnonzero(broken).tolist()
        for begin, end in zip([0, *cuts], [*cuts, len(counts)], strict=True):
            if end > begin and not status[begin] & SUSPECT:
                yield start + begin, bool(broken[begin]), counts[begin:end]
        before_ns, in_doubt = int(time_ns[-1]), bool(status[-1] & SUSPECT)
