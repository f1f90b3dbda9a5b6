"""Checks of the text heaps of an HDF5 file that is being inspected: each is validated before HDF5 reads it.

Texts of varying length are stored in global heaps, which have no check sum. A damaged heap sends HDF5 (2.0 and before)
into an endless loop: an object of no size, or of nearly 2^64 bytes, leads it back to where it was. The bytes are
therefore read here first, and an inconsistent heap is reported as an error of the disk.

One length is not visible here: the one that the reference to a text states (32 bits). HDF5 allocates that much memory
before it notices that the text is shorter and reports an error.
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
    """The bytes of a file, for h5py's driver for Python files; OSError (EBADMSG) for a heap that does not add up."""

    def __init__(self, path: Path, *, check_heaps: bool = True) -> None:
        """`check_heaps` switches the check on. It must be off while numbers are read, since any bytes may occur among
        them.
        """
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
