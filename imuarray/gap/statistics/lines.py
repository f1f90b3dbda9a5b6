"""Lines in the spectrum of a phase: peaks above the median of the neighbouring bins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from imuarray.arrays import Floats
from imuarray.characterise.spectrum import Spectrum
from imuarray.units import MAINS_HZ

HALF_WIDTH = 2
"""Number of bins on each side over which a Hann window spreads a line."""

_FIRST = 2
"""First bin in which lines are detected."""

_BESIDE = 33
"""Width, in bins, of the median that is the floor of the spectrum."""

_HIGH = 4.0
"""Least height of a line over the median of its neighbours, in standard deviations of the cube root of the density,
which is nearly normal (Wilson and Hilferty, PNAS 17, 1931).
"""


HARMONICS = 3
"""Number of multiples of the mains' frequency that are searched: transformers and rectifiers make the second and third.
"""

BY_CHANCE = 0.05
"""Largest share of arbitrary frequencies that lie within a bin of an alias of one of these multiples. It limits the
multiples: the bins of short phases are wide, and those of long ones narrow.
"""


class Line(NamedTuple):
    """Line at `bin` of a spectrum: `power` (3,) in squared counts, `height` (3,) above the floor in standard
    deviations.
    """

    bin: float
    power: Floats
    height: Floats


def floor_of(density: Floats) -> Floats:
    """Return the floor (f, 3) of a density (f, 3): the median of the neighbouring bins."""
    floor = median_filter(density, size=(min(_BESIDE, len(density)), 1), mode="mirror")
    return np.asarray(np.maximum(floor, 1e-12 * density.max()))


def highest_lines(spectrum: Spectrum, count: int, known: Sequence[float] = ()) -> Iterator[Line]:
    """Yield at most `count` lines, the highest first, except near `known` bins; none if all codes are equal."""
    density = spectrum.density
    if not density.max() > 0:
        return
    floor = floor_of(density)
    height = (np.cbrt(density / floor) - 1) / np.sqrt(2 / (9 * spectrum.freedom))[:, None]
    highest = height.max(axis=1)
    highest[:_FIRST] = 0
    bins = np.arange(len(density))
    for place in known:
        highest[np.abs(bins - place) <= HALF_WIDTH + 1] = 0
    for _ in range(count):
        peak = int(highest.argmax())
        if highest[peak] < _HIGH:
            return
        near = np.abs(bins - peak) <= HALF_WIDTH
        excess = np.maximum(density - floor, 0.0)[near]
        power = excess.sum(axis=0) / spectrum.segment_rows
        at = float(np.average(bins[near], weights=excess.sum(axis=1)))
        yield Line(at, power, height[peak])
        highest[near] = 0


def pool_spectra(spectra: Sequence[Spectrum]) -> Spectrum | None:
    """Return the mean spectrum of the phases with the finest resolution, weighted by their segments, with the sum of
    their degrees of freedom; None if no phase has a segment.
    """
    known = [spectrum for spectrum in spectra if spectrum.segments]
    if not known:
        return None
    rows = max(spectrum.segment_rows for spectrum in known)
    same_length = [spectrum for spectrum in known if spectrum.segment_rows == rows]
    density = np.average(
        [spectrum.density for spectrum in same_length], axis=0, weights=[spectrum.segments for spectrum in same_length]
    )
    freedom = np.sum([spectrum.freedom for spectrum in same_length], axis=0)
    first = same_length[0]
    runs = (
        first.rate_hz,
        rows,
        sum(spectrum.segments for spectrum in same_length),
        sum(spectrum.runs for spectrum in same_length),
    )
    return Spectrum(first.frequency_hz, density, freedom, *runs, sum(spectrum.rows for spectrum in same_length), 0)


def shown_hz(hertz: float, rows_per_s: float) -> float:
    """Return the frequency at which rows show a line, 0 to half their rate."""
    return abs(hertz - rows_per_s * round(hertz / rows_per_s))


def unaliased_hz(seen_hz: float, bin_hz: float, rows_per_s: float) -> float:
    """Return the lowest multiple of the mains' frequency of which `seen_hz` is an alias, or else `seen_hz`."""
    multiples_hz = multiples_of_mains(seen_hz, bin_hz, rows_per_s)
    is_alias = multiples_hz and all(abs(hertz - seen_hz) >= bin_hz for hertz in multiples_hz)
    return multiples_hz[0] if is_alias else seen_hz


def multiples_of_mains(seen_hz: float, bin_hz: float, rows_per_s: float) -> list[float]:
    """Return the multiples of the mains' frequency, in Hz, that rows show at `seen_hz`, within a bin.

    Multiples are tried as long as an arbitrary frequency is rarely that near to one of them.
    """
    share = 2 * len(MAINS_HZ) * bin_hz / (rows_per_s / 2)  # share of all frequencies that is near one alias per line
    most = min(HARMONICS, max(1, int(BY_CHANCE / share)))
    multiples_hz = [number * hertz for number in range(1, most + 1) for hertz in MAINS_HZ]
    return [hertz for hertz in multiples_hz if abs(shown_hz(hertz, rows_per_s) - seen_hz) < bin_hz]
