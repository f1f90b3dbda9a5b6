"""The writer of a log: a draft until it is worth keeping, then a live file with a journal, and then a finished file.

Until the caller decides to keep it (`keep`), a log is a draft: a compressed file under a temporary name, which is
renamed when it is complete; if it is never completed, nothing of it remains. From `keep` on it is live: `RUN.h5`, an
uncompressed single-writer/multiple-reader file, and its journal exist before the first row, and every acknowledged row
can be read whatever happens.

Blocks of a live log (`Live`) pass through a bounded queue to a thread, which appends them to the journal (from then on
they are acknowledged: they survive the process), syncs the journal every second (then they survive a power cut), and
whenever a chunk is full adds all waiting rows to the HDF5 file: rows, sync, then a row of the commit table. Nothing is
compressed yet: a chunk has its place from the start and is filled in it. A full disk ends the log before anything is
lost.

A clean end makes both the same finished file (`finish`), and `recover` does so for a log that was interrupted: its rows
are copied into a compressed file, the copy is compared with the original row by row and replaces it, and the journal is
removed. The log remains complete if this is interrupted at any point.
"""

from __future__ import annotations

import contextlib
import os
import queue
import shutil
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, NoReturn, NotRequired, Self, TypedDict

import numpy as np
import numpy.typing as npt

from imuarray import __version__
from imuarray.arrays import Booleans, Floats, Times
from imuarray.errors import NO_ROOM, DiskFullError, ImuArrayError, LogBusyError, LogError, OutputExistsError
from imuarray.log.disk_space import WATERMARK, Reserve, free_bytes, reserve_of, sync_folder, unwritable, write_errors
from imuarray.log.format import (
    CLOCKS,
    MOST_SENSORS,
    STIMULI,
    TRACK_COLUMNS,
    ClockRow,
    Event,
    Phase,
    Preamble,
    SensorHeader,
)
from imuarray.log.hdf5_writer import CHUNK, Draft, LiveFile, sweep
from imuarray.log.journal import (
    NOTES,
    ColumnGroup,
    Columns,
    JournalLock,
    JournalReader,
    JournalWriter,
    Notes,
    OpenPhase,
    groups_of,
    is_running,
    journal_of,
    note_columns,
)
from imuarray.log.reader import Log
from imuarray.log.sensor_log import SensorLog
from imuarray.wall_time import iso_text

QUEUE_BLOCKS = 1024
"""Largest number of blocks that wait for a slow disk; `put` waits if there are more."""

KEPT = "all acknowledged rows are in the log"
_JOURNAL_LOST = "the journal was removed or replaced while the log was written; every sync now commits to the file"
_AT_ONCE = 256


class _Item(NamedTuple):
    number: int
    rows: int
    payload: bytes


