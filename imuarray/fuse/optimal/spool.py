"""A stack of arrays on the disk: what a smoother has to keep of a log does not stay in memory."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from tempfile import TemporaryFile

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_PLACE = struct.Struct("<qq")
"""Behind a group: the length of its head, the shapes, and where the group begins."""


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
        shapes = [array.shape for array in arrays]
        parts = [np.ascontiguousarray(array, np.float64).tobytes() for array in arrays]
        head = np.array([number for shape in shapes for number in (len(shape), *shape)], np.int64).tobytes()
        self._file.seek(self._end)
        self._file.write(b"".join((*parts, head, _PLACE.pack(len(head), self._end))))
        self._end = self._file.tell()

    def pop(self) -> list[Floats]:
        """Take the topmost group; IndexError if there is none."""
        if not self:
            raise IndexError("nothing is on the spool")
        self._file.seek(self._end - _PLACE.size)
        head_bytes, start = _PLACE.unpack(self._file.read(_PLACE.size))
        self._file.seek(start)
        content = self._file.read(self._end - start - _PLACE.size)
        head = iter(np.frombuffer(content[len(content) - head_bytes :], np.int64).tolist())
        arrays, at = [], 0
        for dimensions in head:
            shape = tuple(next(head) for _ in range(dimensions))
            size = math.prod(shape)
            arrays.append(np.frombuffer(content, np.float64, size, at).reshape(shape))
            at += 8 * size
        self._end = start
        return arrays

    def close(self) -> None:
        """Give the file back."""
        self._file.close()
