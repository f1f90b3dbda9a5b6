"""Rows that come late, put in the order of their times, block by block.

A logger with several threads, or a transport that repeats packets, writes rows out of order. A row may come up to
`MOST_ROWS_LATE` rows late; a later one stays where it is, and
`imuarray.importers.cells.TimeColumn` refuses it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Times
from imuarray.importers.cells import CellBlock

MOST_ROWS_LATE = 4096
"""Rows that are held back; so many cells are in memory."""

Blocks = Iterator[tuple[CellBlock, list[int]]]


class RowOrder:
    """Sorts rows by their times; `late` counts those that came after a row with a later time."""

    def __init__(self, times: Callable[[CellBlock, Sequence[int]], Times]) -> None:
        """`times` returns the times (n,) of the rows of the next block, whatever their order."""
        self._times = times
        self._latest: int | None = None
        self.late = 0

    def in_order(self, blocks: Blocks) -> Blocks:
        """Yield the rows of the blocks, sorted by time; rows of equal time keep their order."""
        held: CellBlock | None = None
        held_times = np.zeros(0, np.int64)
        where: list[int] = []
        for block, where in blocks:
            times = self._times(block, where)
            self._count(times)
            joined = block if held is None else _joined(held, block)
            times = np.concatenate([held_times, times])
            order = np.argsort(times, kind="stable")
            if len(order) > MOST_ROWS_LATE:
                yield _chosen(joined, order[:-MOST_ROWS_LATE]), where
            held, held_times = _chosen(joined, order[-MOST_ROWS_LATE:]), times[order[-MOST_ROWS_LATE:]]
        if held is not None:
            yield held, where

    def _count(self, times: Times) -> None:
        """Count the rows that come after a later one."""
        if not len(times):
            return
        latest = np.maximum.accumulate(times if self._latest is None else np.concatenate([[self._latest], times]))
        self.late += int(np.count_nonzero(times < latest[-len(times) :]))
        self._latest = int(latest[-1])


def _joined(first: CellBlock, second: CellBlock) -> CellBlock:
    columns: list[Sequence[str] | npt.NDArray[np.number]] = []
    for a, b in zip(first.columns, second.columns, strict=True):
        columns.append(np.concatenate([a, b]) if isinstance(a, np.ndarray) else [*a, *b])
    return CellBlock(first.source, [*first.lines, *second.lines], columns)


def _chosen(block: CellBlock, rows: npt.NDArray[np.intp]) -> CellBlock:
    """Return the rows of a block in an order."""
    columns: list[Sequence[str] | npt.NDArray[np.number]] = []
    places = rows.tolist()
    for column in block.columns:
        columns.append(column[rows] if isinstance(column, np.ndarray) else [column[row] for row in places])
    return CellBlock(block.source, [block.lines[row] for row in places], columns)
