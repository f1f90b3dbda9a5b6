"""Rows of a table in the order of their reading times, block by block.

A logger with several threads, or a transport that repeats packets, writes rows out of order. A row that is up to
`MOST_ROWS_LATE` rows late is sorted; `imuarray.importers.cells.TimeColumn` refuses a row that is later.

The reading times of rows that arrived in bursts are reconstructed: a chip samples at a steady rate, independent of its
host. Rows are assumed to be read evenly between the mean arrival times of long stretches, so that the chip's oscillator
may drift against the host's clock (`imuarray.log.row_timing`). The delay of each row is kept as a column, so the
arrival times are not lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Times
from imuarray.importers.cells import Blocks, CellBlock
from imuarray.log import LogWriter
from imuarray.log.format import ARRIVAL
from imuarray.log.journal import Columns
from imuarray.log.row_timing import EvenRows, even_rows, row_timing


def count_out(log: LogWriter, sensor: str) -> list[str]:
    """Replace the arrival times of a sensor's rows by their reading times and store the delays. Returns remarks."""
    timing = row_timing(log[sensor])
    if timing.rows < 3:
        return [f"{sensor}: too few rows to reconstruct reading times; arrival times are kept"]
    even_times = even_rows(log[sensor])
    log.revise(sensor, ARRIVAL, _EvenTimes(even_times).delay_s)
    log.revise(sensor, "time", _EvenTimes(even_times).time)
    delays = np.asarray(log[sensor].compensated(ARRIVAL))
    doubt = "" if timing.kind == "bursts" else ", although the rows do not arrive in bursts"
    return [
        f"{sensor}: reading times reconstructed at {even_times.rows_per_s:.5g} rows a second{doubt}; rows arrived up to"
        f" {1e3 * float(np.ptp(delays)):.3g} ms apart from them (rms {1e3 * float(delays.std()):.3g} ms), as"
        f" {ARRIVAL} says"
    ]


class _EvenTimes:
    """Reading times and delays of consecutive blocks of rows."""

    def __init__(self, even: EvenRows) -> None:
        self._even = even
        self._row = 0

    def time(self, columns: Columns) -> Times:
        """Return the reading times (n,) ns of the next rows."""
        start, self._row = self._row, self._row + len(columns["time"])
        return self._even.stamps(start, self._row)

    def delay_s(self, columns: Columns) -> npt.NDArray[np.float64]:
        """Return the delays (n,) s from reading to arrival."""
        arrived: Times = np.asarray(columns["time"], np.int64)
        return np.asarray((arrived - self.time(columns)) * 1e-9)


MOST_ROWS_LATE = 4096
"""Number of rows that are buffered, which limits the memory."""


class RowOrder:
    """Sorts rows by their times; `late` is the number of rows after a row with a later time. Rows that a file contains
    twice, for example because two overlapping files were joined, are kept once; `repeated` is the number of removed
    copies.
    """

    def __init__(self, times: Callable[[CellBlock, Sequence[int]], Times]) -> None:
        """`times` returns the times (n,) of the rows of the next block, whatever their order."""
        self._times = times
        self._latest: int | None = None
        self.late = self.repeated = 0

    def in_order(self, blocks: Blocks) -> Blocks:
        """Yield the rows of the blocks, sorted by time; rows of equal time keep their order."""
        pending: CellBlock | None = None
        held_times = np.zeros(0, np.int64)
        places: list[int] = []
        for block, places in blocks:
            times = self._times(block, places)
            self._count(times)
            rows = block if pending is None else _join(pending, block)
            times = np.concatenate([held_times, times])
            order = self._once(rows, times, np.argsort(times, kind="stable"))
            if len(order) > MOST_ROWS_LATE:
                yield select_rows(rows, order[:-MOST_ROWS_LATE]), places
            pending, held_times = select_rows(rows, order[-MOST_ROWS_LATE:]), times[order[-MOST_ROWS_LATE:]]
        if pending is not None:
            yield pending, places

    def _once(self, block: CellBlock, times: Times, order: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Return the order (n,) without rows that are equal to the one before, in time and in all cells, unless they
        were on the next line: a coarse clock and padding also give equal consecutive rows.
        """
        is_first = np.ones(len(order), bool)
        for place in (np.flatnonzero(np.diff(times[order]) == 0) + 1).tolist():
            row, previous = order[place], order[place - 1]
            is_next = block.lines[row] == block.lines[previous] + 1
            is_first[place] = is_next or any(column[row] != column[previous] for column in block.columns)
        self.repeated += int(np.count_nonzero(~is_first))
        return order[is_first]

    def _count(self, times: Times) -> None:
        """Count the rows that follow a row with a later time."""
        if not len(times):
            return
        latest = np.maximum.accumulate(times if self._latest is None else np.concatenate([[self._latest], times]))
        self.late += int(np.count_nonzero(times < latest[-len(times) :]))
        self._latest = int(latest[-1])


def _join(first: CellBlock, second: CellBlock) -> CellBlock:
    columns: list[Sequence[str] | npt.NDArray[np.number]] = []
    for a, b in zip(first.columns, second.columns, strict=True):
        columns.append(np.concatenate([a, b]) if isinstance(a, np.ndarray) else [*a, *b])
    return CellBlock(first.source, [*first.lines, *second.lines], columns)


def select_rows(block: CellBlock, rows: npt.NDArray[np.intp]) -> CellBlock:
    """Return the `rows` of a block, in this order."""
    columns: list[Sequence[str] | npt.NDArray[np.number]] = []
    places = rows.tolist()
    for column in block.columns:
        columns.append(column[rows] if isinstance(column, np.ndarray) else [column[row] for row in places])
    return CellBlock(block.source, [block.lines[row] for row in places], columns)