class Live:
    """A log that is being recorded at `path`. `put` adds blocks of rows; `flush` waits until they are on the disk."""

    def __init__(
        self, path: Path, preamble: Preamble, *, watermark: int, sync_s: float, force: bool, chunk: int = CHUNK
    ) -> None:
        """Begin: when this returns, the locked journal and the file exist on the disk under their names. LogBusyError,
        DiskFullError, LogError.
        """
        self.path = path
        self.error: ImuArrayError | None = None
        self.groups = groups_of(preamble.sensors)
        self.acknowledged = [0] * len(self.groups)
        self._watermark, self._sync_s, self._chunk = watermark, sync_s, chunk
        self._waiting: list[list[Columns]] = [[] for _ in self.groups]
        self._unwritten = [0] * len(self.groups)
        self._synced_s = time.monotonic()
        self._dirty, self._newest_ns, self._is_journal_lost = False, 0, False
        with write_errors(path):
            self._open(preamble, force)
        self._queue: queue.Queue[_Item | threading.Event | None] = queue.Queue(QUEUE_BLOCKS)
        self._thread = threading.Thread(target=self._run, name=f"log {path.name}", daemon=True)
        self._thread.start()

    def _open(self, preamble: Preamble, force: bool) -> None:
        if free_bytes(self.path) < self._watermark:
            raise DiskFullError(self.path, f"less than {self._watermark >> 20} MiB are free")
        self.lock = JournalLock(self.path, create=True)
        try:
            is_empty = not os.fstat(self.lock.fd).st_size
            if not is_empty and not force:
                raise LogError(f"{self.lock.path}: belongs to another log; move it away, or use --force")
            self._create(preamble, is_empty)
        except BaseException:
            self.lock.close()
            raise

    def _create(self, preamble: Preamble, is_empty: bool) -> None:
        """Create journal, reserve and file, all or none. `is_empty`: the journal does not belong to another log."""
        reserve = None
        try:
            self._reserve = reserve = Reserve(self.path)
            is_empty = True  # the journal belongs to this log from here on
            self._journal = JournalWriter(self.lock.fd, preamble)
            self._journal.sync()
            self._file = LiveFile(self.path, preamble, self._chunk)
        except BaseException:
            if reserve is not None:
                reserve.release()
            if is_empty:
                self.lock.remove()
            raise

    def put(self, number: int, columns: Columns) -> None:
        """Add rows of the group of this number; raises errors of earlier rows (DiskFullError, LogError)."""
        if self.error is not None:
            raise self.error
        rows = len(next(iter(columns.values())))
        self._queue.put(_Item(number, rows, self.groups[number].encode(columns)))

    def flush(self) -> None:
        """Wait until everything that was put is acknowledged and on the disk; DiskFullError, LogError."""
        is_written = threading.Event()
        self._queue.put(is_written)
        is_written.wait()
        if self.error is not None:
            raise self.error

    def drain(self) -> None:
        """Wait until everything that was put is on the disk, for a log that another thread closes."""
        self._thread.join()

    def close(self) -> None:
        """Write buffered rows and close the file; the journal remains locked (`lock`). Errors are stored in `error`."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()
        self._reserve.release()
        self._file.close()

    def _run(self) -> None:
        while True:
            items, flushed, is_open = self._take()
            if self.error is None:
                try:
                    self._work(items, sync=bool(flushed) or not is_open, last=not is_open)
                except (OSError, RuntimeError) as error:  # HDF5 uses both
                    self._stop(unwritable(self.path, error))
                except ImuArrayError as error:
                    self._stop(error)
                except Exception as error:
                    self._stop(LogError(f"{self.path}: can't be written: {error!r}"))
            for event in flushed:
                event.set()
            if not is_open:
                return

    def _take(self) -> tuple[list[_Item], list[threading.Event], bool]:
        """Return the waiting blocks, the callers that wait for them, and whether more can follow."""
        items: list[_Item] = []
        try:
            item = self._queue.get(timeout=self._sync_s if self._dirty else None)
            while True:
                if not isinstance(item, _Item):
                    return items, [] if item is None else [item], item is not None
                items.append(item)
                if len(items) == _AT_ONCE:
                    break
                item = self._queue.get_nowait()
        except queue.Empty:
            pass
        return items, [], True

    def _work(self, items: Sequence[_Item], *, sync: bool, last: bool) -> None:
        if items:
            self._append(items)
        commit = max(self._unwritten) >= self._chunk or (last and any(self._unwritten))
        if self._dirty and (commit or sync or time.monotonic() - self._synced_s >= self._sync_s):
            self._journal.sync()
            self._dirty, self._synced_s = False, time.monotonic()
            commit = commit or self._has_lost_journal()
        if commit:
            self._file.commit(self._waiting, self._journal.mark)
            self._waiting = [[] for _ in self.groups]
            self._unwritten = [0] * len(self.groups)
        if items and free_bytes(self.path) < self._watermark:
            raise DiskFullError(self.path, f"the log was ended: less than {self._watermark >> 20} MiB are free")

    def _has_lost_journal(self) -> bool:
        """Return whether the journal has lost its name, so that only the HDF5 file would survive a crash and each sync
        has to commit. The loss is reported once, as an event.
        """
        if self.lock.is_named:
            return False
        if not self._is_journal_lost:
            self._is_journal_lost = True
            number = len(self.groups) - 1
            payload = self.groups[number].encode(note_columns(Event(self._newest_ns, "", "damaged", _JOURNAL_LOST)))
            self._append([_Item(number, len(payload), payload)])
            self._journal.sync()
        return True

    def _append(self, items: Sequence[_Item]) -> None:
        """Append to the journal; if the disk is full, retry with the space of the reserve."""
        try:
            self._journal.append(items)
        except OSError as error:
            if error.errno not in NO_ROOM:
                raise
            self._reserve.release()
            self._journal.append(items)
            self._acknowledge(items)
            raise DiskFullError(self.path, "the log was ended: no space left on the disk") from None
        self._acknowledge(items)

    def _acknowledge(self, items: Sequence[_Item]) -> None:
        self._dirty = True
        for item in items:
            columns = self.groups[item.number].decode(item.payload, item.rows)
            self.acknowledged[item.number] += item.rows
            self._waiting[item.number].append(columns)
            self._unwritten[item.number] += item.rows
            if "time" in columns:
                self._newest_ns = max(self._newest_ns, int(columns["time"][-1]))

    def _stop(self, error: ImuArrayError) -> None:
        """Stop writing; what was written is synced as far as possible."""
        self.error = DiskFullError(self.path, error.why, KEPT) if isinstance(error, DiskFullError) else error
        with contextlib.suppress(OSError):
            self._journal.sync()


SYNC_S = 1.0
"""Time in s after which acknowledged rows survive a power cut."""


class Block(NamedTuple):
    """Rows of one sensor: time (n,) in int64 ns since the epoch, counts (n, k), status (n,) flags, counts (n,) of its
    thermometer, and further columns (n,) by name in physical units (`compensated`).
    """

    time: Times
    counts: npt.NDArray[Any]
    status: npt.NDArray[np.uint16]
    temperature_counts: npt.NDArray[np.int16] | None = None
    compensated: Mapping[str, Floats] = {}

    def rows(self, chosen: slice | Booleans) -> Block:
        """Return some of the rows."""
        degrees = None if self.temperature_counts is None else self.temperature_counts[chosen]
        compensated = {name: column[chosen] for name, column in self.compensated.items()}
        return Block(self.time[chosen], self.counts[chosen], self.status[chosen], degrees, compensated)


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
    """The keyword arguments of `LogWriter`, for callers that create several."""

    source: str
    epoch: str
    config: NotRequired[str]
    frame_rate_hz: NotRequired[float]
    force: NotRequired[bool]
    watermark: NotRequired[int]
    sync_s: NotRequired[float]


class LogWriter:
    """A log being written; a context manager. Leaving it with an error removes the file, unless `keep()` was called.

    Once the log is kept, a thread writes it: `append` returns when its rows are queued (and waits when too many are),
    and raises errors of earlier rows: DiskFullError, LogError. `flush` returns when everything is on the disk.
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
        """Create `path` for `sensors`; `epoch` is the ISO 8601 UTC wall time of time 0, `frame_rate_hz` the requested
        frame rate (0: not known). A kept log ends with DiskFullError when less than `watermark` bytes are free.
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
        """Add a row of the machine's clocks."""
        columns = {name: np.array([value]) for (name, _, _), value in zip(CLOCKS, row, strict=True)}
        self._put(self._numbers["clocks"], columns)

    def phase(self, phase: Phase) -> None:
        """Name a stretch of time."""
        self._put(len(self._groups) - 1, note_columns(phase))

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases so far of a log that is not kept."""
        return () if self._live is not None else tuple(self._draft.notes.phases)

    def begins(self, phase: Phase) -> None:
        """Name a stretch of time that ends at `phase.end_ns` at the latest, so that a log that is interrupted has it
        too. A later call of `phase` with the same start and name ends it.
        """
        self._put(len(self._groups) - 1, note_columns(OpenPhase(*phase)))

    def event(self, event: Event) -> None:
        """Add an event."""
        self._put(len(self._groups) - 1, note_columns(event))

    def __getitem__(self, sensor: str) -> SensorLog:
        """Return the rows of a sensor so far, as they are read from a log; KeyError for a log that is kept."""
        if self._live is not None:
            raise KeyError(sensor)
        self._draft.flush()
        return SensorLog(self._draft.file[f"sensors/{sensor}"], f"{self.path}: sensor {sensor}", self, _no_log)

    def revise(self, sensor: str, column: str, change: Callable[[Columns], npt.NDArray[Any]]) -> None:
        """Replace the values of a column ("status", "time", ...) of a sensor's rows so far by those that `change`
        computes from the columns of each block of rows. This adds what is known only at the end of a recording.
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
        """Return the rows by sensor that survive an end of this process; rows of a draft never do."""
        rows = [0] * len(self._groups) if self._live is None else self._live.acknowledged
        return {name: rows[self._numbers[name]] for name in self._last_ns}

    def flush(self) -> None:
        """Write everything that waits; the rows of a kept log are then acknowledged and on the disk."""
        if self._live is None:
            self._draft.flush()
        else:
            self._live.flush()

    def drain(self) -> None:
        """Wait until everything is on the disk, for a log that another thread is closing."""
        if self._live is not None:
            self._live.drain()

    def keep(self) -> None:
        """Keep the log from now on, even if an error follows: it appears under its name, with a journal next to it.

        LogBusyError if another process began the same log meanwhile, DiskFullError, LogError.
        """
        if self._live is not None:
            return
        draft_rows = [(number, self._draft.stretches(number)) for number in range(len(self._groups) - 1)]
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
        for number, stretches in draft_rows:
            for columns in stretches:
                live.put(number, columns)
        notes = self._draft.notes
        draft_notes: list[Phase | Event | OpenPhase] = [*notes.phases, *notes.events, *notes.begun]
        for note in draft_notes:
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
        try:
            self._draft.close()
            self._draft.publish(self.path)
        except BaseException:
            self._draft.discard()
            raise

    def _end(self, live: Live, error: BaseException | None) -> None:
        """Finish the live log, if there is space; otherwise it remains unfinished and readable. An error of the thread
        is raised unless it was raised before.
        """
        remark = KEPT
        try:
            live.close()
            if live.error is None or isinstance(live.error, DiskFullError):
                finish(self.path, live.lock)
        except ImuArrayError:
            if live.error is None:
                raise
            remark = f"{KEPT}, which is not finished: free space, then run `imuarray recover {self.path}`"
        finally:
            live.lock.close()
        failure = live.error
        if isinstance(failure, DiskFullError) and remark != failure.kept:
            failure = DiskFullError(self.path, failure.why, remark)
        if failure is not None and error is not failure:
            raise failure


