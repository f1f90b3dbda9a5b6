"""A log while it is recorded: `RUN.h5`, an uncompressed single-writer/multiple-reader file, and its journal.

Blocks pass through a bounded queue to a thread, which appends them to the journal (from then on they are acknowledged:
they survive the process), syncs the journal every second (then they survive a power cut), and whenever a chunk is full
adds all waiting rows to the HDF5 file: rows, sync, then a row of the commit table. Nothing is compressed yet: a chunk
has its place from the start and is filled in it. A full disk ends the log before anything is lost.
"""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import h5py

from imuarray.errors import DiskFullError, ImuArrayError, LogError
from imuarray.log.commits import COMMITS, block_crc, row_of, width
from imuarray.log.disk_space import FULL, Allowance, Reserve, free_bytes, sync_folder, unwritable, write_errors
from imuarray.log.format import CACHE_BYTES, Event
from imuarray.log.journal import JournalLock, JournalWriter, Mark
from imuarray.log.layout import (
    CHUNK,
    LIBVER,
    PLAIN,
    TRACK_COLUMNS,
    Columns,
    create_columns,
    create_sensor,
    create_track,
    groups_of,
    log_attributes,
    note_columns,
)
from imuarray.log.preamble import PREAMBLE, PREAMBLE_CRC, Preamble

QUEUE_BLOCKS = 1024
"""Blocks that may wait for a slow disk; then `put` waits too."""

KEPT = "everything acknowledged until then is in the log"
_JOURNAL_LOST = (
    "the journal was removed or replaced while the log was written: from now on every sync commits to the file"
)
_AT_ONCE = 256
_COMMIT_ROWS = 64
_EMPTY_BYTES = 1 << 14


