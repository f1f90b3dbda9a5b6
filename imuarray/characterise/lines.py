"""Lines of a spectrum: narrow peaks that are significant in noise, with frequency, amplitude and aliases.

A bin is part of a line if noise would exceed its density with a chance of less than p / b, where b bins are searched
and p is the false-alarm probability of the whole spectrum (Bonferroni: neighbouring bins are correlated, so that p is
an upper bound). The ratio of noise in an averaged periodogram to its floor follows Fisher's F distribution.

A sine of amplitude A, d bins off its nearest bin (|d| <= 1/2), has the power A^2 / 2 * W(d)^2 / 1.5 in that bin, where
W(d) = sinc(d) / (1 - d^2) is the Hann window's transform and 1.5 its noise bandwidth. With the powers L-, L0, L+ of the
three bins around it, minus the floor, the shape of W gives exactly::

    g = (L+ - L-) / (L- + L0 + L+) = 4 d / (4 + d^2)
    W(d-1)^2 + W(d)^2 + W(d+1)^2 = 3 (2 + d^2) (4 + d^2) / (4 - d^2)^2 * W(d)^2

The floor at each bin is estimated from its neighbours: the medians of the log density of the bins below and of those
above, without the nearest two on each side, which a line at the bin itself raises, are joined by a straight line over
log frequency. This reproduces a power law exactly, and a line among the neighbours does not raise a median. The
smoothed result is a trend; the curvature that it misses (a filter's corner) is estimated by the same procedure from the
remainder and added (Tukey, "Exploratory Data Analysis", 1977: twicing). The median of the gamma distribution of
averaged periodograms is below its mean; the floor is corrected for that.

Wide lines (`find_bands`: a motor with a varying speed, a fan, a slow sway) are boxes of 4 to 128 bins with more power
than the bins on either side: the mean density in a box over the higher of the two sides' medians, so that neither a
slope nor the corner of a filter looks like a line. For noise this ratio has Fisher's F distribution; the false-alarm
probability applies to all boxes of all widths together (Bonferroni). Narrow lines are removed first. Boxes begin at the
third bin, where the floor above is not available: slow lines are detected there even if they are narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from math import inf, log, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import chdtri, fdtrc, fdtri, gammaincinv, gammaln

from imuarray.arrays import Floats, Indices
from imuarray.characterise.spectrum import NOISE_BANDWIDTH, Spectrum
from imuarray.series import window_medians

FIRST_BIN = 24
"""Fewest cycles of a line in a segment: with fewer, a line can't be distinguished from drift or the corner of a filter.
"""

_GUARD = 2
"""Indices on either side that share a line's power: the main lobe of the Hann window is four bins wide."""

_LOWEST = 2
"""Indices 0 and 1 have lost power with the mean of their segment."""

_SIDE = 32
"""Largest number of bins on either side from which the floor is estimated; at most a sixteenth of all."""

_LEAST = 8
"""Fewest bins on either side: a line takes three or four of them, which must be fewer than half.

The floor can therefore be estimated from bin 12 on, and its remainder, which needs the floor on both sides, from bin 24
on.
"""

_SHARE = 0.4
"""Largest width of a side as a share of the frequency, so that the bend of a filter's corner is resolved."""

_SIGNS = ((0, 1.0), (1, 0.293), (2, 0.018))
"""Lag in bins, and correlation of the signs of the differences from the median. Hann-windowed bins correlate by 4/9 and
1/36 in power, and the signs by 2 / pi arcsin of that.
"""

_EXTREMES = (0.16, 0.84)


@dataclass(frozen=True)
class NoiseFloor:
    """Floor of one column at the `bins` (b,) that are searched for lines: `density` (b,) in squared units per Hz.
    `freedom` (b,) is that of the floor itself, with a relative variance of 2 / freedom. `spectrum_freedom` (b,) is that
    of the densities, and is less than `Spectrum.freedom` if the bins scatter more than expected, as for noise with a
    varying level.
    """

    bins: Indices
    density: Floats
    freedom: Floats
    spectrum_freedom: Floats

    def level(self, probability: float) -> Floats:
        """Return the density (b,) that noise exceeds with `probability` in a bin, by Fisher's F distribution."""
        return np.asarray(
            self.density * _ratio_above(self.spectrum_freedom.tobytes(), self.freedom.tobytes(), probability)
        )

    def exceedance(self, density: Floats, at: Sequence[int]) -> Floats:
        """Return the probability (p,) that noise exceeds `density` of a spectrum in the bins number `at` (p,)."""
        places = np.asarray(at, np.intp)
        ratio = density[self.bins[places]] / self.density[places]
        return np.asarray(fdtrc(self.spectrum_freedom[places], self.freedom[places], ratio))