_ROWS = 1 << 16
_UNCHANGED = "the log is unchanged"


class Recovery(NamedTuple):
    """The result of finishing a log: rows by sensor; `changed` is False if there was nothing to do. `kept` is the name
    of a journal that has unreadable data or belongs to another log.
    """

    rows: dict[str, int]
    changed: bool
    kept: str | None = None


def recover(
    path: Path,
    output: Path | None = None,
    progress: Callable[[int], None] = lambda rows: None,
    *,
    force: bool = False,
    now: datetime | None = None,
) -> Recovery:
    """Finish the interrupted log at `path`, in place or as `output`; a log that is already finished is copied to
    `output`.

    A log whose journal is missing is finished only with `force`. An event in the log records the time (`now`; None: the
    current time) and the number of rows. LogBusyError, DiskFullError, LogError.
    """
    try:
        lock = JournalLock(path, create=False)
    except FileNotFoundError:
        lock = None
    try:
        with Log(path, thorough=True) as log:
            rows = {name: len(sensor) for name, sensor in log.sensors.items()}
            changed, losses = log.preamble is not None, log.losses
            keep = bool(losses) if changed else not _is_journal_of(log)
            if changed:
                if not log.has_journal and not force:
                    raise LogError(
                        f"{path}: {losses[0]}; copy {path.name} and {journal_of(path).name} together, or use --force"
                        " to finish it without them"
                    )
                _rewrite(log, output or path, progress, (*_losses(log), _trace(log, now or datetime.now(UTC))))
        journal_copy = _sweep(path, lock, keep=keep) if output is None else None
        if output is not None and not changed:
            _copy(path, output)
    finally:
        if lock is not None:
            lock.close()
    return Recovery(rows, changed, None if journal_copy is None else journal_copy.name)


