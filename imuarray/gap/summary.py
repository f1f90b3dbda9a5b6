"""Everything that is kept of one sensor in one phase: one pass over its rows, in memory that does not grow with them.

Rows are taken as they come, flagged ones too: a simulation of the same plan flags and misses the same, so that nothing
has to be cleaned before real and simulated rows are compared. Correlations, spectra and Allan variances count in rows,
not in seconds; neighbours in the log are neighbours, whatever lies between.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.characterise.codes import NOTHING, Histogram, histograms
from imuarray.characterise.correlation import Autocovariance
from imuarray.characterise.repeats import Repeats, RepeatTally
from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows
from imuarray.gap.haar import Haar, HaarTally
from imuarray.gap.lone import Lone, LoneTally
from imuarray.gap.segments import Segments, SegmentTally, Temperature
from imuarray.gap.status import IntervalMoments, Intervals, StatusTally
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Block

Floats = npt.NDArray[np.float64]

LAGS = 5
ARCH_LAGS = 3
OCTAVES = 14
"""Averaging factors up to 8192 rows."""

_SEGMENTS = 64
_SEGMENT_ROWS = 16
"""A part of a phase has at least so many rows, or there are fewer parts."""


@dataclass(frozen=True)
class Grid:
    """How finely a phase is looked at: rows of a spectrum's segment, parts of the phase.

    Statistics can be compared between grids that are the same: what a recorded phase has, its simulations get too.
    """

    spectrum_rows: int
    segments: int

    @classmethod
    def of(cls, rows: int) -> Grid:
        """The grid for a phase of so many rows."""
        return cls(segment_rows(max(rows, 1)), min(_SEGMENTS, max(2, rows // _SEGMENT_ROWS)))


@dataclass(frozen=True)
class Summary:
    """One sensor in one phase; arrays have a column for each axis, counts are raw.

    `segments` of time; `codes` and `steps` (sizes of the differences of neighbours), a histogram per axis; `spectrum`
    in squared counts per cycle per row; `correlation` (6, 3) at lags 0 ... 5 and `arch` (4, 3) that of the squared
    differences of neighbours at lags 0 ... 3; `allan` at octaves; `intervals` of time, joint `repeats` of all axes,
    rows with each of the log's `flags`, `words`: rows in which all axes read -1, or all 0, and `lone` readings.
    """

    header: SensorHeader
    phase: Phase
    grid: Grid
    rows: int
    segments: Segments
    codes: tuple[Histogram, ...]
    steps: tuple[Histogram, ...]
    spectrum: Spectrum
    correlation: Floats
    arch: Floats
    allan: Haar
    intervals: Intervals
    repeats: Repeats
    flags: Mapping[str, int]
    words: int
    lone: Lone


class Tally:
    """Takes the blocks of one sensor in one phase."""

    def __init__(self, header: SensorHeader, phase: Phase, grid: Grid) -> None:
        self._header, self._phase, self._grid = header, phase, grid
        self._segments = SegmentTally(phase.start_ns, phase.end_ns, grid.segments)
        self._codes, self._steps = [NOTHING] * 3, [NOTHING] * 3
        self._welch = Welch(1.0, grid.spectrum_rows, 3)
        self._covariance, self._arch = Autocovariance(LAGS, 3), Autocovariance(ARCH_LAGS, 3)
        self._haar = HaarTally(OCTAVES)
        self._intervals, self._repeats, self._status = IntervalMoments(), RepeatTally(), StatusTally()
        self._lone = LoneTally()
        self._origin, self._rows = np.zeros(3), 0
        self._last = np.zeros((3, 0))

    def update(self, block: Block) -> None:
        """The next rows, at least one."""
        apart = block.counts.T.astype(np.float64, order="C")
        if self._rows == 0:
            self._origin = np.rint(apart.mean(axis=1))
        self._rows += len(block.time)
        apart -= self._origin[:, None]
        line = np.concatenate([self._last, apart], axis=1)
        steps = line[:, 1:] - line[:, :-1]
        self._last = apart[:, -1:].copy()
        self._segments.update(block.time, apart, block.temperature_counts)
        self._count(block, steps)
        self._welch.update(apart.T)
        self._covariance.update(apart.T)
        self._arch.update((steps * steps).T)
        self._haar.update(apart)
        self._intervals.update(block.time)
        self._repeats.update(block.counts)
        self._lone.update(block.time, apart)
        self._status.update(block.status, block.counts)

    def result(self, temperature: Temperature) -> Summary:
        """All that came so far."""
        return Summary(
            self._header,
            self._phase,
            self._grid,
            self._rows,
            self._segments.result(self._origin, temperature),
            tuple(self._codes),
            tuple(self._steps),
            self._welch.result(),
            self._covariance.correlation(),
            self._arch.correlation(),
            self._haar.result(),
            self._intervals.result(),
            self._repeats.result(),
            self._status.flags,
            self._status.words,
            self._lone.result(),
        )

    def _count(self, block: Block, steps: Floats) -> None:
        codes = histograms(block.counts.T.astype(np.int64, order="C"))
        sizes = histograms(np.abs(steps).astype(np.int64))
        self._codes = [seen.merge(more) for seen, more in zip(self._codes, codes, strict=True)]
        self._steps = [seen.merge(more) for seen, more in zip(self._steps, sizes, strict=True)]
