"""Splits a long recording into parts of equal duration: `RUN_001.h5`, `RUN_002.h5`, ..., separate logs with one
epoch.

A part is created in the background shortly before it is needed, and finished in the background as soon as every sensor
has rows after its end, because opening and finishing files takes time during which sensors would wait. No rows are lost
in between.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Self, Unpack

import numpy as np

from imuarray.arrays import Integers, Times
from imuarray.errors import DiskFullError, ImuArrayError
from imuarray.log.format import ClockRow, Event, Phase, SensorHeader
from imuarray.log.journal import Notes, OpenPhase, journal_of
from imuarray.log.writer import KEPT, Block, LogWriter, Stimulus, WriterSettings

_LEAD_NS = 5_000_000_000
"""Largest time in ns by which a part is created before its start; rows arrive one or two seconds after their time."""


def part_of(path: Path, number: int) -> Path:
    """Return the name of a part, counted from 1: `RUN_001.h5`."""
    return path.with_name(f"{path.stem}_{number:03d}{path.suffix}")


def runs_of(numbers: Integers) -> list[tuple[int, slice]]:
    """Return the runs of equal numbers (n,), n > 0: each number with its rows."""
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    return [(int(numbers[start]), slice(start, end)) for start, end in pairwise(edges)]


class RotatingWriter:
    """A writer with the interface of LogWriter that writes parts of `every_s` seconds; a context manager.

    Each part gets its share of a phase. `paths` are the parts so far.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        sensors: Sequence[SensorHeader],
        *,
        every_s: float,
        on_first_frame: Callable[[int], None] = lambda time_ns: None,
        **settings: Unpack[WriterSettings],
    ) -> None:
        """Create the first part; ValueError unless `every_s` is positive, and as LogWriter, which gets the `settings`.
        `on_first_frame` is called with the time of the first part's first frame, before there are rows.
        """
        if every_s <= 0:
            raise ValueError(f"parts of {every_s} s: a positive length is required")
        self.path = Path(path)
        self.paths: list[Path] = []
        self._sensors, self._every_ns = tuple(sensors), round(every_s * 1e9)
        self._make = partial(LogWriter, sensors=self._sensors, **settings)
        self._keep, self._on_first_frame = False, on_first_frame
        self._open: dict[int, LogWriter] = {}
        self._first = 0
        self._origin_ns = 0
        self._ahead: dict[int, Future[LogWriter]] = {}
        self._beginning = ThreadPoolExecutor(1, f"begin parts of {self.path.name}")
        self._last_ns = {header.name: -(2**63) for header in sensors}
        """Time of the newest row of each sensor and stimulus."""
        self._phases: list[Phase] = []
        self._open_phases: list[Phase] = []
        self._parts: list[LogWriter] = []
        self._finished = {header.name: 0 for header in sensors}
        self._counting = threading.Lock()
        self._finishing: list[threading.Thread] = []
        self._error: BaseException | None = None
        self._part(0)

    def _part(self, number: int) -> LogWriter:
        """Return the part of this number, counted from 0; if it is already finished, the oldest part that is not."""
        number = max(number, self._first)
        if number not in self._open:
            ahead = self._ahead.pop(number, None)
            part = self._make(part_of(self.path, number + 1)) if ahead is None else ahead.result()
            self._open[number] = part
            self.paths.append(part.path)
            self._parts.append(part)
            if self._keep and ahead is None:
                part.keep()
            for phase in self._open_phases:
                self._begin_phase(phase, number, part)
        return self._open[number]

    def starts(self, time_ns: int) -> None:
        """Note the time of the first frame: the first part lasts `every_s` from here on."""
        self._origin_ns = time_ns
        self._on_first_frame(time_ns)

    def part_at(self, time_ns: int) -> int:
        """Return the number of the part that contains this time, counted from 0."""
        return (time_ns - self._origin_ns) // self._every_ns

    def _span_ns(self, number: int) -> tuple[int, int]:
        """Return start and end of a part; the first part also contains everything before the first frame."""
        start_ns = self._origin_ns + number * self._every_ns
        return start_ns if number else min(start_ns, 0), start_ns + self._every_ns

    def _prepare_next(self, time_ns: int) -> None:
        """Create the part after this time, if it will be needed soon. A part that would replace an older log (`force`)
        is created only when it is needed, since that may never happen.
        """
        number = max(self.part_at(time_ns), self._first) + 1
        lead_ns = min(_LEAD_NS, self._every_ns)
        is_open = number in self._open or number in self._ahead
        if not self._keep or is_open or self._span_ns(number)[0] - time_ns > lead_ns:
            return
        path = part_of(self.path, number + 1)
        if not (path.exists() or journal_of(path).exists()):
            self._ahead[number] = self._beginning.submit(self._create_kept, path)

    def _create_kept(self, path: Path) -> LogWriter:
        part = self._make(path)
        part.keep()
        return part

    def append(self, sensor: str, block: Block) -> None:
        """Add rows of one sensor, to the parts in whose time they lie. ValueError, DiskFullError, LogError."""
        self._raise()
        for number, rows in self._split(block.time):
            part = block.rows(rows)
            self._part(number).append(sensor, part)
            self._last_ns[sensor] = int(part.time[-1])
            self._prepare_next(self._last_ns[sensor])
        self._turn()

    def stimulus(self, name: str, rows: Stimulus) -> None:
        """Add rows to `/truth` or `/reference`."""
        self._raise()
        for number, part_rows in self._split(rows.time):
            part = Stimulus._make(column[part_rows] for column in rows)
            self._part(number).stimulus(name, part)
            self._last_ns[name] = int(part.time[-1])
        self._turn()

    def _split(self, time: Times) -> list[tuple[int, slice]]:
        """Return the number of each part, with its rows."""
        if len(time) == 0:
            return []
        return runs_of((time - self._origin_ns) // self._every_ns)

    def event(self, event: Event) -> None:
        """Add an event to the part of its time."""
        self._raise()
        self._part(self.part_at(event.time_ns) if self._open else 0).event(event)

    def clocks(self, row: ClockRow) -> None:
        """Add a row of the machine's clocks to the part of that time."""
        self._raise()
        self._part(self.part_at(row.time_ns) if self._open else 0).clocks(row)
        self._prepare_next(row.time_ns)

    def phase(self, phase: Phase) -> None:
        """Name a stretch of time."""
        self._phases.append(phase)

    def begins(self, phase: Phase) -> None:
        """Name a stretch of time that ends at `phase.end_ns` at the latest; `phase` ends it."""
        self._open_phases.append(phase)
        for number, part in self._open.items():
            self._begin_phase(phase, number, part)

    def _begin_phase(self, phase: Phase, number: int, part: LogWriter) -> None:
        start_ns, end_ns = self._span_ns(number)
        if phase.start_ns < end_ns and phase.end_ns > start_ns:
            part.begins(phase._replace(start_ns=max(phase.start_ns, start_ns)))

    def _turn(self) -> None:
        """Finish the first part if every sensor has rows in the next one, or if a third has begun (one was silent)."""
        while len(self._open) > 1 and (
            len(self._open) > 2 or min(self._last_ns.values()) >= self._span_ns(self._first)[1]
        ):
            number = min(self._open)
            part = self._open.pop(number)
            self._first = min(self._open)
            self._name_phases(number, part)
            for passed in [ahead for ahead in self._ahead if ahead < self._first]:
                self._beginning.submit(_abandon, self._ahead.pop(passed))
            thread = threading.Thread(target=self._finish, args=(part,), name=f"finish {part.path.name}")
            thread.start()
            self._finishing = [worker for worker in self._finishing if worker.is_alive()] + [thread]

    def _name_phases(self, number: int, part: LogWriter) -> None:
        """Give each part its share of the phases; phases that have not ended last to its end."""
        start_ns, end_ns = self._span_ns(number)
        end_ns = min(end_ns, max(self._last_ns.values()) + 1)
        for phase in Notes(self._phases, begun=[OpenPhase(*phase) for phase in self._open_phases]).phases_until(end_ns):
            if phase.start_ns < end_ns and phase.end_ns > start_ns:
                part.phase(phase._replace(start_ns=max(phase.start_ns, start_ns), end_ns=min(phase.end_ns, end_ns)))

    def _finish(self, part: LogWriter) -> None:
        try:
            part.__exit__(None, None, None)
        except ImuArrayError as error:
            self._error = self._error or error
        with self._counting:
            self._finished = {name: rows + part.acknowledged[name] for name, rows in self._finished.items()}
            self._parts.remove(part)

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    @property
    def acknowledged(self) -> Mapping[str, int]:
        """Return the rows by sensor, of all parts, that survive an end of this process."""
        with self._counting:
            parts = [self._finished, *(part.acknowledged for part in self._parts)]
            return {name: sum(part[name] for part in parts) for name in self._finished}

    def flush(self) -> None:
        """Write everything that is buffered, also in parts that are being finished."""
        for part in self._open.values():
            part.flush()
        with self._counting:
            finishing = [part for part in self._parts if part not in self._open.values()]
        for part in finishing:
            part.drain()

    def keep(self) -> None:
        """Keep the log from now on, even if an error follows."""
        self._keep = True
        for part in self._open.values():
            part.keep()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        failure: BaseException | None = None
        for ahead in self._ahead.values():
            self._beginning.submit(_abandon, ahead)
        for number, part in sorted(self._open.items()):
            if kind is None or self._keep:
                try:
                    self._name_phases(number, part)
                except ImuArrayError as raised:
                    failure = failure or raised
            try:
                part.__exit__(kind, error, trace)
            except ImuArrayError as raised:
                failure = failure or raised
        self._beginning.shutdown()
        for thread in self._finishing:
            thread.join()
        failure = self._name_unfinished_parts(failure or self._error or error)
        if failure is not None and failure is not error:
            raise failure

    def _name_unfinished_parts(self, failure: BaseException | None) -> BaseException | None:
        """Return the error; if the disk was full, it names the parts that could not be finished."""
        unfinished = [path for path in self.paths if journal_of(path).exists()]
        if not isinstance(failure, DiskFullError) or not unfinished:
            return failure
        names = ", ".join(path.name for path in unfinished)
        return DiskFullError(
            failure.path, failure.why, f"{KEPT}; not finished: {names}: free space, then run `imuarray recover`"
        )


def _abandon(ahead: Future[LogWriter]) -> None:
    """Remove a part that is not needed, whether or not it could be created."""
    with contextlib.suppress(ImuArrayError, OSError):
        ahead.result().abandon()


Writer = LogWriter | RotatingWriter
"""The writer of a recording: one log, or a sequence of them."""
