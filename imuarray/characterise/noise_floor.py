"""The noise under the peaks of an averaged spectrum, and how surely it is known.

At each bin the floor is read off its neighbours: the medians of the log density of the bins below and of those above,
leaving out the nearest two on each side, where a line at the bin itself would show, are joined by a straight line over
log frequency. A power law is so met exactly, and a line among the neighbours doesn't lift a median. This, smoothed, is
a trend; what it leaves of curvature (a filter's corner) is found by doing the same with the remainder and is added
(Tukey, "Exploratory Data Analysis", 1977: twicing).

The median of the gamma law that averaged periodograms follow lies below its mean; the floor is corrected for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, fdtrc, fdtri, gammaincinv, gammaln

from imuarray.arrays import Floats, Indices
from imuarray.characterise.spectrum import Spectrum

FIRST_BIN = 24
"""The least number of a line's cycles in a segment: below it the floor can't be distinguished from drift or a corner.
"""

_GUARD = 2
"""Indices on either side that share a line's power: the main lobe of the Hann window is four bins wide."""

_LOWEST = 2
"""Indices 0 and 1 have lost power with the mean of their segment."""

_SIDE = 32
"""Indices on either side that the floor is read off, at most; no more than a sixteenth of all."""

_LEAST = 8
"""Indices on either side, at least: a line takes three or four of them, which must not be half.

So the floor can be read off from bin 12 on, and its remainder, which needs that on both sides, from twice that on."""

_SHARE = 0.4
"""... and no more than this share of the frequency, lest the bend of a filter's corner be lost."""

_SIGNS = ((0, 1.0), (1, 0.293), (2, 0.018))
"""Hann-windowed bins correlate by 4/9 and 1/36 in power, and so their signs about the median: 2 / pi arcsin of that."""

_EXTREMES = (0.16, 0.84)


@dataclass(frozen=True)
class NoiseFloor:
    """Floor of one column at the `bins` (b,) that lines are looked for in: `density` (b,) in squared units per Hz.

    `freedom` (b,) of the floor itself: its relative variance is 2 / freedom. `spectrum_freedom` (b,) of the density
    above it, fewer than `Spectrum.freedom` says if the bins scatter more than that, as of noise that comes and goes.
    """

    bins: Indices
    density: Floats
    freedom: Floats
    spectrum_freedom: Floats

    def level(self, probability: float) -> Floats:
        """Density (b,) that noise exceeds with `probability` in a bin: ratio of two gamma laws, Fisher's F."""
        # Few pairs differ, and each takes long; complex numbers are sorted faster than columns.
        pairs, which = np.unique(self.spectrum_freedom + 1j * self.freedom, return_inverse=True)
        return np.asarray(self.density * fdtri(pairs.real, pairs.imag, 1 - probability)[which.reshape(-1)])

    def exceedance(self, density: Floats, at: Sequence[int]) -> Floats:
        """Probability (p,) that noise exceeds the `density` of a spectrum in the floor's bins number `at` (p,)."""
        places = np.asarray(at, np.intp)
        ratio = density[self.bins[places]] / self.density[places]
        return np.asarray(fdtrc(self.spectrum_freedom[places], self.freedom[places], ratio))


