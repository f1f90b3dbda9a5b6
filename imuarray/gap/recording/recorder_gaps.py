"""Gaps in a log that the recorder caused: it read no sensor in them, and neither does a simulation of the log.

If one sensor lacks a row while the others were read, the row is lost, and the simulator may fail to lose it. If no
sensor was read, the gap says nothing about the sensors: the recorder's timing is a nuisance quantity, and the gap
becomes a note. A gap is the recorder's if all other sensors that were due are missing as well, or if an event of the
logger reports missed frames. In a log with a single sensor it is the recorder's unless the next row has the flag of a
loss.

Now and then every bus fails: a few readings in ten thousand that the logger itself reports as lost are the recorder's
too, and so is one in ten thousand that is missing without a report.

Two other kinds of gap contain no lost row. One is a gap within the period of a slow chip that is polled more often than
it measures. The other is a gap of a queue that reports no overflow: the recorder computes its times from those of the
polls, and the first of these times are not yet even.

A reading that was requested before a stall of the recorder and received after it has the time of the middle of the
stall, which may be wrong by half of it; it lies between two long intervals. Whether the next row is a new reading
depends on the time of this one. Neither row is compared.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.special import pdtrc

from imuarray.arrays import Booleans, Integers, Reals
from imuarray.log import Log, SensorLog
from imuarray.log.format import LOST_BEFORE, OVERRUN, Event
from imuarray.log.missed_frames import MISSED
from imuarray.simulate.timeline import GapFilledTimes, Timeline

MISSING = 1.5
"""Least interval of another sensor around the middle of a gap, in its usual intervals, at which it is missing too."""

DUE = 0.6
"""Longest usual interval of a sensor that was due in a gap, as a share of the gap."""

PERIOD, SLOWER = 1.1, 0.9
"""Longest gap of a slow chip in which no reading is lost, and longest usual interval of its rows at which it is polled
more often than it measures; both in periods of its readings.
"""

QUEUED = 1.2
"""Least ratio of the rate of rows to that of frames at which a sensor has a queue."""

EARLY = 0.9
"""Share of the usual interval below which a row is early, so that no reading was lost before it."""

CHANCE = 0.01
"""Largest probability of the number of common gaps, for sensors that lose rows independently, at which common gaps are
attributed to the recorder.
"""

USUAL_LOSSES = 5e-4
"""Largest share of a sensor's readings that a bus usually loses. A single reading is never more than usual."""

USUAL_UNREPORTED = 1e-4
"""Largest share of readings that are usually missing without a report: a host is interrupted for a moment."""

_DELAYED = re.compile(r"\b(late|miss(ed|ing)|stall(ed|s)?|delay(ed|s)?|busy)\b", re.IGNORECASE)
"""Pattern for a delay of the recorder in the kind or message of an event."""

LATE = "late"
"""Kind of event that this logger writes for a delay."""

_SPAN = re.compile(r"missed in ([\d.]+) s")
"""Pattern for the duration in an event that reports all delays of a period together."""


class _Gap(NamedTuple):
    """The gap between two rows of a sensor, in ns of the log."""

    begin_ns: int
    end_ns: int

    @property
    def length_ns(self) -> int:
        return self.end_ns - self.begin_ns


@dataclass(frozen=True)
class RecorderGaps:
    """Timelines without the recorder's gaps.

    `lines`: the timelines of the sensors without the rows that were due in these gaps; `ends_ns`: by sensor the times
    (k,) of the first rows after them, and of rows that are flagged as following lost rows at a reported delay; `note`:
    a sentence on the gaps, "" without any; `uncertain_ns`: by sensor the times (u,) of rows that were read in a gap at
    an unknown moment, and of the rows that follow them.
    """

    lines: Mapping[str, Timeline]
    ends_ns: Mapping[str, Integers]
    note: str = ""
    uncertain_ns: Mapping[str, Integers] = field(default_factory=dict)


