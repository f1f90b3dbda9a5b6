"""A stack of arrays on the disk: what a smoother has to keep of a log does not stay in memory."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from tempfile import TemporaryFile

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_PLACE = struct.Struct("<q")


class Spool:
    """Groups of arrays, last in, first out, in a temporary file that nobody else sees and that ends with the object."""

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115, it lives as long as the spool
        self._end = 0

    def __bool__(self) -> bool:
        """Whether there is anything on it."""
        return self._end > 0

    def push(self, arrays: Sequence[Floats]) -> None:
        """Put a group on top."""
        self._file.seek(self._end)
        for array in arrays:
            np.lib.format.write_array(self._file, np.ascontiguousarray(array), allow_pickle=False)
        self._file.write(_PLACE.pack(self._end))
        self._end = self._file.tell()

    def pop(self) -> list[Floats]:
        """Take the topmost group; IndexError if there is none."""
        if not self:
            raise IndexError("nothing is on the spool")
        self._file.seek(self._end - _PLACE.size)
        (start,) = _PLACE.unpack(self._file.read(_PLACE.size))
        last = self._end - _PLACE.size
        self._file.seek(start)
        arrays = []
        while self._file.tell() < last:
            arrays.append(np.lib.format.read_array(self._file, allow_pickle=False))
        self._end = start
        return arrays

    def close(self) -> None:
        """Give the file back."""
        self._file.close()
