"""Outliers of a moving sensor: readings that the other sensors of its kind do not explain as motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.gap.recording.outliers import Outliers, OutlierTally
from imuarray.gap.recording.source import RecordedSource
from imuarray.log import SensorLog
from imuarray.log.format import Phase
from imuarray.log.writer import Block

KEPT = 64
"""The most readings of each axis that are kept."""

_MARGIN_NS = 10**9
_ROWS = 8
"""Rows for each fitted number; a shorter block is not used."""


def outliers_in_motion(sensor: SensorLog, others: Sequence[SensorLog], phase: Phase) -> Outliers:
    """The readings of a phase that are furthest, in counts, from the middle of their neighbours once the motion is
    subtracted.

    The motion is a combination of the axes of `others` and of their changes (which stand for a delay), fitted block by
    block. Empty without others.
    """
    tally = OutlierTally(KEPT)
    for block in RecordedSource(sensor).blocks(phase.start_ns, phase.end_ns):
        tally.update(block.time, _without_motion(block, others))
    return tally.result()


def _without_motion(block: Block, others: Sequence[SensorLog]) -> Floats:
    """Counts (3, n) less the fitted motion; nan where there is too little to fit."""
    others_axes = [axis for other in others for axis in _readings_at(other, block.time)]
    columns = (
        [np.ones(len(block.time)), *others_axes, *(np.gradient(axis) for axis in others_axes)]
        if len(block.time) > 1
        else []
    )
    if not others_axes or len(block.time) < _ROWS * len(columns):
        return np.full((3, len(block.time)), np.nan)
    design, counts = np.stack(columns, axis=1), block.counts.astype(float)
    coefficients = np.linalg.lstsq(design, counts, rcond=None)[0]
    return np.asarray((counts - design @ coefficients).T)


def _readings_at(other: SensorLog, time_ns: Integers) -> list[Floats]:
    """Each axis of another sensor at these times (n,), less its mean, linearly interpolated."""
    span = other.between(int(time_ns[0]) - _MARGIN_NS, int(time_ns[-1]) + _MARGIN_NS)
    times = np.asarray(other.time[span], np.int64)
    if len(times) < 2:
        return []
    counts = np.asarray(other.counts[span], float)
    return [np.interp(time_ns - time_ns[0], times - time_ns[0], axis - axis.mean()) for axis in counts.T]
