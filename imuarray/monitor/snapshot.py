"""The state of a log at one moment, in the units of the sensors (g, dps), which people read, instead of SI.

`EventCounts` has the last events of a log, the number of each kind, and the current phase.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.characterise.spectrum import Spectrum
from imuarray.errors import LogError
from imuarray.log.format import Event
from imuarray.log.health import Health, is_trouble
from imuarray.log.layout import Notes
from imuarray.log.missed_frames import MISSED, is_fault_of_bus

KEPT = 50
"""Events that are kept to be shown."""

_MOST_BYTES = 1 << 20
"""Size of the latest notes that are read: some ten thousand events."""


_NUMBER = re.compile(r"\d+(\.\d+)?")


class RepeatedEvent(NamedTuple):
    """The newest of some events that are alike but for numbers, how many `times` they happened, and when first."""

    event: Event
    times: int
    first_ns: int


class EventCounts:
    """Events and phases that were taken so far."""

    def __init__(self) -> None:
        self._kinds: Counter[str] = Counter()
        self._last: deque[Event] = deque(maxlen=KEPT)
        self._groups: dict[tuple[str, str, str], RepeatedEvent] = {}
        self._faults: Counter[tuple[str, str]] = Counter()
        self._on: dict[tuple[int, str], None] = {}
        self.missed = 0
        """Missed frames as reported by events. A machine that is always too slow misses frames that the times of its
        rows don't show: the rows are evenly spaced, only too far apart.
        """
        self._missed_first = 0
        self.bus_failed = False
        """True if an event says that the bus hung or did not answer in time."""
        self.complete = True
        """True if all notes of the log were counted; False if there were too many before."""

    def take(self, text: npt.NDArray[Any]) -> None:
        """Take rows of the group `notes`, lines of text as bytes; lines that are none are passed over."""
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
        """Take the first `rows` bytes of a stored column of notes; the last mebibyte if there are more."""
        start = max(0, rows - _MOST_BYTES)
        text = np.asarray(column[start:rows], np.uint8)
        if start:
            self.complete = False
            text = text[int(np.argmax(text == ord("\n"))) + 1 :]
        self.take(text)

    def take_events(self, events: Iterable[Event]) -> None:
        """Take events, the oldest first."""
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
        return MappingProxyType(dict(self._kinds.most_common()))

    @property
    def problems(self) -> int:
        """Events that report a fault, not its end."""
        return self._faults.total()

    @property
    def faults(self) -> Mapping[tuple[str, str], int]:
        """Events that report a fault by sensor and kind, the most frequent first."""
        return MappingProxyType(dict(self._faults.most_common()))

    @property
    def repeated(self) -> tuple[RepeatedEvent, ...]:
        """The last events that differ in more than numbers, each with how often it happened; the newest first."""
        return tuple(sorted(self._groups.values(), key=lambda repeated: repeated.event.time_ns)[::-1])

    def _add_to_group(self, event: Event) -> None:
        """Count an event with those that differ from it in numbers only."""
        key = event.sensor, event.kind, _NUMBER.sub("#", event.message)
        before = self._groups.pop(key, None)
        first_ns = event.time_ns if before is None else before.first_ns
        self._groups[key] = RepeatedEvent(event, 1 if before is None else before.times + 1, first_ns)
        if len(self._groups) > KEPT:
            del self._groups[next(iter(self._groups))]

    @property
    def recent(self) -> tuple[Event, ...]:
        """The last events, the newest first."""
        return tuple(sorted(self._last, key=lambda event: event.time_ns)[::-1])  # of equal times the later note first

    @property
    def phase(self) -> str:
        """The phase that began last and has not ended, "" if there is none."""
        return next(reversed(self._on), ("", ""))[1] if self._on else ""


WAITING, WRITTEN, FINISHED, INTERRUPTED = "waiting", "being written", "finished", "interrupted"
"""The states of a log that is watched."""


@dataclass(frozen=True)
class Disk:
    """Bytes that are free beside the log, bytes a second that it takes, and seconds until the logger will end it for
    want of room (None: it takes nothing).
    """

    free_bytes: int
    bytes_per_s: float
    left_s: float | None


@dataclass(frozen=True)
class SensorView:
    """A sensor in the last seconds of the log, which are those before the newest row of any sensor.

    From one that is silent nothing came for `silent_s` (None: something did in the last second), nor is its mean known.
    `rows` of the log so far, the first of them at `first_ns`; `delayed` and `missed` among those that were counted, and
    since it is silent; `framed`, whether there is one in every frame. `flags`, rows of the last seconds by flag.
    `time` (n,) ns and `values` (n, k) in `unit`, their `mean` (k,) over the last second and `sd` (k,) over all of
    them. `use` and `peak_use` (k,): share of the measuring range, in the last seconds and at most so far; None for a
    sensor without a range. `temperature_degc` of the last second, where `relative` says that its zero is not known.
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
    `mean` (3,) over the last second, and `noise` (3,), the scatter from frame to frame. `technique` gave it.
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

    `state` is one of the four above, `remark` what else is to be said of it ("" nothing). `begins_ns` and `ends_ns` are
    the first and the last time in it, since `epoch`; `quiet_s` how long nothing came. `rate_hz` is that of
    frames, `frame_rate_hz` what was asked for (0: not known). `missed` are frames whose time had passed, as the logger
    counts them; `delayed` those that were read more than a quarter of a period later than usual, which is fewer than
    the logger calls late: there it is every frame that began behind its time, however little. `counted` is the share of
    the log that was counted so far. `events` by kind, of which `problems` tell of trouble; `recent` are the last ones,
    the newest first, and `repeated` the last ones that differ in more than numbers. `health` is the sign of all of it.
    `took_s` is what it took to look.
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
