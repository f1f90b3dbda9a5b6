"""Summary of one sensor in one phase, from one pass over its rows in bounded memory.

All rows are used, including flagged ones: a simulation of the same plan flags and misses the same rows, so the data
need no cleaning before the comparison. Correlations, spectra and Allan variances are computed over rows, not over
seconds: successive rows of the log are neighbours, whatever the time between them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.characterise.codes import NOTHING, Histogram, histograms
from imuarray.characterise.correlation import Autocovariance
from imuarray.characterise.repeats import Repeats, RepeatTally
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows
from imuarray.gap.recording.outliers import Outliers, OutlierTally
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.recordings import Temperature
from imuarray.gap.statistics.haar import Haar, HaarTally
from imuarray.gap.statistics.intervals import IntervalMoments, Intervals, StatusTally
from imuarray.gap.statistics.segments import Segments, SegmentTally, split_replicates
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Block

LAGS = 5
"""Number of lags, in rows, of the correlation of the readings."""

ARCH_LAGS = 3
"""Number of lags, in rows, of the correlation of squared differences between neighbours."""

OCTAVES = 14
"""Number of octaves of the Allan variance: averaging factors 1 to 8192 rows."""

SPIKES = 8
"""Number of spikes that are kept for each axis."""

_SEGMENTS = 64
"""Largest number of parts of a phase."""

_SEGMENT_ROWS = 16
"""Least number of rows in a part of a phase; a short phase has fewer parts."""


@dataclass(frozen=True)
class Grid:
    """Resolution at which a phase is summarised: rows in a segment of the spectrum, and parts of the phase.

    Statistics are comparable only between equal grids, so simulations use the grid of the recorded phase.
    """

    spectrum_rows: int
    segments: int

    @classmethod
    def of(cls, rows: int) -> Grid:
        """Return the grid for a phase of `rows` rows."""
        return cls(segment_rows(max(rows, 1)), min(_SEGMENTS, max(2, rows // _SEGMENT_ROWS)))


@dataclass(frozen=True)
class Summary:
    """Summary of one sensor in one phase; arrays have a column for each axis, counts are raw.

    `segments`: moments in equal parts of the phase. `codes` and `steps`: one histogram per axis of the codes and of the
    sizes of differences between neighbours. `spectrum`: in squared counts per cycle per row. `alternating`: mean of the
    readings with alternating signs. `correlation` (6, 3): at lags 0 ... 5. `arch` (4, 3): correlation of the squared
    differences between neighbours at lags 0 ... 3. `allan`: Allan variances at octaves. `spikes` (8, 3): the largest
    spikes in a motion, nan at rest. `intervals`: times between rows. `repeats`: repetitions on all axes jointly.
    `flags`: number of rows with each of the log's flags. `words`: number of rows in which all axes read -1, or all 0.
    `slips`: slips of the polls against the data clock. `outliers`: isolated readings, only of a recording.
    """

    header: SensorHeader
    phase: Phase
    grid: Grid
    rows: int
    segments: Segments
    codes: tuple[Histogram, ...]
    steps: tuple[Histogram, ...]
    spectrum: Spectrum
    alternating: Floats
    correlation: Floats
    arch: Floats
    allan: Haar
    spikes: Floats
    intervals: Intervals
    repeats: Repeats
    flags: Mapping[str, int]
    words: int
    slips: int
    outliers: Outliers


class Tally:
    """Accumulates the blocks of one sensor in one phase, for several `replicates` at once whose rows have the same
    times: with few rows the overhead of NumPy calls dominates.

    `outliers`: also collect isolated readings, which no statistic uses.
    """

    def __init__(
        self, header: SensorHeader, phase: Phase, grid: Grid, replicates: int = 1, *, outliers: bool = True
    ) -> None:
        self._header, self._phase, self._grid = header, phase, grid
        columns = 3 * replicates
        self._segments = SegmentTally(phase.start_ns, phase.end_ns, grid.segments, replicates)
        self._codes, self._steps = [NOTHING] * columns, [NOTHING] * columns
        self._welch = Welch(1.0, grid.spectrum_rows, columns)
        self._covariance, self._arch = Autocovariance(LAGS, columns), Autocovariance(ARCH_LAGS, columns)
        self._haar = HaarTally(OCTAVES, columns)
        self._intervals = IntervalMoments(1 / header.rate_hz if header.rate_hz > 0 else 0.0)
        self._repeats = [RepeatTally() for _ in range(replicates)]
        self._status = [StatusTally() for _ in range(replicates)]
        self._outliers = [OutlierTally() for _ in range(replicates)]
        self._with_outliers = outliers
        self._origin, self._rows = np.zeros(columns), 0
        self._alternating = np.zeros(columns)
        self._last = np.zeros((columns, 0))
        self._spikes = None if is_at_rest(phase) else SpikeTally(columns)

    def update(self, *blocks: Block) -> None:
        """Add rows of each replicate, at least one row."""
        time = blocks[0].time
        counts = np.ascontiguousarray(np.concatenate([block.counts.T for block in blocks]))
        deviations = counts.astype(np.float64)
        if self._rows == 0:
            self._origin = np.rint(deviations.mean(axis=1))
        deviations -= self._origin[:, None]
        even, odd = (deviations[:, (self._rows + first) % 2 :: 2].sum(axis=1) for first in (0, 1))
        self._alternating += even - odd
        self._rows += len(time)
        line = np.concatenate([self._last, deviations], axis=1)
        steps = line[:, 1:] - line[:, :-1]
        self._last = deviations[:, -1:].copy()
        self._segments.update(time, deviations, _thermometers(blocks))
        self._count(counts, steps)
        self._welch.update(deviations.T)
        self._covariance.update(deviations.T)
        self._arch.update((steps * steps).T)
        self._haar.update(deviations)
        if self._spikes is not None:
            self._spikes.update(steps)
        self._intervals.update(time)
        columns = counts.reshape(len(blocks), 3, -1).swapaxes(1, 2)
        for block, replicate_counts, repeats, status in zip(blocks, columns, self._repeats, self._status, strict=True):
            repeats.update(replicate_counts)
            status.update(block.status, replicate_counts)
        for at, outliers in enumerate(self._outliers if self._with_outliers else ()):
            outliers.update(time, deviations[3 * at : 3 * at + 3])

    def result(self, temperature: Temperature) -> Summary:
        """Return the summary of the rows added so far, for the only replicate."""
        (summary,) = self.results(temperature)
        return summary

    def results(self, temperature: Temperature) -> list[Summary]:
        """Return the summaries of the rows added so far, one for each replicate."""
        replicates = len(self._repeats)
        spectrum, haar, intervals = self._welch.result(), self._haar.result(), self._intervals.result()
        tables = (self._covariance.correlation(), self._arch.correlation(), haar.variance, haar.kurtosis)
        correlation, arch, variance, kurtosis = (split_replicates(table, replicates) for table in tables)
        alternating = self._alternating.reshape(replicates, 3) / max(self._rows, 1)
        segments = self._segments.results(self._origin, temperature)
        spikes = np.full((SPIKES, 3 * replicates), np.nan) if self._spikes is None else self._spikes.result()
        return [
            Summary(
                self._header,
                self._phase,
                self._grid,
                self._rows,
                segments[at],
                tuple(self._codes[3 * at : 3 * at + 3]),
                tuple(self._steps[3 * at : 3 * at + 3]),
                replace(spectrum, density=spectrum.density[:, 3 * at : 3 * at + 3]),
                alternating[at],
                correlation[at],
                arch[at],
                haar._replace(variance=variance[at], kurtosis=kurtosis[at]),
                spikes[:, 3 * at : 3 * at + 3],
                intervals,
                self._repeats[at].result(),
                self._status[at].flags,
                self._status[at].words,
                self._status[at].slips,
                self._outliers[at].result(),
            )
            for at in range(replicates)
        ]

    def _count(self, counts: npt.NDArray[np.int16], steps: Floats) -> None:
        codes = histograms(counts.astype(np.int64))
        sizes = histograms(np.abs(steps).astype(np.int64))
        self._codes = [histogram.merge(more) for histogram, more in zip(self._codes, codes, strict=True)]
        self._steps = [histogram.merge(more) for histogram, more in zip(self._steps, sizes, strict=True)]


class SpikeTally:
    """Collects the largest spikes of each column while the steps of readings arrive.

    The second differences around a reading that is off by d are d, -2 d and d. The size of a spike is the smallest of
    these three magnitudes (the middle one halved). It is 0 where the signs do not alternate: the curvature of a motion
    has the same sign from row to row.
    """

    def __init__(self, columns: int) -> None:
        self._last = np.zeros((columns, 0))
        self._largest = np.zeros((SPIKES, columns))

    def update(self, steps: Floats) -> None:
        """Add steps (columns, n) of readings."""
        line = np.concatenate([self._last, steps], axis=1)
        self._last = line[:, -3:].copy()
        bends = line[:, 1:] - line[:, :-1]
        if bends.shape[1] < 3:
            return
        middle, sides = bends[:, 1:-1], np.sign(bends[:, 1:-1])
        size = np.minimum(np.abs(middle) / 2, np.minimum(-sides * bends[:, :-2], -sides * bends[:, 2:])).clip(0.0)
        every = np.concatenate([self._largest.T, size], axis=1)
        self._largest = -np.sort(-np.partition(every, -SPIKES, axis=1)[:, -SPIKES:], axis=1).T

    def result(self) -> Floats:
        """Return the sizes (`SPIKES`, columns) of the largest spikes so far in descending order, padded with zeros."""
        return self._largest


def _thermometers(blocks: Sequence[Block]) -> npt.NDArray[np.int16] | None:
    """Return counts (r, n) of the chip's thermometer, if it has one."""
    counts = [block.temperature_counts for block in blocks if block.temperature_counts is not None]
    return np.array(counts) if counts else None


