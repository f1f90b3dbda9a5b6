"""The readings of a sensor at rest that count, a block at a time, and where they follow one another without a gap.

Stale, saturated and suspect rows are left out; readings on either side of a gap are no neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.characterise.noise import LEFT_OUT
from imuarray.characterise.stretch import GAP, broken_rows
from imuarray.log import SensorLog

Floats = npt.NDArray[np.float64]

Stretches = Sequence[tuple[SensorLog, slice]]
"""A sensor at rest: rows of its logs."""

SEGMENT_ROWS = 256
"""What changes over more rows is drift and no noise."""

_BLOCK_ROWS = 256 * SEGMENT_ROWS


class Clock(NamedTuple):
    """Readings a second, and the interval that is a gap."""

    rate_hz: float
    limit_ns: float


def clock_of(stretches: Stretches) -> Clock:
    """From the first block of the longest stretch; no rate where that has no two sound readings."""
    sensor, rows = max(stretches, key=lambda stretch: stretch[1].stop - stretch[1].start)
    part = slice(rows.start, min(rows.stop, rows.start + _BLOCK_ROWS))
    sound = (np.asarray(sensor.status[part]) & LEFT_OUT) == 0
    intervals = np.diff(np.asarray(sensor.time[part])[sound]).astype(float)
    if len(intervals) == 0:
        return Clock(0.0, np.inf)
    limit_ns = GAP * float(np.quantile(intervals, 0.75))
    usual = intervals[(intervals > 0) & (intervals <= limit_ns)]
    return Clock(1e9 / float(usual.mean()) if len(usual) else 0.0, limit_ns)


class Readings(NamedTuple):
    """Sound readings of one block: counts (n, 3), the segment of the stretch that each is in, and whether it doesn't
    continue the one before.
    """

    counts: Floats
    segment: npt.NDArray[np.int64]
    is_first: npt.NDArray[np.bool_]


def readings(sensor: SensorLog, rows: slice, limit_ns: float) -> Iterator[Readings]:
    """The sound readings of `rows`, block after block; an interval longer than `limit_ns` is a gap."""
    last_ns, breaks, breaks_then = -np.inf, 0, 0
    for start in range(rows.start, rows.stop, _BLOCK_ROWS):
        part = slice(start, min(start + _BLOCK_ROWS, rows.stop))
        status = np.asarray(sensor.status[part])
        sound = (status & LEFT_OUT) == 0
        so_far = breaks + np.cumsum(broken_rows(status))
        breaks = int(so_far[-1])
        if not sound.any():
            continue
        time = np.asarray(sensor.time[part])[sound].astype(float)
        apart = np.diff(time, prepend=last_ns) > limit_ns
        apart |= np.diff(so_far[sound], prepend=breaks_then) > 0
        segment = (np.flatnonzero(sound) + start - rows.start) // SEGMENT_ROWS
        yield Readings(np.asarray(sensor.counts[part], float)[sound], segment, apart)
        last_ns, breaks_then = float(time[-1]), int(so_far[sound][-1])


def runs_of(part: Readings) -> Iterator[tuple[bool, Floats]]:
    """The readings between gaps, and whether there is one before them."""
    edges = np.flatnonzero(part.is_first)
    if len(edges) == 0 or edges[0] > 0:
        yield False, part.counts[: edges[0]] if len(edges) else part.counts
    for begin, end in pairwise([*edges.tolist(), len(part.counts)]):
        yield True, part.counts[begin:end]
