"""Probes of the noise level and of its stability."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import RMS, VARIANCE, unevenness
from imuarray.gap.statistics.probes.force import applied_g
from imuarray.gap.statistics.probes.probe import NOTHING, LogProbe, PhaseProbe, Probes, log, noise_lsb, once
from imuarray.gap.statistics.summary import Summary

_LEAST = 4
"""Least number of rows of a segment for a variance, and of segments for the scatter of variances."""

_ROUNDED = 1 / 12
"""Variance of rounding, in squared counts, used as the least variance of a segment. With coarse codes a segment
sometimes has a single code although the noise is not zero. If the log of its variance were left undefined, the
statistic would be missing in a few replicates and would look like a strong deviation.
"""


def noise(summary: Summary) -> Floats:
    """Return the log of the noise from row to row, in the sensor's unit."""
    return log(noise_lsb(summary) / summary.header.sensitivity)


def excess(summary: Summary) -> Floats:
    """Return the log of the ratio of the standard deviation within segments to the noise from row to row."""
    return np.asarray(log(_pooled_variance(summary)) / 2 - log(noise_lsb(summary)))


def halves(summary: Summary) -> Floats:
    """Return the log of the ratio of the variance within the segments of the second half to that of the first half."""
    variance, rows = summary.segments.steady_variance, summary.segments.rows
    middle = (len(rows) + 1) // 2
    return log(_mean_variance(variance[middle:], rows[middle:])) - log(_mean_variance(variance[:middle], rows[:middle]))


def uneven(summary: Summary) -> Floats:
    """Return the log of the ratio of the variance of the segments' log variances to 2 / (rows - 1), the value for
    Gaussian noise; a variance is at least that of rounding.
    """
    part = summary.segments
    places = (part.rows >= _LEAST).nonzero()[0]
    if len(places) < _LEAST:
        return NOTHING
    values = log(part.steady_variance.take(places, axis=0).clip(_ROUNDED))
    values = values - values.sum(axis=0) / len(places)
    expected = (2 / (part.rows[places] - 1.0)).sum() / len(places)
    return log((values * values).sum(axis=0) / (len(places) - 1) / expected)


def with_force(phases: Sequence[Summary]) -> Floats:
    """Return, for each axis, the mean log variance on faces on which more than 0.5 g acts along the axis, less that on
    the other faces; nan unless there are phases of both kinds for every axis.
    """
    if len({phase.phase.up for phase in phases}) < 2:
        return NOTHING
    applied = applied_g(phases)
    values = np.array([log(_pooled_variance(phase)) for phase in phases])
    loaded = np.abs(applied) > 0.5
    known = np.isfinite(applied[:, :1]) & np.isfinite(values)
    on, off = known & loaded, known & ~loaded
    if not (on.any(axis=0).all() and off.any(axis=0).all()):
        return NOTHING
    return np.asarray(np.mean(values, axis=0, where=on) - np.mean(values, axis=0, where=off))


@once
def _pooled_variance(summary: Summary) -> Floats:
    return _mean_variance(summary.segments.steady_variance, summary.segments.rows)


def _mean_variance(variance: Floats, rows: np.ndarray) -> Floats:
    """Return the unbiased variance (k,) pooled over the segments (s, k), weighted by their rows; nan if no segment has
    two rows.
    """
    places = (rows > 1).nonzero()[0]
    rows_of_places = rows[places]
    freedom = int(rows_of_places.sum()) - len(rows_of_places)
    if not freedom:
        return np.full(variance.shape[1:], np.nan)
    return np.asarray(rows_of_places @ variance.take(places, axis=0) / freedom)


_SIZES = ("white_noise", "odr_error", "range_reset", "scale", "channel_swap")

PROBES: Probes = {
    "noise": PhaseProbe(
        "spread", "log of the noise from row to row", (*_SIZES, "bandwidth", "stuck"), RMS, noise, unit="log {u}"
    ),
    "noise_excess": PhaseProbe(
        "spread",
        "log of the standard deviation within segments over the noise from row to row",
        ("glitches", "tone", "popcorn_noise", "bandwidth", "stale_samples"),
        RMS,
        excess,
    ),
    "noise_halves": PhaseProbe(
        "spread", "log of the variance of the second half over the first", ("range_reset",), VARIANCE, halves
    ),
    "noise_uneven": PhaseProbe(
        "spread",
        "log of the variance of segments' log variances",
        ("glitches", "stuck", "range_reset"),
        unevenness,
        uneven,
    ),
    "noise_force": LogProbe(
        "spread", "log of the variance under gravity over that without", ("scale",), VARIANCE, with_force
    ),
}