def recorder_gaps(log: Log, lines: Mapping[str, Timeline]) -> RecorderGaps:
    """Detect the recorder's gaps among the rows of sensors with these timelines."""
    usual_ns = {name: usual_interval_ns(sensor) for name, sensor in log.sensors.items()}
    frame_ns = 1e9 / log.frame_rate_hz if log.frame_rate_hz > 0 else min(filter(None, usual_ns.values()), default=0.0)
    delays: dict[str, list[_Gap]] = {}
    for event in filter(_is_delay, log.events):
        delays.setdefault(event.sensor, []).append(_delay(event, frame_ns))
    timelines, ends_ns, uncertain_ns = dict(lines), {}, {}
    most: list[_Gap] = []
    losses_of: list[str] = []
    for name, line in lines.items():
        of_sensor = [*delays.get("", ()), *delays.get(name, ())]
        flagged_ns = _flagged_times(log[name], usual_ns[name], of_sensor)
        if len(flagged_ns):
            ends_ns[name] = flagged_ns
        if not isinstance(line, GapFilledTimes):
            continue
        others = [(log[other], interval_ns) for other, interval_ns in usual_ns.items() if other != name]
        gaps = [_Gap(begin_ns, end_ns) for begin_ns, end_ns, _ in line.holes()]
        begins_ns, gap_ends_ns = np.array(gaps, float).T
        is_late = _is_delayed(begins_ns, gap_ends_ns + usual_ns[name], of_sensor)
        if others:
            is_common = np.array([_is_common(gap, others) for gap in gaps])
        else:  # only the logger can tell that a single sensor lost a reading
            is_common = ~np.array([_overflowed(log[name], gap) for gap in gaps])
        common_ns = float(np.mean([gap.length_ns for gap in gaps]))
        losses = [_lost_share(*other, common_ns) for other in others if other[1] > 0]
        if others and is_common.any() and pdtrc(is_common.sum() - 1, len(gaps) * math.prod(losses)) > CHANCE:
            is_common[:] = False
        is_idle = np.array([_is_idle(gap, usual_ns[name], log[name].rate_hz) for gap in gaps])
        if 0 < QUEUED * usual_ns[name] < frame_ns:
            is_idle |= ~np.array([_overflowed(log[name], gap) for gap in gaps])
        is_idle &= ~(is_late | is_common)
        is_own = ~(is_late | is_common | is_idle)
        reports_ns = np.sort([event.time_ns for event in log.events if event.sensor == name])
        is_reported = is_own & np.array([_is_reported(gap, usual_ns[name], reports_ns) for gap in gaps])
        few = int(line.missing[is_reported].sum())
        if 0 < few <= max(USUAL_LOSSES * line.rows, 1):
            is_own &= ~is_reported
            losses_of.append(f"{name} ({few})")
        if 0 < line.missing[is_own].sum() <= USUAL_UNREPORTED * line.rows:
            is_own[:] = False
        if is_own.all():
            continue
        of_recorder = [gap for gap, is_other in zip(gaps, (is_own | is_idle).tolist(), strict=True) if not is_other]
        of_common = [gap for gap, is_of_all in zip(gaps, (is_late | is_common).tolist(), strict=True) if is_of_all]
        lost = replace(line, before=line.before[is_own], missing=line.missing[is_own])
        timelines[name] = lost if is_own.any() else line.recorded
        ends_ns[name] = np.union1d(flagged_ns, np.array([gap.end_ns for gap in of_recorder], np.int64))
        uncertain = _uncertain_times(log[name], usual_ns[name], of_recorder)
        if len(uncertain):
            uncertain_ns[name] = uncertain
        most = max(most, of_common, key=len)
    sentences = [_sentence(most), _sentence_of_losses(losses_of)]
    return RecorderGaps(timelines, ends_ns, "; ".join(filter(None, sentences)), uncertain_ns)


def _uncertain_times(sensor: SensorLog, usual_ns: float, gaps: Sequence[_Gap]) -> Integers:
    """Return the times of rows before a gap that were late themselves, and of the rows after these gaps."""
    times = []
    for gap in gaps:
        row = sensor.between(gap.begin_ns, gap.begin_ns).start
        if row > 0 and gap.begin_ns - int(sensor.time[row - 1]) >= MISSING * usual_ns:
            times += [gap.begin_ns, gap.end_ns]
    return np.unique(np.array(times, np.int64))


def _flagged_times(sensor: SensorLog, usual_ns: float, delays: Sequence[_Gap]) -> Integers:
    """Return the times of rows at a delay that are flagged as following lost rows. After a short delay no interval is a
    gap, since the reading before the lost one was late.
    """
    flagged = [np.zeros(0, np.int64)]
    for rows in sensor.blocks() if delays else ():
        is_flagged = (np.asarray(sensor.status[rows]) & LOST_BEFORE) != 0
        if is_flagged.any():
            flagged.append(np.asarray(sensor.time[rows], np.int64)[is_flagged])
    times_ns = np.concatenate(flagged)
    return times_ns[_is_delayed(times_ns - 2 * usual_ns, times_ns + usual_ns, delays)]


