"""The journal beside a log that is being written: every block of rows as it came, appended and never changed.

::

    "imuarray journal 1\\n"  length u32  preamble (JSON)  crc32 u32
    group u16  tag u16  rows u32  crc32 u32  rows of the group (imuarray.log.layout)      again and again

All little-endian. Each block's CRC goes on from the one before it (the first from the preamble's), so that what a crash
or a power cut leaves behind the last good block is not believed. Behind damage in the middle blocks are good again from
where the chain goes on in blocks of this log: the tag comes from its identity (0 in journals of earlier versions).
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from imuarray.errors import LogBusyError, LogError
from imuarray.log.layout import Group, groups_of
from imuarray.log.preamble import Preamble
from imuarray.log.salvage import CRC, HEAD, never_written, next_good

if sys.platform != "win32":  # logs are read there, not recorded
    import fcntl

MAGIC = b"imuarray journal 1\n"
LONGEST_PREAMBLE = 1 << 24
LONGEST_BLOCK = 1 << 28

_SEARCHED = 1 << 26
"""Bytes behind a bad block in which a good one is looked for, and bytes that may be checked for that in all."""

_LEAST_CHECK = 512
"""What each check counts for."""

_TRIES, _PAUSE_S = 20, 0.005
"""How often the lock is asked for while others only look, and how long after each time."""

_UNSYNCED_NS = 5_000_000_000
"""What may wait for the disk at most, generously: behind a hole that a power cut left there is no more than that."""


class Mark(NamedTuple):
    """A place between two blocks: bytes from the start, and the CRC that the next block goes on from."""

    position: int
    chain: int


class Record(NamedTuple):
    """A block that was read: the number of its group, its rows as bytes, and the place behind it."""

    group: int
    rows: int
    payload: bytes
    after: Mark


def journal_of(path: Path) -> Path:
    """Where the journal of the log at `path` stands while it is written."""
    return path.with_name(f"{path.name}.journal")


def tag_of(identity: str) -> int:
    """What every block in the journal of a log with this identity bears."""
    return zlib.crc32(identity.encode()) & 0xFFFF or 1


def is_running(path: Path) -> bool:
    """Whether somebody is writing the log at `path` now."""
    try:
        fd = os.open(journal_of(path), os.O_RDONLY | os.O_CLOEXEC | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return False
    try:
        return not _locked(fd, exclusive=False)
    finally:
        os.close(fd)


def _locked_alone(fd: int) -> bool:
    """Lock an open file alone. Who looks whether it is written (`is_running`) has it for a moment, as one of many: that
    is waited for. False if somebody else has it alone, or for longer.
    """
    for _ in range(_TRIES):
        if _locked(fd, exclusive=True):
            return True
        if not _locked(fd, exclusive=False):
            return False
        _unlock(fd)
        time.sleep(_PAUSE_S)
    return False


def _unlock(fd: int) -> None:
    if sys.platform != "win32":
        fcntl.flock(fd, fcntl.LOCK_UN)


def _locked(fd: int, *, exclusive: bool) -> bool:
    """Lock an open file, as one of many or alone; False if somebody else has it."""
    if sys.platform == "win32":
        return True
    try:
        fcntl.flock(fd, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class JournalLock:
    """The journal of one log, open and locked: nobody else writes or recovers that log meanwhile."""

    def __init__(self, path: Path, *, create: bool) -> None:
        """LogBusyError if somebody else has it; FileNotFoundError if there is none and none is to be created."""
        self.path = journal_of(path)
        flags = os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT if create else 0)
        while True:
            self.fd = os.open(self.path, flags, 0o644)
            if not _locked_alone(self.fd):
                os.close(self.fd)
                raise LogBusyError(path)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(self.fd), self.path.stat()):
                    return
            os.close(self.fd)  # it was removed between opening and locking: somebody finished that log

    def remove(self) -> None:
        """The log is complete without it."""
        self.path.unlink(missing_ok=True)

    def put_aside(self) -> None:
        """The log is finished, but not all of the journal could be read: it is kept as `RUN.h5.journal.damaged`."""
        with contextlib.suppress(FileNotFoundError):
            self.path.replace(self.path.with_name(f"{self.path.name}.damaged"))

    def close(self) -> None:
        """Unlock."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class JournalWriter:
    """Appends blocks to a locked journal. `mark` is the place behind the last block; all before it is written."""

    def __init__(self, fd: int, preamble: Preamble) -> None:
        """Begin the journal anew."""
        text = preamble.to_json().encode("ascii")
        head = MAGIC + CRC.pack(len(text)) + text
        crc = zlib.crc32(head)
        self._fd = fd
        self._tag = tag_of(preamble.identity)
        os.ftruncate(fd, 0)
        os.lseek(fd, 0, os.SEEK_SET)
        self.mark = Mark(0, 0)
        self._write(head + CRC.pack(crc), crc)

    def append(self, blocks: Sequence[tuple[int, int, bytes]]) -> None:
        """Add blocks (group, rows, bytes); if OSError comes, none of them is there."""
        chain, parts = self.mark.chain, []
        for group, rows, payload in blocks:
            head = HEAD.pack(group, self._tag, rows)
            chain = zlib.crc32(payload, zlib.crc32(head, chain))
            parts += [head, CRC.pack(chain), payload]
        self._write(b"".join(parts), chain)

    def _write(self, data: bytes, chain: int) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError:
            os.ftruncate(self._fd, self.mark.position)
            os.lseek(self._fd, self.mark.position, os.SEEK_SET)
            raise
        self.mark = Mark(self.mark.position + len(data), chain)

    def sync(self) -> None:
        """What was appended is on the disk when this returns."""
        getattr(os, "fdatasync", os.fsync)(self._fd)  # macOS has no fdatasync


