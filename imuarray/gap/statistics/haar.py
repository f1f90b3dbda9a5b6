"""Allan variances at octaves, and how long the tails of differences of means are, for a fixed price: four starts in an
averaging time, one running sum, three axes at once.

As `imuarray.characterise.allan_stream`, which also says how sure its values are; here nothing but the values is wanted,
thousands of times, and a curve's identification of noise types would cost more than short series themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_DISTANCES = (1, 2, 4)
"""At rows themselves; every coarser running sum, of half as many values, is looked at at the last distance alone."""


class Haar(NamedTuple):
    """Allan variances (o, k) of k columns at averaging factors 1, 2, 4, ...; `terms` (o,) squares were averaged, nan
    where none was. `kurtosis` (o, k) of the differences of neighbouring means about 0, nan at the first octaves
    (`FINEST`), too.
    """

    variance: Floats
    terms: npt.NDArray[np.int64]
    kurtosis: Floats


FINEST = 3
"""Fourth powers are added up from that octave on; those of more differences would cost as much as all else."""


class HaarTally:
    """Adds up squared second differences of the running sums of `columns` series, at the first `octaves` octaves."""

    def __init__(self, octaves: int, columns: int = 3) -> None:
        self._levels = [_Level(columns, _DISTANCES)]
        self._levels += [_Level(columns, _DISTANCES[-1:]) for _ in range(octaves - 3)]
        self._squares, self._fourths, self._terms = *np.zeros((2, octaves, columns)), [0] * octaves
        self._total = np.zeros((columns, 1))
        self._is_begun = False

    def update(self, values: Floats) -> None:
        """The next values (k, n), best about an origin near them."""
        phase = np.concatenate([self._total, values], axis=1)
        np.cumsum(phase, axis=1, out=phase)
        self._total = phase[:, -1:].copy()
        self._feed(phase[:, 1:] if self._is_begun else phase)
        self._is_begun = True

    def result(self) -> Haar:
        """The variances of all values so far."""
        terms = np.array(self._terms, np.int64)
        factors = 2.0 ** np.arange(len(terms))
        scale = np.where(terms > 0, 2 * factors * factors * terms, np.nan)
        kurtosis = np.full_like(self._squares, np.nan)
        known = (self._squares > 0) & (np.arange(len(terms)) >= FINEST)[:, None]
        np.divide(self._fourths * np.maximum(terms, 1)[:, None], self._squares**2, out=kurtosis, where=known)
        return Haar(self._squares / scale[:, None], terms, kurtosis)

    def _feed(self, phase: Floats) -> None:
        for number, level in enumerate(self._levels):
            for distance, differences in level.second_differences(phase):
                octave = number + distance.bit_length() - 1
                if octave < len(self._terms):
                    if octave < FINEST:
                        self._squares[octave] += np.einsum("kn,kn->k", differences, differences)
                    else:
                        np.multiply(differences, differences, out=differences)
                        self._squares[octave] += differences.sum(axis=1)
                        self._fourths[octave] += np.einsum("kn,kn->k", differences, differences)
                    self._terms[octave] += differences.shape[1]
            phase = level.coarser(phase)
            if phase.shape[1] == 0:
                return


class _Level:
    """A running sum at one stride: what its second differences reach back to, and where its next even value is."""

    def __init__(self, columns: int, distances: tuple[int, ...]) -> None:
        self._distances, self._odd = distances, 0
        self._kept: Floats = np.zeros((columns, 0))

    def second_differences(self, phase: Floats) -> Iterator[tuple[int, Floats]]:
        """Of each distance (k, m) those that end in `phase` (k, n)."""
        known, reach = self._kept.shape[1], 2 * self._distances[-1]
        line = np.concatenate([self._kept, phase], axis=1) if known else phase
        self._kept = line[:, -reach:].copy()
        for distance in self._distances:
            reached = line[:, max(known - 2 * distance, 0) :]
            if reached.shape[1] > 2 * distance:
                first = reached[:, distance:] - reached[:, :-distance]
                yield distance, first[:, distance:] - first[:, :-distance]

    def coarser(self, phase: Floats) -> Floats:
        """Every second value, over all blocks."""
        taken = phase[:, self._odd :: 2]
        self._odd = (self._odd + phase.shape[1]) % 2
        return taken
