"""Lines of a spectrum: narrow peaks that noise alone would hardly make, their frequency, amplitude and aliases.

A bin is part of a line if noise would exceed its density with a chance of less than p / b, where b bins are looked at
and p is the false-alarm probability of the whole spectrum (Bonferroni: neighbouring bins are correlated, so that p is
an upper bound). Of noise the averaged periodogram over its floor follows Fisher's F law, see `noise_floor.py`.

A sine of amplitude A, d bins off its nearest bin (|d| <= 1/2), has the power A^2 / 2 * W(d)^2 / 1.5 in that bin, where
W(d) = sinc(d) / (1 - d^2) is the Hann window's transform and 1.5 its noise bandwidth. With the powers L-, L0, L+ of the
three bins about it, from which the floor is taken off, the shape of W gives exactly::

    g = (L+ - L-) / (L- + L0 + L+) = 4 d / (4 + d^2)
    W(d-1)^2 + W(d)^2 + W(d+1)^2 = 3 (2 + d^2) (4 + d^2) / (4 - d^2)^2 * W(d)^2
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log, sqrt

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.characterise.noise_floor import NoiseFloor, noise_floor
from imuarray.characterise.spectrum import NOISE_BANDWIDTH, Spectrum

FALSE_ALARM = 0.01
"""Chance that a spectrum of noise alone shows a line."""

_APART = 3
"""Peaks nearer than this many bins are one line."""

_LEAKED = 4.0
"""A peak must be this multiple of the leakage of stronger lines to its bin: their frequency may vary."""

_BESIDE = np.array([-5, -3, 3, 5])
"""A line is narrow: it also stands out from these bins near it, whatever the floor does there (a skirt, a notch)."""

_ASIDE = np.arange(3, 11)
"""Bins on either side that the slope of the noise is read off."""

_MOST = 0.8
"""g of a line a whole bin off its peak: noise may push it past the half that a clean one reaches."""

_SHARED = np.array([[1, 2 / 3, 1 / 6], [2 / 3, 1, 2 / 3], [1 / 6, 2 / 3, 1]])
"""Size of the correlation of the noise in three neighbouring Hann-windowed bins."""

_TIMES = np.arange(64) / 64
"""A segment, as finely as three bins need."""


@dataclass(frozen=True)
class SpectralLine:
    """One line: `frequency_hz` and `amplitude` (of the sine, in the series' unit) with standard errors.

    `false_alarm` is the chance that noise makes such a peak anywhere in the spectrum, at most; `over_floor` the peak's
    density over that of the noise. At half the rate a line has no phase: there the amplitude is that of +A, -A, +A, ...
    A line that is wider than a bin or two (of a motor, say) has more amplitude than stands here.
    """

    frequency_hz: float
    frequency_error_hz: float
    amplitude: float
    amplitude_error: float
    false_alarm: float
    over_floor: float


@dataclass(frozen=True)
class LineSearch:
    """All `lines` of a column, strongest first, and where they were looked for.

    `frequency_hz` (b,), the noise `floor` (b,) there and the `level` (b,) above which a density is a line, both in
    squared units per Hz. `false_alarm` is the probability that `level` is for, over all b bins. No bins where there is
    nothing to look at: too short segments, a constant column.
    """

    lines: tuple[SpectralLine, ...]
    frequency_hz: Floats
    floor: Floats
    level: Floats
    false_alarm: float


def find_lines(spectrum: Spectrum, column: int = 0, false_alarm: float = FALSE_ALARM) -> LineSearch:
    """The lines in one column of a spectrum; ValueError if `false_alarm` is no probability."""
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm is {false_alarm}, a probability is required")
    floor = noise_floor(spectrum, column)
    frequency_hz = spectrum.frequency_hz[floor.bins]
    if len(floor.bins) == 0:
        return LineSearch((), frequency_hz, floor.density, floor.density, false_alarm)
    level = floor.level(false_alarm / len(floor.bins))
    power = _mirrored(spectrum.density[:, column])
    peaks = [at for at in _peaks(power, floor.bins, level) if _is_narrow(power, floor, at, false_alarm)]
    chances = floor.exceedance(spectrum.density[:, column], peaks) * len(floor.bins)
    lines = tuple(
        _line(spectrum, floor, power, at, min(1.0, chance)) for at, chance in zip(peaks, chances.tolist(), strict=True)
    )
    return LineSearch(lines, frequency_hz, floor.density, level, false_alarm)


def aliases(apparent_hz: float, rate_hz: float, highest_hz: float) -> tuple[float, ...]:
    """Frequencies up to `highest_hz` that look like `apparent_hz` (0 to half the rate) sampled at `rate_hz`, ascending.

    |n rate +- apparent| for all whole n. ValueError for an apparent frequency outside that range, or no positive rate.
    """
    if not 0 < rate_hz < inf or not 0 <= apparent_hz <= rate_hz / 2:
        raise ValueError(f"{apparent_hz} Hz sampled at {rate_hz} Hz: 0 to half of a positive rate is required")
    turns = range(int(max(0.0, highest_hz + apparent_hz) / rate_hz) + 1)
    frequencies_hz = {turn * rate_hz + side * apparent_hz for turn in turns for side in (-1, 1)}
    return tuple(sorted(frequency_hz for frequency_hz in frequencies_hz if 0 <= frequency_hz <= highest_hz))


def _mirrored(density: Floats) -> Floats:
    """The density (m + 1,) and one bin beyond half the rate; the bin at half the rate twice, as it has no twin."""
    return np.concatenate([density[:-1], 2 * density[-1:], density[-2:-1]])


def _peaks(power: Floats, bins: npt.NDArray[np.intp], level: Floats) -> list[int]:
    """Return which of the `bins` (b,) are peaks above the level (b,), strongest first, none that a stronger one leaks
    to.
    """
    here = power[bins]
    limit = np.concatenate([level[:-1], 2 * level[-1:]])
    tops = np.flatnonzero((here > limit) & (here >= power[bins - 1]) & (here >= power[bins + 1]))
    peaks: list[int] = []
    leaked = np.zeros(len(bins))
    for at in tops[np.argsort(-here[tops], kind="stable")].tolist():
        if here[at] > limit[at] + _LEAKED * leaked[at]:
            peaks.append(at)
            leaked += here[at] * _leakage(np.abs(bins - bins[at]))
    return peaks


def _is_narrow(power: Floats, floor: NoiseFloor, at: int, false_alarm: float) -> bool:
    """Return whether peak number `at` stands out from the four bins beside it.

    Of noise with the square root of a bin's chance: so weak a condition costs few lines, and doubts nearly no peak
    where the floor is right.
    """
    from scipy.special import fdtri  # the inverse of Fisher's F without the weight of scipy.stats

    neighbours = float(_reflected(power, int(floor.bins[at]) + _BESIDE).mean())
    freedom = float(floor.spectrum_freedom[at])
    chance = sqrt(false_alarm / len(floor.bins))
    return bool(power[floor.bins[at]] > neighbours * fdtri(freedom, len(_BESIDE) * freedom, 1 - chance))


def _tilt(power: Floats, bin_: int) -> float:
    """Slope of the log of the noise at a line, per bin, from the medians of eight bins on either side."""
    below, above = (float(np.median(_reflected(power, bin_ + side * _ASIDE))) for side in (-1, 1))
    return log(above / below) / (2 * float(_ASIDE.mean()))


def _reflected(power: Floats, bins: npt.NDArray[np.intp]) -> Floats:
    """The power (b,) at `bins`, mirrored at half the rate."""
    last = len(power) - 2
    return np.asarray(power[last - np.abs(last - bins)])


def _leakage(away: npt.NDArray[np.intp]) -> Floats:
    """The most (b,) that a line shows so many bins from its peak, as a share of that; no limit next to it."""
    distance = np.maximum(away, _APART) - 0.5
    share = (np.pi * distance * (distance**2 - 1)) ** -2.0 / _lobe(0.5)
    return np.asarray(np.where(away < _APART, inf, share))


def _lobe(offset: float) -> float:
    """W^2, see above, less than a bin from its peak."""
    return float(np.sinc(offset) / (1 - offset**2)) ** 2


def _line(spectrum: Spectrum, floor: NoiseFloor, power: Floats, at: int, false_alarm: float) -> SpectralLine:
    """The line whose strongest bin is number `at` of those looked at."""
    bin_, is_last = int(floor.bins[at]), int(floor.bins[at]) == len(spectrum.density) - 1
    noise = float(floor.density[at]) * (2 if is_last else 1)
    excess = power[bin_ - 1 : bin_ + 2] - noise * np.exp(_tilt(power, bin_) * np.arange(-1, 2))
    total = max(float(excess.sum()), float(excess[1]))
    g = float(np.clip((excess[2] - excess[0]) / total, -_MOST, _MOST))
    offset = 2 * g / (1 + sqrt(1 - g * g))
    square = 2 * NOISE_BANDWIDTH / _three_bins(offset) * total * spectrum.resolution_hz
    amplitude = sqrt(square) / (2 if is_last else 1)
    errors = noise**2 * (2 * _SHARED**2 / floor.spectrum_freedom[at] + 2 / floor.freedom[at])
    errors += 2 * noise * total * _beside_line(offset, spectrum)
    slope = (4 + offset**2) ** 2 / (4 * (4 - offset**2)) / total * np.array([-1 - g, -g, 1 - g])
    offset_error = sqrt(1 / 12) if is_last else sqrt(float(slope @ errors @ slope))
    amplitude_error = amplitude / (2 * total) * sqrt(float(errors.sum()))
    frequency_hz = min((bin_ + offset) * spectrum.resolution_hz, spectrum.rate_hz / 2)
    over_floor = float(power[bin_]) / noise
    return SpectralLine(
        frequency_hz, offset_error * spectrum.resolution_hz, amplitude, amplitude_error, false_alarm, over_floor
    )


def _three_bins(offset: float) -> float:
    """Sum of W^2 over the peak's bin and its two neighbours: 1.5 in the middle of a bin, 1.47 between two."""
    return 3 * (2 + offset**2) * (4 + offset**2) / (4 - offset**2) ** 2 * _lobe(offset)


def _beside_line(offset: float, spectrum: Spectrum) -> Floats:
    """Covariance (3, 3) of the three bins' powers from the product of line and noise, for unit power and unit noise.

    With the line's phase taken out, the noise of bin a in one segment is the sum of w(t) e^(-2 pi i (a - d) t) times
    white noise, which the next segment sees half a segment later.
    """
    window = np.sin(np.pi * _TIMES) ** 2
    waves = window * np.exp(-2j * np.pi * np.outer(np.arange(-1, 2) - offset, _TIMES))
    line = waves.sum(axis=1)
    half = len(_TIMES) // 2
    here, onward = waves @ waves.conj().T, waves[:, half:] @ waves[:, :half].conj().T
    inside = (spectrum.segments - spectrum.runs) / spectrum.segments
    both = np.real(np.outer(line.conj(), line) * (here + inside * (onward + onward.conj().T)))
    return np.asarray(both / (np.sum(window**2) * np.sum(np.abs(line) ** 2) * spectrum.segments))
