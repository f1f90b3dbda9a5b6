"""Allan variances at octaves for a fixed price: four starts in an averaging time, one running sum, three axes at once.

As `imuarray.characterise.allan_stream`, which also says how sure its values are; here nothing but the values is wanted,
thousands of times, and a curve's identification of noise types would cost more than short series themselves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_DISTANCES = (1, 2, 4)
"""At rows themselves; every coarser running sum, of half as many values, is looked at at the last distance alone."""


class Haar(NamedTuple):
    """Allan variances (o, k) of k columns at averaging factors 1, 2, 4, ...; `terms` (o,) squares were averaged, nan
    where none was.
    """

    variance: Floats
    terms: npt.NDArray[np.int64]


class HaarTally:
    """Adds up squared second differences of the running sums of `columns` series, at the first `octaves` octaves."""

    def __init__(self, octaves: int, columns: int = 3) -> None:
        self._levels = [_Level(columns) for _ in range(max(1, octaves - 2))]
        self._squares = np.zeros((octaves, columns))
        self._terms = np.zeros(octaves, np.int64)
        self._total = np.zeros((columns, 1))
        self._feed(np.zeros((columns, 1)))

    def update(self, values: Floats) -> None:
        """The next values (k, n), best about an origin near them."""
        phase = np.cumsum(values, axis=1)
        phase += self._total
        self._total = phase[:, -1:].copy()
        self._feed(phase)

    def result(self) -> Haar:
        """The variances of all values so far."""
        factors = 2.0 ** np.arange(len(self._terms))
        with np.errstate(invalid="ignore"):
            mean = self._squares / self._terms[:, None].astype(np.float64)
        return Haar(np.where(self._terms[:, None] > 0, mean / (2 * factors[:, None] ** 2), np.nan), self._terms.copy())

    def _feed(self, phase: Floats) -> None:
        for number, level in enumerate(self._levels):
            for distance in _DISTANCES if number == 0 else _DISTANCES[-1:]:
                self._add(number + distance.bit_length() - 1, level.second_differences(phase, distance))
            phase = level.coarser(phase)
            if phase.shape[1] == 0:
                return

    def _add(self, octave: int, differences: Floats) -> None:
        if octave < len(self._terms):
            self._squares[octave] += np.einsum("kn,kn->k", differences, differences)
            self._terms[octave] += differences.shape[1]


class _Level:
    """A running sum at one stride: what its second differences reach back to, and where its next even value is."""

    def __init__(self, columns: int) -> None:
        self._kept = {distance: np.zeros((columns, 0)) for distance in _DISTANCES}
        self._odd = 0

    def second_differences(self, phase: Floats, distance: int) -> Floats:
        """(k, m) those that end in `phase` (k, n)."""
        line = np.concatenate([self._kept[distance], phase], axis=1)
        self._kept[distance] = line[:, max(line.shape[1] - 2 * distance, 0) :].copy()
        if line.shape[1] <= 2 * distance:
            return line[:, :0]
        first: Floats = line[:, distance:] - line[:, :-distance]
        return np.asarray(first[:, distance:] - first[:, :-distance])

    def coarser(self, phase: Floats) -> Floats:
        """Every second value, over all blocks."""
        taken = phase[:, self._odd :: 2]
        self._odd = (self._odd + phase.shape[1]) % 2
        return taken
