"""The state of a log at one moment, in the units of the sensors (g, dps), which people read, instead of SI.

`EventCounts` has the last events of a log, the number of each kind, and the current phase.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.characterise.spectrum import Spectrum
from imuarray.errors import LogError
from imuarray.log.format import Event
from imuarray.log.health import Health, is_trouble
from imuarray.log.journal import Notes
from imuarray.log.missed_frames import MISSED, is_fault_of_bus

KEPT = 50
"""Largest number of events that are kept."""

_MOST_BYTES = 1 << 20
"""Largest number of bytes of the latest notes that are read: some ten thousand events."""


_NUMBER = re.compile(r"\d+(\.\d+)?")


class RepeatedEvent(NamedTuple):
    """The newest of events that differ only in numbers, their number `times`, and the time of the first."""

    event: Event
    times: int
    first_ns: int


class EventCounts:
    """The events and phases so far."""

    def __init__(self) -> None:
        self._kinds: Counter[str] = Counter()
        self._last: deque[Event] = deque(maxlen=KEPT)
        self._groups: dict[tuple[str, str, str], RepeatedEvent] = {}
        self._faults: Counter[tuple[str, str]] = Counter()
        self._on: dict[tuple[int, str], None] = {}
        self.missed = 0
        """Missed frames according to events. The rows of a machine that is always too slow are evenly spaced, so that
        their times do not show missed frames.
        """
        self._missed_first = 0
        self.bus_failed = False
        """True if an event says that the bus hung or did not answer in time."""
        self.complete = True
        """True if all notes of the log are counted; False if there were too many."""

    def take(self, text: npt.NDArray[Any]) -> None:
        """Add rows of the group `notes`, lines of text as bytes; invalid lines are skipped."""
        notes = Notes()
        try:
            notes.add({"text": text})
        except LogError:
            self.complete = False
        self.take_events(notes.events)
        for begun in notes.begun:
            self._on[begun.start_ns, begun.name] = None
        for phase in notes.phases:
            self._on.pop((phase.start_ns, phase.name), None)

    def take_stored(self, column: Any, rows: int) -> None:
        """Add the first `rows` bytes of a stored column of notes, at most the last mebibyte of them."""
        start = max(0, rows - _MOST_BYTES)
        text = np.asarray(column[start:rows], np.uint8)
        if start:
            self.complete = False
            text = text[int(np.argmax(text == ord("\n"))) + 1 :]
        self.take(text)

    def take_events(self, events: Iterable[Event]) -> None:
        """Add events, the oldest first."""
        for event in events:
            self._kinds[event.kind] += 1
            self._last.append(event)
            self._add_to_group(event)
            if is_trouble(event):
                self._faults[event.sensor, event.kind] += 1
            self.bus_failed |= is_fault_of_bus(event)
            if event.kind == "late" and not event.sensor and (match := MISSED.match(event.message)):
                frames = int(match[2])  # "in all" includes the number of the first event
                self.missed += frames - (self._missed_first if match[1] else 0)
                self._missed_first = 0 if match[1] else frames

    @property
    def kinds(self) -> Mapping[str, int]:
        """Events by kind, the most frequent first."""
        return dict(self._kinds.most_common())

    @property
    def problems(self) -> int:
        """Events that report a fault, not its end."""
        return self._faults.total()

    @property
    def faults(self) -> Mapping[tuple[str, str], int]:
        """Events that report a fault by sensor and kind, the most frequent first."""
        return dict(self._faults.most_common())

    @property
    def repeated(self) -> tuple[RepeatedEvent, ...]:
        """The last events that differ in more than numbers, each with its number; the newest first."""
        return tuple(sorted(self._groups.values(), key=lambda repeated: repeated.event.time_ns)[::-1])

    def _add_to_group(self, event: Event) -> None:
        key = event.sensor, event.kind, _NUMBER.sub("#", event.message)
        earlier = self._groups.pop(key, None)
        first_ns = event.time_ns if earlier is None else earlier.first_ns
        self._groups[key] = RepeatedEvent(event, 1 if earlier is None else earlier.times + 1, first_ns)
        if len(self._groups) > KEPT:
            del self._groups[next(iter(self._groups))]

    @property
    def recent(self) -> tuple[Event, ...]:
        """The last events, the newest first."""
        return tuple(sorted(self._last, key=lambda event: event.time_ns)[::-1])  # at equal times, the later note first

    @property
    def phase(self) -> str:
        """The phase that began last and has not ended, "" if there is none."""
        return next(reversed(self._on), ("", ""))[1] if self._on else ""


WAITING, WRITTEN, FINISHED, INTERRUPTED = "waiting", "being written", "finished", "interrupted"
"""The states of a monitored log."""


@dataclass(frozen=True)
class Disk:
    """The free bytes on the log's disk, the bytes per second that the log takes, and the seconds until the logger ends
    because the disk is full (None: it takes nothing).
    """

    free_bytes: int
    bytes_per_s: float
    left_s: float | None


@dataclass(frozen=True)
class SensorView:
    """A sensor in the last seconds of the log, which end at the newest row of any sensor.

    A silent sensor has had no readings for `silent_s` (None: it is not silent), and its mean is unknown. `rows`: number
    of rows of the log so far, the first at `first_ns`; `delayed` and `missed` rows among those that are counted, and
    since it is silent; `framed`: it has one row in every frame; `flags`: rows of the last seconds by flag. `time` (n,)
    in ns and `values` (n, k) in `unit`, with their `mean` (k,) over the last second and `sd` (k,) over all. `use` and
    `peak_use` (k,): used share of the measuring range in the last seconds and in the log so far; None for a sensor
    without a range. `temperature_degc` of the last second; `relative`: its zero is unknown.
    """

    name: str
    chip: str
    quantity: str
    unit: str
    columns: tuple[str, ...]
    rows: int
    first_ns: int | None
    rate_hz: float
    silent_s: float | None
    framed: bool
    delayed: int
    missed: int
    flags: Mapping[str, int]
    time: Times
    values: Floats
    mean: Floats
    sd: Floats
    use: Floats | None
    peak_use: Floats | None
    temperature_degc: float | None
    relative: bool
    spectrum: Spectrum | None


@dataclass(frozen=True)
class FusedView:
    """The fused result of the last seconds by quantity: `time` (n,) ns, `triads` (n, 3) in SI in the box frame, their
    `mean` (3,) over the last second, and `noise` (3,), the scatter from frame to frame.
    """

    technique: str
    calibrated: bool
    time: Times
    triads: Mapping[str, Floats]
    mean: Mapping[str, Floats]
    noise: Mapping[str, Floats]


@dataclass(frozen=True)
class Snapshot:
    """A log at one moment.

    `state` is one of the four above, `remark` further information ("": none). `begins_ns` and `ends_ns` are the times
    of the first and the newest row since `epoch`; `quiet_s` is the time without new rows. `rate_hz` is the current rate
    of frames, `frame_rate_hz` the requested one (0: unknown). `missed` are frames whose time had passed, as the logger
    counts them; `delayed` are frames that were read more than a quarter of a period later than usual. The logger's late
    frames are all that began after their time, and therefore more. `counted` is the share of the log that is counted so
    far. `events` are counted by kind; `problems` of them report a fault. `recent` are the last events, the newest
    first, `repeated` the last that differ in more than numbers. `health` follows from all of it. `took_s` is the
    duration of the refresh.
    """

    path: Path
    state: str
    remark: str = ""
    source: str = ""
    epoch: str = ""
    phase: str = ""
    begins_ns: int | None = None
    ends_ns: int | None = None
    quiet_s: float = 0.0
    rate_hz: float = 0.0
    frame_rate_hz: float = 0.0
    delayed: int = 0
    missed: int = 0
    counted: float = 1.0
    events: Mapping[str, int] | None = None
    problems: int = 0
    recent: tuple[Event, ...] = ()
    repeated: tuple[RepeatedEvent, ...] = ()
    health: Health | None = None
    disk: Disk | None = None
    sensors: tuple[SensorView, ...] = ()
    fused: FusedView | None = None
    not_fused: str = ""
    took_s: float = 0.0
