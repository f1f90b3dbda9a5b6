"""The health of a recording: green, amber or red with a reason, derived from missed frames, silent sensors, lost
readings and events that report a fault.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from imuarray.log.format import Event
from imuarray.printable import counted, duration, listed, percent, printable

Level = Literal["green", "amber", "red"]

HARMLESS = frozenset(
    {"back", "reconfigured", "clock", "start_up", "recovered", "imported", "import", "simulated", "taken", "cut_off"}
)
"""Kinds of events that report no fault, or the end of one."""

_ENDS = re.compile(r"works again|in all \d|the adapter is back|answers again|set up again")
"""Beginning of the message of an event that ends a fault (`imuarray.acquire.fault_episode`); its kind is that of the
event with which the fault began.
"""

MANY_MISSED = 0.05
"""Share of missed frames above which a recording does not meet its frame rate."""

SHORT_ROOM_S, NO_ROOM_S = 3600.0, 600.0
"""Seconds until the disk is full below which the health is amber, and below which it is red."""

_KINDS: Mapping[str, str] = {
    "checksum": "packets with a wrong checksum",
    "garbage": "bytes that belong to no packet",
    "repeated": "packets received twice",
    "lost": "readings lost",
}
"""Descriptions of kinds of events whose name does not explain them."""

_NAMED = 3
"""Largest number of reasons, and of sensors of a reason, that are named."""


def is_trouble(event: Event) -> bool:
    """Return whether an event reports a fault, not its end."""
    return event.kind not in HARMLESS and not _ENDS.match(event.message)


@dataclass(frozen=True)
class Observations:
    """The observations of a recording from which its health follows.

    The numbers of `sensors`, `frames` and `missed` frames; `bus_failed`: the bus hung or did not answer in time. By
    name of the sensor: seconds for which it is `silent`, readings `lost`, `gaps` of unknown length, `clipped` readings,
    and the share of the time for which the recorder `stalled`. `faults` by sensor ("": the array) and kind of event;
    `stopped`: why the recording ended unexpectedly ("": it did not); `room_s`: seconds until the disk is full (None:
    unknown).
    """

    sensors: int
    frames: int
    missed: int = 0
    bus_failed: bool = False
    silent: Mapping[str, float] = field(default_factory=dict)
    lost: Mapping[str, int] = field(default_factory=dict)
    gaps: Mapping[str, int] = field(default_factory=dict)
    clipped: Mapping[str, int] = field(default_factory=dict)
    faults: Mapping[tuple[str, str], int] = field(default_factory=dict)
    stopped: str = ""
    room_s: float | None = None
    stalled: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Health:
    """Green: as intended; amber: something was lost or failed; red: a fault persists, or much is lost. `reason` is a
    phrase without a full stop, `advice` what to do about the first reason ("": nothing).
    """

    level: Level
    reason: str
    advice: str = ""


class StartVerdict(NamedTuple):
    """A verdict on the start of a sensor: `fault` if its readings can't be used, and a sentence (or "")."""

    fault: bool
    text: str = ""


class _Reason(NamedTuple):
    text: str
    advice: str


def health_of(observations: Observations) -> Health:
    """Return the health of a recording from its observations."""
    urgent, minor = list(_urgent(observations)), list(_minor(observations))
    reasons = [*urgent, *minor]
    if not reasons:
        delivering = (
            "the sensor delivers" if observations.sensors == 1 else f"all {observations.sensors} sensors deliver"
        )
        return Health("green", f"{delivering}, no frame was missed, no fault reported")
    text = "; ".join(reason.text for reason in reasons[:_NAMED])
    return Health("red" if urgent else "amber", text, reasons[0].advice)


def _urgent(observations: Observations) -> Iterator[_Reason]:
    if observations.stopped:
        yield _Reason(observations.stopped, "check whether the logger is running")
    if observations.silent:
        longest = max(observations.silent.values())
        yield _Reason(f"{_names(observations.silent)} silent for {duration(longest)}", "check cable, power and address")
    if _share(observations) >= MANY_MISSED:
        yield _missed_reason(observations, f"{percent(_share(observations))} of the frames missed")
    if observations.room_s is not None and observations.room_s < NO_ROOM_S:
        yield _Reason(f"the disk is full in {duration(observations.room_s)}", _ROOM)


def _minor(observations: Observations) -> Iterator[_Reason]:
    if 0 < _share(observations) < MANY_MISSED:
        yield _missed_reason(observations, f"{counted(observations.missed, 'frame')} missed")
    if lost_rows := {name: count for name, count in observations.lost.items() if count}:
        yield _Reason(f"{counted(sum(lost_rows.values()), 'reading')} of {_names(lost_rows)} lost", _EVENTS)
    if observations.stalled:
        share = max(observations.stalled.values())
        yield _Reason(
            f"no readings of {_names(observations.stalled)} in {percent(share)} of the time: the recorder stalled",
            _STALLS,
        )
    if gaps := {name: count for name, count in observations.gaps.items() if count}:
        yield _Reason(f"{counted(sum(gaps.values()), 'gap')} in the readings of {_names(gaps)}", _EVENTS)
    if clipped := {name: count for name, count in observations.clipped.items() if count}:
        text = f"{counted(sum(clipped.values()), 'reading')} of {_names(clipped)} at the end of the range"
        yield _Reason(text, "choose a wider range if the motion was intended")
    if faults := {key: count for key, count in observations.faults.items() if not _is_counted(observations, *key)}:
        kinds = dict.fromkeys(_KINDS.get(kind, kind.replace("_", " ")) for _, kind in faults)
        total = counted(sum(faults.values()), "fault")
        faulty = dict.fromkeys(sensor for sensor, _ in faults if sensor)
        yield _Reason(f"{total}{f' of {_names(faulty)}' if faulty else ''} reported ({_names(kinds)})", _EVENTS)
    if observations.room_s is not None and NO_ROOM_S <= observations.room_s < SHORT_ROOM_S:
        yield _Reason(f"the disk is full in {duration(observations.room_s)}", _ROOM)


def _missed_reason(observations: Observations, text: str) -> _Reason:
    return (
        _Reason(f"{text}, the bus did not always answer", _WIRING)
        if observations.bus_failed
        else _Reason(text, _SLOWER)
    )


_WIRING = "check the wires and pull-up resistors of the bus"
_SLOWER = "lower the frame rate, or record fewer sensors"
_STALLS = "compare readings by their times, not by their row numbers"
_EVENTS = "read the events, which say why"
_ROOM = "free space, or log to another disk"


def _is_counted(observations: Observations, sensor: str, kind: str) -> bool:
    """Return whether the content of these events is already counted as missed frames, lost readings or silence."""
    if kind == "late":
        return observations.missed > 0
    return kind == "lost" and (
        observations.lost.get(sensor, 0) > 0 or observations.gaps.get(sensor, 0) > 0 or sensor in observations.silent
    )


def _share(observations: Observations) -> float:
    return observations.missed / max(1, observations.frames + observations.missed)


def _names(names: Mapping[str, object]) -> str:
    spelled = [printable(name) for name in names]
    if len(spelled) <= _NAMED or (short := listed(spelled)).count(",") >= _NAMED:
        rest = f" and {len(spelled) - _NAMED} more" if len(spelled) > _NAMED else ""
        return ", ".join(spelled[:_NAMED]) + rest
    return short
