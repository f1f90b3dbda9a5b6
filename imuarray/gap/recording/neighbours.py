"""Readings of a moving sensor that stand alone beside what the others of its kind make of the motion."""

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
"""So many of each axis are kept."""

_MARGIN_NS = 10**9
_ROWS = 8
"""Rows for each number that is fitted; in a shorter block nothing is told."""


def lone_beside(sensor: SensorLog, others: Sequence[SensorLog], phase: Phase) -> Outliers:
    """The readings of a phase that are furthest, in counts, from the middle of their neighbours once the motion is
    taken off: a combination of the `others`' axes and of their changes, which stand for a delay, fitted block by block.
    None without others.
    """
    tally = OutlierTally(KEPT)
    for block in RecordedSource(sensor).blocks(phase.start_ns, phase.end_ns):
        tally.update(block.time, _left(block, others))
    return tally.result()


def _left(block: Block, others: Sequence[SensorLog]) -> Floats:
    """(3, n) counts without what the motion explains, nan where too little is known of it."""
    felt = [axis for other in others for axis in _felt(other, block.time)]
    columns = [np.ones(len(block.time)), *felt, *(np.gradient(axis) for axis in felt)] if len(block.time) > 1 else []
    if not felt or len(block.time) < _ROWS * len(columns):
        return np.full((3, len(block.time)), np.nan)
    design, counts = np.stack(columns, axis=1), block.counts.astype(float)
    found = np.linalg.lstsq(design, counts, rcond=None)[0]
    return np.asarray((counts - design @ found).T)


def _felt(other: SensorLog, time_ns: Integers) -> list[Floats]:
    """Each axis of another sensor at these times (n,), less its mean, in straight lines between its rows."""
    span = other.between(int(time_ns[0]) - _MARGIN_NS, int(time_ns[-1]) + _MARGIN_NS)
    times = np.asarray(other.time[span], np.int64)
    if len(times) < 2:
        return []
    counts = np.asarray(other.counts[span], float)
    return [np.interp(time_ns - time_ns[0], times - time_ns[0], axis - axis.mean()) for axis in counts.T]
