"""Blocks of frames and rows of numbers in temporary files, so that results of a whole log, and a second pass over it,
need no memory that grows with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from io import SEEK_END
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.fuse.frames import Frames

AT_ONCE = 1 << 15
"""Number of rows of a block."""


class RowSource(Protocol):
    """Rows (n, k): an array, or an object that reads a slice of them on demand."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> Floats: ...


class RowSpool:
    """Rows (n, `columns`) of float64 in a temporary or a named file. A `RowSource`, a context manager."""

    def __init__(self, columns: int, path: Path | None = None, mode: str = "w+b") -> None:
        self._columns, self._path = columns, path
        self._file: IO[bytes] = TemporaryFile() if path is None else path.open(mode)  # noqa: SIM115, lives as long
        self._length = self._file.seek(0, SEEK_END) // (8 * columns)

    def append(self, rows: Floats) -> None:
        """Add rows (m, columns) at the end."""
        self._file.seek(0, SEEK_END)
        self._file.write(np.ascontiguousarray(rows, np.float64).data)
        self._length += len(rows)

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, rows: slice, /) -> Floats:
        """Read rows; the slice has no step."""
        begin, end, _ = rows.indices(self._length)
        result = np.empty((max(0, end - begin), self._columns))
        self._file.seek(begin * 8 * self._columns)
        self._file.readinto(result.data)  # type: ignore[attr-defined]  # a file on the disk has it
        return result

    def complete(self) -> Path:
        """Write everything to the named file and return its path; ValueError for a temporary file."""
        if self._path is None:
            raise ValueError("a temporary file has no name")
        self._file.flush()
        return self._path

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def row_blocks(rows: RowSource, begin: int = 0, end: int | None = None) -> Iterator[Floats]:
    """Yield the rows from `begin` to `end` (None: all) in blocks of `AT_ONCE`."""
    end = len(rows) if end is None else end
    for first in range(begin, end, AT_ONCE):
        yield rows[first : min(first + AT_ONCE, end)]


def square_sum(rows: RowSource, begin: int, end: int) -> Floats:
    """Return the sum (k,) of the squares of the rows from `begin` to `end`."""
    columns = (np.ascontiguousarray(block.T) for block in row_blocks(rows, begin, end))  # several times faster
    return np.asarray(sum((np.sum(np.square(each), axis=1) for each in columns), np.zeros(rows[:1].shape[1])))


def parts_of(rows: int, parts: int) -> Iterator[tuple[int, int]]:
    """Yield the first row of each part of `numpy.array_split`, and that of the next."""
    size, longer = divmod(rows, parts)
    return pairwise(part * size + min(part, longer) for part in range(parts + 1))


_COLUMNS = tuple(item.name for item in fields(Frames))


class _ArrayHeader(NamedTuple):
    """Type and shape of an array in the file."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]


class FrameSpool:
    """Frames by quantity and temperatures by sensor, block by block, in a temporary file of 9 to 12 bytes per axis and
    frame, which is deleted with the object.
    """

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115, it lives as long as the spool
        self._blocks: list[tuple[dict[str, dict[str, _ArrayHeader]], dict[str, _ArrayHeader]]] = []
        self.frames = 0
        """Number of frames in all blocks."""

    def add(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> None:
        """Write the next block. OSError."""
        columns = {
            quantity: {name: self._put(column) for name in _COLUMNS if (column := getattr(part, name)) is not None}
            for quantity, part in frames.items()
        }
        self._blocks.append((columns, {sensor: self._put(column) for sensor, column in degc.items()}))
        self.frames += len(next(iter(frames.values())).time)

    def blocks(self) -> Iterator[tuple[dict[str, Frames], dict[str, Floats]]]:
        """Yield all blocks in their order."""
        self._file.seek(0)
        for columns, degc in self._blocks:
            frames = {
                quantity: Frames(**{name: self._get(place) for name, place in part.items()})
                for quantity, part in columns.items()
            }
            yield frames, {sensor: self._get(place) for sensor, place in degc.items()}

    def _put(self, column: npt.NDArray[Any]) -> _ArrayHeader:
        self._file.write(np.ascontiguousarray(column).data)
        return _ArrayHeader(column.dtype, column.shape)

    def _get(self, place: _ArrayHeader) -> npt.NDArray[Any]:
        column = np.empty(place.shape, place.dtype)
        self._file.readinto(column.data)
        return column

    def close(self) -> None:
        """Close the file."""
        self._file.close()
