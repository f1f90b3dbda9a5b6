"""Probes of the shape of the spectrum over frequency in cycles per row; the probes in `spread` measure its size."""

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
"""Number of bands, from bin 2 of the spectrum to half the rate, with equal widths in the log of frequency."""

_FIRST = 4
"""First bin of the spectrum in which a line is detected."""

_NEIGHBOURHOOD = 33
"""Width, in bins, of the median that is the floor of the spectrum."""

_SIDE = _NEIGHBOURHOOD // 2

_IN_PAIRS = 0.25
"""Share of rows equal to the previous row, above which the readings of a chip are assumed to come in pairs."""

Places = npt.NDArray[np.int_]


def band(number: int, summary: Summary) -> Floats:
    """Return the log of the ratio of the mean density in band `number` (0 is the lowest) to the geometric mean over all
    bands.
    """
    return np.asarray(_bands(summary)[number])


def line(summary: Summary) -> Floats:
    """Return the normal score of the highest ratio of a density to the median of the 33 bins around it."""
    if summary.spectrum.segments == 0:
        return NOTHING
    return _score_of_highest(_over_floor(summary), float(summary.spectrum.freedom[_FIRST]))


def line_of_log(phases: Sequence[Summary]) -> Floats:
    """Return the normal score of the highest density of all phases at rest together; nan with fewer than two phases.

    A line at the same frequency in all phases exceeds the floor of the mean spectrum by more standard deviations than
    that of any single phase. Phase i has n_i degrees of freedom and segments of N_i rows, in which the ratio of the
    line to the floor is proportional to N_i; the mean with weights N_i n_i is therefore the most sensitive. It has (sum
    N_i n_i)^2 / (sum N_i^2 n_i) degrees of freedom. Shorter segments have wider bins, each of which is used for several
    of the finest bins.
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
    """Return the ratio of the density (m, k) to the median of the 33 bins around it; nan where the median is 0."""
    density = summary.spectrum.density
    mirrored = density.T[:, _mirror(len(density))]  # filtered as one line: faster than three lines or two dimensions
    floor = median_filter(mirrored.ravel(), size=_NEIGHBOURHOOD).reshape(mirrored.shape)[:, _SIDE:-_SIDE].T
    return np.asarray(density / np.where(floor > 0, floor, np.nan))


def _score_of_highest(ratio: Floats, freedom: float) -> Floats:
    """Return the normal score (k,) of the highest of the ratios (m, k) of densities to their floor.

    A density is nearly chi-squared, and its cube root nearly normal (Wilson and Hilferty, PNAS 17, 1931).
    """
    score = (np.cbrt(ratio[_FIRST:-1].max(axis=0)) - 1) / np.sqrt(2 / (9 * freedom))
    return score_of_largest(score, len(ratio))


def alternation(summary: Summary) -> Floats:
    """Return the log of the ratio of twice the density at half the rate to the mean density of the bins before it. The
    density is doubled because this frequency has no negative counterpart in a one-sided spectrum.

    nan for a chip that is polled much faster than it measures: its readings come in pairs, and their sum with
    alternating signs depends only on the times at which a reading is polled just once.
    """
    density = summary.spectrum.density
    if summary.repeats.repeat_share > _IN_PAIRS:
        return np.full(3, np.nan)
    return np.asarray(log(2 * density[-1]) - log(density[-_NEIGHBOURHOOD:-2].mean(axis=0)))


def every_other(summary: Summary) -> Floats:
    """Return the mean of the readings with alternating signs, in units of its standard error.

    An error that depends on the parity of the row, for example with two converters that alternate or a sensor that is
    read first in every other frame, accumulates over the phase. A line near half the rate beats with the rows and
    averages out.
    """
    density = np.median(summary.spectrum.density[-_NEIGHBOURHOOD:-2], axis=0)
    square_error = np.where(density > 0, density, np.nan) / (2 * max(summary.rows, 1))
    return np.asarray(summary.alternating / np.sqrt(square_error))


@once
def _bands(summary: Summary) -> Floats:
    """Return (b, 3) the log of the ratio of the mean density in each band to the geometric mean over the bands."""
    density = summary.spectrum.density
    edges = _edges(len(density))
    sums = np.add.reduceat(density, edges[:-1], axis=0)
    logs = log(sums / (edges[1:] - edges[:-1])[:, None])
    return np.asarray(logs - logs.mean(axis=0))


@cache
def _edges(bins: int) -> Places:
    """Return the first bins of the bands, followed by the end of the last band."""
    return np.rint(np.geomspace(2, bins, BANDS + 1)).astype(int)


@cache
def _mirror(bins: int) -> Places:
    """Return the numbers of the bins, extended at both ends by the mirrored bins that a median filter of
    `_NEIGHBOURHOOD` bins needs.
    """
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
