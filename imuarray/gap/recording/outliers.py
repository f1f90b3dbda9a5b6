"""Isolated readings: those that are far from both neighbours, which are close to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.gap.recording.source import RecordedSource
from imuarray.log import SensorLog
from imuarray.log.format import Phase
from imuarray.log.writer import Block

MOST = 16
"""Default of the largest number of readings of each axis that are kept."""

_ALONE = 1.5
"""Least ratio of an isolated reading's distance from the middle of its neighbours to that of a neighbour from the
middle of its own: it is 2 for an isolated reading, 1 next to a step.
"""

_ASIDE = 2
"""Number of rows that are needed on either side."""


_ROBUST = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of normal values: 1 / 0.6745."""


@dataclass(frozen=True)
class Outliers:
    """The k readings of a phase that are furthest from the middle of their two neighbours, limited in number for each
    axis.

    `axis` (k,), times `time_ns` (k,) and signed distances `deviation` (k,) in counts. Only isolated readings are
    listed; the first two and the last two rows of a phase are left out.
    """

    axis: Integers
    time_ns: Integers
    deviation: Floats


class OutlierTally:
    """Collects the isolated readings that are furthest from their neighbours, for each axis, while rows arrive."""

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._time, self._line = np.zeros(0, np.int64), np.zeros((3, 0))
        self._furthest: list[list[tuple[float, int, float]]] = [[], [], []]

    def update(self, time_ns: Integers, apart: Floats) -> None:
        """Add rows: times (n,) in ns, and counts (3, n) less an origin."""
        time = np.concatenate([self._time, time_ns])
        line = np.concatenate([self._line, apart], axis=1)
        self._time, self._line = time[-2 * _ASIDE :], line[:, -2 * _ASIDE :].copy()
        if len(time) <= 2 * _ASIDE:
            return
        off = line[:, 1:-1] - (line[:, :-2] + line[:, 2:]) / 2
        size = np.abs(off)
        inner = size[:, 1:-1]
        alone = inner > _ALONE * np.maximum(size[:, :-2], size[:, 2:])
        for axis in range(3):
            (places,) = alone[axis].nonzero()
            far = inner[axis, places]
            if len(places) > self._most:
                places = places[far >= np.partition(far, -self._most)[-self._most]]
            rows = [
                (float(inner[axis, at]), int(time[at + _ASIDE]), float(off[axis, at + 1])) for at in places.tolist()
            ]
            self._furthest[axis] = sorted([*self._furthest[axis], *rows], reverse=True)[: self._most]

    def result(self) -> Outliers:
        """Return the readings collected so far, axis by axis, the furthest first."""
        rows = [(axis, time, by) for axis, axis_readings in enumerate(self._furthest) for _, time, by in axis_readings]
        axes, times, deviation = zip(*rows, strict=True) if rows else ((), (), ())
        return Outliers(np.array(axes, np.int64), np.array(times, np.int64), np.array(deviation, float))


def robust_std(values: Floats) -> Floats:
    """Return the standard deviation of each column of (r, k), estimated from the median absolute deviation."""
    return np.asarray(_ROBUST * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


MOST_IN_MOTION = 64
"""Largest number of readings of each axis that are kept in a phase of motion."""

_MARGIN_NS = 10**9
_ROWS_A_COEFFICIENT = 8
"""Fewest rows for each fitted coefficient; shorter blocks are not used."""


def outliers_in_motion(sensor: SensorLog, others: Sequence[SensorLog], phase: Phase) -> Outliers:
    """Return the readings of a phase that are furthest, in counts, from the middle of their neighbours after the motion
    is subtracted.

    The motion is a combination of the axes of `others` and of their changes (which represent a delay), fitted block by
    block. Without others the result is empty.
    """
    tally = OutlierTally(MOST_IN_MOTION)
    for block in RecordedSource(sensor).blocks(phase.start_ns, phase.end_ns):
        tally.update(block.time, _without_motion(block, others))
    return tally.result()


def _without_motion(block: Block, others: Sequence[SensorLog]) -> Floats:
    """Return the counts (3, n) less the fitted motion; nan if the rows are too few for a fit."""
    others_axes = [axis for other in others for axis in _readings_at(other, block.time)]
    columns = (
        [np.ones(len(block.time)), *others_axes, *(np.gradient(axis) for axis in others_axes)]
        if len(block.time) > 1
        else []
    )
    if not others_axes or len(block.time) < _ROWS_A_COEFFICIENT * len(columns):
        return np.full((3, len(block.time)), np.nan)
    design, counts = np.stack(columns, axis=1), block.counts.astype(float)
    coefficients = np.linalg.lstsq(design, counts, rcond=None)[0]
    return np.asarray((counts - design @ coefficients).T)


def _readings_at(other: SensorLog, time_ns: Integers) -> list[Floats]:
    """Return each axis of another sensor less its mean, linearly interpolated to these times (n,)."""
    span = other.between(int(time_ns[0]) - _MARGIN_NS, int(time_ns[-1]) + _MARGIN_NS)
    times = np.asarray(other.time[span], np.int64)
    if len(times) < 2:
        return []
    counts = np.asarray(other.counts[span], float)
    return [np.interp(time_ns - time_ns[0], times - time_ns[0], axis - axis.mean()) for axis in counts.T]
