"""A long recording cut into parts of equal time: `RUN_001.h5`, `RUN_002.h5`, ..., logs of their own with one epoch.

A part is finished, in the background, as soon as every sensor has rows behind its end; nothing is lost in between.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import numpy.typing as npt

from imuarray.errors import ImuArrayError
from imuarray.log.format import ClockRow, Event, Phase, SensorHeader
from imuarray.log.layout import Begun, Notes
from imuarray.log.room import WATERMARK
from imuarray.log.writer import SYNC_S, Block, LogWriter, Stimulus


def part_of(path: Path, number: int) -> Path:
    """The name of a part, counted from 1: `RUN_001.h5`."""
    return path.with_name(f"{path.stem}_{number:03d}{path.suffix}")


class RotatingWriter:
    """Takes what a LogWriter takes, and writes parts of `every_s` seconds; a context manager.

    Each part gets its share of a phase. `paths` are the parts so far.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        sensors: Sequence[SensorHeader],
        *,
        every_s: float,
        source: str,
        epoch: str,
        config: str = "",
        force: bool = False,
        watermark: int = WATERMARK,
        sync_s: float = SYNC_S,
    ) -> None:
        """Create the first part; ValueError unless `every_s` is positive, and as LogWriter."""
        if every_s <= 0:
            raise ValueError(f"parts of {every_s} s: a positive length is wanted")
        self.path = Path(path)
        self.paths: list[Path] = []
        self._sensors, self._every_ns = tuple(sensors), round(every_s * 1e9)
        self._make = partial(
            LogWriter,
            sensors=self._sensors,
            source=source,
            epoch=epoch,
            config=config,
            force=force,
            watermark=watermark,
            sync_s=sync_s,
        )
        self._keep = False
        self._open: dict[int, LogWriter] = {}
        self._first = 0
        self._last_ns = {header.name: -(2**63) for header in sensors}
        """How far every sensor came, and every stimulus that there is."""
        self._phases: list[Phase] = []
        self._begun: list[Phase] = []
        self._parts: list[LogWriter] = []
        self._finished = {header.name: 0 for header in sensors}
        self._counting = threading.Lock()
        self._finishing: list[threading.Thread] = []
        self._error: BaseException | None = None
        self._part(0)

    def _part(self, number: int) -> LogWriter:
        """The part of this number, counted from 0; where it is finished already, the oldest that is not."""
        number = max(number, self._first)
        if number not in self._open:
            part = self._make(part_of(self.path, number + 1))
            self._open[number] = part
            self.paths.append(part.path)
            self._parts.append(part)
            if self._keep:
                part.keep()
            for phase in self._begun:
                self._begin(phase, number, part)
        return self._open[number]

    def append(self, sensor: str, block: Block) -> None:
        """Add rows of one sensor, to the parts in whose time they lie. ValueError, DiskFullError, LogError."""
        self._raise()
        for number, rows in self._split(block.time):
            temperature = None if block.temperature_counts is None else block.temperature_counts[rows]
            compensated = {name: column[rows] for name, column in block.compensated.items()}
            part = Block(block.time[rows], block.counts[rows], block.status[rows], temperature, compensated)
            self._part(number).append(sensor, part)
            self._last_ns[sensor] = int(part.time[-1])
        self._turn()

    def stimulus(self, name: str, rows: Stimulus) -> None:
        """Add rows to `/truth` or `/reference`."""
        self._raise()
        for number, some in self._split(rows.time):
            part = Stimulus(rows.time[some], rows.specific_force[some], rows.angular_rate[some], rows.temperature[some])
            self._part(number).stimulus(name, part)
            self._last_ns[name] = int(part.time[-1])
        self._turn()

    def _split(self, time: npt.NDArray[np.int64]) -> list[tuple[int, slice]]:
        """Number of a part, and the rows that belong to it."""
        if len(time) == 0:
            return []
        parts = time // self._every_ns
        edges = [0, *(np.flatnonzero(np.diff(parts)) + 1).tolist(), len(time)]
        return [(int(parts[start]), slice(start, end)) for start, end in pairwise(edges)]

    def event(self, event: Event) -> None:
        """Note that something happened, in the part of that time."""
        self._raise()
        self._part(event.time_ns // self._every_ns if self._open else 0).event(event)

    def clocks(self, row: ClockRow) -> None:
        """Note what the machine's clocks say, in the part of that time."""
        self._raise()
        self._part(row.time_ns // self._every_ns if self._open else 0).clocks(row)

    def phase(self, phase: Phase) -> None:
        """Name a stretch of time."""
        self._phases.append(phase)

    def begins(self, phase: Phase) -> None:
        """Name a stretch of time that ends at `phase.end_ns` at the latest; `phase` ends it."""
        self._begun.append(phase)
        for number, part in self._open.items():
            self._begin(phase, number, part)

    def _begin(self, phase: Phase, number: int, part: LogWriter) -> None:
        start_ns, end_ns = number * self._every_ns, (number + 1) * self._every_ns
        if phase.start_ns < end_ns and phase.end_ns > start_ns:
            part.begins(phase._replace(start_ns=max(phase.start_ns, start_ns)))

    def _turn(self) -> None:
        """Finish the first part if everybody has left it, or a third one has begun (somebody has been silent)."""
        while len(self._open) > 1 and (
            len(self._open) > 2 or min(self._last_ns.values()) >= (self._first + 1) * self._every_ns
        ):
            number = min(self._open)
            part = self._open.pop(number)
            self._first = min(self._open)
            self._name_phases(number, part)
            thread = threading.Thread(target=self._finish, args=(part,), name=f"finish {part.path.name}")
            thread.start()
            self._finishing = [one for one in self._finishing if one.is_alive()] + [thread]

    def _name_phases(self, number: int, part: LogWriter) -> None:
        """Each part's share of the phases; those that are not over go on to its end."""
        start_ns, end_ns = number * self._every_ns, (number + 1) * self._every_ns
        end_ns = min(end_ns, max(self._last_ns.values()) + 1)
        for phase in Notes(self._phases, begun=[Begun(*phase) for phase in self._begun]).phases_until(end_ns):
            if phase.start_ns < end_ns and phase.end_ns > start_ns:
                part.phase(phase._replace(start_ns=max(phase.start_ns, start_ns), end_ns=min(phase.end_ns, end_ns)))

    def _finish(self, part: LogWriter) -> None:
        try:
            part.__exit__(None, None, None)
        except ImuArrayError as error:
            self._error = error
        with self._counting:  # its rows are counted, and nothing else of it is kept
            self._finished = {name: rows + part.acknowledged[name] for name, rows in self._finished.items()}
            self._parts.remove(part)

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    @property
    def acknowledged(self) -> Mapping[str, int]:
        """Rows by sensor, of all parts, that are kept whatever happens to this process."""
        with self._counting:
            parts = [self._finished, *(part.acknowledged for part in self._parts)]
            return {name: sum(part[name] for part in parts) for name in self._finished}

    def flush(self) -> None:
        """Write everything that waits."""
        for part in self._open.values():
            part.flush()

    def keep(self) -> None:
        """From now on the log is worth having, whatever happens."""
        self._keep = True
        for part in self._open.values():
            part.keep()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        failed: BaseException | None = None
        for number, part in sorted(self._open.items()):
            try:
                if kind is None or self._keep:
                    self._name_phases(number, part)
                part.__exit__(kind, error, trace)
            except ImuArrayError as failure:
                failed = failed or failure
        for thread in self._finishing:
            thread.join()
        failed = failed or self._error
        if failed is not None and failed is not error:
            raise failed


Writer = LogWriter | RotatingWriter
"""What a recording is written with."""
