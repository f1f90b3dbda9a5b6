"""The writer of a log: a draft until it is worth keeping, then a live file with a journal.

Until the caller decides to keep it (`keep`), a log is a draft: a compressed file under a temporary name that takes its
own name when it is complete, and of which nothing remains if that never happens. From `keep` on it is live: `RUN.h5`
and its journal exist before the first row, and whatever happens then, every acknowledged row can be read
(`imuarray.log.live`). A clean end makes both the same finished file (`imuarray.log.finish`).
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, NoReturn, NotRequired, Self, TypedDict

import numpy as np
import numpy.typing as npt

from imuarray import __version__
from imuarray.arrays import Floats, Times
from imuarray.errors import DiskFullError, ImuArrayError, LogBusyError, LogError, OutputExistsError
from imuarray.log.disk_space import WATERMARK
from imuarray.log.draft import Draft
from imuarray.log.finish import finish
from imuarray.log.format import MOST_SENSORS, ClockRow, Event, Phase, SensorHeader
from imuarray.log.journal import is_running
from imuarray.log.layout import CHUNK, CLOCKS, STIMULI, Columns, OpenPhase, note_columns
from imuarray.log.live import KEPT, Live
from imuarray.log.preamble import Preamble
from imuarray.log.sensor_log import SensorLog

SYNC_S = 1.0
"""Seconds after which acknowledged rows survive a power cut."""


class Block(NamedTuple):
    """Rows of one sensor: time (n,) int64 ns since the epoch, counts (n, k), status (n,) flags, and what the chip has
    besides.
    """

    time: Times
    counts: npt.NDArray[Any]
    status: npt.NDArray[np.uint16]
    temperature_counts: npt.NDArray[np.int16] | None = None
    compensated: Mapping[str, Floats] = {}


class Stimulus(NamedTuple):
    """Rows of `/truth` or `/reference`: time (n,) ns, specific force (n, 3) m/s2 and angular rate (n, 3) rad/s in the
    box frame, temperature (n,) degC.
    """

    time: Times
    specific_force: Floats
    angular_rate: Floats
    temperature: Floats


def _no_log(path: Path) -> NoReturn:
    raise LogError(f"{path}: is still being written")


class WriterSettings(TypedDict):
    """The keyword arguments of `LogWriter`, for those that make several."""

    source: str
    epoch: str
    config: NotRequired[str]
    frame_rate_hz: NotRequired[float]
    force: NotRequired[bool]
    watermark: NotRequired[int]
    sync_s: NotRequired[float]


class LogWriter:
    """A log being written; a context manager. Leaving it with an error removes the file, unless `keep()` was called.

    Once it is kept, a thread writes: `append` returns when its rows are queued (and waits when too many are), and
    raises what went wrong with earlier ones: DiskFullError, LogError. `flush` returns when everything is on the disk.
    """

    # Keyword-only and independent of one another: attributes that a file has, and how it is kept.
    def __init__(  # noqa: PLR0913
        self,
        path: str | PathLike[str],
        sensors: Sequence[SensorHeader],
        *,
        source: str,
        epoch: str,
        config: str = "",
        frame_rate_hz: float = 0.0,
        force: bool = False,
        watermark: int = WATERMARK,
        sync_s: float = SYNC_S,
    ) -> None:
        """Create `path` for `sensors`; `epoch` is the ISO 8601 UTC wall time of time 0, `frame_rate_hz` what was asked
        for (0: not known). A kept log ends with DiskFullError when less than `watermark` bytes are free.
        OutputExistsError, LogBusyError, LogError.
        """
        self.path = Path(path)
        self.epoch = epoch
        if self.path.is_dir():
            raise LogError(f"{path}: is a folder; a log is a file")
        if len(sensors) > MOST_SENSORS:
            raise LogError(f"{path}: {len(sensors)} sensors; a log has at most {MOST_SENSORS}")
        if is_running(self.path):
            raise LogBusyError(path)
        if self.path.exists() and not force:
            raise OutputExistsError(path)
        software, identity = f"imuarray {__version__}", uuid.uuid4().hex
        self._preamble = Preamble(tuple(sensors), source, epoch, config, software, identity, frame_rate_hz)
        self._force, self._watermark, self._sync_s = force, watermark, sync_s
        self._draft = Draft(self.path, self._preamble, CHUNK)
        self.paths = (self.path,)
        self._live: Live | None = None
        self._groups = self._draft.groups
        self._numbers = {group.path.removeprefix("sensors/"): number for number, group in enumerate(self._groups)}
        self._last_ns = {header.name: -(2**63) for header in sensors}

    def append(self, sensor: str, block: Block) -> None:
        """Add rows of one sensor; ValueError unless time is strictly increasing, across blocks too."""
        if len(block.time) == 0:
            return
        if block.time[0] <= self._last_ns[sensor] or (np.diff(block.time) <= 0).any():
            raise ValueError(f"sensor {sensor}: time is not strictly increasing")
        self._last_ns[sensor] = int(block.time[-1])
        columns = {"time": block.time, "counts": block.counts, "status": block.status, **block.compensated}
        if block.temperature_counts is not None:
            columns["temperature_counts"] = block.temperature_counts
        self._put(self._numbers[sensor], columns)

    def stimulus(self, name: str, rows: Stimulus) -> None:
        """Add rows to `/truth` or `/reference`."""
        if name not in STIMULI:
            raise ValueError(f"{name}: a stimulus is {' or '.join(STIMULI)}")
        if len(rows.time):
            self._put(self._numbers[name], rows._asdict())

    def clocks(self, row: ClockRow) -> None:
        """Note what the machine's clocks say."""
        columns = {name: np.array([value]) for (name, _, _), value in zip(CLOCKS, row, strict=True)}
        self._put(self._numbers["clocks"], columns)

    def phase(self, phase: Phase) -> None:
        """Name a stretch of time."""
        self._put(len(self._groups) - 1, note_columns(phase))

    def begins(self, phase: Phase) -> None:
        """Name a stretch of time that ends at `phase.end_ns` at the latest: a log that is cut short has it too. `phase`
        with the same start and name ends it.
        """
        self._put(len(self._groups) - 1, note_columns(OpenPhase(*phase)))

    def event(self, event: Event) -> None:
        """Note that something happened."""
        self._put(len(self._groups) - 1, note_columns(event))

    def __getitem__(self, sensor: str) -> SensorLog:
        """The rows of a sensor so far, as they are read from a log; KeyError for a log that is kept."""
        if self._live is not None:
            raise KeyError(sensor)
        self._draft.flush()
        return SensorLog(self._draft.file[f"sensors/{sensor}"], f"{self.path}: sensor {sensor}", self, _no_log)

    def revise(self, sensor: str, column: str, change: Callable[[Columns], npt.NDArray[Any]]) -> None:
        """Put other values in a column ("status", "time", ...) of a sensor's rows so far: those that `change` makes of
        the columns of each stretch of rows. What is known of a recording only at its end comes into a log in this way.
        ValueError if times no longer increase, KeyError for a log that is kept.
        """
        if self._live is not None:
            raise KeyError(sensor)
        self._draft.revise(self._numbers[sensor], column, change)

    def _put(self, number: int, columns: Columns) -> None:
        checked = self._groups[number].checked(columns)
        if self._live is None:
            self._draft.append(number, checked)
        else:
            self._live.put(number, checked)

    @property
    def acknowledged(self) -> dict[str, int]:
        """Rows by sensor that are kept whatever happens to this process: those of a draft never are."""
        rows = [0] * len(self._groups) if self._live is None else self._live.acknowledged
        return {name: rows[self._numbers[name]] for name in self._last_ns}

    def flush(self) -> None:
        """Write everything that waits; of a kept log it is then acknowledged and on the disk."""
        if self._live is None:
            self._draft.flush()
        else:
            self._live.flush()

    def drain(self) -> None:
        """Wait until everything is on the disk, of a log that another thread is leaving."""
        if self._live is not None:
            self._live.drain()

    def keep(self) -> None:
        """Keep the log from now on, whatever happens: it appears under its name, with a journal next to it.

        LogBusyError if another process began the same log meanwhile, DiskFullError, LogError.
        """
        if self._live is not None:
            return
        before = [(number, self._draft.stretches(number)) for number in range(len(self._groups) - 1)]
        live = Live(
            self.path,
            self._preamble,
            watermark=self._watermark,
            sync_s=self._sync_s,
            force=self._force,
            chunk=CHUNK,
        )
        self._draft.discard()
        self._live = live
        for number, stretches in before:
            for columns in stretches:
                live.put(number, columns)
        notes = self._draft.notes
        noted: list[Phase | Event | OpenPhase] = [*notes.phases, *notes.events, *notes.begun]
        for note in noted:
            live.put(len(self._groups) - 1, note_columns(note))

    def abandon(self) -> None:
        """Remove a log that got no rows. OSError."""
        if self._live is None:
            self._draft.discard()
            return
        try:
            self._live.close()
            self.path.unlink(missing_ok=True)
            self._live.lock.remove()
        finally:
            self._live.lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._end(self._live, error)
        elif kind is None:
            self._complete()
        else:
            self._draft.discard()

    def _complete(self) -> None:
        """The draft becomes the log."""
        try:
            self._draft.close()
            self._draft.publish(self.path)
        except BaseException:
            self._draft.discard()
            raise

    def _end(self, live: Live, error: BaseException | None) -> None:
        """The live log becomes a finished one, if there is room; else it stays as it is, and readable. What went wrong
        in the thread is raised unless it was already.
        """
        kept = KEPT
        try:
            live.close()
            if live.error is None or isinstance(live.error, DiskFullError):
                finish(self.path, live.lock)
        except ImuArrayError:
            if live.error is None:
                raise
            kept = f"{KEPT}, which is not finished: make room, then imuarray recover {self.path}"
        finally:
            live.lock.close()
        failure = live.error
        if isinstance(failure, DiskFullError) and kept != failure.kept:
            failure = DiskFullError(self.path, failure.why, kept)
        if failure is not None and error is not failure:
            raise failure
