"""Opens for reading an HDF5 file that was never closed, without changing it.

Its superblock says that it is open for writing, so HDF5 opens it only as a reader of a file with an active writer
(SWMR). Such a reader waits for damaged blocks to be repaired, each time twice as long; after a power cut no writer will
repair them. HDF5 is therefore given the file with that flag cleared and with its actual end: the superblock states the
end at the last flush of the whole file, and a chunk that was flushed alone may follow it.

Text heaps are validated before HDF5 reads them: texts of varying length are stored in global heaps, which have no check
sum. A damaged heap sends HDF5 (2.0 and earlier) into an endless loop, because an object of size 0 or of nearly 2^64
bytes leads back to its own position. The bytes are therefore read here first, and an inconsistent heap is reported as a
disk error.

One length is not checked here: that in the reference to a text (32 bits). HDF5 allocates that much memory before it
notices that the text is shorter, and reports an error.
"""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path
from typing import Any

_SIGN = b"GCOL"
_HEAD = 16
"""Bytes before the first object of a heap, and before the data of an object (HDF5 file format, III.E)."""
LONGEST = 1 << 24
"""Longest heap; it holds as many texts as fit into 4 KiB, or one that is longer: a configuration is the longest."""


class HeapCheckedFile(io.RawIOBase):
    """The bytes of a file, for h5py's driver for Python files; OSError (EBADMSG) for an inconsistent heap."""

    def __init__(self, path: Path, *, check_heaps: bool = True) -> None:
        """Open the file. `check_heaps` must be off while numbers are read, because they may contain any bytes."""
        self._file = path.open("rb", buffering=0)
        self._check_heaps = check_heaps
        self._at = 0
        self._good: set[int] = set()

    def readable(self) -> bool:
        """Always True."""
        return True

    def seekable(self) -> bool:
        """Always True."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Move or return the position, as of any file."""
        start = (0, self._at, os.fstat(self._file.fileno()).st_size)[whence]
        self._at = start + offset
        return self._at

    def tell(self) -> int:
        """Move or return the position, as of any file."""
        return self._at

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes, and check the heaps among them."""
        view = memoryview(buffer).cast("B")
        count = os.preadv(self._file.fileno(), [view], self._at)
        if self._check_heaps:
            self._look(bytes(view[:count]))
        self._at += count
        return count

    def _look(self, data: bytes) -> None:
        """Check heaps that begin in these bytes or just before them, since HDF5 may read a heap in two pieces."""
        before = os.pread(self._file.fileno(), min(self._at, len(_SIGN) - 1), max(self._at - len(_SIGN) + 1, 0))
        data, start = before + data, self._at - len(before)
        offset = data.find(_SIGN)
        while offset >= 0:
            if start + offset not in self._good:
                if not _adds_up(self._file.fileno(), start + offset):
                    raise OSError(errno.EBADMSG, "a heap of texts is damaged")
                self._good.add(start + offset)
            offset = data.find(_SIGN, offset + 1)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _adds_up(fd: int, at: int) -> bool:
    """Return whether the objects of the heap at this place fill it exactly."""
    length = int.from_bytes(os.pread(fd, _HEAD, at)[8:], "little")
    if not _HEAD <= length <= LONGEST:
        return False
    heap = os.pread(fd, length, at)
    if len(heap) < length:
        return False
    place = _HEAD
    while length - place >= _HEAD:
        number = int.from_bytes(heap[place : place + 2], "little")
        size = int.from_bytes(heap[place + 8 : place + _HEAD], "little")
        if number == 0 and size < _HEAD:  # what is free counts its own head
            return False
        place += size if number == 0 else _HEAD + -(-size // 8) * 8
    return place <= length


_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_FLAGS = 11
_END = slice(28, 36)
_LENGTH = 44
"""Bytes of a superblock of version 3 with 8-byte addresses; its check sum follows (HDF5 file format, II.A)."""


def is_marked_open(path: Path) -> bool:
    """Return whether a file is marked as open for writing."""
    with path.open("rb") as file:
        head = file.read(_LENGTH)
    return _is_version_3(head) and head[_FLAGS] != 0


def _is_version_3(head: bytes) -> bool:
    return len(head) == _LENGTH and head[:8] == _SIGNATURE and head[8] == 3 and head[9] == 8


class UnclosedFile(HeapCheckedFile):
    """The bytes of a file, with the flags of its superblock cleared and its actual end; for h5py's driver for Python
    files.
    """

    def __init__(self, path: Path, *, check_heaps: bool = True) -> None:
        """`check_heaps` as of `HeapCheckedFile`."""
        super().__init__(path, check_heaps=check_heaps)
        head = os.pread(self._file.fileno(), _LENGTH + 4, 0)
        self._head = head
        if _is_version_3(head[:_LENGTH]) and head[_LENGTH:] == _checksum(head[:_LENGTH]):
            end = max(int.from_bytes(head[_END], "little"), os.fstat(self._file.fileno()).st_size)
            ended = head[_FLAGS + 1 : _END.start] + end.to_bytes(8, "little") + head[_END.stop : _LENGTH]
            cleared = head[:_FLAGS] + b"\0" + ended
            self._head = cleared + _checksum(cleared)

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes; those of the superblock are the corrected ones."""
        at = self._at
        count = super().readinto(buffer)
        if at < len(self._head):
            piece = self._head[at : at + count]
            memoryview(buffer).cast("B")[: len(piece)] = piece
        return count


def _checksum(data: bytes) -> bytes:
    """Compute Bob Jenkins' lookup3 (hashlittle, public domain, 2006), with which HDF5 checks its metadata."""
    mask = 0xFFFFFFFF
    words = [int.from_bytes(data[start : start + 4], "little") for start in range(0, -(-len(data) // 12) * 12, 4)]
    a = b = c = (0xDEADBEEF + len(data)) & mask

    def turned(value: int, by: int) -> int:
        return ((value << by) | (value >> (32 - by))) & mask

    for start in range(0, len(words), 3):
        a, b, c = (a + words[start]) & mask, (b + words[start + 1]) & mask, (c + words[start + 2]) & mask
        if start + 3 == len(words):
            break
        for by in (4, 6, 8, 16, 19, 4):
            a = ((a - c) & mask) ^ turned(c, by)
            c = (c + b) & mask
            a, b, c = b, c, a
    for by in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - turned(b, by)) & mask
        a, b, c = b, c, a
    return b.to_bytes(4, "little")
