"""The journal beside a log that is being written: every block of rows as it came, appended and never changed.

::

    "imuarray journal 1\\n"  length u32  preamble (JSON)  crc32 u32
    group u16  0 u16  rows u32  crc32 u32  rows of the group (imuarray.log.layout)      again and again

All little-endian. Each block's CRC goes on from the one before it (the first from the preamble's), so that a block is
good only if everything before it is: what a crash or a power cut leaves behind the last good block is never believed.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

from imuarray.errors import LogBusyError, LogError
from imuarray.log.layout import Group, groups_of
from imuarray.log.preamble import Preamble

if sys.platform != "win32":  # logs are read there, not recorded
    import fcntl

MAGIC = b"imuarray journal 1\n"
LONGEST_PREAMBLE = 1 << 24
LONGEST_BLOCK = 1 << 28

_HEAD = struct.Struct("<HHI")
_CRC = struct.Struct("<I")


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
            if not _locked(self.fd, exclusive=True):
                os.close(self.fd)
                raise LogBusyError(path)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(self.fd), self.path.stat()):
                    return
            os.close(self.fd)  # it was removed between opening and locking: somebody finished that log

    def remove(self) -> None:
        """The log is complete without it."""
        self.path.unlink(missing_ok=True)

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
        head = MAGIC + _CRC.pack(len(text)) + text
        crc = zlib.crc32(head)
        self._fd = fd
        os.ftruncate(fd, 0)
        os.lseek(fd, 0, os.SEEK_SET)
        self.mark = Mark(0, 0)
        self._write(head + _CRC.pack(crc), crc)

    def append(self, blocks: Sequence[tuple[int, int, bytes]]) -> None:
        """Add blocks (group, rows, bytes); if OSError comes, none of them is there."""
        chain, parts = self.mark.chain, []
        for group, rows, payload in blocks:
            head = _HEAD.pack(group, 0, rows)
            chain = zlib.crc32(payload, zlib.crc32(head, chain))
            parts += [head, _CRC.pack(chain), payload]
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

    def _begin(self) -> tuple[Preamble, Mark]:
        head = self._file.read(len(MAGIC) + _CRC.size)
        if head[: len(MAGIC)] != MAGIC or len(head) < len(MAGIC) + _CRC.size:
            raise LogError(f"{self.path}: no journal of a log, or one that was never begun")
        (length,) = _CRC.unpack(head[len(MAGIC) :])
        if length > min(LONGEST_PREAMBLE, self._left()):
            raise LogError(f"{self.path}: the journal's beginning is damaged")
        text = self._file.read(length)
        crc = zlib.crc32(head + text)
        if self._file.read(_CRC.size) != _CRC.pack(crc):
            raise LogError(f"{self.path}: the journal's beginning is damaged")
        return Preamble.from_json(text), Mark(self._file.tell(), crc)

    def records(self, start: Mark | None = None) -> Iterator[Record]:
        """The blocks from `start` on (None: all) up to the last good one."""
        position, chain = start or self.start
        self._file.seek(position)
        while len(head := self._file.read(_HEAD.size + _CRC.size)) == _HEAD.size + _CRC.size:
            group, zero, rows = _HEAD.unpack_from(head)
            if zero or not rows or group >= len(self.groups):
                return
            wanted = rows * self.groups[group].row_bytes
            if wanted > min(LONGEST_BLOCK, self._left()):
                return
            payload = self._file.read(wanted)
            chain = zlib.crc32(payload, zlib.crc32(head[: _HEAD.size], chain))
            if len(payload) < wanted or head[_HEAD.size :] != _CRC.pack(chain):
                return
            position += len(head) + len(payload)
            yield Record(group, rows, payload, Mark(position, chain))

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
