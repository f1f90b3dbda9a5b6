"""Probes of the level of the readings and of its stability."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import LEVEL, SKEWNESS, VARIANCE
from imuarray.gap.statistics.probes.probe import NOTHING, LogProbe, PhaseProbe, Probes, log, once
from imuarray.gap.statistics.summary import Summary

LEAST_LEVEL = 2e-6
"""Least meaningful difference of means in the sensor's unit: a hundredth of the difference that is detectable in an
hour with the usual noise.
"""

_ERROR_SHARE = 0.5
"""Share of the standard error of a mean below which differences are not meaningful. A fit to several sensors or several
faces leaves a larger share of the standard error as a residual.
"""

_LEAST, _MANY = 8, 16
"""Least numbers of segments for a variance, and for higher moments. With few segments the log of a variance has a long
lower tail: with two degrees of freedom it is seven standard deviations below its mean once in a thousand times.
"""


@once
def mean(summary: Summary) -> Floats:
    """Return the mean reading (3,) in the sensor's unit, by its nominal sensitivity."""
    part = summary.segments
    places = (part.rows > 0).nonzero()[0]
    total = part.rows[places] @ part.mean.take(places, axis=0)
    return np.asarray(total / (summary.rows * summary.header.sensitivity)) if summary.rows else NOTHING


def least_level(summary: Summary) -> float:
    """Return the least meaningful difference of means, in the sensor's unit: a share of the standard error of the mean
    of independent readings.

    A fit that removes a level leaves only rounding. An attitude that is estimated from the level itself leaves a
    residual of second order in the error of the attitude, which is small and far from normal.
    """
    if not summary.rows:
        return LEAST_LEVEL
    part = summary.segments
    has_rows = part.rows > 1
    variance = part.rows[has_rows] @ part.steady_variance[has_rows] / summary.rows if has_rows.any() else np.zeros(1)
    return max(LEAST_LEVEL, _ERROR_SHARE * math.sqrt(variance.min() / summary.rows) / summary.header.sensitivity)


def least_mean_level(phases: Sequence[Summary]) -> float:
    """Return the least meaningful difference of the mean over phases with equal weights, in the sensor's unit."""
    return math.sqrt(sum(least_level(phase) ** 2 for phase in phases)) / max(len(phases), 1)


def least_return(phases: Sequence[Summary]) -> float:
    """Return the least meaningful difference between the last and the first phase, in the sensor's unit."""
    return math.hypot(least_level(phases[0]), least_level(phases[-1]))


def halves(summary: Summary) -> Floats:
    """Return the mean of the second half's segments less that of the first half's."""
    part = summary.segments.mean / summary.header.sensitivity
    middle = (len(part) + 1) // 2
    first, second = (half[np.isfinite(half[:, 0])] for half in (part[:middle], part[middle:]))
    return np.asarray(second.mean(axis=0) - first.mean(axis=0)) if len(first) and len(second) else NOTHING


def wander(summary: Summary) -> Floats:
    """Return the log of the ratio of the variance of the segments' means about a straight line to that expected for
    independent readings.
    """
    part = summary.segments
    places = (part.rows > 1).nonzero()[0]
    if len(places) < _LEAST:
        return NOTHING
    expected = 1 / (part.rows[places] - 1) @ part.steady_variance.take(places, axis=0) / len(places)
    residual = _about_line(summary)
    return np.asarray(log((residual * residual).sum(axis=0) / (len(places) - 2)) - log(expected))


def uneven(summary: Summary) -> Floats:
    """Return the arsinh of the skewness of the segments' means about a straight line. It differs from 0 if the readings
    switch between two levels, one of which is rare.
    """
    if np.count_nonzero(summary.segments.rows > 1) < _MANY:
        return np.full(summary.segments.mean.shape[1], np.nan)
    residual = _about_line(summary)
    square = (residual * residual).mean(axis=0)
    return np.asarray(np.arcsinh(_share((residual**3).mean(axis=0), square**1.5)))


@once
def _about_line(summary: Summary) -> Floats:
    """Return (s, 3) the means of segments with at least two rows, less a straight line fitted to them, in counts."""
    part = summary.segments
    places = (part.rows > 1).nonzero()[0]
    times, means = part.time_s[places], part.mean.take(places, axis=0)
    times, means = times - times.sum() / len(places), means - means.sum(axis=0) / len(places)
    return np.asarray(means - times[:, None] * (times @ means / (times @ times)))


def _share(moment: Floats, of: Floats) -> Floats:
    """Return `moment` divided by `of`; nan where `of` is not positive."""
    return np.divide(moment, of, out=np.full_like(of, np.nan), where=of > 0)


def returned(phases: Sequence[Summary]) -> Floats:
    """Return the mean of the last phase less that of the first phase on the same face; nan if there is none."""
    last = phases[-1]
    before = [phase for phase in phases[:-1] if phase.phase.up == last.phase.up]
    return mean(last) - mean(before[0]) if before else NOTHING


def whole(phases: Sequence[Summary]) -> Floats:
    """Return the mean of all phases with equal weights of all faces or poses, as in the fit of a bias; nan for a single
    phase, for which the probe `mean` gives the same value.
    """
    return level(phases) if len(phases) > 1 else NOTHING


def level(phases: Sequence[Summary]) -> Floats:
    """Return the mean of all phases with equal weights of all faces or poses, also for a single phase; nan without
    readings.
    """
    faces: dict[str, list[Floats]] = {}
    for phase in phases:
        if phase.rows:
            faces.setdefault(phase.phase.up or phase.phase.name, []).append(mean(phase))
    return np.mean([np.add.reduce(means) / len(means) for means in faces.values()], axis=0) if faces else NOTHING


_SLOW = ("bias_instability", "random_walk", "popcorn_noise", "common_mode")

PROBES: Probes = {
    "mean": PhaseProbe(
        "level",
        "mean reading",
        ("bias", "scale", "misalignment", "axis_error", "turn_on_bias", "bistable_bias", "range_reset", "channel_swap"),
        LEVEL,
        mean,
        unit="{u}",
        resolution=least_level,
    ),
    "mean_halves": PhaseProbe(
        "level",
        "mean of the second half less that of the first",
        (*_SLOW, "thermal_bias", "range_reset"),
        LEVEL,
        halves,
        unit="{u}",
    ),
    "wander": PhaseProbe(
        "level",
        "log of the variance of segments' means about a straight line, over that of white noise",
        _SLOW,
        VARIANCE,
        wander,
    ),
    "wander_uneven": PhaseProbe(
        "level", "arsinh of the skewness of segments' means about a straight line", ("popcorn_noise",), SKEWNESS, uneven
    ),
    "mean_return": LogProbe(
        "level",
        "mean of the last phase less that of the first on the same face",
        ("random_walk",),
        LEVEL,
        returned,
        unit="{u}",
        resolution=least_return,
    ),
    "level": LogProbe(
        "level",
        "mean reading of the whole log",
        ("turn_on_bias", "bistable_bias", "common_mode", "range_reset"),
        LEVEL,
        whole,
        unit="{u}",
        resolution=least_mean_level,
    ),
}
