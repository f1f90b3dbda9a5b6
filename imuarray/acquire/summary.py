"""What happened while a log was recorded, in numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Summary:
    """What happened while a log was recorded."""

    frames: int = 0
    late: int = 0
    """Frames that began after their time."""
    missed: int = 0
    """Frames whose time had passed altogether when the one before ended, up to the end that was asked for."""
    uncertain: int = 0
    """Readings whose time is uncertain by a millisecond or more: the machine did something else meanwhile."""
    lost: dict[str, int] = field(default_factory=dict)
    """Readings that never arrived, by sensor."""
    silent: list[str] = field(default_factory=list)
    """Sensors that gave no reading any more when the recording ended."""
    refused: int = 0
    """Frames of a serial link that were old, repeated, out of order or of an earlier boot, and were not taken."""
    seconds: float = 0.0
    """How long was recorded: frames and missed frames, a period each (`imuarray.log.missed_frames`)."""
    logs: list[Path] = field(default_factory=list)
    """The files, in the order of their time: one, unless it was cut into parts."""