def side_by_side(replicates: Sequence[Summary]) -> Summary:
    """Join replicates whose rows have the same times into one summary with three columns per replicate, for statistics
    that are computed column by column. All other fields are those of the first replicate.
    """
    first = replicates[0]
    if len(replicates) == 1:
        return first
    parts = [summary.segments for summary in replicates]
    spectrum = replace(first.spectrum, density=_columns_together([summary.spectrum.density for summary in replicates]))
    return replace(
        first,
        segments=replace(
            first.segments,
            mean=_columns_together([part.mean for part in parts]),
            variance=_columns_together([part.variance for part in parts]),
            third=_columns_together([part.third for part in parts]),
            fourth=_columns_together([part.fourth for part in parts]),
        ),
        codes=tuple(chain.from_iterable(summary.codes for summary in replicates)),
        steps=tuple(chain.from_iterable(summary.steps for summary in replicates)),
        spectrum=spectrum,
        alternating=np.concatenate([summary.alternating for summary in replicates]),
        correlation=_columns_together([summary.correlation for summary in replicates]),
        arch=_columns_together([summary.arch for summary in replicates]),
        allan=first.allan._replace(
            variance=_columns_together([summary.allan.variance for summary in replicates]),
            kurtosis=_columns_together([summary.allan.kurtosis for summary in replicates]),
        ),
        spikes=_columns_together([summary.spikes for summary in replicates]),
    )


def _columns_together(tables: Sequence[Floats]) -> Floats:
    return np.concatenate(tables, axis=1)
