"""The duration of a recording and the number of missed frames, as the logger counts them and as its log shows them.

The duration of a recording is that of its frames, missed ones included, at one period each; the time to create and
finish files does not count. The logger counts missed frames and reports them in events of the kind "late". If the
events of a log are incomplete (it was interrupted, or is a part of a longer one), missed frames are derived from the
times of its rows.

A logger begins frames on a grid: frame k is due k periods after the first one. A frame is missed if its time has passed
before the previous frame ends; the grid does not shift. The number of missing rows between two rows of a sensor that
is read once per frame is therefore the number of periods between them minus the number of rows, regardless of how many
are missing and how regularly the others arrive. They are missed frames if no reading of this sensor was lost.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from imuarray.arrays import Times
from imuarray.log.format import Event
from imuarray.log.health import is_trouble
from imuarray.log.reader import Log
from imuarray.log.sensor_log import SensorLog
from imuarray.units import INERTIAL

_SAME_CLOCK = frozenset({"i2c", "spi", "emulated", "replay"})
"""Sources with times of the clock by which the logger begins frames; periods are exact on this clock."""
_EARLY = 0.25
"""Share of a period by which a row may be too early for its frame: reading the first row may have taken longer."""
_OF_ALL = frozenset({"adapter", "bus"})
"""Kinds of faults by which every sensor loses readings, although their frames are not missed."""
_OWN_PACE = 1.25
"""Rows per frame above which a sensor has a queue, which it fills at its own rate."""

MISSED = re.compile(r"(in all )?(\d+) frames? missed")
"""The message of an event of the kind "late": the frames missed when a delay began, or in the whole delay."""

BUS_WAS_LATE = "the bus did not answer in time"
"""The reason in this event's message if a transaction timed out in the previous frame; else the machine was late."""


class FrameTiming(NamedTuple):
    """Missed frames (None: not known) and duration of a log in seconds."""

    missed: int | None
    seconds: float


def frames_in(seconds: float, rate_hz: float) -> int:
    """Return how many frames begin in `seconds`, at least one; a remainder below a millionth of a frame is ignored."""
    return max(1, math.ceil(seconds * rate_hz - 1e-6))


def duration_s(frames: int, missed: int, rate_hz: float) -> float:
    """Return the duration of this number of frames at `rate_hz`, in s."""
    return (frames + missed) / rate_hz


def missed_by_events(events: Iterable[Event]) -> int | None:
    """Return the number of missed frames according to the events, in the order in which they were recorded; None if
    they include a total of a fault that began in the previous log.
    """
    missed, first = 0, None
    for event in events:
        match = MISSED.match(event.message) if event.kind == "late" and not event.sensor else None
        if match is None:
            continue
        if match[1] and first is None:
            return None
        missed += int(match[2]) - (first or 0 if match[1] else 0)
        first = None if match[1] else int(match[2])
    return missed


def is_fault_of_bus(event: Event) -> bool:
    """Return whether an event says that the bus hung, or that frames were missed because it did not answer."""
    return not event.sensor and (event.kind == "bus" or (event.kind == "late" and BUS_WAS_LATE in event.message))


def frame_period_ns(source: str, frame_rate_hz: float) -> int:
    """Return the period of the grid on which the rows of a log from `source` lie; 0 if no grid is known."""
    return round(1e9 / frame_rate_hz) if source in _SAME_CLOCK and frame_rate_hz > 0 else 0


def is_read_once_a_frame(chip_rate_hz: float, rate_hz: float, frame_period_ns: int) -> bool:
    """Return whether a sensor with `rate_hz` rows per second, of a chip with `chip_rate_hz` values per second (0: not
    known), yields one row in every frame.
    """
    if frame_period_ns <= 0:
        return False
    frame_rate_hz = 1e9 / frame_period_ns
    keeps_up = chip_rate_hz <= 0 or chip_rate_hz >= frame_rate_hz * (1 - 1e-6)
    return bool(keeps_up and rate_hz <= _OWN_PACE * frame_rate_hz)


