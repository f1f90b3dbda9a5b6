"""Columns of a log as smooth functions of time, read a block at a time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Integers, Reals
from imuarray.errors import LogError
from imuarray.log.columns import NamedColumn

BLOCK = 16384
"""Rows per block; a whole number of the log's chunks."""

_KEPT = 4
"""Minimum number of blocks kept in memory."""

_MANY = 256
"""Fewer times are found by a search."""

_GAP = 8.0
"""An interval longer than so many of the shorter one beside it is a gap: the slopes at its ends say nothing of what
lies between, and a cubic piece by them would swing far beyond both rows.
"""

_KEPT_BYTES = 1 << 24
"""More blocks are kept up to so many bytes: replicates of a log read it again and again. Two hours of a temperature at
28 Hz take 6 MB, and as much again for a box that lies still.
"""


class _CubicPieces(NamedTuple):
    """Rows at times (k,) ns, the last row the first of the next block, and the k - 1 cubic pieces between them, p0 + x
    (p1 + x (p2 + x p3)) for a column where 0 <= x <= 1: p0 of all is `start` (c, k - 1). `moves` (k,): how many of the
    pieces before a row are not constant; of these m pieces alone the lengths `length_s` (m,) and `curve` (3, c, m), p1,
    p2, p3, are kept. A lone row has one piece, constant.
    """

    time_ns: Integers
    start: Reals
    moves: Integers
    length_s: Reals
    curve: Reals

    @property
    def bytes(self) -> int:
        """The size in memory; a broadcast row takes none."""
        arrays = (self.time_ns, self.moves, self.length_s, self.curve)
        return sum(array.nbytes for array in arrays) + (self.start.nbytes if self.start.strides[1] else 0)

    def row_before(self, time_ns: Integers) -> npt.NDArray[np.intp]:
        """Return the number of the piece in which a time within the block lies."""
        rows = self._evenly(time_ns)
        if rows is None:
            rows = np.searchsorted(self.time_ns, time_ns, side="right") - 1
        return np.clip(rows, 0, self.start.shape[1] - 1)

    def _evenly(self, time_ns: Integers) -> npt.NDArray[np.intp] | None:
        """Return the same, if the rows are so even that dividing finds it: five times as fast as a search."""
        last = len(self.time_ns) - 1
        if last < 1 or len(time_ns) < _MANY:
            return None
        step_ns = (self.time_ns[-1] - self.time_ns[0]) / last
        rows = ((time_ns - self.time_ns[0]) / step_ns).astype(np.intp)
        if rows.min() < 0 or rows.max() >= last:
            np.clip(rows, 0, last - 1, out=rows)
        rows += time_ns >= self.time_ns.take(rows + 1)
        if rows.max() >= last:
            return None
        is_right = (self.time_ns.take(rows) <= time_ns) & (time_ns < self.time_ns.take(rows + 1))
        return rows if is_right.all() else None


