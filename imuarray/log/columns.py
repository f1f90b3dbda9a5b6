"""Columns that behave like HDF5 datasets: `Column` of a log that is being written, `NamedColumn` that names its place
in errors, and the tracks `/truth`, `/reference` and `/clocks`.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from threading import Lock
from typing import Any, NamedTuple, cast

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.log.format import CLOCKS

UNREADABLE = (OSError, RuntimeError, KeyError, MemoryError)
"""The exceptions of HDF5 on stored rows that it can't read; ValueError, TypeError and IndexError mean a bad slice."""


CACHED_BYTES = 1 << 26
"""Largest number of bytes of a log's rows that stay in memory: an hour of nine triads at 100 Hz has 57 MB."""

RECENT_BYTES = 1 << 24
"""Largest number of bytes in memory of a longer log, whose rows can't be kept from one pass to the next: a block of
each column of twelve sensors.
"""

TRACK_BYTES = 1 << 23
"""Largest number of bytes of the tracks, which few analyses read more than once: two blocks of each column."""

_BLOCK_ROWS = 1 << 16
"""Number of rows of a column that are read and kept together: sixteen chunks."""

_FEW_ROWS = 1 << 10
"""Number of rows below which rows are read alone, which is faster than reading their block."""


class RowCache:
    """The most recently used blocks of rows of all columns of a log; it keeps rows after `use` was called.

    Most analyses read a log several times, and reading means decompressing: reading an hour of nine triads takes a
    fifth of the time of fusing it by the mean.
    """

    def __init__(self, limit_bytes: int | None = None) -> None:
        """Keep up to `limit_bytes` (None: `CACHED_BYTES`)."""
        self._limit_bytes, self._bytes = CACHED_BYTES if limit_bytes is None else limit_bytes, 0
        self.used = False
        self._blocks: OrderedDict[tuple[str, int], npt.NDArray[Any]] = OrderedDict()
        self._lock = Lock()

    def use(self, size_bytes: int) -> None:
        """Keep rows from now on. If the log has more bytes than the limit, keep only `RECENT_BYTES`, because a pass
        over all rows would not find any row of the previous pass.
        """
        self.used = True
        if size_bytes > self._limit_bytes:
            self._limit_bytes = min(self._limit_bytes, RECENT_BYTES)

    def rows(self, column: h5py.Dataset, name: str, start: int, stop: int) -> npt.NDArray[Any]:
        """Return a copy of the rows from `start` to `stop` (`start` < `stop`) of a column; it raises HDF5's errors."""
        first = range(start - start % _BLOCK_ROWS, stop, _BLOCK_ROWS)
        parts = [
            self._block(column, name, block_start)[max(start - block_start, 0) : stop - block_start]
            for block_start in first
        ]
        return parts[0].copy() if len(parts) == 1 else np.concatenate(parts)

    def held(self, name: str, start: int, stop: int) -> npt.NDArray[Any] | None:
        """Return a copy of a few rows of a column if they are in memory, else None."""
        first = start - start % _BLOCK_ROWS
        with self._lock:
            block = self._blocks.get((name, first))
        return None if block is None or stop - first > len(block) else block[start - first : stop - first].copy()

    def _block(self, column: h5py.Dataset, name: str, first: int) -> npt.NDArray[Any]:
        key = name, first
        with self._lock:
            if key in self._blocks:
                self._blocks.move_to_end(key)
                return self._blocks[key]
        block = np.asarray(column[first : first + _BLOCK_ROWS])
        with self._lock:
            if key not in self._blocks:
                self._blocks[key] = block
                self._bytes += block.nbytes
            while self._bytes > self._limit_bytes:
                self._bytes -= self._blocks.popitem(last=False)[1].nbytes
        return block


class NamedColumn:
    """An HDF5 dataset (or a `Column`) that names its place in errors: reading damaged rows raises LogError."""

    __slots__ = ("_cache", "_column", "_dtype", "_place")

    def __init__(
        self,
        column: h5py.Dataset | Column,
        place: str,
        cache: RowCache | None = None,
        dtype: np.dtype[Any] | None = None,
    ) -> None:
        """`cache` keeps rows that are read; only for a dataset that does not change. Rows are returned as `dtype`
        (None: as they are stored).
        """
        self._column, self._place, self._cache = column, place, cache
        self._dtype: np.dtype[Any] = column.dtype if dtype is None else dtype

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._column, name)

    def __repr__(self) -> str:
        try:
            return f"<column {self._place}, {' x '.join(map(str, self.shape))} {self.dtype}>"
        except (*UNREADABLE, ValueError):  # h5py's errors for a closed file
            return f"<column {self._place}, closed>"

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of rows, and the shape of a row."""
        return cast(tuple[int, ...], self._column.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the values that are read."""
        return self._dtype

    def __len__(self) -> int:
        return len(self._column)

    def __iter__(self) -> Iterator[Any]:
        return (self[row] for row in range(len(self)))

    def __getitem__(self, key: Any) -> Any:
        rows = self._read_stored(key)
        return rows if rows.dtype == self._dtype else rows.astype(self._dtype)

    def _read_stored(self, key: Any) -> Any:
        if self._cache is not None and self._cache.used:
            if isinstance(key, slice) and key.step in (None, 1):
                start, stop, _ = key.indices(len(self))
                if stop - start >= _FEW_ROWS:
                    with suppress(*UNREADABLE):  # the requested rows may be intact although others of the block are not
                        return self._cache.rows(self._column, self._place, start, stop)
                if stop > start and (rows := self._cache.held(self._place, start, stop)) is not None:
                    return rows
            elif isinstance(key, int):
                start = key + len(self) if key < 0 else key
                if (rows := self._cache.held(self._place, start, start + 1)) is not None:
                    return rows[0]
        try:
            return self._column[key]
        except UNREADABLE:
            raise self._damage_error(key) from None

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.asarray(self[()] if self.shape == () else self[:], dtype)

    def _damage_error(self, key: Any) -> LogError:
        if isinstance(self._column, h5py.Dataset) and not self._column:
            return LogError(f"{self._place}: the log is closed; read its rows while it is open")
        rows = key[0] if isinstance(key, tuple) and key else key
        if isinstance(rows, slice):
            start, stop, _ = rows.indices(len(self))
        elif isinstance(rows, int | np.integer):
            start = int(rows) % len(self)
            stop = start + 1
        else:
            start, stop = 0, len(self)
        rows_text = f"row {start} is" if stop == start + 1 else f"rows {start} to {stop - 1} are"
        return LogError(f"{self._place}: {rows_text} damaged (imuarray verify lists all)")


