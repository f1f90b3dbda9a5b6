"""Opens an HDF5 file that was never closed for reading, without changing it.

Its superblock says that it is open for writing, so HDF5 opens it only as a reader of a file with an active writer
(SWMR). Such a reader waits for damaged blocks to be repaired, twice as long each time and in the end for ever; after a
power cut no writer will repair them. HDF5 is therefore given the file with that one flag cleared and with its actual
end: the superblock states the end at the last flush of the whole file, and a chunk that was flushed alone may follow
it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from imuarray.log.hdf5_heaps import HeapCheckedFile

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
