"""The part of a log that is evaluated: a phase at rest, and within it the longest run of rows at a steady interval.

`find_rate_changes` detects changes of the row rate: a setting that was changed, or a phone that saves power. The rows
are divided into pieces of equal numbers of rows. A run of pieces ends where both the median interval and the mean
interval without gaps change in two consecutive pieces: a coarse clock does not change the mean, and lost rows do not
change the median. The row of the change is the one that best divides the intervals into those of the two rates.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence
from dataclasses import dataclass
from math import log, nan

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Indices
from imuarray.errors import LogError
from imuarray.log import Log, SensorLog
from imuarray.log.format import LOST_BEFORE, RECONFIGURED, SUSPECT, Phase
from imuarray.log.rests import steady_rests
from imuarray.spelling import guess

GAP = 1.5
"""An interval longer than this multiple of the upper quartile of the intervals is a gap; an array that is polled in
alternating order has short and long intervals in turn, and the long ones are not gaps.
"""


@dataclass(frozen=True)
class Stretch:
    """The part of a log that is characterised: a phase, or all of it (`phase` None); `chosen_by` states the reason for
    the choice.

    Rows between the times of `left_out` (ns) do not count as readings at rest; `remark` states the reason.
    """

    start_ns: int
    end_ns: int
    phase: str | None
    up: str
    chosen_by: str
    left_out: tuple[tuple[int, int], ...] = ()
    remark: str = ""


_MOST_RUNS = 20_000
"""Largest number of runs that are kept, the longest ones."""

LEAST_RUN = 9
"""Fewest rows of a run in the Allan deviation: fewer do not have two octaves."""

Spans = Sequence[tuple[int, int]]
"""Start and end in ns of times in which readings do not count."""


def flags_of(sensor: SensorLog, part: slice, left_out: Spans = ()) -> npt.NDArray[np.uint16]:
    """Return the flags (n,) of rows of a sensor, with rows in the spans `left_out` marked as suspect."""
    flags = np.array(sensor.status[part], np.uint16)
    if len(left_out):
        time_ns = np.asarray(sensor.time[part], np.int64)
        for start_ns, end_ns in left_out:
            flags[slice(*np.searchsorted(time_ns, (start_ns, end_ns)))] |= SUSPECT
    return flags


@dataclass(frozen=True)
class Timing:
    """The times of one sensor's rows: median and longest interval (nan with fewer than 2 rows), number of gaps, the
    longest run of rows without a gap, lost readings or suspect rows, the interval above which a gap is counted, and all
    `runs` of at least `LEAST_RUN` rows, in order.
    """

    interval_s: float
    largest_gap_s: float
    gaps: int
    run: slice
    gap_limit_s: float = float("inf")
    runs: tuple[slice, ...] = ()


def choose_stretch(log: Log, phase: str | None = None) -> Stretch:
    """Return the longest phase called `phase`; without a name the longest of `steady_rests`, or the whole log if no
    phase is a rest.

    LogError if no phase has that name.
    """
    if phase is not None:
        named = [item for item in log.phases if item.name == phase]
        if not named:
            names = list(dict.fromkeys(item.name for item in log.phases))
            raise LogError(
                f"{log.path}: no phase {phase!r}; it has {', '.join(names) or 'no phases'}{guess(phase, names)}"
            )
        return _stretch(named, "named")
    rests = steady_rests(log.phases)
    return _stretch(rests, "longest phase at rest") if rests else _whole(log)


def _stretch(phases: list[Phase], chosen_by: str) -> Stretch:
    longest = max(phases, key=lambda phase: phase.end_ns - phase.start_ns)
    return Stretch(longest.start_ns, longest.end_ns, longest.name, longest.up, chosen_by)


def _whole(log: Log) -> Stretch:
    sensors = [sensor for sensor in log.sensors.values() if len(sensor)]
    start = min((int(sensor.time[0]) for sensor in sensors), default=0)
    end = max((int(sensor.time[-1]) + 1 for sensor in sensors), default=0)
    return Stretch(start, end, None, "", "no phase at rest: the whole log")


def find_timing(
    sensor: SensorLog, rows: slice, block: int = 1 << 16, *, counted: bool = False, left_out: Spans = ()
) -> Timing:
    """Return the median interval, gaps and longest unbroken run of `rows`, read `block` rows at a time.

    A run ends at a gap, where readings were lost or the chip was configured again, and at every row that is suspect or
    in a span that is left out. With `counted`, rows arrived in bursts: they were measured at a steady rate, and no
    interval between them is a gap. The median of more than `block` rows is the median of the blocks' medians, and so is
    the quartile. LogError if time doesn't increase.
    """
    if rows.stop - rows.start < 2:
        return Timing(float("nan"), float("nan"), 0, rows)
    quartiles = [np.quantile(_intervals(sensor, part), (0.5, 0.75)) for part in _parts(rows, block)]
    median, upper = np.median(quartiles, axis=0).tolist()
    gaps, largest, begin, runs = 0, 0, rows.start, [slice(rows.start, rows.start)]
    for part in _parts(rows, block):
        intervals = _intervals(sensor, part)
        wide = intervals > (np.inf if counted else GAP * upper)
        gaps += int(np.count_nonzero(wide))
        largest = max(largest, int(intervals.max()))
        for row in (part.start + 1 + np.flatnonzero(wide | broken_rows(flags_of(sensor, part, left_out))[1:])).tolist():
            runs.append(slice(begin, row))
            begin = row
        if len(runs) > _MOST_RUNS:
            runs = _longest(runs)
    runs.append(slice(begin, rows.stop))
    longest = max(runs, key=_length)
    limit_s = np.inf if counted else GAP * upper * 1e-9
    return Timing(median * 1e-9, largest * 1e-9, gaps, longest, limit_s, tuple(_longest(runs)))


def _longest(runs: list[slice]) -> list[slice]:
    """Return the longest runs in order of time: those that are long enough, up to a maximum number."""
    longest = sorted((run for run in runs if _length(run) >= LEAST_RUN), key=_length, reverse=True)[:_MOST_RUNS]
    return sorted(longest, key=lambda run: int(run.start))


def _parts(rows: slice, block: int) -> list[slice]:
    """Return the slices that cover `rows` and share their end rows, so that every interval is in exactly one."""
    return [slice(start, min(start + block + 1, rows.stop)) for start in range(rows.start, rows.stop - 1, block)]


def _intervals(sensor: SensorLog, part: slice) -> npt.NDArray[np.int64]:
    time = np.asarray(sensor.time[part], np.int64)
    intervals = time[1:] - time[:-1]
    if intervals.min() <= 0:
        raise LogError(f"{sensor.where}: time does not increase at row {part.start + 1 + int(intervals.argmin())}")
    return intervals


def broken_rows(status: npt.NDArray[np.uint16]) -> npt.NDArray[np.bool_]:
    """Return for (n,) flags whether the row does not continue the one before; the first row by its own flags only."""
    doubt = (status & SUSPECT) != 0
    broken: npt.NDArray[np.bool_] = ((status & (LOST_BEFORE | RECONFIGURED)) != 0) | doubt
    broken[1:] |= doubt[:-1]
    return broken


def _length(rows: slice) -> int:
    return int(rows.stop - rows.start)


PIECE_ROWS = 64
"""Fewest rows in a piece: its mean interval is then known to 7 % even for a program that sleeps for a uniformly
distributed time between its readings.
"""

PIECES = 512
"""Largest number of pieces, which limits the memory."""

CHANGED = 1.25
"""Least ratio of two intervals that counts as a change of the rate."""

LONG_GAP = 3.0
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
    """Return the median of the intervals in each of consecutive pieces that begin at rows `edges` (k,), and the mean of
    those that are not gaps, in s: (k, 2).
    """
    times = np.asarray(sensor.time[int(edges[0]) : int(edges[-1]) + piece_rows + 1], np.int64)
    intervals = (np.diff(times).astype(float) * 1e-9).reshape(len(edges), piece_rows)
    medians = np.median(intervals, axis=1)
    usual = intervals <= LONG_GAP * medians[:, None]
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
