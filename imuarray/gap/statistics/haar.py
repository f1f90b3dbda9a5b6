"""Allan variances at octaves, and the kurtosis of differences of means, at a fixed cost per row.

Windows begin at every quarter of the averaging time, and all axes are computed at once. Sums over two, four, ... rows
are sums of pairs of the previous sums, so whole numbers stay exact.

`imuarray.characterise.allan` also computes confidence limits. Here only the values are needed, thousands of
times, and for short series its identification of noise types would take longer than the variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.series import change_powers

_FINE = 4
"""Number of octaves that are computed from sums of 1 and 2 rows, block by block; the others use sums of 4 rows."""


class Haar(NamedTuple):
    """Allan variances (o, k) of k columns at averaging factors 1, 2, 4, ...

    `terms` (o,): the number of squares that were averaged (the variance is nan if it is 0). `kurtosis` (o, k): that of
    the differences of neighbouring means about 0, nan also at the octaves before `FINEST`.
    """

    variance: Floats
    terms: Integers
    kurtosis: Floats


FINEST = 3
"""First octave at which fourth powers are summed: at finer octaves, which have more differences, they would take as
long as everything else together.
"""


class HaarTally:
    """Accumulates squared differences of neighbouring means of `columns` series, at the first `octaves` octaves (4 or
    more).
    """

    def __init__(self, octaves: int, columns: int = 3) -> None:
        self._rows, self._twos = _Level(columns, (1, 2, 4)), _Level(columns, (4,))
        self._fours = _Coarse(columns, octaves - _FINE)
        self._squares, self._fourths, self._terms = *np.zeros((2, octaves, columns)), [0] * octaves

    def update(self, values: Floats) -> None:
        """Add values (k, n); subtract an origin near their mean first to reduce rounding errors."""
        sums = values
        for number, level in enumerate((self._rows, self._twos)):
            line = level.line(sums)
            self._add(number, _cumulative(line), level.differences(line.shape[1]))
            sums = level.coarser(line)
        line, differences = self._fours.differences(sums)
        self._add(0, line, differences)

    def result(self) -> Haar:
        """Return the variances of all values added so far."""
        terms = np.array(self._terms, np.int64)
        factors = 2.0 ** np.arange(len(terms))
        scale = np.where(terms > 0, 2 * factors * factors * terms, np.nan)
        kurtosis = np.full_like(self._squares, np.nan)
        known = (self._squares > 0) & (np.arange(len(terms)) >= FINEST)[:, None]
        np.divide(self._fourths * np.maximum(terms, 1)[:, None], self._squares**2, out=kurtosis, where=known)
        return Haar(self._squares / scale[:, None], terms, kurtosis)

    def _add(self, octave: int, cumulative: Floats, differences: Sequence[_Difference]) -> None:
        """Add differences of neighbouring windows of cumulative sums (k, n); octaves are counted from `octave` on."""
        known = [each for each in differences if each.number > 0]
        changes = [(each.first, each.number, each.length, each.step) for each in known]
        sums = change_powers(cumulative, changes)
        squares, fourths = _change_powers(cumulative, changes) if sums is None else sums
        for each, square, fourth in zip(known, squares, fourths, strict=True):
            at = octave + each.octave
            self._terms[at] += each.number
            self._squares[at] += square
            if at >= FINEST:
                self._fourths[at] += fourth


class _Difference(NamedTuple):
    """The differences of neighbouring windows of `length` sums at an octave: the first window, their number, and the
    step from one window to the next.
    """

    octave: int
    first: int
    number: int
    length: int
    step: int


def _cumulative(line: Floats) -> Floats:
    """Return the cumulative sums (k, n + 1) of a line (k, n), from 0 on."""
    sums = np.zeros((len(line), line.shape[1] + 1))
    np.cumsum(line, axis=1, out=sums[:, 1:])
    return sums


def _change_powers(lines: Floats, changes: Sequence[tuple[int, int, int, int]]) -> Floats:
    """Return what `imuarray.series.change_powers` returns, without compiled code."""
    powers = np.zeros((2, len(changes), len(lines)))
    for at, (first, count, length, step) in enumerate(changes):
        end = first + (count - 1) * step + 1
        begin, middle, last = (lines[:, first + shift : end + shift : step] for shift in (0, length, 2 * length))
        squares = ((last - middle) - (middle - begin)) ** 2
        powers[:, at] = np.add.reduce(squares, axis=1), np.einsum("kn,kn->k", squares, squares)
    return powers


class _Level:
    """Sums over a number of rows: keeps the last sums, which the next differences need, and the start of the next
    pair.
    """

    def __init__(self, columns: int, distances: tuple[int, ...]) -> None:
        self._distances, self._new, self._paired = distances, 0, 0
        self._kept: Floats = np.zeros((columns, 0))

    def line(self, sums: Floats) -> Floats:
        """Return the kept sums followed by the next sums (k, n)."""
        self._new, reach = self._kept.shape[1], 2 * self._distances[-1] - 1
        line = np.concatenate([self._kept, sums], axis=1) if self._new else sums
        self._kept = line[:, -reach:].copy()
        return line

    def differences(self, count: int) -> list[_Difference]:
        """Return the differences of neighbouring sums that end in the new part of a line of `count` sums."""
        firsts = {distance: max(self._new - 2 * distance + 1, 0) for distance in self._distances}
        return [
            _Difference(distance.bit_length() - 1, first, count - 2 * distance + 1 - first, distance, 1)
            for distance, first in firsts.items()
        ]

    def coarser(self, line: Floats) -> Floats:
        """Return the sums of pairs; pairs continue across blocks."""
        begin = self._new - self._paired
        pairs = (line.shape[1] - begin) // 2
        self._paired = line.shape[1] - begin - 2 * pairs
        stop = begin + 2 * pairs
        return np.asarray(line[:, begin:stop:2] + line[:, begin + 1 : stop : 2])


class _Coarse:
    """Octaves with windows of 4, 8, 16, ... sums over 4 rows, computed from a running sum, which needs fewer calls than
    sums of pairs.
    """

    def __init__(self, columns: int, octaves: int) -> None:
        self._running: Floats = np.zeros((columns, 1))
        self._next = [0] * octaves

    def differences(self, sums: Floats) -> tuple[Floats, list[_Difference]]:
        """Return the running sum with that of the next sums (k, n), and the differences of windows that end in the new
        part; windows begin at every quarter of their length.
        """
        cumulative = np.cumsum(sums, axis=1)
        cumulative += self._running[:, -1:]
        line = np.concatenate([self._running, cumulative], axis=1)
        differences = []
        for octave, first in enumerate(self._next):
            step = 1 << octave
            count = max((line.shape[1] - 1 - first) // step - 7, 0)
            self._next[octave] = first + count * step
            differences.append(_Difference(_FINE + octave, first, count, 4 * step, step))
        consumed = min(self._next, default=line.shape[1] - 1)
        self._next = [first - consumed for first in self._next]
        self._running = line[:, consumed:].copy()
        return line, differences
