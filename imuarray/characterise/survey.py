"""One pass over a sensor's rows for all that is told of them, block by block: memory doesn't grow with the log.

Rows are cut into runs wherever one doesn't continue the one before: at a gap, where readings were lost, where the chip
was set up again or is in doubt; rows in doubt are left out. Spectrum, autocorrelation and repeats never look across a
cut.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.characterise.allan import AllanCurve, Estimator, allan_deviation_of_counts
from imuarray.characterise.allan_stream import AllanStream
from imuarray.characterise.codes import NOTHING, Histogram, histogram
from imuarray.characterise.correlation import Autocorrelation, Autocovariance
from imuarray.characterise.intervals import Intervals, IntervalTally
from imuarray.characterise.repeats import Repeats, RepeatTally
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows
from imuarray.characterise.stretch import Spans, Timing, broken_rows, flags_of
from imuarray.log import SensorLog
from imuarray.log.format import SUSPECT

MIN_ROWS = 9
"""A run shorter than this gives no Allan deviation: not even two octaves."""

EXACT_ROWS = 4_000_000
"""Up to here the overlapping estimator is the default: it holds one column's running sum, 4 bytes a row, or 8 where the
counts wander far.
"""

LAGS = 50

_BLOCK = 1 << 16


@dataclass(frozen=True)
class Survey:
    """Statistics of one sensor's stretch; `curve` is of its longest run (None if too short), the rest of all runs.

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
    curve = stream.curve() if stream else _exact(sensor, timing.run, interval_s, run_rows)
    return Survey(welch.result(), covariance.result(), tuple(seen), intervals.result(), repeats.result(), curve, chosen)


def _exact(sensor: SensorLog, run: slice, interval_s: float, run_rows: int) -> AllanCurve | None:
    """The overlapping Allan deviation of a run that is short enough for its running sum to be held."""
    if run_rows < MIN_ROWS:
        return None
    columns = range(int(sensor.counts.shape[1]))
    return allan_deviation_of_counts([_Column(sensor, run, column) for column in columns], interval_s)


@dataclass(frozen=True)
class _Column:
    """One column of the counts of a run, read where it is asked for."""

    sensor: SensorLog
    run: slice
    column: int

    @property
    def dtype(self) -> np.dtype[np.generic]:
        return self.sensor.counts.dtype

    def __len__(self) -> int:
        return int(self.run.stop - self.run.start)

    def __getitem__(self, rows: slice) -> npt.NDArray[np.integer]:
        start, stop, _ = rows.indices(len(self))
        return np.asarray(self.sensor.counts[self.run.start + start : self.run.start + stop, self.column])


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
