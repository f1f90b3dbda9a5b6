"""Probes of the distribution of the noise: shape and tails."""

from __future__ import annotations

import math

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import KURTOSIS, SCORE, SKEWNESS, TAILS, VARIANCE
from imuarray.gap.statistics.probes.probe import (
    NOTHING,
    PhaseProbe,
    Probes,
    arcsine,
    log,
    noise_lsb,
    once,
    one_row,
    score_of_largest,
)
from imuarray.gap.statistics.summary import Summary

TAIL = 3.0
"""Limit of the tail of differences between neighbours, in standard deviations: 0.27 % of Gaussian ones are beyond."""


_HALF_COUNT = 0.5
"""Counts that are added to the sizes of spikes, so that their logs are finite."""


def skewness(summary: Summary) -> Floats:
    """Return the arsinh of the skewness about the segments' means."""
    variance, third, _ = _central(summary)
    return np.asarray(
        np.arcsinh(np.divide(third, variance**1.5, out=np.full_like(variance, np.nan), where=variance > 0))
    )


def kurtosis(summary: Summary) -> Floats:
    """Return the log of the kurtosis about the segments' means, less log 3."""
    variance, _, fourth = _central(summary)
    return log(_share(fourth, 3 * variance**2))


def tail(summary: Summary) -> Floats:
    """Return the arcsine of the share of differences between neighbours that exceed `TAIL` standard deviations of the
    differences of noise. Each code is treated as an interval one count wide, which the limit divides.
    """
    limit = TAIL * np.sqrt(2) * noise_lsb(summary)
    beyond = [
        float(steps.counts @ (steps.codes + (0.5 - end)).clip(0.0, 1.0)) if math.isfinite(end) else math.nan
        for steps, end in zip(summary.steps, limit.tolist(), strict=True)
    ]
    return arcsine(beyond, summary.rows - 1)


def extreme(summary: Summary) -> Floats:
    """Return the normal score of the largest difference between neighbours, computed as if all differences were
    independent and Gaussian.
    """
    largest = [float(steps.codes[-1]) if len(steps.codes) else np.nan for steps in summary.steps]
    return score_of_largest(np.array(largest) / (np.sqrt(2) * noise_lsb(summary)), 2 * summary.rows)


def spike(summary: Summary) -> Floats:
    """Return the log of the ratio of the largest spike to the smallest that is kept; nan at rest, where `extreme`
    detects spikes.

    Noise and late polls cause many spikes of about the same size. Half a count is added to both sizes, which may be 0.
    """
    return np.asarray(log(summary.spikes[0] + _HALF_COUNT) - log(summary.spikes[-1] + _HALF_COUNT))


def _spike_resolution(summary: Summary) -> float:
    """Return the change of `spike` by one count, on the axis with the smallest spikes."""
    smallest = summary.spikes[-1]
    return float(1 / (smallest.min() + _HALF_COUNT)) if np.isfinite(smallest).all() else 0.0


def _share(moment: Floats, of: Floats) -> Floats:
    """Return `moment` divided by `of`; nan where `of` is not positive."""
    return np.divide(moment, of, out=np.full_like(of, np.nan), where=of > 0)


@once
def _central(summary: Summary) -> tuple[Floats, Floats, Floats]:
    """Return the second, third and fourth moments (3,) about the segments' means."""
    part = summary.segments
    places = (part.rows > 0).nonzero()[0]
    if len(places) == 0:
        return NOTHING, NOTHING, NOTHING
    share = part.rows[places] / part.rows.sum()
    second, third, fourth = (share @ power.take(places, axis=0) for power in (part.variance, part.third, part.fourth))
    return second, third, fourth


PROBES: Probes = {
    "skewness": PhaseProbe(
        "distribution",
        "arsinh of the skewness within segments",
        ("glitches", "saturation", "nonlinearity"),
        SKEWNESS,
        skewness,
    ),
    "kurtosis": PhaseProbe(
        "distribution",
        "log of a third of the kurtosis within segments",
        ("glitches", "saturation", "tone"),
        KURTOSIS,
        kurtosis,
    ),
    "tail": PhaseProbe(
        "distribution", "arcsine of the share of steps beyond 3 sigma", ("glitches",), TAILS, tail, resolution=one_row
    ),
    "extreme": PhaseProbe(
        "distribution", "normal score of the largest step", ("glitches", "range_reset"), SCORE, extreme
    ),
    "spike": PhaseProbe(
        "distribution",
        "log of the largest spike in motion over the eighth largest",
        ("glitches",),
        VARIANCE,
        spike,
        in_motion=True,
        resolution=_spike_resolution,
    ),
}
