"""Changes of the row rate of a sensor: a setting that was changed, or a phone that saves power.

The rows are divided into pieces of equal numbers of rows. A run of pieces ends where both the median interval and the
mean interval without gaps change in two consecutive pieces: a coarse clock does not change the mean, and lost rows do
not change the median. The row of the change is the one that best divides the intervals into those of the two rates.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence
from dataclasses import dataclass
from math import log, nan

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.log import SensorLog

PIECE_ROWS = 64
"""Fewest rows in a piece: its mean interval is then known to 7 % even with uniformly distributed sleeps."""

PIECES = 512
"""Largest number of pieces, which limits the memory."""

CHANGED = 1.25
"""Least ratio of two intervals that counts as a change of the rate."""

GAP = 3.0
"""Least interval of a gap, in median intervals of a piece."""

_BLOCK_ROWS = 1 << 16
"""Number of rows that are evaluated at once."""

LISTED = 3
"""Largest number of runs that are described individually."""


@dataclass(frozen=True)
class SteadyRun:
    """Rows `start` to `stop` at `rate_hz`, from `begin_s` after the first row on."""

    start: int
    stop: int
    begin_s: float
    rate_hz: float


def find_rate_changes(sensor: SensorLog) -> tuple[SteadyRun, ...]:
    """Return the runs of rows of a steady rate, in their order; () if the rate does not change."""
    rows = len(sensor)
    piece_rows = max(PIECE_ROWS, -(-rows // PIECES))
    edges = np.arange(0, rows - piece_rows, piece_rows)
    if len(edges) < 4:
        return ()
    at_once = max(1, _BLOCK_ROWS // piece_rows)
    intervals_s = np.concatenate(
        [_intervals_s(sensor, edges[first : first + at_once], piece_rows) for first in range(0, len(edges), at_once)]
    )
    if not (intervals_s > 0).all():
        return ()
    begins = _runs(np.log(intervals_s))
    if len(begins) < 2:
        return ()
    ends = [*begins[1:], len(edges)]
    levels_s = [
        float(np.median(intervals_s[min(begin + 1, end - 1) : end, 1])) for begin, end in zip(begins, ends, strict=True)
    ]
    starts = [0]
    for place, begin in enumerate(begins[1:]):
        starts.append(_row_of_change(sensor, int(edges[begin]), piece_rows, levels_s[place : place + 2]))
    first_ns = int(sensor.time[0])
    return tuple(
        SteadyRun(start, stop, (int(sensor.time[start]) - first_ns) * 1e-9, 1 / level_s)
        for start, stop, level_s in zip(starts, [*starts[1:], rows], levels_s, strict=True)
    )


def _intervals_s(sensor: SensorLog, edges: Indices, piece_rows: int) -> Floats:
    """Return the median interval in pieces from rows `edges` (k,), and the mean without gaps, in s: (k, 2)."""
    times = np.asarray(sensor.time[int(edges[0]) : int(edges[-1]) + piece_rows + 1], np.int64)
    intervals = (np.diff(times).astype(float) * 1e-9).reshape(len(edges), piece_rows)
    medians = np.median(intervals, axis=1)
    usual = intervals <= GAP * medians[:, None]
    means = intervals.mean(axis=1) if usual.all() else np.mean(intervals, axis=1, where=usual)
    return np.stack([medians, means], axis=1)


def _runs(levels: Floats) -> list[int]:
    """Return the first pieces of runs of equal levels (n, 2), the logarithms of intervals."""
    begins, least = [0], log(CHANGED)
    rows = levels.tolist()
    # Median and mean intervals of the run's pieces except the first, sorted.
    intervals: tuple[list[float], list[float]] = [], []
    for piece in range(2, len(rows) - 1):
        for column, ordered in enumerate(intervals):
            if piece - 1 > begins[-1]:
                insort(ordered, rows[piece - 1][column])
        usual = [(each[(len(each) - 1) // 2] + each[len(each) // 2]) / 2 if each else nan for each in intervals]
        changes = [row[column] - usual[column] for row in rows[piece : piece + 2] for column in range(2)]
        if all(change > least for change in changes) or all(change < -least for change in changes):
            begins.append(piece)
            intervals = [], []
    return begins


def _row_of_change(sensor: SensorLog, row: int, piece_rows: int, levels_s: Sequence[float]) -> int:
    """Return the row near `row` that divides the intervals best into those of the two levels."""
    start = max(row - piece_rows, 0)
    intervals = np.diff(np.asarray(sensor.time[start : row + 2 * piece_rows], np.int64)) * 1e-9
    before, after = (np.abs(np.log(np.maximum(intervals, 1e-12) / level_s)) for level_s in levels_s)
    cost = np.concatenate([[0.0], np.cumsum(before - after)])
    return start + int(np.argmin(cost))


def rate_change_sentence(runs: Sequence[SteadyRun]) -> str:
    """Describe changes of the rate; "" without any."""
    if not runs:
        return ""
    if len(runs) > LISTED:
        rates = sorted(run.rate_hz for run in runs)
        return f"the rate changes {len(runs) - 1} times, between {rates[0]:.4g} and {rates[-1]:.4g} rows per second"
    later = (f", {run.rate_hz:.4g} from {run.begin_s:.4g} s on" for run in runs[1:])
    return f"the rate changes: {runs[0].rate_hz:.4g} rows per second at first" + "".join(later)