@dataclass(frozen=True, eq=False)
class SplineColumns:
    """`columns` (n,) or (n, 3) at `time` (n,) ns, joined by cubic pieces whose slope at a row comes from the rows
    before and after it (three-point formula; from one at the ends): values and slopes without jumps. Across a gap the
    pieces are monotonic.

    Only a few blocks of rows are in memory at any time, up to `_KEPT_BYTES`. `where` stands in the LogError for rows
    that aren't finite or whose times don't increase.
    """

    time: NamedColumn | Integers
    columns: tuple[NamedColumn | npt.NDArray[np.float64], ...]
    where: str

    def at(self, time_ns: Integers) -> tuple[Reals, Reals]:
        """Return (n, c) values, all columns side by side, and (n, c) their derivatives per s, in any order of times.

        Before the first row that row, after the last the last, both with derivative 0. Where nothing changes between
        the first and the last of the times, one row stands for all (read-only).
        """
        within = np.clip(time_ns, self.first_ns, self.last_ns)
        constant = self._constant(within)
        if constant is not None:
            return constant, np.broadcast_to(np.zeros(constant.shape[1]), constant.shape)
        values, slopes = np.split(self._joined(within, _values_and_slopes, 2), 2)
        return np.ascontiguousarray(values.T), np.ascontiguousarray(np.where(time_ns == within, slopes, 0.0).T)

    def values_at(self, time_ns: Integers) -> Reals:
        """Return (n, c) the values alone."""
        within = np.clip(time_ns, self.first_ns, self.last_ns)
        constant = self._constant(within)
        return np.ascontiguousarray(self._joined(within, _values, 1).T) if constant is None else constant

    def _constant(self, within: Integers) -> Reals | None:
        """Return (n, c) one row, broadcast, if it stands for all between the first and the last of the times."""
        if len(within) == 0:
            return None
        ends = np.array([within.min(), within.max()])
        first, last = self._numbers(ends).tolist()
        if last - first >= _KEPT:  # these would be read twice
            return None
        for number in range(first, last + 1):
            block = self._block(number)
            begin, end = block.row_before(ends).tolist()
            if block.moves[end + 1] > block.moves[begin]:
                return None
        value = block.start[:, end] + 0.0
        return np.broadcast_to(value, (len(within), len(value)))

    def _joined(self, within: Integers, worked_out: Callable[[_CubicPieces, Integers], Reals], of_each: int) -> Reals:
        """Return (c * of_each, n) what each block makes of the times in it."""
        if (within[1:] >= within[:-1]).all():
            return self._in_order(within, worked_out, of_each)
        order = np.argsort(within, kind="stable")
        result = np.empty((of_each * sum(self._widths), len(within)))
        result[:, order] = self._in_order(within[order], worked_out, of_each)
        return result

    def _in_order(self, within: Integers, worked_out: Callable[[_CubicPieces, Integers], Reals], of_each: int) -> Reals:
        """Return the same of times that ascend."""
        first, last = self._numbers(within[[0, -1]]).tolist() if len(within) else (0, 0)
        if first == last:
            return worked_out(self._block(first), within)
        edges = [0, *np.searchsorted(within, self._starts_ns[first + 1 : last + 1]).tolist(), len(within)]
        result = np.empty((of_each * sum(self._widths), len(within)))
        for number, (begin, end) in enumerate(pairwise(edges), start=first):
            if end > begin:
                result[:, begin:end] = worked_out(self._block(number), within[begin:end])
        return result

    def _numbers(self, within: Integers) -> npt.NDArray[np.intp]:
        """Return (n,) the block of each time."""
        return np.searchsorted(self._starts_ns, within, side="right") - 1

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
    def _blocks(self) -> dict[int, _CubicPieces]:
        """The blocks in memory, the most recently used last."""
        return {}

    def _block(self, number: int) -> _CubicPieces:
        blocks = self._blocks
        block = blocks.pop(number, None)
        if block is not None:
            blocks[number] = block
            return block
        blocks[number] = block = self._read(number)
        while len(blocks) > _KEPT and sum(block.bytes for block in blocks.values()) > _KEPT_BYTES:
            del blocks[next(iter(blocks))]
        return block

    def _read(self, number: int) -> _CubicPieces:
        """One block, with a row more on either side while slopes are taken."""
        start = number * BLOCK
        before = min(start, 1)
        rows = slice(start - before, start + BLOCK + 2)
        time_ns, values = self._rows(rows)
        if not np.isfinite(values).all() or (np.diff(time_ns) <= 0).any():
            raise LogError(
                f"{self.where}: rows {start} to {start + len(time_ns)}: finite numbers are required, in order"
            )
        own = slice(before, before + BLOCK + 1)
        slopes = _slopes(time_ns, values)
        pieces = slice(before, before + len(time_ns[own]) - 1)
        return _between(time_ns[own], values[own], slopes[own], _gaps(time_ns)[pieces])

    def _rows(self, rows: slice) -> tuple[Integers, Reals]:
        try:
            columns = [np.asarray(column[rows], float) for column in self.columns]
            return np.asarray(self.time[rows], np.int64), np.concatenate(
                [column.reshape(len(column), -1) for column in columns], axis=1
            )
        except (OSError, TypeError, ValueError) as error:
            raise LogError(f"{self.where}: {' '.join(str(error).split())}") from None


def _slopes(time_ns: Integers, rows: Reals) -> Reals:
    """Return (k, c) per s by the three-point formula; exactly 0 between rows that are equal, which it rounds to
    nearly 0.
    """
    if len(rows) == 1:
        return np.zeros_like(rows)
    still = np.pad(np.diff(rows, axis=0) == 0, ((1, 1), (0, 0)), constant_values=True)
    if still.all():
        return np.zeros_like(rows)
    slopes = np.gradient(rows, (time_ns - time_ns[0]) * 1e-9, axis=0)
    return np.where(still[:-1] & still[1:], 0.0, slopes)