def _is_journal_of(log: Log) -> bool:
    """Return whether the journal beside a finished log belongs to it, because the process was killed just before it
    removed the journal: it has the same epoch and sensors. Also true if it is empty or missing.
    """
    try:
        with JournalReader(log.path) as journal:
            preamble = journal.preamble
    except FileNotFoundError:
        return True
    except (LogError, OSError):
        return journal_of(log.path).stat().st_size == 0
    return preamble.epoch == log.epoch and {header.name for header in preamble.sensors} == set(log.sensors)


def finish(path: Path, lock: JournalLock) -> None:
    """Finish the log at `path`, whose writer has closed it and holds its `lock`; DiskFullError, LogError."""
    with Log(path, journal_fd=lock.fd) as log:
        losses = log.losses
        _rewrite(log, path, lambda rows: None, _losses(log))
    _sweep(path, lock, keep=bool(losses))


def _end_ns(log: Log) -> int:
    return max((int(sensor.time[-1]) for sensor in log.sensors.values() if len(sensor)), default=0)


def _losses(log: Log) -> tuple[Event, ...]:
    """Return an event for each loss of an unfinished log."""
    return tuple(Event(_end_ns(log), "", "damaged", loss) for loss in log.losses)


def _trace(log: Log, now: datetime) -> Event:
    """Return the event that says that the log was interrupted and recovered."""
    rows = sum(len(sensor) for sensor in log.sensors.values())
    text = f"the log was interrupted; its {rows} rows were recovered {iso_text(now, 'seconds')}"
    return Event(_end_ns(log), "", "recovered", text)


