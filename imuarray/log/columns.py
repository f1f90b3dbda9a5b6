"""Columns in the place of HDF5 datasets: of a log that still grows (`Column`), and of any log, with a name
(`NamedColumn`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError

UNREADABLE = (OSError, RuntimeError, KeyError, MemoryError)
"""What HDF5 raises on stored rows that it can't read; ValueError, TypeError and IndexError are of a bad slice."""


class NamedColumn:
    """An HDF5 dataset (or a `Column`) that knows whose it is: LogError where its rows are damaged, else the same."""

    __slots__ = ("_column", "_where")

    def __init__(self, column: h5py.Dataset | Column, where: str) -> None:
        self._column, self._where = column, where

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._column, name)

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows, and what a row holds."""
        return cast(tuple[int, ...], self._column.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of what is stored."""
        return cast(np.dtype[Any], self._column.dtype)

    def __len__(self) -> int:
        return len(self._column)

    def __iter__(self) -> Iterator[Any]:
        return (self[row] for row in range(len(self)))

    def __getitem__(self, key: Any) -> Any:
        try:
            return self._column[key]
        except UNREADABLE:
            raise self._damaged(key) from None

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.asarray(self[()] if self.shape == () else self[:], dtype)

    def _damaged(self, key: Any) -> LogError:
        """The rows that were asked for, in words."""
        rows = key[0] if isinstance(key, tuple) and key else key
        if isinstance(rows, slice):
            start, stop, _ = rows.indices(len(self))
        elif isinstance(rows, int | np.integer):
            start = int(rows) % len(self)
            stop = start + 1
        else:
            start, stop = 0, len(self)
        which = f"row {start} is" if stop == start + 1 else f"rows {start} to {stop - 1} are"
        return LogError(f"{self._where}: {which} damaged (imuarray verify tells all)")


class Column:
    """A column whose first rows stand in a file and whose last ones are here; slices and shapes as an HDF5 dataset."""

    chunks = None

    def __init__(
        self,
        name: str,
        tail: npt.NDArray[Any],
        rows: int = 0,
        stored: Callable[[int, int], npt.NDArray[Any]] | None = None,
    ) -> None:
        """`stored` gives the rows from one number to another of the `rows` in the file; OSError where they can't be
        had.
        """
        self.name, self._rows, self._tail, self._stored = name, rows, tail, stored
        self.dtype: np.dtype[Any] = tail.dtype
        self.shape: tuple[int, ...] = (rows + len(tail), *tail.shape[1:])
        self.ndim, self.size = tail.ndim, int(np.prod(self.shape))

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> Any:
        first, *rest = key if isinstance(key, tuple) and key else (key,)
        if isinstance(first, slice) and (first.step is None or first.step > 0):
            rows = self._slice(*first.indices(len(self)))
            return rows[(slice(None), *rest)] if rest else rows
        if isinstance(first, int | np.integer):
            row = int(first) + (len(self) if first < 0 else 0)
            if not 0 <= row < len(self):
                raise IndexError(f"row {first} of {len(self)}")
            return self._slice(row, row + 1, 1)[(0, *rest)]
        return self._slice(0, len(self), 1)[key]

    def _slice(self, start: int, stop: int, step: int) -> npt.NDArray[Any]:
        """Rows from both parts."""
        head = self._tail[:0]
        if self._stored is not None and start < min(stop, self._rows):
            head = np.asarray(self._stored(start, min(stop, self._rows)), self.dtype)[::step]
        if stop <= self._rows:
            return head.copy()
        first = start if start >= self._rows else start + step * len(head)
        tail = self._tail[first - self._rows : stop - self._rows : step]
        return np.concatenate([head, tail])

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.asarray(self[:], dtype)


class LiveGroup:
    """A group of such columns, in the place of an HDF5 group."""

    def __init__(self, name: str, attributes: Mapping[str, Any], columns: Mapping[str, Column]) -> None:
        self.name, self.attrs = name, attributes
        self._columns = columns

    def get(self, name: str) -> Column | None:
        """A column, if it is there."""
        return self._columns.get(name)

    def __getitem__(self, name: str) -> Column:
        return self._columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self._columns


GROUP = (h5py.Group, LiveGroup)
"""What a group of a log is an instance of."""

DATASET = (h5py.Dataset, Column)
"""And a column."""
