"""Times at which each row of each sensor is read: by a poll loop, by a chip's own queue, or or as in a given log.

A poll loop is like the recorder's. A frame visits the segments of the bus in one order and the next frame in the
reverse order (this saves one switch of the multiplexer per frame), so that a sensor's intervals are alternately
slightly shorter and slightly longer. The duration of a burst is its number of clocks at 400 kHz. The times of a log can
be used with or without the rows that it lost.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from imuarray.array import ArrayConfig, SensorConfig
from imuarray.arrays import Booleans, Floats, Integers
from imuarray.chips import CHIPS
from imuarray.errors import ConfigError
from imuarray.log import SensorLog
from imuarray.log.columns import NamedColumn
from imuarray.log.format import LOST_BEFORE
from imuarray.log.missed_frames import frames_in

_CLOCK_NS = 2500
_SWITCH_CLOCKS = 19
_BURST_CLOCKS = {chip: 9 * (spec.burst_bytes + 3) if spec.burst_bytes else 0 for chip, spec in CHIPS.items()}
"""SCL clocks of a burst as the drivers read it: nine per byte, after two addresses and a register (BUS-01)."""

_SOON = 1.1
"""Margin, in frames, for the different delays in forward and reverse order: a slow chip is not read in a frame if it
can wait for the next frame with this margin.
"""
_SINGLE = 1024
_PIECE, _PIECES = 16384, 16
"""Rows of a recorded sensor whose stamps are read at once, and the number of such pieces that are kept: 2 MB."""

_HOLE = 1.5
"""Ratio to the usual interval below which an interval is too short for a missing row."""

_TYPICAL = 1024
"""Minimum number of intervals of a block for which the usual interval is estimated again."""

_LEAST_REGULAR, _REGULAR = 200, 0.9
"""Minimum number of intervals, and minimum share of them within `_OFF_GRID` of the usual one, of a regular record."""

_OFF_GRID = 0.2
"""Largest deviation of an interval from a whole number of usual intervals, in usual intervals, if rows are missing."""

_LONGEST_SKIP = 20.5
"""Length of a gap in usual intervals above which it cannot be decided whether an unflagged gap fits the period. A
longer gap is a pause of the recorder: the rate of the rows is that between pauses.
"""

_AROUND = 2
"""Number of intervals on either side of a long one in which a shorter one shows that a row was late and not lost."""

_LEAST_BEAT, _EVEN = 3, 0.5
"""Minimum number of distances between gaps, and the coefficient of variation of these distances below which gaps are
evenly spaced; the coefficient is 1 for independent gaps.
"""


class Timeline(Protocol):
    """The rows of one sensor."""

    @property
    def rows(self) -> int:
        """The number of rows."""

    @property
    def rows_per_s(self) -> float:
        """The nominal rate in rows per second."""

    def stamps(self, start: int, stop: int) -> Integers:
        """Return (stop - start,) int64 ns since the epoch, strictly increasing."""


@dataclass(frozen=True)
class PollTimes:
    """The times of a polled sensor: one row every `every` frames of `period_ns`, from frame `first` on, with one fixed
    delay after the start of even frames and another one after the start of odd frames.
    """

    rows: int
    period_ns: int
    every: int = 1
    first: int = 0
    forth_ns: int = 0
    back_ns: int = 0

    @property
    def rows_per_s(self) -> float:
        """Rows a second."""
        return 1e9 / (self.period_ns * self.every)

    def stamps(self, start: int, stop: int) -> Integers:
        """Return the start of each frame plus the delay of this sensor in it."""
        frames = np.arange(self.first + self.every * start, self.first + self.every * stop, self.every, dtype=np.int64)
        stamps = frames * self.period_ns + self.forth_ns
        if self.back_ns != self.forth_ns:
            stamps += (frames & 1) * (self.back_ns - self.forth_ns)
        return stamps


@dataclass(frozen=True)
class QueueTiming:
    """The times of a chip whose queue is read: one row for every sample, at its data rate."""

    rows: int
    rows_per_s: float

    def stamps(self, start: int, stop: int) -> Integers:
        """Return the times at the data rate."""
        return np.asarray(np.rint(np.arange(start, stop) * (1e9 / self.rows_per_s)), np.int64)


class LogTimes:
    """The rows of a recorded sensor at the times of its log; it is pickled like a `SensorLog`."""

    def __init__(self, sensor: SensorLog) -> None:
        self._sensor = sensor
        self.rows = len(sensor)
        self.rows_per_s = self._between_pauses() or max(sensor.rate_hz, 1.0)

    def stamps(self, start: int, stop: int) -> Integers:
        """Return the times in the log; read-only."""
        if stop - start == 1:
            return self._single_stamp(start)
        first, last = start // _PIECE, max(stop - 1, start) // _PIECE
        if first == last:
            return self._piece(first)[start - first * _PIECE : stop - first * _PIECE]
        parts = [self._piece(number) for number in range(first, last + 1)]
        return np.concatenate(parts)[start - first * _PIECE : stop - first * _PIECE]

    def __getstate__(self) -> dict[str, object]:
        return {name: getattr(self, name) for name in ("_sensor", "rows", "rows_per_s")}

    @cached_property
    def _time(self) -> NamedColumn:
        return self._sensor.time

    def _between_pauses(self) -> float:
        """Return the rows per second of the stretches between pauses of the recorder; 0 for a single row."""
        intervals, span_ns, usual_ns = 0, 0, 0.0
        for start in range(0, self.rows - 1, _PIECE):
            steps_ns = np.diff(np.asarray(self._time[start : start + _PIECE + 1], np.int64))
            usual_ns = usual_ns or float(np.median(steps_ns))
            in_stretches = steps_ns[np.asarray(steps_ns, float) <= _LONGEST_SKIP * usual_ns]
            intervals, span_ns = intervals + len(in_stretches), span_ns + int(in_stretches.sum())
        return intervals * 1e9 / span_ns if span_ns > 0 else 0.0

    @cached_property
    def _piece(self) -> Callable[[int], Integers]:
        """Return the stamps (p,) of one piece; they are cached, because replicates of a log read them repeatedly."""
        return lru_cache(maxsize=_PIECES)(self._read)

    def _read(self, number: int) -> Integers:
        stamps = np.array(self._time[number * _PIECE : (number + 1) * _PIECE], np.int64)
        stamps.flags.writeable = False
        return stamps

    @cached_property
    def _single_stamp(self) -> Callable[[int], Integers]:
        """Return the cached stamp (1,) of a single row, because the ends of phases are requested repeatedly."""
        return lru_cache(maxsize=_SINGLE)(lambda row: np.asarray(self._time[row : row + 1], np.int64))


@dataclass(frozen=True, eq=False)
class GapFilledTimes:
    """The rows of a recorded sensor including those that it lost: `missing` (h,) rows, evenly spaced, precede its rows
    `before` (h,), which ascend and do not include the first one.
    """

    recorded: Timeline
    before: Integers
    missing: Integers

    @property
    def rows(self) -> int:
        """The number of recorded and lost rows."""
        return self.recorded.rows + int(self.missing.sum())

    @property
    def rows_per_s(self) -> float:
        """The rate between pauses, without losses."""
        in_pauses = int(self.missing[self.missing + 1 > _LONGEST_SKIP].sum())
        return self.recorded.rows_per_s * (self.rows - 1) / (self.recorded.rows - 1 + in_pauses)

    def stamps(self, start: int, stop: int) -> Integers:
        """Return the times in the log, including those of the lost rows."""
        if stop <= start:
            return np.zeros(0, np.int64)
        holes_before = bisect_right(self._ends, start)  # holes
        if holes_before == len(self._ends) or self._ends[holes_before] - self.missing[holes_before] >= stop:
            lead = self._ends[holes_before - 1] - int(self.before[holes_before - 1]) if holes_before else 0
            return self.recorded.stamps(start - lead, stop - lead)
        return self._stamps_of_rows(np.arange(start, stop))

    def holes(self) -> Iterator[tuple[int, int, int]]:
        """Yield the stamps in ns of the rows before and after each hole, and how many are missing between them."""
        for row, count in zip(self.before.tolist(), self.missing.tolist(), strict=True):
            before_ns, after_ns = self.recorded.stamps(row - 1, row + 1).tolist()
            yield before_ns, after_ns, count

    def _stamps_of_rows(self, rows: Integers) -> Integers:
        """Return the stamps of rows (n,) in order."""
        ends, missing = np.array(self._ends), self.missing
        hole = np.searchsorted(ends - missing, rows, side="right") - 1  # the last hole that begins at or before the row
        inside = np.flatnonzero((hole >= 0) & (rows < ends[hole]))
        last = rows - np.concatenate([ends - self.before, [0]])[hole]  # the recorded row at or before it
        last[inside] = self.before[hole[inside]] - 1
        times = self.recorded.stamps(int(last[0]), min(int(last[-1]) + 2, self.recorded.rows))
        stamps = times[last - last[0]]
        parts = missing[hole[inside]] + 1
        step = rows[inside] - ends[hole[inside]] + parts
        whole, rest = np.divmod(times[last[inside] - last[0] + 1] - stamps[inside], parts)
        stamps[inside] += step * whole + step * rest // parts  # no product exceeds 64 bits
        return np.asarray(stamps)

    @cached_property
    def _ends(self) -> list[int]:
        """The number (h,), counting lost rows, of the recorded row after each hole."""
        ends: list[int] = (self.before + np.cumsum(self.missing)).tolist()
        return ends


def filled(sensor: SensorLog) -> LogTimes | GapFilledTimes:
    """Return the rows of a recorded sensor and those that it lost.

    Rows are lost before a row with flag 8 if the interval is at least `_HOLE` times the usual one. Because not every
    recorder sets that flag, rows are also lost in gaps of a regular record that are a whole number of its periods and
    are not compensated by an early row nearby. Gaps without the flag at even distances are the beat of the chip's clock
    with the recorder's clock: no row is lost there.

    The usual interval is the median of the intervals without the flag, in blocks of 65536 rows. Reads times and flags
    once, a block at a time.
    """
    recorded = LogTimes(sensor)
    holes = list(_holes(sensor)) if recorded.rows > 1 else []
    if not holes:
        return recorded
    before, missing, is_flagged = (np.concatenate(column) for column in zip(*holes, strict=True))
    lost = is_flagged | (not _is_beat(before))
    return GapFilledTimes(recorded, before[lost], missing[lost]) if lost.any() else recorded


def _holes(sensor: SensorLog) -> Iterator[tuple[Integers, Integers, Booleans]]:
    """Yield, for each block with holes: the rows before which others are missing, how many, whether flagged."""
    usual_ns, is_regular = 0.0, False
    for block in sensor.blocks():
        first = max(block.start - _AROUND - 1, 0)
        times = np.asarray(sensor.time[first : min(block.stop + _AROUND, len(sensor))], np.int64)
        intervals = np.diff(times)  # the interval before row r has the number r - 1 - first
        own = slice(max(block.start, 1) - 1 - first, block.stop - 1 - first)
        lost = (np.asarray(sensor.status[first + 1 : first + len(times)]) & LOST_BEFORE) != 0
        plain = intervals[own][~lost[own]]
        if len(plain) >= (_TYPICAL if usual_ns else 1):
            usual_ns = float(np.median(plain))
        if usual_ns <= 0:
            continue
        periods = intervals / usual_ns
        if len(periods) >= _LEAST_REGULAR:  # a shorter block at the end is as regular as the previous one
            is_regular = bool(np.mean(np.abs(periods - 1) <= _OFF_GRID) >= _REGULAR)
        are_holes = np.where(lost, periods >= _HOLE, is_regular & _are_skips(periods))
        holes = np.flatnonzero(are_holes[own]) + own.start
        if len(holes):
            yield first + 1 + holes, np.rint(periods[holes]).astype(np.int64) - 1, lost[holes]


def _are_skips(periods: Floats) -> Booleans:
    """Return (n,) whether rows are missing in these intervals of a regular record, in units of the usual interval: the
    interval is close to a whole number of periods, and no shorter interval is nearby, as there would be after a row
    that is only late.
    """
    near = sliding_window_view(np.pad(periods, _AROUND, constant_values=1.0), 2 * _AROUND + 1).min(axis=1)
    fits = np.abs(periods - np.rint(periods)) <= _OFF_GRID
    return np.asarray(fits & (periods >= _HOLE) & (periods <= _LONGEST_SKIP) & (near >= 1 - _OFF_GRID))


def _is_beat(rows: Integers) -> bool:
    """Return True if the gaps before these rows (h,) are evenly spaced."""
    distances = np.diff(rows)
    return len(distances) >= _LEAST_BEAT and float(np.std(distances)) < _EVEN * float(np.mean(distances))


def poll(array: ArrayConfig, frame_rate_hz: float, seconds: float) -> Mapping[str, Timeline]:
    """Return the timelines of an array that is polled `frame_rate_hz` times a second for `seconds`; ConfigError if the
    bus is too slow for this rate.
    """
    if not frame_rate_hz > 0:
        raise ConfigError(f"{frame_rate_hz:g} frames per second: allowed is anything above 0")
    frames, period_ns = frames_in(seconds, frame_rate_hz), round(1e9 / frame_rate_hz)
    forth, back, frame_ns = _offsets_ns(array)
    polled = [sensor.name for sensor in array.sensors if not sensor.fifo]
    if max((abs(back[name] - forth[name]) for name in polled), default=0) >= period_ns:
        raise ConfigError(
            f"{frame_rate_hz:g} frames per second: the bus needs {frame_ns * 1e-6:.3g} ms to read all sensors; allowed "
            f"are at most {math.floor(1e9 / frame_ns)} frames per second, or queues (fifo = true)"
        )
    lines: dict[str, Timeline] = {}
    for sensor in array.sensors:
        if sensor.fifo:
            lines[sensor.name] = QueueTiming(max(1, math.ceil(seconds * sensor.chip_rate_hz)), sensor.chip_rate_hz)
            continue
        every, first = _visits(sensor, frame_rate_hz)
        rows = max(0, -(-(frames - first) // every))
        lines[sensor.name] = PollTimes(rows, period_ns, every, first, forth[sensor.name], back[sensor.name])
    return lines


def _visits(sensor: SensorConfig, frame_rate_hz: float) -> tuple[int, int]:
    """Return the number of frames between two rows, and the frame of the first row."""
    if sensor.spec.on_demand:  # each conversion is requested in the first frame after the previous one
        first = sum(max(1, math.ceil(frame_rate_hz * seconds)) for seconds in sensor.spec.conversions_s)
        return max(1, math.ceil(frame_rate_hz / sensor.chip_rate_hz)), first
    return max(1, math.ceil(frame_rate_hz / sensor.chip_rate_hz - _SOON)), 0


def _offsets_ns(array: ArrayConfig) -> tuple[dict[str, int], dict[str, int], int]:
    """Return the delays in ns from the start of a frame to each sensor's burst, in the forward and in the reverse
    order, and the duration of a frame.
    """
    segments: dict[int | str | None, list[SensorConfig]] = {}
    for sensor in array.sensors:
        segments.setdefault(sensor.bus or sensor.channel, []).append(sensor)
    orders = list(segments.values())
    forth, frame_ns = _burst_offsets(orders)
    return forth, _burst_offsets(orders[::-1])[0], frame_ns


def _burst_offsets(segments: list[list[SensorConfig]]) -> tuple[dict[str, int], int]:
    """Return the delays in ns to each sensor's burst, and the end of the last one."""
    offsets: dict[str, int] = {}
    passed_ns = 0
    for index, segment in enumerate(segments):
        if index and not segment[0].on_spi:
            passed_ns += _SWITCH_CLOCKS * _CLOCK_NS  # a frame begins on the segment where the last one ended
        for sensor in segment:
            offsets[sensor.name] = passed_ns
            passed_ns += _burst_ns(sensor)
    return offsets, passed_ns


def _burst_ns(sensor: SensorConfig) -> int:
    """Return the duration of a burst in ns: on SPI eight clocks for the register and for each byte."""
    if sensor.on_spi:
        return round(8e9 * (CHIPS[sensor.chip].burst_bytes + 1) / sensor.spi_rules.clock_hz)
    return _BURST_CLOCKS[sensor.chip] * _CLOCK_NS