def loses_no_reading(sensor: str, faults: Iterable[tuple[str, str]]) -> bool:
    """Return whether the faults, as (sensor, kind of event), include none of this sensor and none of the bus or of the
    adapter: all rows that it lacks are then missed frames.
    """
    return not any(name == sensor or (not name and kind in _OF_ALL) for name, kind in faults)


def missing_rows(first_ns: int, last_ns: Times, rows: int, frame_period_ns: int) -> int:
    """Count the missing rows between the first and the newest of `rows` of a sensor that is read once a frame.

    `last_ns` (1 or 2,) are the times of its newest rows. The visiting order of sensors alternates from frame to frame;
    rows an even number of frames apart are therefore a whole number of periods apart, except for lateness.
    """
    if rows < 2 or frame_period_ns <= 0:
        return 0
    parity = min((rows - 1) % 2, len(last_ns) - 1)
    periods = math.floor((int(last_ns[-1 - parity]) - first_ns) / frame_period_ns + _EARLY)
    return max(0, periods - (rows - 1 - parity))


def missed_by_all(missing: Sequence[tuple[int, int]], frame_period_ns: int) -> int | None:
    """Return the number of missed frames from (time of the first row, number of missing rows) of each sensor that is
    read once per frame; None without such sensors. A row that only one sensor lacks is a lost reading. If the first
    frame took several periods, a sensor that was read late in it has missed fewer frames.
    """
    begins_ns = min((first_ns for first_ns, _ in missing), default=0)
    return min((count + (first_ns - begins_ns) // frame_period_ns for first_ns, count in missing), default=None)


def frame_timing(log: Log) -> FrameTiming:
    """Return missed frames and duration of `log`.

    If the log lies on a known grid of frames, the duration is that of its frames and missed frames. If every sensor has
    lost readings, missed frames after the last row do not count. Otherwise the duration is the time from the first row
    to the last, plus one period.
    """
    period_ns = frame_period_ns(log.source, log.frame_rate_hz)
    sensors = [sensor for sensor in log.sensors.values() if sensor.quantity in INERTIAL and len(sensor) > 1]
    once = [sensor for sensor in sensors if is_read_once_a_frame(sensor.rate_hz, _rate_hz(sensor), period_ns)]
    missing = {
        sensor.name: (
            int(sensor.time[0]),
            missing_rows(int(sensor.time[0]), sensor.time[len(sensor) - 2 :], len(sensor), period_ns),
        )
        for sensor in once
    }
    by_events = missed_by_events(log.events)
    if not once:
        return FrameTiming(by_events or None if period_ns else None, _span_s(log))
    faults = {(event.sensor, event.kind) for event in log.events if is_trouble(event)}
    by_rows = missed_by_all([missing[name] for name in missing if loses_no_reading(name, faults)], period_ns)
    if by_rows is None:
        frames = max(len(sensor) + missing[sensor.name][1] for sensor in once)
        return FrameTiming(by_events, duration_s(frames, 0, log.frame_rate_hz))
    # Rows determine the frames missed between them to within one, but not those missed after the last row.
    complete = log.state == "finished" and all(event.kind != "recovered" for event in log.events)
    if by_events is None or (by_events == 0 and by_rows > 1):
        missed = by_rows
    else:
        missed = by_events if complete else max(by_events, by_rows)
    lost_frames = (max(count - by_rows, 0) for _, count in missing.values())
    frames = max(len(sensor) + (count if count > 1 else 0) for sensor, count in zip(once, lost_frames, strict=True))
    return FrameTiming(missed, duration_s(frames, missed, log.frame_rate_hz))


def _span_s(log: Log) -> float:
    """Return the time from the first row to the last, plus one frame, in s."""
    rows = [sensor for sensor in log.sensors.values() if len(sensor)]
    if not rows:
        return 0.0
    first, last = min(int(sensor.time[0]) for sensor in rows), max(int(sensor.time[-1]) for sensor in rows)
    return (last - first) * 1e-9 + (1 / log.frame_rate_hz if log.frame_rate_hz > 0 else 0.0)


def _rate_hz(sensor: SensorLog) -> float:
    rows = len(sensor)
    return (rows - 1) * 1e9 / max(1, int(sensor.time[rows - 1]) - int(sensor.time[0]))