def _is_delayed(begin_ns: Reals, end_ns: Reals, delays: Sequence[_Gap]) -> Booleans:
    """Return whether the logger reports a delay that begins before the end, and ends after the begin, of each of k
    periods (k,).
    """
    if not delays:
        return np.zeros(len(begin_ns), bool)
    begins_ns, ends_ns = np.array(sorted(delays), np.int64).T
    latest_ns = np.maximum.accumulate(ends_ns)
    before = np.searchsorted(begins_ns, end_ns, side="right")
    return np.asarray((before > 0) & (latest_ns[before - 1] > begin_ns))


def _is_reported(gap: _Gap, usual_ns: float, reports_ns: Integers) -> bool:
    """Return whether one of the logger's reports on a sensor (r,), in ascending order, is about the gap."""
    first, last = np.searchsorted(reports_ns, [gap.begin_ns - usual_ns, gap.end_ns + usual_ns])
    return bool(first < last)


def _is_idle(gap: _Gap, usual_ns: float, rate_hz: float) -> bool:
    """Return whether no reading of a chip with this rate was lost in the gap."""
    if rate_hz <= 0:
        return False
    period_ns = 1e9 / rate_hz
    return usual_ns < SLOWER * period_ns and gap.length_ns <= PERIOD * period_ns


def _overflowed(sensor: SensorLog, gap: _Gap) -> bool:
    """Return whether a flag of the row after the gap reports lost rows."""
    row = sensor.between(gap.end_ns, gap.end_ns + 1).start
    return bool(row < len(sensor) and int(sensor.status[row]) & (OVERRUN | LOST_BEFORE))


def _is_common(gap: _Gap, others: Sequence[tuple[SensorLog, float]]) -> bool:
    """Return whether all other sensors that were due in the gap are missing in it; False if none was due."""
    due = [(sensor, interval_ns) for sensor, interval_ns in others if 0 < interval_ns <= DUE * gap.length_ns]
    return bool(due) and all(_is_missing(sensor, interval_ns, gap) for sensor, interval_ns in due)


def _is_missing(sensor: SensorLog, usual_ns: float, gap: _Gap) -> bool:
    """Return whether the sensor's rows around the middle of the gap are further apart than usual."""
    middle_ns = (gap.begin_ns + gap.end_ns) // 2
    row = sensor.between(middle_ns, middle_ns).start
    if not 0 < row < len(sensor):
        return False
    before_ns, after_ns = (int(time) for time in sensor.time[row - 1 : row + 1])
    return after_ns - before_ns >= max(MISSING * usual_ns, gap.length_ns / 2)


def _lost_share(sensor: SensorLog, usual_ns: float, gap_ns: float) -> float:
    """Return the share of a log's time in which a sensor lacks rows, not counting one gap of length `gap_ns`."""
    span_ns = int(sensor.time[-1]) - int(sensor.time[0])
    return max(1 - ((len(sensor) - 1) * usual_ns + gap_ns) / span_ns, 0.0)


def usual_interval_ns(sensor: SensorLog) -> float:
    """Return the median of a sensor's first intervals in ns; 0 with fewer than two rows."""
    return float(np.median(np.diff(np.asarray(sensor.time[: 1 << 14], np.int64)))) if len(sensor) > 1 else 0.0


def _is_delay(event: Event) -> bool:
    """Return whether an event reports a delay of the recorder. An event that names a sensor does if its kind is
    "late": some recorders write one event for each sensor that they could not read in time.
    """
    is_of_all = not event.sensor and bool(_DELAYED.search(event.kind) or _DELAYED.search(event.message))
    return is_of_all or event.kind == LATE


def _delay(event: Event, frame_ns: float) -> _Gap:
    """Return the period in which the logger was late according to an event, which it writes at the end. Its length is
    that of the missed frames, or the duration that the event states. If a queue overflowed, its rows are missing from
    the beginning of the period.
    """
    missed, span = MISSED.match(event.message), _SPAN.search(event.message)
    length_ns = float(span[1]) * 1e9 if missed and span else int(missed[2]) * frame_ns if missed else 0.0
    return _Gap(event.time_ns - round(length_ns), event.time_ns)


def _sentence(gaps: Sequence[_Gap]) -> str:
    if not gaps:
        return ""
    lengths_s = np.array([gap.length_ns for gap in gaps]) * 1e-9
    times = "once" if len(gaps) == 1 else f"{len(gaps)} times"
    return (
        f"the recorder read no sensor for {np.median(lengths_s):.2g} s, {times} ({lengths_s.sum():.3g} s in all); "
        "these rows are missing, not different"
    )


def _sentence_of_losses(losses_of: Sequence[str]) -> str:
    if not losses_of:
        return ""
    return f"the logger reports a few lost readings, as on any bus: {', '.join(losses_of)}"