def _gaps(time_ns: Integers) -> Booleans:
    """Return a mask (k - 1,) of the intervals that are gaps."""
    lengths = np.diff(time_ns)
    if len(lengths) < 2:
        return np.zeros(len(lengths), bool)
    neighbours = np.pad(lengths.astype(float), 1, constant_values=math.inf)
    return np.asarray(lengths > _GAP * np.minimum(neighbours[:-2], neighbours[2:]))


def _between(time_ns: Integers, rows: Reals, slopes: Reals, is_gap: Booleans) -> _CubicPieces:
    """Return the cubic pieces (Hermite) between rows (k, c) with these slopes per s.

    In gaps (k - 1,) they are monotonic: no slope exceeds three times the mean one, or has another sign (Fritsch and
    Carlson, SIAM J. Numer. Anal. 17, 1980).
    """
    if len(rows) == 1:
        return _CubicPieces(time_ns, rows.T.copy(), np.zeros(2, np.int64), np.zeros(0), np.zeros((3, rows.shape[1], 0)))
    length_s = np.diff(time_ns) * 1e-9
    start, rise = rows[:-1].T, rows[1:].T - rows[:-1].T
    begin, end = slopes[:-1].T * length_s, slopes[1:].T * length_s
    if is_gap.any():
        low, high = np.minimum(0.0, 3 * rise[:, is_gap]), np.maximum(0.0, 3 * rise[:, is_gap])
        begin[:, is_gap], end[:, is_gap] = (np.clip(slope[:, is_gap], low, high) for slope in (begin, end))
    moving = ((rise != 0) | (begin != 0) | (end != 0)).any(axis=0)
    moves = np.concatenate([[0], np.cumsum(moving)])
    if not moving.any():
        still = np.broadcast_to(start[:, :1].copy(), start.shape)
        return _CubicPieces(time_ns, still, moves, np.zeros(0), np.zeros((3, len(start), 0)))
    rise, begin, end = rise[:, moving], begin[:, moving], end[:, moving]
    curve = np.stack([begin, 3 * rise - 2 * begin - end, begin + end - 2 * rise])
    return _CubicPieces(time_ns, np.ascontiguousarray(start), moves, length_s[moving], curve)


def _values(block: _CubicPieces, time_ns: Integers) -> Reals:
    """Return (c, n) at times within the block."""
    row = block.row_before(time_ns)
    start: Reals = block.start.take(row, axis=1)
    moving = _moving(block, row)
    if len(moving) == len(row) and len(row):
        x, _, (begin, square, cube) = _pieces(block, time_ns, row)
        start += x * (begin + x * (square + x * cube))
    elif len(moving):
        x, _, (begin, square, cube) = _pieces(block, time_ns[moving], row[moving])
        start[:, moving] += x * (begin + x * (square + x * cube))
    return start


def _values_and_slopes(block: _CubicPieces, time_ns: Integers) -> Reals:
    """Return (2 c, n) values, and their derivatives per s below."""
    row = block.row_before(time_ns)
    moving = _moving(block, row)
    columns = len(block.start)
    result = np.zeros((2 * columns, len(row)))
    block.start.take(row, axis=1, out=result[:columns], mode="clip")
    if len(moving):
        x, length_s, (begin, square, cube) = _pieces(block, time_ns[moving], row[moving])
        result[:columns, moving] += x * (begin + x * (square + x * cube))
        result[columns:, moving] = (begin + x * (2 * square + x * (3 * cube))) / length_s
    return result


def _moving(block: _CubicPieces, row: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Return which of these pieces are not constant."""
    return np.flatnonzero(block.moves.take(row + 1) > block.moves.take(row))


def _pieces(block: _CubicPieces, time_ns: Integers, row: npt.NDArray[np.intp]) -> tuple[Reals, Reals, Reals]:
    """Return (n,) where in their pieces, none of which is constant, the times lie, 0 to 1; (n,) the lengths of these in
    s; (3, c, n) p1, p2, p3.
    """
    piece = block.moves.take(row)
    length_s = block.length_s.take(piece)
    return ((time_ns - block.time_ns.take(row)) * 1e-9) / length_s, length_s, block.curve.take(piece, axis=2)
