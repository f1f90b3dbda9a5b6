"""Probes of the level of the readings and its stability."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import LEVEL, SKEWNESS, VARIANCE
from imuarray.gap.statistics.probes.probe import NOTHING, LogProbe, PhaseProbe, Probes, log, once
from imuarray.gap.statistics.summary import Summary

LEAST_LEVEL = 2e-6
"""In the sensor's unit, a hundredth of what an hour of the usual noise lets see."""

_ERROR_SHARE = 0.5
"""Of the standard error of a mean: a fit that is told by several sensors, or by several faces, leaves more of it."""

_LEAST, _MANY = 8, 16
"""Fewer segments say nothing of a variance, of higher moments: the log of a variance of two degrees of freedom is below
its mean by seven standard deviations as often as once in a thousand times.
"""


@once
def mean(summary: Summary) -> Floats:
    """Return the mean reading by the nominal sensitivity."""
    part = summary.segments
    places = (part.rows > 0).nonzero()[0]
    total = part.rows[places] @ part.mean.take(places, axis=0)
    return np.asarray(total / (summary.rows * summary.header.sensitivity)) if summary.rows else NOTHING


def least_level(summary: Summary) -> float:
    """Return the least difference of means that says anything: a share of the standard error of the mean of readings
    that are independent. A fit that takes a level out leaves rounding; an attitude that is estimated from the level
    itself leaves what is of second order in its error, which is as unlike a normal quantity as it is small.
    """
    if not summary.rows:
        return LEAST_LEVEL
    part = summary.segments
    has_rows = part.rows > 1
    variance = part.rows[has_rows] @ part.steady_variance[has_rows] / summary.rows if has_rows.any() else np.zeros(1)
    return max(LEAST_LEVEL, _ERROR_SHARE * math.sqrt(variance.min() / summary.rows) / summary.header.sensitivity)


def least_mean_level(phases: Sequence[Summary]) -> float:
    """Return the same of the mean over phases that are weighted alike."""
    return math.sqrt(sum(least_level(phase) ** 2 for phase in phases)) / max(len(phases), 1)


def least_return(phases: Sequence[Summary]) -> float:
    """Return the same of the difference of two phases."""
    return math.hypot(least_level(phases[0]), least_level(phases[-1]))


def halves(summary: Summary) -> Floats:
    """Return the mean of the second half's segments less that of the first half's."""
    part = summary.segments.mean / summary.header.sensitivity
    middle = (len(part) + 1) // 2
    first, second = (half[np.isfinite(half[:, 0])] for half in (part[:middle], part[middle:]))
    return np.asarray(second.mean(axis=0) - first.mean(axis=0)) if len(first) and len(second) else NOTHING


def wander(summary: Summary) -> Floats:
    """Return the log of the variance of the segments' means about a straight line, over what independent readings would
    give.
    """
    part = summary.segments
    places = (part.rows > 1).nonzero()[0]
    if len(places) < _LEAST:
        return NOTHING
    expected = 1 / (part.rows[places] - 1) @ part.steady_variance.take(places, axis=0) / len(places)
    residual = _about_line(summary)
    return np.asarray(log((residual * residual).sum(axis=0) / (len(places) - 2)) - log(expected))


def uneven(summary: Summary) -> Floats:
    """arsinh of the skewness of the segments' means about a straight line: of two levels one is seldom."""
    if np.count_nonzero(summary.segments.rows > 1) < _MANY:
        return np.full(summary.segments.mean.shape[1], np.nan)
    residual = _about_line(summary)
    square = (residual * residual).mean(axis=0)
    return np.asarray(np.arcsinh(_share((residual**3).mean(axis=0), square**1.5)))


@once
def _about_line(summary: Summary) -> Floats:
    """Return (s, 3) means of segments that hold readings, less a straight line through them."""
    part = summary.segments
    places = (part.rows > 1).nonzero()[0]
    times, means = part.time_s[places], part.mean.take(places, axis=0)
    times, means = times - times.sum() / len(places), means - means.sum(axis=0) / len(places)
    return np.asarray(means - times[:, None] * (times @ means / (times @ times)))


def _share(moment: Floats, of: Floats) -> Floats:
    """nan of nothing."""
    return np.divide(moment, of, out=np.full_like(of, np.nan), where=of > 0)


def returned(phases: Sequence[Summary]) -> Floats:
    """Return the mean of the last phase less that of the first one on the same face."""
    last = phases[-1]
    before = [phase for phase in phases[:-1] if phase.phase.up == last.phase.up]
    return mean(last) - mean(before[0]) if before else NOTHING


def whole(phases: Sequence[Summary]) -> Floats:
    """Return the mean of all phases, each face or pose weighted alike, as the fit of a bias has it; nan of a single
    phase, whose own mean says it.
    """
    return level(phases) if len(phases) > 1 else NOTHING


def level(phases: Sequence[Summary]) -> Floats:
    """Return the same, of a single phase too; nan without readings."""
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
