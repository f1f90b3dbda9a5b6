"""Stretches of a recorded log in which a chip was not set as it should be, as its recorder noticed: from which row on
its readings show that, and what they were before.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.recording.outliers import robust_std
from imuarray.log import SensorLog
from imuarray.log.format import STALE, SUSPECT

MOST = 64
"""So many of a log are kept, the first."""

_BEFORE, _WITHIN = 16, 4096
"""Rows that are looked at."""

_FEWEST = 8
_FAR = 6.0
"""Standard deviations from the readings before, on some axis, of a chip that is set otherwise."""

_ROUNDED_LSB = 0.5


class Reset(NamedTuple):
    """Rows that the recorder doubts, from `doubt_s` on; their readings are others from `moment_s` until `end_s`,
    seconds since the log's epoch, between rows. `before` and `within` (3,) are readings in counts, with their
    `noise_before` and `noise_within` (nan if they are too few). `blank_s`: for so long the chip gave zeros at first.
    """

    doubt_s: float
    moment_s: float
    end_s: float
    before: Floats
    within: Floats
    noise_before: Floats
    noise_within: Floats
    blank_s: float = 0.0


def resets_in(sensor: SensorLog) -> tuple[Reset, ...]:
    """In the order of time. A stretch in which no reading changes, or before which there are none, is none."""
    found: list[Reset] = []
    for begin, end in _doubted(sensor):
        reset = _reset(sensor, begin, end)
        if reset is not None:
            found.append(reset)
        if len(found) == MOST:
            break
    return tuple(found)


def _doubted(sensor: SensorLog) -> Iterator[tuple[int, int]]:
    """Rows [begin, end) that are flagged, stretch by stretch."""
    begun: int | None = None
    for block in sensor.blocks():
        flagged = (np.asarray(sensor.status[block]) & SUSPECT) != 0
        edges = np.diff(flagged.astype(np.int8), prepend=np.int8(begun is not None))
        for at in np.flatnonzero(edges).tolist():
            if edges[at] > 0:
                begun = block.start + at
            elif begun is not None:
                yield begun, block.start + at
                begun = None
    if begun is not None:
        yield begun, len(sensor)


def _reset(sensor: SensorLog, begin: int, end: int) -> Reset | None:
    before = _counts(sensor, max(begin - _BEFORE, 0), begin)
    inside = _counts(sensor, begin, min(end, begin + _WITHIN))
    if len(before) < _FEWEST:
        return None
    level, noise = _middle(before)
    blank = _is_blank(sensor, begin, inside)
    read = np.flatnonzero(~blank)
    onset = _onset(inside[read], level, noise)
    if onset is None:
        return None
    changed = inside[read[onset:]]
    since = int(read[onset])
    emptied = int(read[onset - 1]) + 1 if onset else 0  # zeros in between come of the reset
    within, noise_within = _middle(changed)
    if len(changed) < _FEWEST // 2:
        noise_within = np.full(3, np.nan)
    doubt_s, moment_s, read_s, end_s = (_between_s(sensor, row) for row in (begin, begin + emptied, begin + since, end))
    return Reset(doubt_s, moment_s, end_s, level, within, noise, noise_within, read_s - moment_s)


def _onset(inside: Floats, level: Floats, noise: Floats) -> int | None:
    """From which of the readings (n, 3) within the stretch on all are others than before; None if none are. A dip may
    end after the first one.
    """
    for last_rows in (_FEWEST // 2, 1) if len(inside) else ():
        last = np.median(inside[-last_rows:], axis=0) - level
        axis = int(np.abs(last / noise).argmax())
        if abs(last[axis]) > _FAR * noise[axis]:
            usual = np.flatnonzero((inside[:, axis] - level[axis]) / last[axis] < 1 / 2)
            onset = int(usual[-1]) + 1 if len(usual) else 0
            if onset < len(inside):
                return onset
    return None


def _is_blank(sensor: SensorLog, begin: int, inside: Floats) -> Booleans:
    """Which rows hold no reading, but the zeros of a chip that has made none since it was reset."""
    stale = (np.asarray(sensor.status[begin : begin + len(inside)]) & STALE) != 0
    return np.asarray(stale & (inside == 0).all(axis=1))


def _middle(counts: Floats) -> tuple[Floats, Floats]:
    """(3,) median of readings (n, 3), and how they scatter, whatever few of them do."""
    return np.asarray(np.median(counts, axis=0)), np.maximum(robust_std(counts), _ROUNDED_LSB)


def _counts(sensor: SensorLog, begin: int, end: int) -> Floats:
    return np.asarray(sensor.counts[begin:end], float)


def _between_s(sensor: SensorLog, row: int) -> float:
    """Half an interval before a row, that of the two rows before it: it may come long after these."""
    first = max(min(row, len(sensor)) - 2, 0)
    times = np.asarray(sensor.time[first : first + 2], np.int64)
    step_ns = int(times[-1] - times[0])
    return float(times[-1] + step_ns / 2) * 1e-9
