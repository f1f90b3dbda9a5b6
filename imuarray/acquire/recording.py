"""The options of a recording, and its summary: counts of what happened while the log was recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from imuarray.acquire.service import Service
from imuarray.acquire.start_up import Judge
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.writer import Block


@dataclass
class Summary:
    """Counts of what happened while a log was recorded."""

    frames: int = 0
    late: int = 0
    """Frames that began after their time."""
    missed: int = 0
    """Frames that were skipped because the frame before ended after their time, up to the requested end."""
    missed_by_bus: int = 0
    """Those of the missed frames before which a transaction on the bus timed out."""
    uncertain: int = 0
    """Readings whose time is uncertain by a millisecond or more, because the machine was busy."""
    lost: dict[str, int] = field(default_factory=dict)
    """Readings that did not arrive, by sensor."""
    silent: list[str] = field(default_factory=list)
    """Sensors that no longer gave readings when the recording ended."""
    refused: int = 0
    """Frames of a serial link that were rejected: old, repeated, out of order or of an earlier boot."""
    seconds: float = 0.0
    """Duration: frames and missed frames, one period each (`imuarray.log.missed_frames`)."""
    logs: list[Path] = field(default_factory=list)
    """The files in the order of their time: one, unless the log was split into parts."""


@dataclass(frozen=True)
class RecordingOptions:
    """The options of a recording, and the callbacks that follow it."""

    rate_hz: float
    """Frames per second; a frame reads every sensor once."""
    seconds: float | None = None
    """Duration; None: until `stopped` returns True."""
    phase: str = ""
    """Name of the whole log ("static", "z_up", ...)."""
    up: str = ""
    """The box axis that points up in `phase` ("+Z", ...)."""
    phases: Sequence[Phase] = ()
    """Names of parts of the log, in times of the bus's clock."""
    rotate_s: float | None = None
    """Length of the parts into which the log is split, each a log of its own (`imuarray.log.rotate`)."""
    wall_time: datetime | None = None
    """UTC time of the start; None: that of the transcript being replayed, else the wall clock, read once."""
    force: bool = False
    """Overwrite the log if it exists."""
    judge: Judge | None = None
    """States how sensors started; a sensor that started wrong is flagged and configured again."""
    service: Service | None = None
    """The service manager to notify; None: the one that started this process, if any."""
    stopped: Callable[[], bool] = lambda: False
    """Polled between frames; True ends the recording."""
    progress: Callable[[int], None] = lambda frames: None
    """Receives the number of frames, after every write."""
    observe: Callable[[str, Block], None] = lambda sensor, block: None
    """Receives every block of a sensor's rows as it is written."""
    tell: Callable[[Event], None] = lambda event: None
    """Receives every event."""
    counted: Callable[[Summary], None] = lambda summary: None
    """Receives the summary so far, after every write."""
    begun: Callable[[str, Sequence[SensorHeader]], None] = lambda epoch, sensors: None
    """Receives the log's epoch and sensor headers before the log is created; an exception ends the recording."""
    started: Callable[[int], None] = lambda time_ns: None
    """Receives the start time of the first of several parts."""
