"""Stretches of a recorded log in which a chip had lost its configuration, according to the recorder's flags: the first
row that shows it, and the readings before and in the stretch.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.recording.outliers import robust_std
from imuarray.log import SensorLog
from imuarray.log.format import RECONFIGURED, STALE, SUSPECT

MOST = 64
"""Largest number of resets of a log that are kept, the first ones."""

_BEFORE, _WITHIN = 16, 4096
"""Largest number of rows before and within a stretch that are used."""

_FEWEST = 8
_FAR = 6.0
"""Least distance from the readings before, in standard deviations on one axis, of a chip that is configured
differently.
"""

_ROUNDED_LSB = 0.5


class Reset(NamedTuple):
    """A stretch of rows from `doubt_s` on that the recorder flags as doubtful.

    The readings differ from `moment_s` until `end_s`; all three are times between rows, in s since the log's epoch.
    `before` and `within` (3,) are the median readings in counts, `noise_before` and `noise_within` their noise (nan for
    too few rows). `blank_s` is the time for which the chip returned zeros at first.
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
    """Return the resets of a sensor in the order of time.

    Stretches without readings before them are left out. Stretches in which no reading changes are left out too, unless
    the chip was then set up again: it may have lost the settings of a filter.
    """
    resets: list[Reset] = []
    for begin, end in _doubtful_stretches(sensor):
        reset = _reset(sensor, begin, end)
        if reset is not None:
            resets.append(reset)
        if len(resets) == MOST:
            break
    return tuple(resets)


def _doubtful_stretches(sensor: SensorLog) -> Iterator[tuple[int, int]]:
    """Yield the stretches [begin, end) of flagged rows."""
    first: int | None = None
    for block in sensor.blocks():
        flagged = (np.asarray(sensor.status[block]) & SUSPECT) != 0
        edges = np.diff(flagged.astype(np.int8), prepend=np.int8(first is not None))
        for at in np.flatnonzero(edges).tolist():
            if edges[at] > 0:
                first = block.start + at
            elif first is not None:
                yield first, block.start + at
                first = None
    if first is not None:
        yield first, len(sensor)


def _reset(sensor: SensorLog, begin: int, end: int) -> Reset | None:
    before = _counts(sensor, max(begin - _BEFORE, 0), begin)
    inside = _counts(sensor, begin, min(end, begin + _WITHIN))
    if len(before) < _FEWEST:
        return None
    level, noise = _middle(before)
    blank = _is_blank(sensor, begin, inside)
    rows = np.flatnonzero(~blank)
    onset = _onset(inside[rows], level, noise)
    if onset is None and len(rows) and _is_set_up_again(sensor, end):
        onset = 0
    if onset is None:
        return None
    changed = inside[rows[onset:]]
    since = int(rows[onset])
    emptied = int(rows[onset - 1]) + 1 if onset else 0  # zeros in between result from the reset
    within, noise_within = _middle(changed)
    if len(changed) < _FEWEST // 2:
        noise_within = np.full(3, np.nan)
    doubt_s, moment_s, read_s, end_s = (_between_s(sensor, row) for row in (begin, begin + emptied, begin + since, end))
    return Reset(doubt_s, moment_s, end_s, level, within, noise, noise_within, read_s - moment_s)


def _onset(inside: Floats, level: Floats, noise: Floats) -> int | None:
    """Return the index of the reading from which all readings (n, 3) within the stretch differ from those before it;
    None without one. If the median of the last readings does not differ, the last one alone is examined: a short reset
    may show in one reading only.
    """
    for last_rows in (_FEWEST // 2, 1) if len(inside) else ():
        last = np.median(inside[-last_rows:], axis=0) - level
        axis = int(np.abs(last / noise).argmax())
        if abs(last[axis]) > _FAR * noise[axis]:
            unchanged = np.flatnonzero((inside[:, axis] - level[axis]) / last[axis] < 1 / 2)
            onset = int(unchanged[-1]) + 1 if len(unchanged) else 0
            if onset < len(inside):
                return onset
    return None


def _is_set_up_again(sensor: SensorLog, row: int) -> bool:
    return row < len(sensor) and bool(np.asarray(sensor.status[row : row + 1])[0] & RECONFIGURED)


def _is_blank(sensor: SensorLog, begin: int, inside: Floats) -> Booleans:
    """Return the mask of the rows that contain the zeros of a chip without a reading since its reset."""
    stale = (np.asarray(sensor.status[begin : begin + len(inside)]) & STALE) != 0
    return np.asarray(stale & (inside == 0).all(axis=1))


def _middle(counts: Floats) -> tuple[Floats, Floats]:
    """Return the median (3,) and the robust standard deviation (3,) of readings (n, 3), which is at least that of
    rounding.
    """
    return np.asarray(np.median(counts, axis=0)), np.maximum(robust_std(counts), _ROUNDED_LSB)


def _counts(sensor: SensorLog, begin: int, end: int) -> Floats:
    return np.asarray(sensor.counts[begin:end], float)


def _between_s(sensor: SensorLog, row: int) -> float:
    """Return the time, in s, between a row and the row before it: half a usual interval after the latter. The usual
    interval is that of the two rows before, because the gap to the row may be long.
    """
    first = max(min(row, len(sensor)) - 2, 0)
    times = np.asarray(sensor.time[first : first + 2], np.int64)
    step_ns = int(times[-1] - times[0])
    return float(times[-1] + step_ns / 2) * 1e-9
