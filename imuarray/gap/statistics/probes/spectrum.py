"""Probes of the shape of the spectrum over frequency in cycles per row; the size belongs to `spread`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import GENEROUS, SCORE, VARIANCE
from imuarray.gap.statistics.probes.probe import NOTHING, LogProbe, PhaseProbe, Probes, log, once, score_of_largest
from imuarray.gap.statistics.summary import Summary

BANDS = 6
"""From the second bin to half the rate, equally wide in the log of frequency."""

_FIRST = 4
_NEIGHBOURHOOD = 33
_SIDE = _NEIGHBOURHOOD // 2
_IN_PAIRS = 0.25
"""Share of rows that equal the one before from which on the readings of a chip come in pairs."""

Places = npt.NDArray[np.int_]


def band(number: int, summary: Summary) -> Floats:
    """Return the log of the mean density in band `number` (0 is the lowest), over the geometric mean of all bands'."""
    return np.asarray(_bands(summary)[number])


def line(summary: Summary) -> Floats:
    """Normal score of the highest density over the median of its 33 neighbours."""
    if summary.spectrum.segments == 0:
        return NOTHING
    return _score_of_highest(_over_floor(summary), float(summary.spectrum.freedom[_FIRST]))


def line_of_log(phases: Sequence[Summary]) -> Floats:
    """Normal score of the highest density of all phases at rest together; nan with fewer than two phases.

    A line that is at the same frequency in all phases exceeds the floor by more standard deviations there than in any
    of them. Phase i has n_i degrees of freedom and segments of N_i rows, in which the line's power over the floor is
    proportional to N_i; the mean with weights N_i n_i therefore shows it best. It has (sum N_i n_i)^2 / (sum N_i^2 n_i)
    degrees of freedom. Shorter segments have wider bins, each of which stands for several of the finest ones.
    """
    known = [phase for phase in phases if phase.spectrum.segments]
    if len(known) < 2:
        return NOTHING
    lengths = np.array([phase.spectrum.segment_rows for phase in known])
    freedom = np.array([phase.spectrum.freedom[_FIRST] for phase in known])
    bins = np.arange(lengths.max() // 2 + 1)
    ratio = np.zeros((len(bins), len(known[0].spectrum.density.T)))
    for phase, weight in zip(known, lengths * freedom / (lengths @ freedom), strict=True):
        ratio += weight * _over_floor(phase)[bins * phase.spectrum.segment_rows // lengths.max()]
    return _score_of_highest(ratio, float((lengths @ freedom) ** 2 / (lengths**2 @ freedom)))


@once
def _over_floor(summary: Summary) -> Floats:
    """Return the density (m, k) over the median of its 33 neighbours; nan where that is 0."""
    density = summary.spectrum.density
    mirrored = density.T[:, _mirror(len(density))]  # one line after the other: faster than three, or two dimensions
    floor = median_filter(mirrored.ravel(), size=_NEIGHBOURHOOD).reshape(mirrored.shape)[:, _SIDE:-_SIDE].T
    return np.asarray(density / np.where(floor > 0, floor, np.nan))


def _score_of_highest(ratio: Floats, freedom: float) -> Floats:
    """Normal score of the highest of the ratios (m, k) of densities to their floor.

    A density is about chi-squared, its cube root about normal (Wilson and Hilferty, PNAS 17, 1931).
    """
    score = (np.cbrt(ratio[_FIRST:-1].max(axis=0)) - 1) / np.sqrt(2 / (9 * freedom))
    return score_of_largest(score, len(ratio))


def alternation(summary: Summary) -> Floats:
    """Return the log of the density at half the rate, which has no twin and counts double, over that of the bins before
    it.

    nan for a chip that is polled much faster than it measures: its readings come in pairs, whose sum with alternating
    signs consists of the moments at which a poll finds one reading alone.
    """
    density = summary.spectrum.density
    if summary.repeats.repeat_share > _IN_PAIRS:
        return np.full(3, np.nan)
    return np.asarray(log(2 * density[-1]) - log(density[-_NEIGHBOURHOOD:-2].mean(axis=0)))


def every_other(summary: Summary) -> Floats:
    """Return the mean of the readings with alternating signs, in its standard errors.

    An error that follows the number of a reading, as of two converters in turn or of a sensor that is read first in
    every other frame, adds up over the phase; a line beats with the rows and does not, however near it is to half their
    rate.
    """
    density = np.median(summary.spectrum.density[-_NEIGHBOURHOOD:-2], axis=0)
    square_error = np.where(density > 0, density, np.nan) / (2 * max(summary.rows, 1))
    return np.asarray(summary.alternating / np.sqrt(square_error))


@once
def _bands(summary: Summary) -> Floats:
    """Return (b, 3) log of the mean density in each band, over the geometric mean."""
    density = summary.spectrum.density
    edges = _edges(len(density))
    sums = np.add.reduceat(density, edges[:-1], axis=0)
    logs = log(sums / (edges[1:] - edges[:-1])[:, None])
    return np.asarray(logs - logs.mean(axis=0))


@cache
def _edges(bins: int) -> Places:
    """First bins of the bands, and the end of the last band."""
    return np.rint(np.geomspace(2, bins, BANDS + 1)).astype(int)


@cache
def _mirror(bins: int) -> Places:
    """Return the bins, and at either end those that a median of `_NEIGHBOURHOOD` reaches for beyond it."""
    return np.asarray(np.abs((bins - 1) - np.abs((bins - 1) - np.arange(-_SIDE, bins + _SIDE))))


_LOW = ("bias_instability", "random_walk", "popcorn_noise", "common_mode", "bandwidth")
_HIGH = ("bandwidth", "odr_error", "stale_samples", "tone")


def _band_probe(number: int) -> PhaseProbe:
    moved_by, margin = (_LOW, VARIANCE) if number < BANDS // 2 else (_HIGH, GENEROUS)
    return PhaseProbe(
        "spectrum", f"log density in band {number + 1} of {BANDS}", moved_by, margin, partial(band, number)
    )


PROBES: Probes = {
    **{f"band_{number + 1}": _band_probe(number) for number in range(BANDS)},
    "line": PhaseProbe(
        "spectrum", "normal score of the highest peak over its neighbours' median", ("tone",), SCORE, line
    ),
    "line_of_log": LogProbe(
        "spectrum", "normal score of the highest peak of all phases together", ("tone",), SCORE, line_of_log
    ),
    "alternation": PhaseProbe(
        "spectrum",
        "log of the density at half the rate over that before",
        ("tone",),
        GENEROUS,
        alternation,
        by_column=False,
    ),
    "every_other": PhaseProbe(
        "spectrum",
        "normal score of the mean of every other reading less that of those between",
        ("tone",),
        SCORE,
        every_other,
    ),
}