@lru_cache(maxsize=16)
def _ratio_above(above: bytes, below: bytes, probability: float) -> Floats:
    """Return the read-only ratio (b,) that noise exceeds with `probability`. `above` and `below` are degrees of freedom
    (b,) as bytes of float64; they are the same for all windows of one length.
    """
    # Few pairs are different, and each takes long to compute; complex numbers are sorted faster than columns.
    pairs, pair_of_bin = np.unique(np.frombuffer(above) + 1j * np.frombuffer(below), return_inverse=True)
    result = np.asarray(fdtri(pairs.real, pairs.imag, 1 - probability)[pair_of_bin.reshape(-1)])
    result.flags.writeable = False
    return result


def noise_floor(spectrum: Spectrum, column: int = 0) -> NoiseFloor:
    """Return the noise floor of one column of a spectrum; without bins if the column has no noise or too few bins."""
    power = np.array(spectrum.density[:, column])
    last = len(power) - 1
    if last < 4 * FIRST_BIN or not (power[_LOWEST:] > 0).all():
        return NoiseFloor(np.zeros(0, np.intp), *[np.zeros(0)] * 3)
    power[-1] *= 2  # the bin at half the rate has no negative frequency
    height = np.log(np.concatenate([power, power[-2:0:-1]]))  # ... and the bins above it mirror those below
    wide = np.arange(FIRST_BIN // 2, last + 1)
    trend = _smooth(_join_medians(height, wide, last), wide, last)
    rest = np.zeros(len(height))
    rest[wide] = height[wide] - trend
    rest[last + 1 :] = rest[last - 1 : 0 : -1]
    bins = wide[-(last + 1 - FIRST_BIN) :]
    level = trend[-len(bins) :] + _join_medians(rest, bins, last)
    freedom = spectrum.freedom[bins]
    floor_freedom = 2 / _variance(float(freedom[0]), int(bins[0]), last)
    freedom = freedom * _scatter_factor(height[bins] - level, float(freedom[0]), float(np.median(floor_freedom)))
    density = np.exp(level) / (chdtri(freedom[0], 0.5) / freedom[0])
    density[-1] /= 2
    return NoiseFloor(bins, density, floor_freedom, freedom)


def _sides(bins: Indices, last: int) -> Indices:
    """Return the number (b,) of bins on either side of each of `bins` (b,) from which the floor is estimated."""
    return np.clip((_SHARE * bins).astype(np.intp), _LEAST, min(_SIDE, max(_LEAST, last // 16)))


def _join_medians(height: Floats, bins: Indices, last: int) -> Floats:
    """Return at each bin the medians of the bins below and above it, interpolated over log frequency (b,)."""
    joined = np.empty(len(bins))
    for side, rows, below, above, share in _neighbourhoods(bins.tobytes(), len(height), last):
        if (side == side[0]).all():  # the windows above some bins are also the windows below other bins
            medians = _median(height, np.arange(below[0], above[-1] + 1), side[:1])
            low, high = medians[below - below[0]], medians[above - below[0]]
        else:
            low, high = _median(height, below, side), _median(height, above, side)
        joined[rows] = low + (high - low) * share
    return joined


class _Neighbourhoods(NamedTuple):
    """Neighbours of some of the bins: their number on either side (w,), the indices of the bins (w,), the first
    neighbour below and above (w,), and the position of the bin between their means over log frequency (w,), 0 to 1.
    """

    side: Indices
    which: Indices
    below: Indices
    above: Indices
    share: Floats


@lru_cache(maxsize=16)
def _neighbourhoods(bins: bytes, length: int, last: int) -> list[_Neighbourhoods]:
    """Return the neighbours of the bins (their bytes) in two groups: bins with fewer neighbours than the others, and
    the rest, whose medians have the same number of values.
    """
    places = np.frombuffer(bins, np.intp)
    logs = np.log(np.arange(1, length + 1))  # of every bin number from 1 on
    sides = _sides(places, last)
    means: dict[int, Floats] = {
        side: np.lib.stride_tricks.sliding_window_view(logs, side).mean(axis=1) for side in np.unique(sides).tolist()
    }
    groups = []
    for is_edge in (True, False):
        rows = np.flatnonzero((sides < sides.max()) == is_edge)
        if len(rows) == 0:
            continue
        side, place = sides[rows], places[rows]
        below, above = place - _GUARD - side, place + _GUARD + 1
        low_end = np.array([means[each][at - 1] for each, at in zip(side.tolist(), below.tolist(), strict=True)])
        high_end = np.array([means[each][at - 1] for each, at in zip(side.tolist(), above.tolist(), strict=True)])
        share = (logs[place - 1] - low_end) / (high_end - low_end)
        groups.append(_Neighbourhoods(side, rows, below, above, share))
    return groups


def _median(height: Floats, first: Indices, side: Indices) -> Floats:
    """Return the medians (b,) of `side` finite heights each, from `first` (b,) on; `side` is (b,), or (1,) if all are
    equal. Sorting takes a sixth of the time of `numpy.median`.
    """
    compiled = window_medians(height, first, side)
    if compiled is not None:
        return compiled
    most = int(side.max())
    padded = np.concatenate([height, np.full(most, np.inf)])
    rows = np.lib.stride_tricks.sliding_window_view(padded, most)[first]
    if (side < most).any():
        rows[np.arange(most) >= side[:, None]] = np.inf
    rows.sort(axis=1)
    at = np.arange(len(rows))
    low, high = rows[at, (side - 1) // 2], rows[at, side // 2]
    return np.asarray(np.where(side % 2, high, (low + high) / 2))


def _smooth(height: Floats, bins: Indices, last: int) -> Floats:
    """Return the means (b,) of the neighbours of each of all `bins`, over half the width of the floor's sides."""
    half = np.minimum(_sides(bins, last) // 2, bins - bins[0])
    sums = np.concatenate([[0.0], np.cumsum(np.concatenate([height, height[-2 : -2 - _SIDE : -1]]))])
    at = bins - bins[0]
    return np.asarray((sums[at + half + 1] - sums[at - half]) / (2 * half + 1))


@lru_cache(maxsize=16)
def _variance(freedom: float, first: int, last: int) -> Floats:
    """Return the read-only variance (b,) of the log of the floor at the bins from `first` to `last`: that of the log of
    a gamma variable's median, 1 / (4 density^2), over the equivalent number of bins; mirrored bins contain no new
    information.
    """
    bins = np.arange(first, last + 1)
    half = freedom / 2
    median = gammaincinv(half, 0.5)
    single = 1 / (4 * np.exp(half * np.log(median) - median - gammaln(half)) ** 2)
    sides = _sides(bins, last)
    new = 1 - np.maximum(0, bins + _GUARD + sides - last) / (2 * sides)
    result = np.asarray(single * np.array([_share_of_one(side) for side in sides.tolist()]) / np.maximum(new, 0.5))
    result.flags.writeable = False
    return result


@cache
def _share_of_one(side: int) -> float:
    """Return the variance of the log of the floor relative to that of one bin, as for means with the weights of all
    three steps. Twice the weight of the bin itself is subtracted, because the bin is part of its floor.
    """
    window = np.concatenate([np.ones(side), np.zeros(2 * _GUARD + 1), np.ones(side)]) / (2 * side)
    half = side // 2
    trend = np.convolve(window, np.full(2 * half + 1, 1 / (2 * half + 1)))
    weights = -np.convolve(trend, window)
    weights[side + _GUARD : -(side + _GUARD)] += trend
    weights[side + _GUARD + half : -(side + _GUARD + half)] += window
    shared = [correlation * float(weights[lag:] @ weights[: len(weights) - lag]) for lag, correlation in _SIGNS]
    return 2 * sum(shared) - shared[0] - 2 * float(weights[len(weights) // 2])


def _scatter_factor(rest: Floats, freedom: float, floor_freedom: float) -> float:
    """Return the factor by which the scatter of the log ratios (b,) reduces the degrees of freedom; 1 within three
    standard errors.
    """
    expected = float(np.diff(np.log(fdtri(freedom, floor_freedom, _EXTREMES)))[0])
    spread = float(np.diff(np.quantile(rest, _EXTREMES))[0])
    limit = expected * (1 + 3 * np.sqrt(1.62 / len(rest)))
    return 1.0 if spread <= limit else (expected / spread) ** 2


FALSE_ALARM = 0.01
"""Chance that a spectrum of noise alone shows a line."""

_APART = 3
"""Least distance of two lines in bins."""

_LEAKED = 4.0
"""Least ratio of a peak to the leakage of stronger lines to its bin: their frequency may vary."""

_NEIGHBOURS = np.array([-5, -3, 3, 5])
"""Offsets of the bins that a narrow line must also exceed, independently of the floor there (a skirt, a notch)."""

_SLOPE_BINS = np.arange(3, 11)
"""Offsets of the bins on either side from which the slope of the noise is estimated."""

_MOST = 0.8
"""Largest |g|, that of a line a whole bin away from its peak: noise may make it larger than that of half a bin."""

_SHARED = np.array([[1, 2 / 3, 1 / 6], [2 / 3, 1, 2 / 3], [1 / 6, 2 / 3, 1]])
"""Size of the correlation of the noise in three neighbouring Hann-windowed bins."""

_TIMES = np.arange(64) / 64
"""Times in a segment, in its lengths; 64 suffice for the three bins at a peak."""


@dataclass(frozen=True)
class SpectralLine:
    """One line: `frequency_hz` and `amplitude` (of the sine, in the series' unit) with standard errors.

    `false_alarm` is an upper limit of the probability that noise has such a peak anywhere in the spectrum; `over_floor`
    is the ratio of the peak's density to that of the noise. At half the rate a line has no phase: there the amplitude
    is that of +A, -A, +A, ... The amplitude of a line wider than a bin or two (a motor, for example) is larger than
    this.
    """

    frequency_hz: float
    frequency_error_hz: float
    amplitude: float
    amplitude_error: float
    false_alarm: float
    over_floor: float


@dataclass(frozen=True)
class LineSearch:
    """All `lines` of a column, strongest first, and the frequencies that were searched.

    `frequency_hz` (b,), the noise `floor` (b,) there and the `level` (b,) above which a density is a line, both in
    squared units per Hz. `false_alarm` is the probability that noise exceeds `level` in any of the b bins. b is 0 for
    too short segments and for a constant column.
    """

    lines: tuple[SpectralLine, ...]
    frequency_hz: Floats
    floor: Floats
    level: Floats
    false_alarm: float


def find_lines(spectrum: Spectrum, column: int = 0, false_alarm: float = FALSE_ALARM) -> LineSearch:
    """Return the lines in one column of a spectrum; ValueError if `false_alarm` is not a probability."""
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm is {false_alarm}, a probability is required")
    floor = noise_floor(spectrum, column)
    frequency_hz = spectrum.frequency_hz[floor.bins]
    if len(floor.bins) == 0:
        return LineSearch((), frequency_hz, floor.density, floor.density, false_alarm)
    level = floor.level(false_alarm / len(floor.bins))
    power = _mirror(spectrum.density[:, column])
    peaks = [at for at in _peaks(power, floor.bins, level) if _is_narrow(power, floor, at, false_alarm)]
    chances = floor.exceedance(spectrum.density[:, column], peaks) * len(floor.bins)
    lines = tuple(
        _line(spectrum, floor, power, at, min(1.0, chance)) for at, chance in zip(peaks, chances.tolist(), strict=True)
    )
    return LineSearch(lines, frequency_hz, floor.density, level, false_alarm)


def aliases(apparent_hz: float, rate_hz: float, highest_hz: float) -> tuple[float, ...]:
    """Return the frequencies up to `highest_hz` that look like `apparent_hz` (0 to half the rate) sampled at `rate_hz`,
    ascending.

    |n rate +- apparent| for all whole n. ValueError for an apparent frequency outside that range, or no positive rate.
    """
    if not 0 < rate_hz < inf or not 0 <= apparent_hz <= rate_hz / 2:
        raise ValueError(f"{apparent_hz} Hz sampled at {rate_hz} Hz: 0 to half of a positive rate is required")
    turns = range(int(max(0.0, highest_hz + apparent_hz) / rate_hz) + 1)
    frequencies_hz = {turn * rate_hz + side * apparent_hz for turn in turns for side in (-1, 1)}
    return tuple(sorted(frequency_hz for frequency_hz in frequencies_hz if 0 <= frequency_hz <= highest_hz))


def _mirror(density: Floats) -> Floats:
    """Return the density (m + 1,) and one mirrored bin; the bin at half the rate (no negative frequency) is doubled."""
    return np.concatenate([density[:-1], 2 * density[-1:], density[-2:-1]])


def _peaks(power: Floats, bins: npt.NDArray[np.intp], level: Floats) -> list[int]:
    """Return which `bins` (b,) are peaks above the level (b,), strongest first, without leakage of stronger ones."""
    heights = power[bins]
    limit = np.concatenate([level[:-1], 2 * level[-1:]])
    tops = np.flatnonzero((heights > limit) & (heights >= power[bins - 1]) & (heights >= power[bins + 1]))
    peaks: list[int] = []
    leaked = np.zeros(len(bins))
    for at in tops[np.argsort(-heights[tops], kind="stable")].tolist():
        if heights[at] > limit[at] + _LEAKED * leaked[at]:
            peaks.append(at)
            leaked += heights[at] * _leakage(np.abs(bins - bins[at]))
    return peaks


def _is_narrow(power: Floats, floor: NoiseFloor, at: int, false_alarm: float) -> bool:
    """Return whether peak number `at` exceeds the four bins near it significantly.

    The significance level is the square root of that of a bin. This weak condition rejects few real lines; if the floor
    is right, it rejects hardly any peak.
    """
    neighbours = float(_reflect(power, int(floor.bins[at]) + _NEIGHBOURS).mean())
    freedom = float(floor.spectrum_freedom[at])
    chance = sqrt(false_alarm / len(floor.bins))
    return bool(power[floor.bins[at]] > neighbours * fdtri(freedom, len(_NEIGHBOURS) * freedom, 1 - chance))


def _tilt(power: Floats, bin_: int) -> float:
    """Return the slope of the log of the noise at a line, per bin, from the medians of eight bins on either side."""
    below, above = (float(np.median(_reflect(power, bin_ + side * _SLOPE_BINS))) for side in (-1, 1))
    return log(above / below) / (2 * float(_SLOPE_BINS.mean()))


def _reflect(power: Floats, bins: npt.NDArray[np.intp]) -> Floats:
    """Return the power (b,) at `bins`, mirrored at half the rate."""
    last = len(power) - 2
    return np.asarray(power[last - np.abs(last - bins)])


def _leakage(bins_away: npt.NDArray[np.intp]) -> Floats:
    """Return the largest power (b,) that a line can have at this distance in bins from its peak, relative to the peak;
    inf next to the peak.
    """
    distance = np.maximum(bins_away, _APART) - 0.5
    share = (np.pi * distance * (distance**2 - 1)) ** -2.0 / _lobe(0.5)
    return np.asarray(np.where(bins_away < _APART, inf, share))


def _lobe(offset: float) -> float:
    """Return W^2 as defined above, for an offset of less than one bin."""
    return float(np.sinc(offset) / (1 - offset**2)) ** 2


def _line(spectrum: Spectrum, floor: NoiseFloor, power: Floats, at: int, false_alarm: float) -> SpectralLine:
    """Return the line with its strongest bin at number `at` of the searched bins."""
    bin_, is_last = int(floor.bins[at]), int(floor.bins[at]) == len(spectrum.density) - 1
    noise = float(floor.density[at]) * (2 if is_last else 1)
    excess = power[bin_ - 1 : bin_ + 2] - noise * np.exp(_tilt(power, bin_) * np.arange(-1, 2))
    total = max(float(excess.sum()), float(excess[1]))
    g = float(np.clip((excess[2] - excess[0]) / total, -_MOST, _MOST))
    offset = 2 * g / (1 + sqrt(1 - g * g))
    square = 2 * NOISE_BANDWIDTH / _three_bins(offset) * total * spectrum.resolution_hz
    amplitude = sqrt(square) / (2 if is_last else 1)
    errors = noise**2 * (2 * _SHARED**2 / floor.spectrum_freedom[at] + 2 / floor.freedom[at])
    errors += 2 * noise * total * _line_covariance(offset, spectrum)
    slope = (4 + offset**2) ** 2 / (4 * (4 - offset**2)) / total * np.array([-1 - g, -g, 1 - g])
    offset_error = sqrt(1 / 12) if is_last else sqrt(float(slope @ errors @ slope))
    amplitude_error = amplitude / (2 * total) * sqrt(float(errors.sum()))
    frequency_hz = min((bin_ + offset) * spectrum.resolution_hz, spectrum.rate_hz / 2)
    over_floor = float(power[bin_]) / noise
    return SpectralLine(
        frequency_hz, offset_error * spectrum.resolution_hz, amplitude, amplitude_error, false_alarm, over_floor
    )


def _three_bins(offset: float) -> float:
    """Return the sum of W^2 over the peak's bin and its neighbours: 1.5 in the middle of a bin, 1.47 between two."""
    return 3 * (2 + offset**2) * (4 + offset**2) / (4 - offset**2) ** 2 * _lobe(offset)


def _line_covariance(offset: float, spectrum: Spectrum) -> Floats:
    """Return the covariance (3, 3) of the three bins' powers from the product of line and noise, for unit power and
    unit noise.

    With the line's phase taken out, the noise of bin a in one segment is the sum of w(t) e^(-2 pi i (a - d) t) times
    white noise, which the next segment contains half a segment earlier.
    """
    window = np.sin(np.pi * _TIMES) ** 2
    waves = window * np.exp(-2j * np.pi * np.outer(np.arange(-1, 2) - offset, _TIMES))
    line = waves.sum(axis=1)
    half = len(_TIMES) // 2
    overlap, onward = waves @ waves.conj().T, waves[:, half:] @ waves[:, :half].conj().T
    inside = (spectrum.segments - spectrum.runs) / spectrum.segments
    products = np.real(np.outer(line.conj(), line) * (overlap + inside * (onward + onward.conj().T)))
    return np.asarray(products / (np.sum(window**2) * np.sum(np.abs(line) ** 2) * spectrum.segments))


WIDTHS = (4, 8, 16, 32, 64, 128)
"""Widths of a box in bins; the narrowest is the main lobe of the Hann window."""

RISES = 1.35
"""Least ratio of a box to both its sides: ripples of filters and of floors are smaller."""

SLACK = 1.08
"""Allowance for the curvature of the floor: the ratio of a box to its sides is divided by it before the test."""

_BAND_FIRST = 3
_BAND_LOWEST = 2
"""First bin of a side: bins 0 and 1 have lost power with the mean of their segment."""

_LEAST_SIDE = 4
_BAND_SIDE = 2
"""The width of a side in boxes. A side begins half a box away from the box, because a line as wide as the box also has
some power beyond it.
"""

_BAND_SHARED = 1.94
"""Number of bins with the information of one independent bin: Hann-windowed neighbours correlate by 4/9 and 1/36 in
power."""

_MEDIAN = 0.64
"""A median is as precise as the mean of this share of its values."""

_CLEARED = 3
"""Number of bins on either side of a narrow line that contain its power."""


@dataclass(frozen=True)
class Band(SpectralLine):
    """A wide line: the middle and the `width_hz` of its power (twice its standard deviation), and the amplitude of a
    sine of that power, in the series' unit.
    """

    width_hz: float


@dataclass(frozen=True)
class _Box:
    """Indices [first, stop), the density of the floor near them, and the probability that noise is this high in any of
    the boxes.
    """

    first: int
    stop: int
    floor: float
    chance: float


def find_bands(spectrum: Spectrum, column: int = 0, narrow: Sequence[SpectralLine] = ()) -> tuple[Band, ...]:
    """Return the wide lines in one column of a spectrum, strongest first, in addition to the known `narrow` ones."""
    density = np.array(spectrum.density[:, column])
    density[-1] *= 2  # the bin at half the rate has no negative frequency
    last = len(density) - 1
    if last < 4 * WIDTHS[0] or not (density[_BAND_FIRST:] > 0).all():
        return ()
    for line in narrow:
        _level(density, round(line.frequency_hz / spectrum.resolution_hz))
    boxes = sorted(_boxes(density, float(np.median(spectrum.freedom))), key=lambda box: box.chance)
    in_band = np.zeros(len(density), bool)
    bands = []
    for box in boxes:
        around = slice(max(box.first - (box.stop - box.first), 0), box.stop + (box.stop - box.first))
        if not in_band[around].any():
            bands.append(_band(spectrum, density, box))
            in_band[around] = True
    return tuple(sorted(bands, key=lambda band: -band.amplitude))


def _level(density: Floats, at: int) -> None:
    """Replace a narrow line by the median of its neighbours."""
    first, stop = max(at - _CLEARED, 0), min(at + _CLEARED + 1, len(density))
    neighbours = np.concatenate([density[max(first - 2 * _CLEARED, 2) : first], density[stop : stop + 2 * _CLEARED]])
    if len(neighbours):
        density[first:stop] = np.median(neighbours)


def _boxes(density: Floats, freedom: float) -> list[_Box]:
    """Return the boxes of all widths that exceed their sides significantly."""
    from scipy.special import fdtrc  # scipy.stats is slow to import

    widths = [width for width in WIDTHS if 8 * width < len(density)]
    trials = sum(2 * len(density) // width for width in widths)
    mirrored = np.concatenate([density, density[-2 : -2 - 4 * WIDTHS[-1] : -1]])  # the bins above half the rate
    boxes = []
    for width in widths:
        starts = np.arange(_BAND_FIRST, len(density) - width, width // 2)
        floor, bins = _floors(mirrored, starts, width)
        means = sliding_window_view(density, width)[starts].mean(axis=1)
        ratio = means / floor
        sure = freedom * max(width / _BAND_SHARED, 1.0), freedom * np.maximum(_MEDIAN * bins / _BAND_SHARED, 1.0)
        chance = trials * fdtrc(*sure, ratio / SLACK)
        for at in np.flatnonzero((ratio > RISES) & (chance < FALSE_ALARM)).tolist():
            first = int(starts[at])
            boxes.append(_Box(first, first + width, float(floor[at]), float(chance[at])))
    return boxes


def _floors(density: Floats, starts: Indices, width: int) -> tuple[Floats, Indices]:
    """Return the higher of the medians of the sides of each box (b,), inf where a side does not fit into the spectrum,
    and the number of bins of the shorter side.
    """
    span = _BAND_SIDE * width
    floor, bins = np.full(len(starts), np.inf), np.full(len(starts), span)
    windows = sliding_window_view(density, span)
    lower = starts - width // 2 - span
    whole = lower >= _BAND_LOWEST
    upper = np.median(windows[starts + 3 * width // 2], axis=1)
    floor[whole] = np.maximum(np.median(windows[lower[whole]], axis=1), upper[whole])
    for at in np.flatnonzero(~whole).tolist():
        side = density[_BAND_LOWEST : max(int(starts[at]) - width // 2, _BAND_LOWEST)]
        if len(side) >= _LEAST_SIDE:
            floor[at], bins[at] = max(float(np.median(side)), float(upper[at])), len(side)
    return floor, bins


def _band(spectrum: Spectrum, density: Floats, box: _Box) -> Band:
    """Return the line in a box: its power above the floor, in the box and in half its width on either side."""
    width = box.stop - box.first
    bins = np.arange(max(box.first - width // 2, 1), min(box.stop + width // 2, len(density)))
    excess = density[bins] - box.floor
    positive = np.maximum(excess, 0.0)
    total = max(float(excess.sum()), float(positive.max()))
    weights = positive**2 / float((positive**2).sum())
    middle = float(bins @ weights)
    spread = sqrt(max(float(((bins - middle) ** 2) @ (positive / float(positive.sum()))), 0.25))
    sure = float(np.median(spectrum.freedom)) * max(spread / _BAND_SHARED, 1.0)
    amplitude = sqrt(2 * total * spectrum.resolution_hz)
    return Band(
        middle * spectrum.resolution_hz,
        spread * spectrum.resolution_hz / sqrt(sure / 2),
        amplitude,
        amplitude / 2 * sqrt(2 / sure),
        min(1.0, box.chance),
        float(np.max(density[box.first : box.stop])) / box.floor,
        2 * spread * spectrum.resolution_hz,
    )