def _copy(path: Path, output: Path) -> None:
    """Copy a finished log to another name; LogError."""
    part = output.with_name(f".{output.name}.{os.getpid()}.part")
    try:
        shutil.copyfile(path, part)
        part.replace(output)
    except OSError as error:
        raise unwritable(output, error, _UNCHANGED) from None
    finally:
        part.unlink(missing_ok=True)
    sync_folder(output)


def _rewrite(log: Log, target: Path, progress: Callable[[int], None], added: tuple[Event, ...]) -> None:
    """Write a finished copy of an unfinished log with the events `added`, check it, and rename it to `target`."""
    if log.preamble is None:
        raise LogError(f"{log.path}: is finished")
    try:
        draft = Draft(target, log.preamble, durable=True)
    except DiskFullError as error:
        raise DiskFullError(target, error.why, _UNCHANGED) from None
    try:
        rows_done = 0
        for number, group in enumerate(draft.groups):
            for rows in _stretches(log, group):
                draft.append(number, rows)
                rows_done += len(rows["time"])
                progress(rows_done)
        draft.notes = Notes(list(log.phases), [*log.events, *added])
        draft.close()
        with Log(draft.part) as copy:
            _compare(log, copy, groups_of(log.preamble.sensors), added)
        draft.publish(target)
        sync_folder(target)
    except DiskFullError as error:
        raise DiskFullError(target, error.why, _UNCHANGED) from None
    except OSError as error:
        raise unwritable(target, error, _UNCHANGED) from None
    finally:
        draft.discard()


def _columns(log: Log, group: ColumnGroup) -> Mapping[str, Any] | None:
    """Return the stored columns of a group; None if the log has no such group."""
    if group.path in TRACK_COLUMNS:
        track = {"truth": log.truth, "reference": log.reference, "clocks": log.clocks}[group.path]
        return None if track is None else track._asdict()
    sensor = log[group.path.removeprefix("sensors/")]
    columns: dict[str, Any] = {"time": sensor.time, "counts": sensor.counts, "status": sensor.status}
    columns["temperature_counts"] = sensor.temperature_counts
    return {name: columns[name] if name in columns else sensor.compensated(name) for name, _, _ in group.columns}


def _stretches(log: Log, group: ColumnGroup) -> Iterator[dict[str, Any]]:
    """Yield the rows of a group in large blocks."""
    columns = None if group.path == NOTES else _columns(log, group)
    if columns is None:
        return
    for start in range(0, len(columns["time"]), _ROWS):
        yield {name: np.asarray(column[start : start + _ROWS]) for name, column in columns.items()}


def _compare(log: Log, copy: Log, groups: tuple[ColumnGroup, ...], added: tuple[Event, ...]) -> None:
    """Raise LogError unless the copy has, bit by bit, the contents of the log and the events `added`."""
    for group in groups:
        for rows, copied in zip(_stretches(log, group), _stretches(copy, group), strict=True):
            if any(rows[name].tobytes() != copied[name].tobytes() for name in rows):
                raise LogError(f"{log.path}: its finished copy differs in /{group.path}; {_UNCHANGED}")
    if (log.phases, (*log.events, *added)) != (copy.phases, copy.events):
        raise LogError(f"{log.path}: its finished copy differs in phases or events; {_UNCHANGED}")


def _sweep(path: Path, lock: JournalLock | None, *, keep: bool) -> Path | None:
    """Remove the files that a finished log does not need: its journal (renamed instead, with `keep`), the reserve, and
    copies of terminated processes. Return the new name of the journal if it was renamed.
    """
    journal_copy = None
    if lock is not None and keep:
        journal_copy = lock.put_aside()
    elif lock is not None:
        lock.remove()
    if reserve_of(path).exists():  # on a read-only disk, the removal of a missing file is an error as well
        reserve_of(path).unlink(missing_ok=True)
    sweep(path)
    sync_folder(path)
    return journal_copy
