"""Allan variances at octaves, and the kurtosis of differences of means, at a fixed cost per row.

Windows begin at every quarter of the averaging time, and all axes are computed at once. Sums over two, four, ... rows
are sums of pairs of the previous sums, so whole numbers stay exact.

`imuarray.characterise.allan` also computes confidence limits. Here only the values are needed, thousands of
times, and for short series its identification of noise types would take longer than the variances.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers

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
            for distance, differences in level.differences(line):
                self._add(number + distance.bit_length() - 1, differences)
            sums = level.coarser(line)
        for number, differences in self._fours.differences(sums):
            self._add(_FINE + number, differences)

    def result(self) -> Haar:
        """Return the variances of all values added so far."""
        terms = np.array(self._terms, np.int64)
        factors = 2.0 ** np.arange(len(terms))
        scale = np.where(terms > 0, 2 * factors * factors * terms, np.nan)
        kurtosis = np.full_like(self._squares, np.nan)
        known = (self._squares > 0) & (np.arange(len(terms)) >= FINEST)[:, None]
        np.divide(self._fourths * np.maximum(terms, 1)[:, None], self._squares**2, out=kurtosis, where=known)
        return Haar(self._squares / scale[:, None], terms, kurtosis)

    def _add(self, octave: int, differences: Floats) -> None:
        self._terms[octave] += differences.shape[1]
        if octave < FINEST:
            self._squares[octave] += np.einsum("kn,kn->k", differences, differences)
            return
        np.multiply(differences, differences, out=differences)
        self._squares[octave] += np.add.reduce(differences, axis=1)
        self._fourths[octave] += np.einsum("kn,kn->k", differences, differences)


class _Level:
    """Sums over a number of rows: keeps the last sums, which the next differences need, and the begin of the next
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

    def differences(self, line: Floats) -> Iterator[tuple[int, Floats]]:
        """Yield each distance with the differences (k, m) of neighbouring sums that end in the new part of a line."""
        window, length = line, 1
        for distance in (1, 2, 4):
            if distance > length:
                window, length = window[:, length:] + window[:, :-length], distance
            if distance in self._distances:
                first = max(self._new - 2 * distance + 1, 0)
                if window.shape[1] - first > distance:
                    yield distance, window[:, first + distance :] - window[:, first:-distance]

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

    def differences(self, sums: Floats) -> Iterator[tuple[int, Floats]]:
        """Yield the octaves with the differences (k, m) of windows that end in the next sums (k, n); windows begin at
        every quarter of their length.
        """
        cumulative = np.cumsum(sums, axis=1)
        cumulative += self._running[:, -1:]
        line = np.concatenate([self._running, cumulative], axis=1)
        for octave, first in enumerate(self._next):
            stride = 1 << octave
            count = (line.shape[1] - 1 - first) // stride - 7
            if count > 0:
                self._next[octave] = first + count * stride
                end = self._next[octave] - stride + 1
                middle = line[:, first + 4 * stride : end + 4 * stride : stride]
                second = line[:, first + 8 * stride : end + 8 * stride : stride] - middle
                yield octave, second - (middle - line[:, first:end:stride])
        consumed = min(self._next, default=line.shape[1] - 1)
        self._next = [first - consumed for first in self._next]
        self._running = line[:, consumed:].copy()