class JournalReader:
    """An open journal; a context manager. `preamble` and `groups` as they were when it was begun."""

    def __init__(self, path: Path) -> None:
        """Open the journal of the log at `path`; FileNotFoundError, LogError."""
        self.path = journal_of(path)
        if self.path.exists() and not self.path.is_file():  # to open a pipe would wait for its other end
            raise LogError(f"{self.path}: is no file")
        self._file: BinaryIO = self.path.open("rb")
        try:
            self.preamble, self.start = self._begin()
        except BaseException:
            self._file.close()
            raise
        self.groups: tuple[Group, ...] = groups_of(self.preamble.sensors)
        self.damage: list[str] = []
        """What `records` had to leave out although good blocks follow it."""
        self._tag = tag_of(self.preamble.identity)
        self._left_to_check = _SEARCHED

    def _begin(self) -> tuple[Preamble, Mark]:
        head = self._file.read(len(MAGIC) + CRC.size)
        if head[: len(MAGIC)] != MAGIC or len(head) < len(MAGIC) + CRC.size:
            raise LogError(f"{self.path}: no journal of a log, or one that was never begun")
        (length,) = CRC.unpack(head[len(MAGIC) :])
        if length > min(LONGEST_PREAMBLE, self._left()):
            raise LogError(f"{self.path}: the journal's beginning is damaged")
        text = self._file.read(length)
        crc = zlib.crc32(head + text)
        if self._file.read(CRC.size) != CRC.pack(crc):
            raise LogError(f"{self.path}: the journal's beginning is damaged")
        return Preamble.from_json(text), Mark(self._file.tell(), crc)

    def records(self, start: Mark | None = None, newest_ns: Mapping[int, int] | None = None) -> Iterator[Record]:
        """The blocks from `start` on (None: all) up to the last good one. What is bad before that is left out and told
        in `damage`; behind it times go on from those before it, and from `newest_ns` by group.
        """
        mark, newest = start or self.start, dict(newest_ns or {})
        while True:
            for record in self._chained(mark):
                times = self._times(record)
                before = newest.get(record.group, -(1 << 62))
                if self.damage and (np.diff(times, prepend=before) <= 0).any():
                    self.damage.append(f"journal: from byte {mark.position} on it is not this log's, or damaged")
                    return
                if len(times):
                    newest[record.group] = int(times[-1])
                mark = record.after
                yield record
            resumed = self._behind(mark, max(newest.values(), default=0))
            if resumed is None:
                return
            if resumed != mark:
                self.damage.append(
                    f"journal: bytes {mark.position} to {resumed.position - 1} are damaged, rows are lost"
                )
            mark = resumed

    def _times(self, record: Record) -> npt.NDArray[np.int64]:
        """The times of a sensor's block, none of another's."""
        rows = record.rows if self.groups[record.group].path.startswith("sensors/") else 0
        return np.frombuffer(record.payload, "<i8", rows)

    def _behind(self, end: Mark, newest_ns: int) -> Mark | None:
        """Where good blocks go on behind a bad one at `end`; None if it is what a crash leaves at the end."""
        if os.fstat(self._file.fileno()).st_size <= end.position:
            return None
        if self._is_good(end):  # it was being written a moment ago
            return end
        self._file.seek(end.position)
        data = self._file.read(min(_SEARCHED, max(0, self._left())))
        sizes = tuple(group.row_bytes for group in self.groups)
        found = next_good(data, end, sizes, self._tag, lambda *place: self._is_good(Mark(*place)))
        resumed = None if found is None else Mark(*found)
        if resumed is not None and never_written(data[: resumed.position - end.position], end.position):
            late = (self._times(record) for record in self._chained(resumed))
            if not any(len(times) and times[-1] > newest_ns + _UNSYNCED_NS for times in late):
                return None
        return resumed

    def _is_good(self, mark: Mark) -> bool:
        """Whether a good block stands there."""
        if self._left_to_check <= 0:
            return False
        record = next(self._chained(mark), None)
        self._left_to_check -= _LEAST_CHECK + (len(record.payload) if record else 0)
        return record is not None

    def _chained(self, start: Mark) -> Iterator[Record]:
        """The blocks from `start` on up to the first that is not good."""
        position, chain = start
        self._file.seek(position)
        while len(head := self._file.read(HEAD.size + CRC.size)) == HEAD.size + CRC.size:
            group, tag, rows = HEAD.unpack_from(head)
            if tag not in (0, self._tag) or not rows or group >= len(self.groups):
                return
            wanted = rows * self.groups[group].row_bytes
            if wanted > min(LONGEST_BLOCK, self._left()):
                return
            payload = self._file.read(wanted)
            chain = zlib.crc32(payload, zlib.crc32(head[: HEAD.size], chain))
            if len(payload) < wanted or head[HEAD.size :] != CRC.pack(chain):
                return
            position += len(head) + len(payload)
            yield Record(group, rows, payload, Mark(position, chain))
            self._file.seek(position)

    def _left(self) -> int:
        """Bytes from here to the end, now: the log may be growing."""
        return os.fstat(self._file.fileno()).st_size - self._file.tell()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
