"""Rows of numbers in a file, so that results of a whole log are computed in memory that does not grow with it."""

from __future__ import annotations

from collections.abc import Iterator
from io import SEEK_END
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Protocol, Self

import numpy as np

from imuarray.arrays import Floats

AT_ONCE = 1 << 15
"""Number of rows of a block."""


class RowSource(Protocol):
    """Rows (n, k): an array, or an object that reads a slice of them on demand."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> Floats: ...


class RowSpool:
    """Rows (n, `columns`) of float64 in a temporary file, or in a file with a name. A `RowSource`, a context
    manager.
    """

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
