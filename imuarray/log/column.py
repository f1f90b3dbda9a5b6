"""Columns in the place of HDF5 datasets: of a log that still grows (`Column`), and of any log, with a name
(`NamedColumn`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError

_TRIES = 3
_UNREADABLE = (OSError, RuntimeError, KeyError, MemoryError)
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
        except _UNREADABLE:
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

    def __init__(self, dataset: h5py.Dataset, rows: int, tail: npt.NDArray[Any]) -> None:
        self._dataset, self._rows, self._tail = dataset, rows, tail
        self.dtype: np.dtype[Any] = tail.dtype
        self.shape: tuple[int, ...] = (rows + len(tail), *tail.shape[1:])
        self.ndim, self.size = tail.ndim, int(np.prod(self.shape))
        self.attrs = dataset.attrs
        self.name = dataset.name
        self.chunks = dataset.chunks

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
        head = np.asarray(self._stored(slice(start, max(start, min(stop, self._rows)), step)), self.dtype)
        if stop <= self._rows:
            return head
        behind = start if start >= self._rows else start + step * len(head)
        tail = self._tail[behind - self._rows : stop - self._rows : step]
        return np.concatenate([head, tail]) if start < self._rows else tail.copy()

    def _stored(self, rows: slice) -> npt.NDArray[Any]:
        """Rows of the file; once more if its writer was just changing the page that says where they are."""
        for _ in range(_TRIES - 1):
            try:
                return cast(npt.NDArray[Any], self._dataset[rows])
            except OSError:
                time.sleep(0.01)
        return cast(npt.NDArray[Any], self._dataset[rows])

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.asarray(self[:], dtype)


class LiveGroup:
    """A group of such columns, in the place of an HDF5 group."""

    def __init__(self, group: h5py.Group, columns: Mapping[str, Column]) -> None:
        self.name, self.attrs = group.name, group.attrs
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