def noise_floor(spectrum: Spectrum, column: int = 0) -> NoiseFloor:
    """The noise floor of one column of a spectrum; no bins in it where the column has no noise or too few bins."""
    power = np.array(spectrum.density[:, column])
    last = len(power) - 1
    if last < 4 * FIRST_BIN or not (power[_LOWEST:] > 0).all():
        return NoiseFloor(np.zeros(0, np.intp), *[np.zeros(0)] * 3)
    power[-1] *= 2  # the bin at half the rate has no twin
    height = np.log(np.concatenate([power, power[-2:0:-1]]))  # ... and the bins above it mirror those below
    wide = np.arange(FIRST_BIN // 2, last + 1)
    trend = _smoothed(_joined_medians(height, wide, last), wide, last)
    rest = np.zeros(len(height))
    rest[wide] = height[wide] - trend
    rest[last + 1 :] = rest[last - 1 : 0 : -1]
    bins = wide[-(last + 1 - FIRST_BIN) :]
    level = trend[-len(bins) :] + _joined_medians(rest, bins, last)
    freedom = spectrum.freedom[bins]
    floor_freedom = 2 / _variance(float(freedom[0]), bins, last)
    freedom = freedom * _thinned(height[bins] - level, float(freedom[0]), float(np.median(floor_freedom)))
    density = np.exp(level) / (chdtri(freedom[0], 0.5) / freedom[0])
    density[-1] /= 2
    return NoiseFloor(bins, density, floor_freedom, freedom)


def _sides(bins: Indices, last: int) -> Indices:
    """Return the number (b,) of bins on either side of each of `bins` (b,) from which the floor is estimated."""
    return np.clip((_SHARE * bins).astype(np.intp), _LEAST, min(_SIDE, max(_LEAST, last // 16)))


def _joined_medians(height: Floats, bins: Indices, last: int) -> Floats:
    """Return at each bin the medians of the bins below and above it, interpolated over log frequency (b,)."""
    joined = np.empty(len(bins))
    for side, which, below, above, share in _neighbourhoods(bins.tobytes(), len(height), last):
        if (side == side[0]).all():  # the windows above some bins are those below others
            medians = _median(height, np.arange(below[0], above[-1] + 1), side[:1])
            low, high = medians[below - below[0]], medians[above - below[0]]
        else:
            low, high = _median(height, below, side), _median(height, above, side)
        joined[which] = low + (high - low) * share
    return joined


class _Neighbourhoods(NamedTuple):
    """For some of the bins: how many neighbours on either side each is read off (w,), which of all bins they are (w,),
    the first neighbour below and above (w,), and how far between their means over log frequency the bin is (w,).
    """

    side: Indices
    which: Indices
    below: Indices
    above: Indices
    share: Floats


@lru_cache(maxsize=16)
def _neighbourhoods(bins: bytes, length: int, last: int) -> list[_Neighbourhoods]:
    """The neighbours of the bins (their bytes): those that are read off fewer than the others together, and the rest,
    of whom none has to be left out of a median.
    """
    places = np.frombuffer(bins, np.intp)
    logs = np.log(np.arange(1, length + 1))  # of every bin number from 1 on
    sides = _sides(places, last)
    means: dict[int, Floats] = {
        side: np.lib.stride_tricks.sliding_window_view(logs, side).mean(axis=1) for side in np.unique(sides).tolist()
    }
    groups = []
    for few in (True, False):
        which = np.flatnonzero((sides < sides.max()) == few)
        if len(which) == 0:
            continue
        side, place = sides[which], places[which]
        below, above = place - _GUARD - side, place + _GUARD + 1
        low_end = np.array([means[each][at - 1] for each, at in zip(side.tolist(), below.tolist(), strict=True)])
        high_end = np.array([means[each][at - 1] for each, at in zip(side.tolist(), above.tolist(), strict=True)])
        share = (logs[place - 1] - low_end) / (high_end - low_end)
        groups.append(_Neighbourhoods(side, which, below, above, share))
    return groups


def _median(height: Floats, first: Indices, side: Indices) -> Floats:
    """Medians (b,) of `side` (b,), or (1,) for all, finite heights each from `first` (b,) on: to sort them takes a
    sixth of what `numpy.median` does.
    """
    most = int(side.max())
    padded = np.concatenate([height, np.full(most, np.inf)])
    rows = np.lib.stride_tricks.sliding_window_view(padded, most)[first]
    if (side < most).any():
        rows[np.arange(most) >= side[:, None]] = np.inf
    rows.sort(axis=1)
    at = np.arange(len(rows))
    low, high = rows[at, (side - 1) // 2], rows[at, side // 2]
    return np.asarray(np.where(side % 2, high, (low + high) / 2))


def _smoothed(height: Floats, bins: Indices, last: int) -> Floats:
    """Means (b,) of the neighbours of each of all `bins` up to the last, half as far as the floor looks (b,)."""
    half = np.minimum(_sides(bins, last) // 2, bins - bins[0])
    sums = np.concatenate([[0.0], np.cumsum(np.concatenate([height, height[-2 : -2 - _SIDE : -1]]))])
    at = bins - bins[0]
    return np.asarray((sums[at + half + 1] - sums[at - half]) / (2 * half + 1))


def _variance(freedom: float, bins: Indices, last: int) -> Floats:
    """Variance (b,) of the log of the floor: that of a gamma law's log at its median, 1 / (4 density^2), over the
    number of bins that it is as sure as; mirrored bins bring nothing new.
    """
    half = freedom / 2
    median = gammaincinv(half, 0.5)
    single = 1 / (4 * np.exp(half * np.log(median) - median - gammaln(half)) ** 2)
    sides = _sides(bins, last)
    new = 1 - np.maximum(0, bins + _GUARD + sides - last) / (2 * sides)
    return np.asarray(single * np.array([_share_of_one(side) for side in sides.tolist()]) / np.maximum(new, 0.5))


@cache
def _share_of_one(side: int) -> float:
    """Variance of the log of the floor in units of that of one bin, as of means: the weights of all three steps.

    Twice the weight of the bin itself is taken off: by so much more the bin's ratio to its floor scatters.
    """
    joined = np.concatenate([np.ones(side), np.zeros(2 * _GUARD + 1), np.ones(side)]) / (2 * side)
    half = side // 2
    trend = np.convolve(joined, np.full(2 * half + 1, 1 / (2 * half + 1)))
    weights = -np.convolve(trend, joined)
    weights[side + _GUARD : -(side + _GUARD)] += trend
    weights[side + _GUARD + half : -(side + _GUARD + half)] += joined
    shared = [correlation * float(weights[lag:] @ weights[: len(weights) - lag]) for lag, correlation in _SIGNS]
    return 2 * sum(shared) - shared[0] - 2 * float(weights[len(weights) // 2])


def _thinned(rest: Floats, freedom: float, floor_freedom: float) -> float:
    """Return the factor by which the scatter of the log ratios (b,) reduces the degrees of freedom; 1 within three
    standard errors.
    """
    expected = float(np.diff(np.log(fdtri(freedom, floor_freedom, _EXTREMES)))[0])
    spread = float(np.diff(np.quantile(rest, _EXTREMES))[0])
    allowed = expected * (1 + 3 * np.sqrt(1.62 / len(rest)))
    return 1.0 if spread <= allowed else (expected / spread) ** 2
