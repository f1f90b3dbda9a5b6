"""Columns of a log as smooth functions of time, read a block at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.simulate.motion.felt import Integers

Floats = npt.NDArray[np.floating[Any]]

BLOCK = 16384
"""Rows per block; a whole number of the log's chunks."""

_KEPT = 4


class _Block(NamedTuple):
    """Rows (k, c) at times (k,) ns with their slopes (k, c) per s; the last row is the first of the next block."""

    time_ns: Integers
    rows: Floats
    slopes: Floats


@dataclass(frozen=True, eq=False)
class Recorded:
    """`columns` (n,) or (n, 3) at `time` (n,) ns, joined by cubic pieces whose slope at a row comes from the rows
    before and after it (three-point formula; from one at the ends): values and slopes without jumps.

    Only a few blocks of rows are in memory at any time. `where` stands in the LogError for rows that aren't finite or
    whose times don't increase.
    """

    time: h5py.Dataset
    columns: tuple[h5py.Dataset, ...]
    where: str

    def at(self, time_ns: Integers) -> tuple[Floats, Floats]:
        """(n, c) values, all columns side by side, and (n, c) their derivatives per s, in any order of times.

        Before the first row that row, after the last the last, both with derivative 0.
        """
        within = np.clip(time_ns, self.first_ns, self.last_ns)
        number = np.searchsorted(self._starts_ns, within, side="right") - 1
        blocks = np.unique(number)
        if len(blocks) == 1:
            values, slopes = _between_rows(self._block(int(blocks[0])), within)
        else:
            width = self._block(int(blocks[0])).rows.shape[1] if len(blocks) else sum(self._widths)
            values, slopes = np.empty((2, len(within), width))
            for block in blocks.tolist():
                here = number == block
                values[here], slopes[here] = _between_rows(self._block(block), within[here])
        return values, np.where((time_ns == within)[:, None], slopes, 0.0)

    @cached_property
    def first_ns(self) -> int:
        """Time of the first row."""
        return int(self.time[0])

    @cached_property
    def last_ns(self) -> int:
        """Time of the last row."""
        return int(self.time[-1])

    @property
    def _widths(self) -> tuple[int, ...]:
        return tuple(1 if column.ndim == 1 else int(column.shape[1]) for column in self.columns)

    @cached_property
    def _starts_ns(self) -> Integers:
        """(blocks,) time of the first row of each."""
        rows = range(0, max(len(self.time) - 1, 1), BLOCK)
        return np.array([self.time[row] for row in rows], np.int64)

    @cached_property
    def _block(self) -> Callable[[int], _Block]:
        return lru_cache(maxsize=_KEPT)(self._read)

    def _read(self, number: int) -> _Block:
        """One block, with a row more on either side while slopes are taken."""
        start = number * BLOCK
        before = min(start, 1)
        rows = slice(start - before, start + BLOCK + 2)
        time_ns, values = self._rows(rows)
        if not np.isfinite(values).all() or (np.diff(time_ns) <= 0).any():
            raise LogError(f"{self.where}: rows {start} to {start + len(time_ns)}: finite numbers are wanted, in order")
        if len(time_ns) == 1:
            return _Block(time_ns, values, np.zeros_like(values))
        slopes = np.gradient(values, (time_ns - time_ns[0]) * 1e-9, axis=0)
        own = slice(before, before + BLOCK + 1)
        return _Block(time_ns[own], values[own], slopes[own])

    def _rows(self, rows: slice) -> tuple[Integers, Floats]:
        try:
            columns = [np.asarray(column[rows], float) for column in self.columns]
            return np.asarray(self.time[rows], np.int64), np.concatenate(
                [column.reshape(len(column), -1) for column in columns], axis=1
            )
        except (OSError, TypeError, ValueError) as error:
            raise LogError(f"{self.where}: {' '.join(str(error).split())}") from None


def _between_rows(block: _Block, time_ns: Integers) -> tuple[Floats, Floats]:
    """(n, c) values and derivatives per s of the cubic pieces (Hermite) at times within the block."""
    if len(block.time_ns) == 1:
        shape = (len(time_ns), block.rows.shape[1])
        return np.broadcast_to(block.rows, shape), np.zeros(shape)
    row = np.clip(np.searchsorted(block.time_ns, time_ns, side="right") - 1, 0, len(block.time_ns) - 2)
    length = ((block.time_ns[row + 1] - block.time_ns[row]) * 1e-9)[:, None]
    x = ((time_ns - block.time_ns[row]) * 1e-9)[:, None] / length
    start, rise = block.rows[row], block.rows[row + 1] - block.rows[row]
    begin, end = block.slopes[row] * length, block.slopes[row + 1] * length
    square, cube = 3 * rise - 2 * begin - end, begin + end - 2 * rise
    return start + x * (begin + x * (square + x * cube)), (begin + x * (2 * square + x * (3 * cube))) / length
