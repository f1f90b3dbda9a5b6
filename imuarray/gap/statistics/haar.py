"""Allan variances at octaves, and how long the tails of differences of means are, for a fixed price: four starts in an
averaging time, three axes at once. Sums over two, four, ... rows are sums of pairs of those before: whole numbers stay
exact.

As `imuarray.characterise.allan_stream`, which also says how sure its values are; here nothing but the values is wanted,
thousands of times, and a curve's identification of noise types would cost more than short series themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers

_FINE = 4
"""At so many octaves sums of 1 and 2 rows are looked at, block by block; at the others sums of 4."""


class Haar(NamedTuple):
    """Allan variances (o, k) of k columns at averaging factors 1, 2, 4, ...; `terms` (o,) squares were averaged, nan
    where none was. `kurtosis` (o, k) of the differences of neighbouring means about 0, nan at the first octaves
    (`FINEST`), too.
    """

    variance: Floats
    terms: Integers
    kurtosis: Floats


FINEST = 3
"""Fourth powers are added up from that octave on; those of more differences would cost as much as all else."""


class HaarTally:
    """Adds up squared differences of neighbouring means of `columns` series, at the first `octaves` octaves (4 or
    more).
    """

    def __init__(self, octaves: int, columns: int = 3) -> None:
        self._rows, self._twos = _Level(columns, (1, 2, 4)), _Level(columns, (4,))
        self._fours = _Coarse(columns, octaves - _FINE)
        self._squares, self._fourths, self._terms = *np.zeros((2, octaves, columns)), [0] * octaves

    def update(self, values: Floats) -> None:
        """The next values (k, n), best about an origin near them."""
        sums = values
        for number, level in enumerate((self._rows, self._twos)):
            line = level.line(sums)
            for distance, differences in level.differences(line):
                self._add(number + distance.bit_length() - 1, differences)
            sums = level.coarser(line)
        for number, differences in self._fours.differences(sums):
            self._add(_FINE + number, differences)

    def result(self) -> Haar:
        """The variances of all values so far."""
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
    """Sums over so many rows, one after the other: those before that differences reach back to, and where the next pair
    of them begins.
    """

    def __init__(self, columns: int, distances: tuple[int, ...]) -> None:
        self._distances, self._new, self._paired = distances, 0, 0
        self._kept: Floats = np.zeros((columns, 0))

    def line(self, sums: Floats) -> Floats:
        """What is kept, and the next sums (k, n)."""
        self._new, reach = self._kept.shape[1], 2 * self._distances[-1] - 1
        line = np.concatenate([self._kept, sums], axis=1) if self._new else sums
        self._kept = line[:, -reach:].copy()
        return line

    def differences(self, line: Floats) -> Iterator[tuple[int, Floats]]:
        """Of each distance (k, m) those of the sums of as many neighbours that end in what is new of a line."""
        window, length = line, 1
        for distance in (1, 2, 4):
            if distance > length:
                window, length = window[:, length:] + window[:, :-length], distance
            if distance in self._distances:
                first = max(self._new - 2 * distance + 1, 0)
                if window.shape[1] - first > distance:
                    yield distance, window[:, first + distance :] - window[:, first:-distance]

    def coarser(self, line: Floats) -> Floats:
        """The sums of pairs, over all blocks."""
        begin = self._new - self._paired
        pairs = (line.shape[1] - begin) // 2
        self._paired = line.shape[1] - begin - 2 * pairs
        stop = begin + 2 * pairs
        return np.asarray(line[:, begin:stop:2] + line[:, begin + 1 : stop : 2])


class _Coarse:
    """Sums over 4 rows, of which so many octaves have windows of 4, 8, 16, ...: few values, which a running sum of all
    serves with fewer calls than sums of pairs.
    """

    def __init__(self, columns: int, octaves: int) -> None:
        self._running: Floats = np.zeros((columns, 1))
        self._next = [0] * octaves

    def differences(self, sums: Floats) -> Iterator[tuple[int, Floats]]:
        """Of each octave (k, m) those of windows that end in the next sums (k, n); they begin at every quarter."""
        own = np.cumsum(sums, axis=1)
        own += self._running[:, -1:]
        line = np.concatenate([self._running, own], axis=1)
        for octave, first in enumerate(self._next):
            stride = 1 << octave
            count = (line.shape[1] - 1 - first) // stride - 7
            if count > 0:
                self._next[octave] = first + count * stride
                end = self._next[octave] - stride + 1
                middle = line[:, first + 4 * stride : end + 4 * stride : stride]
                second = line[:, first + 8 * stride : end + 8 * stride : stride] - middle
                yield octave, second - (middle - line[:, first:end:stride])
        done = min(self._next, default=line.shape[1] - 1)
        self._next = [first - done for first in self._next]
        self._running = line[:, done:].copy()
