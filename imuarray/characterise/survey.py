"""A survey of a sensor's rows: all statistics in one pass, block by block, in memory that does not grow with the log.

Rows are cut into runs wherever one doesn't continue the one before: at a gap, where readings were lost, where the chip
was set up again or is in doubt; rows in doubt are left out. Spectrum, autocorrelation and repeats never reach across a
cut.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from imuarray.characterise.allan import AllanCurve, Estimator, allan_deviation_of_runs
from imuarray.characterise.allan_stream import AllanStream
from imuarray.characterise.codes import NOTHING, Histogram, histogram
from imuarray.characterise.correlation import Autocorrelation, Autocovariance
from imuarray.characterise.intervals import Intervals, IntervalTally
from imuarray.characterise.repeats import Repeats, RepeatTally
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows
from imuarray.characterise.stretch import LEAST_RUN, Spans, Timing, broken_rows, flags_of
from imuarray.log import SensorLog
from imuarray.log.format import SUSPECT

MIN_ROWS = LEAST_RUN
"""A run shorter than this gives no Allan deviation: not even two octaves."""

EXACT_ROWS = 4_000_000
"""Up to here the overlapping estimator is the default: it holds one column's running sum, 4 bytes a row, or 8 where the
counts wander far.
"""

LAGS = 50

_BLOCK = 1 << 16


@dataclass(frozen=True)
class Survey:
    """Statistics of one sensor's stretch; `curve` is of `runs_of_curve` (None if too short), the rest of all.

    `histograms` one per column; `estimator` of the Allan deviation.
    """

    spectrum: Spectrum
    correlation: Autocorrelation
    histograms: tuple[Histogram, ...]
    intervals: Intervals
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
    """Return everything about the `rows` of a sensor, whose runs `timing` found; `interval_s` is the longest run's
    mean. Rows in the spans `left_out` do not count.

    `estimator` None: overlapping for a run of at most `EXACT_ROWS`, else decimated. None without two rows.
    """
    run_rows = timing.run.stop - timing.run.start
    if run_rows < 2:
        return None
    chosen: Estimator = estimator or ("overlapping" if run_rows <= EXACT_ROWS else "decimated")
    columns = int(sensor.counts.shape[1])
    welch = Welch(1 / interval_s, segment_rows(run_rows), columns)
    covariance = Autocovariance(LAGS, columns)
    intervals, repeats, seen = IntervalTally(), RepeatTally(), [NOTHING] * columns
    runs = runs_of_curve(timing, chosen)
    stream = AllanStream(interval_s) if chosen == "decimated" and run_rows >= MIN_ROWS else None
    for begin, starts_run, counts in _pieces(sensor, rows, timing, intervals, left_out):
        if starts_run:
            for tally in (welch, covariance, repeats):
                tally.end_run()
        welch.update(counts)
        covariance.update(counts)
        repeats.update(counts)
        seen = [known.merge(histogram(column)) for known, column in zip(seen, counts.T, strict=True)]
        inside = slice(max(timing.run.start - begin, 0), max(timing.run.stop - begin, 0))
        if stream is not None and len(counts[inside]):
            stream.feed(counts[inside])
    curve = stream.curve() if stream else _exact(sensor, runs, interval_s)
    return Survey(welch.result(), covariance.result(), tuple(seen), intervals.result(), repeats.result(), curve, chosen)


def runs_of_curve(timing: Timing, estimator: Estimator) -> tuple[slice, ...]:
    """The runs of rows that the Allan deviation is taken of: the longest ones, of `EXACT_ROWS` together at most; with
    the decimated estimator the longest one alone.
    """
    if estimator == "decimated" or not timing.runs:
        return (timing.run,)
    chosen: list[slice] = []
    total = 0
    for run in sorted(timing.runs, key=lambda run: run.start - run.stop):
        total += run.stop - run.start
        if chosen and total > EXACT_ROWS:
            break
        chosen.append(run)
    return tuple(sorted(chosen, key=lambda run: int(run.start)))


def _exact(sensor: SensorLog, runs: Sequence[slice], interval_s: float) -> AllanCurve | None:
    """The overlapping Allan deviation of runs that are short enough for their running sum to be held."""
    lengths = [run.stop - run.start for run in runs]
    if max(lengths) < MIN_ROWS:
        return None
    columns = [_Column(sensor, tuple(runs), column) for column in range(int(sensor.counts.shape[1]))]
    return allan_deviation_of_runs(columns, interval_s, lengths)


@dataclass(frozen=True)
class _Column:
    """One column of the counts of runs, one after the other, read where it is asked for."""

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
        before = [self.runs[at].start - (int(self._ends[at - 1]) if at else 0) for at in (first, last)]
        begin, end = start + before[0], stop + before[1]
        counts = np.asarray(self.sensor.counts[begin:end, self.column])
        if first == last:
            return counts
        kept = np.zeros(end - begin, bool)
        for run in self.runs[first : last + 1]:
            kept[max(run.start - begin, 0) : max(run.stop - begin, 0)] = True
        return counts[kept]


def _pieces(
    sensor: SensorLog, rows: slice, timing: Timing, intervals: IntervalTally, left_out: Spans
) -> Iterator[tuple[int, bool, npt.NDArray[np.int64]]]:
    """The rows cut into pieces: number of the first row, whether it starts a run, and the counts (n, k)."""
    before_ns, in_doubt = None, False
    for start in range(rows.start, rows.stop, _BLOCK):
        part = slice(start, min(start + _BLOCK, rows.stop))
        time_ns, status = np.asarray(sensor.time[part], np.int64), flags_of(sensor, part, left_out)
        counts = np.asarray(sensor.counts[part], np.int64)
        intervals.update(time_ns)
        since_ns = np.diff(time_ns, prepend=time_ns[0] if before_ns is None else before_ns)
        broken = broken_rows(status) | (since_ns > timing.gap_limit_s * 1e9)
        broken[0] |= in_doubt
        cuts = np.flatnonzero(broken).tolist()
        for begin, end in zip([0, *cuts], [*cuts, len(counts)], strict=True):
            if end > begin and not status[begin] & SUSPECT:
                yield start + begin, bool(broken[begin]), counts[begin:end]
        before_ns, in_doubt = int(time_ns[-1]), bool(status[-1] & SUSPECT)