class Column:
    """A column whose first rows are stored in a file and whose last rows are in memory; it is sliced like an HDF5
    dataset and has the same shape.
    """

    chunks = None

    def __init__(
        self,
        name: str,
        tail: npt.NDArray[Any],
        rows: int = 0,
        stored: Callable[[int, int], npt.NDArray[Any]] | None = None,
    ) -> None:
        """`stored` returns the rows between two row numbers of the `rows` in the file; OSError if unreadable."""
        self.name, self._rows, self._tail, self._read_stored = name, rows, tail, stored
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
        """Return rows from both parts."""
        head = self._tail[:0]
        if self._read_stored is not None and start < min(stop, self._rows):
            head = np.asarray(self._read_stored(start, min(stop, self._rows)), self.dtype)[::step]
        if stop <= self._rows:
            return head.copy()
        first = start if start >= self._rows else start + step * len(head)
        tail = self._tail[first - self._rows : stop - self._rows : step]
        return np.concatenate([head, tail])

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.asarray(self[:], dtype)


class LiveGroup:
    """A group of columns (`Column`); it replaces an HDF5 group."""

    def __init__(self, name: str, attributes: Mapping[str, Any], columns: Mapping[str, Column]) -> None:
        self.name, self.attrs = name, attributes
        self._columns = columns

    def get(self, name: str) -> Column | None:
        """Return the column of this name, if it exists."""
        return self._columns.get(name)

    def __getitem__(self, name: str) -> Column:
        return self._columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self._columns


GROUP = (h5py.Group, LiveGroup)
"""The classes of the groups of a log."""

DATASET = (h5py.Dataset, Column)
"""The classes of a column, in the file or in memory."""


class Track(NamedTuple):
    """`/truth` or `/reference`: columns time (n,) ns, specific_force (n, 3) m/s2 and angular_rate (n, 3) rad/s in the
    box frame, temperature (n,) degC; None for columns that the log lacks.
    """

    time: NamedColumn
    specific_force: NamedColumn | None
    angular_rate: NamedColumn | None
    temperature: NamedColumn | None


class ClockTrack(NamedTuple):
    """`/clocks`: columns (n,) ns of the log's own time and of four clocks of the machine (`imuarray.log.format`)."""

    time: NamedColumn
    monotonic: NamedColumn
    monotonic_raw: NamedColumn
    boottime: NamedColumn
    realtime: NamedColumn


def track_of(group: Any, place: str, cache: RowCache | None = None) -> Track:
    """Return the track that a group of the file contains, whose rows `cache` keeps; LogError, which names its `place`,
    if it contains none.
    """
    if not isinstance(group, GROUP) or "time" not in group:
        raise LogError(f"{place} has no time")
    columns = [group.get(column) for column in Track._fields]
    for column, tail in zip(columns, ((), (3,), (3,), ()), strict=True):
        if column is not None and column.shape != (*group["time"].shape, *tail):
            raise LogError(f"{place}: a column has another shape than time")
    return Track(*_columns_named(columns, place, cache))


def clocks_of(group: Any, place: str) -> ClockTrack:
    """Return the clock rows that a group of the file contains; LogError, which names its `place`, if there are none."""
    columns = [group.get(column) for column, _, _ in CLOCKS]
    if any(not isinstance(column, DATASET) or column.dtype.kind != "i" for column in columns) or (
        len({column.shape for column in columns}) != 1
    ):
        raise LogError(f"{place} is missing a column, or its columns differ in length")
    return ClockTrack(*_columns_named(columns, place))


def _columns_named(columns: Sequence[Any], place: str, cache: RowCache | None = None) -> Iterator[Any]:
    """Yield the columns that exist, and None for the others."""
    return (
        None if column is None else named_column(column, f"{place}: {column.name.rsplit('/', 1)[-1]}", cache)
        for column in columns
    )


def named_column(
    column: h5py.Dataset | Column, place: str, cache: RowCache | None, dtype: np.dtype[Any] | None = None
) -> NamedColumn:
    """Return a column, read as `dtype`, whose rows `cache` keeps unless they may change, as those of a growing log."""
    return NamedColumn(column, place, cache if isinstance(column, h5py.Dataset) else None, dtype)
