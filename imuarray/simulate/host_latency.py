"""Delays of the host that read an array, estimated from the times of all its sensors' rows in a log.

The sensors of a frame are read one after the other, as fast as the bus transfers their bytes. If another program uses
the processor before one of them is read, this sensor and all that follow are late by that time. A recorder knows only
the two times between which a reading was transferred, and stores the middle of them. If the reading took longer than
its bits need, the error is at most half the wait: half of the wait is before the stored time of the row, half after it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.log import SensorLog
from imuarray.log.format import LOST_BEFORE
from imuarray.simulate.timeline import GapFilledTimes, Timeline

_TIGHT_NS = 500_000
"""Limit of the spread in ns of the intervals between two readings of a frame, apart from waits. Above it, intervals
contain idle time, which a wait shortens.
"""

_LEAST_NS = 250_000
"""Half of the shortest wait that is evaluated, in ns."""

_LEAST = 16
"""Minimum number of times that one sensor must follow another for their usual interval to be estimated."""

_NEVER_NS = 1 << 62
_NOTHING: Integers = np.zeros(0, np.int64)

_WINDOW_ROWS = 1 << 16
_MARGIN_NS = 10**9


@dataclass(frozen=True, eq=False)
class DelayedTimes:
    """The rows of a recorded sensor at the times of its `own` timeline, with the delays of the host. Before the rows
    numbered `waited` (w,), ascending, the host waited for twice `half_ns` (w,). The rows numbered `missed` (m,),
    ascending, are missing in all sensors.
    """

    own: Timeline
    waited: Integers
    half_ns: Integers
    missed: Integers

    @property
    def rows(self) -> int:
        """The number of rows of its own timeline."""
        return self.own.rows

    @property
    def rows_per_s(self) -> float:
        """The rate of its own timeline."""
        return self.own.rows_per_s

    def stamps(self, start: int, stop: int) -> Integers:
        """Return the times of its own timeline."""
        return self.own.stamps(start, stop)

    def waits(self, start: int, stop: int) -> tuple[Integers, Booleans]:
        """Return, for rows start ... stop - 1, half of the host's wait before each in ns (n,), and whether the host
        missed a reading there (n,).
        """
        halves, missed = np.zeros(stop - start, np.int64), np.zeros(stop - start, bool)
        first, last = np.searchsorted(self.waited, (start, stop))
        halves[self.waited[first:last] - start] = self.half_ns[first:last]
        first, last = np.searchsorted(self.missed, (start, stop))
        missed[self.missed[first:last] - start] = True
        return halves, missed


def lost_rows(line: Timeline) -> tuple[tuple[int, int, int], ...]:
    """Return the stamps in ns of the rows before and after each stretch in which the sensor lost rows, and how many."""
    timeline = line.own if isinstance(line, DelayedTimes) else line
    return tuple(timeline.holes()) if isinstance(timeline, GapFilledTimes) else ()


def find_delays(lines: Mapping[str, Timeline], sensors: Mapping[str, SensorLog]) -> dict[str, Timeline]:
    """Return the `lines` of recorded `sensors` with the host's delays, which are estimated from the times of all of
    them; a timeline without delays is returned unchanged.
    """
    names = list(lines)
    recorded = [sensors[name] for name in names]
    windows = _windows(recorded)
    first = next(windows, None)
    if first is None:
        return dict(lines)
    pairs = _pairs(first, len(names))
    parts = [_find_in_window(rows, pairs, len(names)) for rows in chain([first], windows)]
    all_delays = [
        _HostDelays(*map(np.concatenate, zip(*of_sensor, strict=True))) for of_sensor in zip(*parts, strict=True)
    ]
    polled = {
        name: delays for number, (name, delays) in enumerate(zip(names, all_delays, strict=True)) if pairs.has(number)
    }
    after_loss = {name: delays.after_loss_ns for name, delays in polled.items()}
    late = {
        name: _line(lines[name], delays, _find_missed(name, lines[name], after_loss)) for name, delays in polled.items()
    }
    return {**lines, **late}


class _HostDelays(NamedTuple):
    """The delays of one sensor: rows (w,) before which the host waited, half of the waits (w,), and the times (l,) of
    rows flagged as following a loss.
    """

    waited: Integers
    half_ns: Integers
    after_loss_ns: Integers


class _FrameRows(NamedTuple):
    """The rows of all sensors in order of time (n,): the index `which` of their sensor, their `number` in it, whether
    they are flagged as following a loss, and whether they lie within the window and not in its margins.
    """

    time_ns: Integers
    which: Integers
    number: Integers
    is_after_loss: Booleans
    inner: Booleans


class _SensorPairs(NamedTuple):
    """Intervals in ns (s, s) at which the second sensor is usually read right after the first; nan unless the two are
    read in one frame as fast as the bus allows. `idle_ns` are the intervals of the other pairs.
    """

    usual_ns: Floats
    idle_ns: Floats

    def has(self, which: int) -> bool:
        """Return whether this sensor is read directly before or after another one."""
        return bool(np.isfinite(self.usual_ns[which]).any() or np.isfinite(self.usual_ns[:, which]).any())


def _windows(sensors: Sequence[SensorLog]) -> Iterator[_FrameRows]:
    """Yield all rows in large blocks."""
    longest = max(sensors, key=len)
    for block in longest.blocks(_WINDOW_ROWS):
        is_first, is_last = block.start == 0, block.stop == len(longest)
        begin_ns = -_NEVER_NS if is_first else int(longest.time[block.start])
        end_ns = _NEVER_NS if is_last else int(longest.time[block.stop])
        yield _rows(sensors, begin_ns, end_ns)


def _rows(sensors: Sequence[SensorLog], begin_ns: int, end_ns: int) -> _FrameRows:
    parts = []
    for which, sensor in enumerate(sensors):
        span = sensor.between(begin_ns - _MARGIN_NS, end_ns + _MARGIN_NS)
        times = np.asarray(sensor.time[span], np.int64)
        flags = (np.asarray(sensor.status[span]) & LOST_BEFORE) != 0
        number = np.arange(span.start, span.start + len(times))
        parts.append((times, np.full(len(times), which), number, flags, (times >= begin_ns) & (times < end_ns)))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    return _FrameRows(*(column[order] for column in columns))


def _find_in_window(rows: _FrameRows, pairs: _SensorPairs, sensors: int) -> list[_HostDelays]:
    halves = _halves(rows, pairs)
    late = rows.inner & (halves >= _LEAST_NS)
    is_lost = rows.inner & rows.is_after_loss
    windows = []
    for number in range(sensors):
        is_late = late & (rows.which == number)
        after_loss_ns = rows.time_ns[is_lost & (rows.which == number)]
        windows.append(_HostDelays(rows.number[is_late], np.rint(halves[is_late]).astype(np.int64), after_loss_ns))
    return windows


def _pairs(rows: _FrameRows, count: int) -> _SensorPairs:
    """Return the intervals between the rows of each pair of the first `count` sensors."""
    usual, idle = np.full((2, count, count), np.nan)
    intervals = np.diff(rows.time_ns)
    for first in range(count):
        for second in range(count):
            of_pair = intervals[(rows.which[:-1] == first) & (rows.which[1:] == second)]
            if len(of_pair) < _LEAST:
                continue
            shortest, middle, upper = np.percentile(of_pair, (0, 50, 75))
            tight = first != second and middle - shortest < _TIGHT_NS and upper - middle < _TIGHT_NS
            (usual if tight else idle)[first, second] = middle
    return _SensorPairs(usual, idle)


def _halves(rows: _FrameRows, pairs: _SensorPairs) -> Floats:
    """Return (n,) half of the host's wait before each row: the excess that the intervals before and after it have in
    common. If one of the two intervals is not known, it is the excess of the other minus the part that belongs to the
    neighbour.
    """
    interval, step = np.diff(rows.time_ns), (rows.which[:-1], rows.which[1:])
    over, idle = interval - pairs.usual_ns[step], interval - pairs.idle_ns[step]
    edge = [np.nan]
    before, after = np.concatenate([edge, over]), np.concatenate([over, edge])
    starts = np.concatenate([edge, idle])
    smaller = np.clip(np.minimum(before, after), 0.0, None)  # nan if either is
    inside = np.nan_to_num(smaller)
    for at in np.flatnonzero((inside[1:] > 0) & (inside[:-1] > 0)) + 1:  # the part of the previous row is subtracted
        smaller[at] = inside[at] = max(min(before[at] - inside[at - 1], after[at]), 0.0)
    previous, ahead = np.concatenate([[0.0], inside[:-1]]), np.concatenate([inside[1:], [0.0]])
    first = np.clip(after - ahead, 0.0, None)
    # The waits of both rows of a frame with two rows follow from one interval.
    lonely = np.isnan(np.concatenate([smaller[1:], edge]))
    first = np.where(lonely, np.clip(np.fmin(first, starts), 0.0, None), first)
    carried = np.concatenate([[0.0], np.nan_to_num(np.where(np.isnan(before), first, 0.0))[:-1]])
    last = np.clip(before - np.where(previous > 0, previous, carried), 0.0, None)
    return np.asarray(np.nan_to_num(np.where(np.isfinite(smaller), smaller, np.where(np.isfinite(after), first, last))))


def _find_missed(name: str, line: Timeline, after: Mapping[str, Integers]) -> Integers:
    """Return the numbers of rows that were lost while every other sensor also lost rows: the host did not read then."""
    other_times = [times for other, times in after.items() if other != name]
    if not isinstance(line, GapFilledTimes) or not other_times:
        return _NOTHING
    missed, rows = [_NOTHING], line.recorded.rows
    begins = line.before + np.cumsum(line.missing) - line.missing
    for row, count, begin in zip(line.before.tolist(), line.missing.tolist(), begins.tolist(), strict=True):
        last_ns, _, *more = line.recorded.stamps(row - 1, min(row + 2, rows)).tolist()
        (next_ns,) = more or [_NEVER_NS]
        if all(_has_between(times, last_ns, next_ns) for times in other_times):
            missed.append(np.arange(begin, begin + count))
    return np.concatenate(missed)


def _has_between(times: Integers, after_ns: int, until_ns: int) -> bool:
    first = int(np.searchsorted(times, after_ns, side="right"))
    return first < len(times) and int(times[first]) <= until_ns


def _line(line: Timeline, delays: _HostDelays, missed: Integers) -> Timeline:
    waited = delays.waited
    if not len(waited) and not len(missed):
        return line
    if isinstance(line, GapFilledTimes):
        lead = np.concatenate([[0], np.cumsum(line.missing)])
        waited = waited + lead[np.searchsorted(line.before, waited, side="right")]
    return DelayedTimes(line, waited, delays.half_ns, missed)