class LiveFile:
    """The HDF5 file of a log that is being recorded. Its columns only ever grow, by commits."""

    def __init__(self, path: Path, preamble: Preamble, chunk: int = CHUNK) -> None:
        """Create it, with everything that it will ever hold, under a temporary name; on the disk; then name it."""
        self._groups = groups_of(preamble.sensors)
        self._rows = [0] * len(self._groups)
        self._identity = preamble.identity
        self._chunk = chunk
        part = path.with_name(f".{path.name}.{os.getpid()}.live.part")
        part.unlink(missing_ok=True)
        self.file = h5py.File(part, "w", libver=LIBVER, rdcc_nbytes=CACHE_BYTES)
        self._room = Allowance(part, path)
        try:
            self._room.ask((len(self._groups) + 1) * _EMPTY_BYTES + len(preamble.config) * 8)
            self._create(preamble, chunk)
            self._room.sync()
            part.replace(path)
            sync_folder(path)
        except BaseException:
            self.close()
            part.unlink(missing_ok=True)
            raise

    def _create(self, preamble: Preamble, chunk: int) -> None:
        self.file.attrs.update(log_attributes(preamble))
        text = preamble.to_json()
        self.file.attrs.update({PREAMBLE: text, PREAMBLE_CRC: zlib.crc32(text.encode())})
        for header in preamble.sensors:
            create_sensor(self.file, header, preamble.epoch, chunk, PLAIN)
        for name in TRACK_COLUMNS:
            create_track(self.file, name, preamble.epoch, chunk, PLAIN)
        create_columns(self.file, self._groups[-1], chunk, PLAIN)
        columns = width(self._groups)
        self.file.create_dataset(COMMITS, (0, columns), "<i8", maxshape=(None, columns), chunks=(_COMMIT_ROWS, columns))
        self.file.swmr_mode = True

    def commit(self, waiting: Sequence[Sequence[Columns]], mark: Mark) -> None:
        """Add rows of all groups, everything that the journal holds before `mark`; LogError."""
        added = {number: self._groups[number].joined(parts) for number, parts in enumerate(waiting) if parts}
        for number, rows in added.items():
            self._add(number, rows)
        self.file.flush()
        self._room.sync()
        table = self.file[COMMITS]
        self._room.ask(_COMMIT_ROWS * 8 * table.shape[1] if len(table) % _COMMIT_ROWS == 0 else 0)
        table.resize(len(table) + 1, axis=0)
        table[-1] = row_of(mark, block_crc(self._groups, added), self._rows, self._identity)
        table.flush()

    def _add(self, number: int, rows: Columns) -> None:
        group, start = self._groups[number], self._rows[number]
        count = len(next(iter(rows.values())))
        chunks = -(-(start + count) // self._chunk) - -(-start // self._chunk)
        self._room.ask(chunks * self._chunk * group.row_bytes)
        for name, values in rows.items():
            dataset = self.file[group.path][name]
            dataset.resize(start + count, axis=0)
            dataset[start:] = values
        self._rows[number] = start + count

    def close(self) -> None:
        """Close the file; committed rows are in it."""
        with contextlib.suppress(Exception):  # the journal has what this can't write any more
            self.file.close()
        self._room.close()


class _Item(NamedTuple):
    number: int
    rows: int
    payload: bytes


class Live:
    """A log that is being recorded at `path`. `put` blocks of rows; `flush` waits until they are on the disk."""

    def __init__(
        self, path: Path, preamble: Preamble, *, watermark: int, sync_s: float, force: bool, chunk: int = CHUNK
    ) -> None:
        """Begin: lock, journal and file are there, on the disk and named, when this returns. LogBusyError,
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
                raise LogError(f"{self.lock.path}: is left over from another log; move it away, or use --force")
            self._begin(preamble, is_empty)
        except BaseException:
            self.lock.close()
            raise

    def _begin(self, preamble: Preamble, is_empty: bool) -> None:
        """Journal, reserve, file: all of them or none. `is_empty`: the journal is that of no other log."""
        reserve = None
        try:
            self._reserve = reserve = Reserve(self.path)
            is_empty = True  # from here on
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
        """Add rows of the group of this number; raises what went wrong with earlier ones (DiskFullError, LogError)."""
        if self.error is not None:
            raise self.error
        rows = len(next(iter(columns.values())))
        self._queue.put(_Item(number, rows, self.groups[number].encode(columns)))

    def flush(self) -> None:
        """Wait until everything that was put is acknowledged and on the disk; DiskFullError, LogError."""
        done = threading.Event()
        self._queue.put(done)
        done.wait()
        if self.error is not None:
            raise self.error

    def drain(self) -> None:
        """Wait until everything that was put is on the disk, of a log that another thread closes."""
        self._thread.join()

    def close(self) -> None:
        """Write what waits and close the file; the journal stays, and locked (`lock`). Errors are left in `error`."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()
        self._reserve.release()
        self._file.close()

    def _run(self) -> None:
        """The thread: takes what is there, all at once, until there is nothing more to come."""
        while True:
            items, flushed, more = self._take()
            if self.error is None:
                try:
                    self._work(items, sync=bool(flushed) or not more, last=not more)
                except (OSError, RuntimeError) as error:  # HDF5 uses both
                    self._stop(unwritable(self.path, error))
                except ImuArrayError as error:
                    self._stop(error)
                except Exception as error:
                    self._stop(LogError(f"{self.path}: can't be written: {error!r}"))
            for done in flushed:
                done.set()
            if not more:
                return

    def _take(self) -> tuple[list[_Item], list[threading.Event], bool]:
        """Blocks that came, those who wait for them, and whether more can come."""
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
        """Return whether the journal can't be found under its name any more, so that a crash would leave the HDF5 file
        alone: then each sync commits. An event says so once.
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
        """Append to the journal; if the disk is full, once more with the space of the reserve."""
        try:
            self._journal.append(items)
        except OSError as error:
            if error.errno not in FULL:
                raise
            self._reserve.release()
            self._journal.append(items)
            self._acknowledge(items)
            raise DiskFullError(self.path, "the log was ended: no room left on the disk") from None
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
