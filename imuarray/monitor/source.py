"""What a monitor reads from, and what it has read so far."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from imuarray.log.hdf5_superblock import is_marked_open
from imuarray.log.journal import journal_of
from imuarray.monitor.backlog import Backlog
from imuarray.monitor.held import Attributes
from imuarray.monitor.notes import FusionNotes
from imuarray.monitor.window import Window


@dataclass
class Seen:
    """What was read so far: the last `span_ns` by sensor, and what was told."""

    span_ns: int
    windows: dict[str, Window] = field(default_factory=dict)
    told: FusionNotes = field(default_factory=FusionNotes)

    def expect(self, names: Iterable[str]) -> None:
        """These sensors: windows of the same ones go on, others begin empty."""
        names = list(names)
        if list(self.windows) != names:
            self.windows = {name: Window(self.span_ns) for name in names}


class Source(Protocol):
    """A log that is read from into `seen`; `attributes` of its sensors, `state` as it was last seen."""

    path: Path
    source: str
    epoch: str
    state: str
    seen: Seen
    attributes: dict[str, Attributes]
    frame_rate_hz: float
    row_bytes: dict[str, int]
    backlog: Backlog

    def read(self) -> int:
        """Add what is new; the number of rows."""

    def close(self) -> None:
        """Let go of the files."""


def identity(path: Path) -> tuple[int, int] | None:
    """Which file has that name now."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def look(path: Path) -> tuple[object, ...]:
    """What is there under the name of a log, to see whether that changed: its file, and that of its journal."""
    unclosed = False
    with contextlib.suppress(OSError):
        unclosed = is_marked_open(path)
    return identity(path), identity(journal_of(path)), unclosed
