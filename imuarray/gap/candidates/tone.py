"""`tone`: a line in the spectrum."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from imuarray.characterise.spectrum import Spectrum
from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.evidence import Evidence
from imuarray.simulate.effects.tone import Tone

Floats = npt.NDArray[np.float64]

_TRACES = (
    *("line", "alternation", "noise_excess", "kurtosis", "lag_1", "lag_2", "lag_3", "lag_5"),
    *("band_2", "band_3", "band_4", "band_5", "band_6", "allan_2", "allan_8", "allan_32"),
    *("fast_own_axes", "fast_box_axes", "fast_between_axes", "fast_other_chips"),
)
_BEYOND = 2.7
_MAINS_HZ = (50.0, 60.0)

_FIRST = 2
_HALF_WIDTH = 2
"""Bins on each side that a Hann window spreads a line over."""

_BESIDE = 33
_HIGH = 4.0
"""A line is so many standard deviations above its neighbours' median, by the cube root of its density, which is about
normal (Wilson and Hilferty, PNAS 17, 1931).
"""

_CLEAR = 2.0
_LINES = 2


class _Line(NamedTuple):
    """At `bin` of a spectrum; `power` (3,) in squared counts, `height` (3,) over the floor in standard deviations."""

    bin: float
    power: Floats
    height: Floats


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The two highest lines of the mean spectrum at rest, at the frequency at which rows show them; at that of the
    mains if it is where rows show these.
    """
    yield from with_removal(evidence, Tone.name, _found(evidence), several=True)


def _found(evidence: Evidence) -> Iterator[Trial]:
    if not evidence.is_odd(*_TRACES, beyond=_BEYOND):
        return
    spectrum = _pooled([one.raw.spectrum for one in evidence.still])
    if spectrum is None:
        return
    known_hz = [effect.frequency_hz for effect in evidence.effects if isinstance(effect, Tone)]
    bin_hz = evidence.rows_per_s / spectrum.segment_rows
    for line in _lines(spectrum, [_shown_hz(hertz, evidence.rows_per_s) / bin_hz for hertz in known_hz]):
        power = np.where(line.height > _CLEAR, line.power, 0.0)
        x, y, z = (np.sqrt(2 * power) / evidence.header.sensitivity).tolist()
        yield Trial((Tone((x, y, z), _true_hz(line.bin * bin_hz, bin_hz, evidence.rows_per_s)),), ("amplitude",))


def _pooled(spectra: list[Spectrum]) -> Spectrum | None:
    """The finest one, of all phases in which it is as fine; with freedom added up."""
    known = [one for one in spectra if one.segments]
    if not known:
        return None
    rows = max(one.segment_rows for one in known)
    alike = [one for one in known if one.segment_rows == rows]
    density = np.average([one.density for one in alike], axis=0, weights=[one.segments for one in alike])
    freedom = np.sum([one.freedom for one in alike], axis=0)
    first = alike[0]
    runs = (first.rate_hz, rows, sum(one.segments for one in alike), sum(one.runs for one in alike))
    return Spectrum(first.frequency_hz, density, freedom, *runs, sum(one.rows for one in alike), 0)


def _lines(spectrum: Spectrum, known: list[float]) -> Iterator[_Line]:
    """The highest ones, those beside `known` bins left out."""
    density = spectrum.density
    floor = median_filter(density, size=(min(_BESIDE, len(density)), 1), mode="mirror")
    floor = np.maximum(floor, 1e-12 * density.max())
    height = (np.cbrt(density / floor) - 1) / np.sqrt(2 / (9 * spectrum.freedom))[:, None]
    highest = height.max(axis=1)
    highest[:_FIRST] = 0
    bins = np.arange(len(density))
    for place in known:
        highest[np.abs(bins - place) <= _HALF_WIDTH + 1] = 0
    for _ in range(_LINES):
        peak = int(highest.argmax())
        if highest[peak] < _HIGH:
            return
        near = np.abs(bins - peak) <= _HALF_WIDTH
        excess = np.maximum(density - floor, 0.0)[near]
        power = excess.sum(axis=0) / spectrum.segment_rows
        at = float(np.average(bins[near], weights=excess.sum(axis=1)))
        yield _Line(at, power, height[peak])
        highest[near] = 0


def _shown_hz(hertz: float, rows_per_s: float) -> float:
    """Where rows show it, 0 to half their rate."""
    return abs(hertz - rows_per_s * round(hertz / rows_per_s))


def _true_hz(shown_hz: float, bin_hz: float, rows_per_s: float) -> float:
    """That of the mains if it shows in the same bin, else what is shown."""
    alike = [hertz for hertz in _MAINS_HZ if abs(_shown_hz(hertz, rows_per_s) - shown_hz) < bin_hz]
    return alike[0] if alike and alike[0] > rows_per_s / 2 else shown_hz


TONE = Candidate(
    Tone.name, guesses, {"static": "still for 5 minutes, and again at another poll rate, by which an alias moves"}
)
