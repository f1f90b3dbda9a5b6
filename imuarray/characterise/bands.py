"""Wide lines of a spectrum: boxes of neighbouring bins with more power than the bins on either side.

Examples are a motor with a varying speed, a fan and a slow sway. Boxes of 4 to 128 bins are compared with the bins on
either side of them: the mean density in a box over the higher of the two sides' medians, so that neither a slope nor
the corner of a filter looks like a line. For noise this ratio has Fisher's F distribution; the false-alarm probability
applies to all boxes of all widths together (Bonferroni). Narrow lines (`imuarray.characterise.lines`) are removed
first. Boxes begin at the third bin, where a floor that needs many bins below it is not available: slow lines are
detected here even if they are narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from imuarray.arrays import Floats, Indices
from imuarray.characterise.lines import FALSE_ALARM, SpectralLine
from imuarray.characterise.spectrum import Spectrum

WIDTHS = (4, 8, 16, 32, 64, 128)
"""Widths of a box in bins; the narrowest is the main lobe of the Hann window."""

RISES = 1.35
"""Least ratio of a box to both its sides: ripples of filters and of floors are smaller."""

SLACK = 1.08
"""Allowance for the curvature of the floor: the ratio of a box to its sides is divided by it before the test."""

_FIRST = 3
_LOWEST = 2
"""First bin of a side: bins 0 and 1 have lost power with the mean of their segment."""

_LEAST_SIDE = 4
_SIDE = 2
"""Width of a side in boxes; it begins half a box away, because a line as wide as the box extends beyond it."""

_SHARED = 1.94
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
    """Indices [first, stop), the density of the floor near them, and the probability of such noise in any box."""

    first: int
    stop: int
    floor: float
    chance: float


def find_bands(spectrum: Spectrum, column: int = 0, narrow: Sequence[SpectralLine] = ()) -> tuple[Band, ...]:
    """Return the wide lines in one column of a spectrum, strongest first, in addition to the known `narrow` ones."""
    density = np.array(spectrum.density[:, column])
    density[-1] *= 2  # the bin at half the rate has no negative frequency
    last = len(density) - 1
    if last < 4 * WIDTHS[0] or not (density[_FIRST:] > 0).all():
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
        starts = np.arange(_FIRST, len(density) - width, width // 2)
        floor, bins = _floors(mirrored, starts, width)
        means = sliding_window_view(density, width)[starts].mean(axis=1)
        ratio = means / floor
        sure = freedom * max(width / _SHARED, 1.0), freedom * np.maximum(_MEDIAN * bins / _SHARED, 1.0)
        chance = trials * fdtrc(*sure, ratio / SLACK)
        for at in np.flatnonzero((ratio > RISES) & (chance < FALSE_ALARM)).tolist():
            first = int(starts[at])
            boxes.append(_Box(first, first + width, float(floor[at]), float(chance[at])))
    return boxes


def _floors(density: Floats, starts: Indices, width: int) -> tuple[Floats, Indices]:
    """Return the higher of the medians of a box's sides (b,), inf beyond the spectrum, and the shorter side's bins."""
    span = _SIDE * width
    floor, bins = np.full(len(starts), np.inf), np.full(len(starts), span)
    windows = sliding_window_view(density, span)
    lower = starts - width // 2 - span
    whole = lower >= _LOWEST
    upper = np.median(windows[starts + 3 * width // 2], axis=1)
    floor[whole] = np.maximum(np.median(windows[lower[whole]], axis=1), upper[whole])
    for at in np.flatnonzero(~whole).tolist():
        side = density[_LOWEST : max(int(starts[at]) - width // 2, _LOWEST)]
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
    sure = float(np.median(spectrum.freedom)) * max(spread / _SHARED, 1.0)
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
