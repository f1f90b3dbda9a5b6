"""The same sensor in several logs of one kind, such as a turn-on series: variation from run to run, and the common
profile.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.recording.outliers import robust_std
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader

PARTS = 16
"""Number of points of a run's profile."""

_LEAST_SPREAD = 0.2
"""Least spread of runs, as a share of the rms standard error of their means."""

_LEAST_GROUP = 2
"""Least number of runs in a group: a single run is an outlier, not a state."""


@dataclass(frozen=True)
class Runs:
    """Runs of one sensor, in its unit, along its own axes.

    `means` (r, 3); `errors` (r, 3), their standard errors, computed as if the readings of a run were independent;
    `profiles` (r, 16, 3), the means over parts of each run less the run's mean.
    """

    header: SensorHeader
    means: Floats
    errors: Floats
    profiles: Floats

    @cached_property
    def deviations(self) -> Floats:
        """(r, 3) distance of each run from the median of all, in robust standard deviations; 0 where all are equal."""
        apart, spread = self.means - np.median(self.means, axis=0), self.spread
        return np.asarray(np.divide(apart, spread, out=np.zeros_like(apart), where=spread > 0))

    @cached_property
    def spread(self) -> Floats:
        """Robust standard deviation (3,) of the means, at least a fifth of the rms standard error `errors`: the means
        of a few hundred integers are often equal.
        """
        least = _LEAST_SPREAD * np.sqrt((self.errors**2).mean(axis=0))
        return np.asarray(np.maximum(robust_std(self.means), least))

    @property
    def joint_distance(self) -> Floats:
        """(r,) norm over the three axes of each run's `deviations` from the median."""
        return np.asarray(np.sqrt((self.deviations**2).sum(axis=1)))

    @cached_property
    def mean_profile(self) -> Floats:
        """Mean profile (16, 3) of the runs."""
        return np.asarray(self.profiles.mean(axis=0))


def divide(means: Floats, variances: Floats, least: int = _LEAST_GROUP) -> tuple[Booleans, float]:
    """Divide runs into the two groups that scatter least within themselves, along the direction of the largest scatter.

    `means` (r, k) of r runs on k axes; `variances` (r, k) of their errors. Returns which runs are in the group of the
    larger values, and the log of the ratio of the variance about a common mean to the variance within the groups, with
    each axis in units of its own scatter. A group has at least `least` runs. The ratio is nan with fewer runs than two
    groups need, or if no axis scatters.

    If all axes change between two states, hardly any variance remains within the groups; with a drift a quarter
    remains, and with normal scatter on independent axes a half.
    """
    count = len(means)
    total = means.var(axis=0) if count else np.zeros(means.shape[1])
    scattered = total > 0
    if count < 2 * least or not scattered.any():
        return np.zeros(count, bool), math.nan
    scaled = (means - means.mean(axis=0))[:, scattered] / np.sqrt(total[scattered])
    direction = np.linalg.svd(scaled, full_matrices=False)[2][0]
    order = np.argsort(scaled @ direction, kind="stable")
    size = np.arange(least, count - least + 1)
    sums = scaled[order].cumsum(axis=0)[size - 1]
    between = (sums**2).sum(axis=1) * (1 / size + 1 / (count - size))
    cut = int(between.argmax())
    noise = float((variances[:, scattered] / total[scattered]).sum())
    upper = np.zeros(count, bool)
    upper[order[size[cut] :]] = True
    whole = float(scattered.sum() * count)
    return upper, math.log((whole + noise) / (max(whole - between[cut], 0.0) + noise))


def runs_of(summaries: Sequence[Summary]) -> Runs:
    """Return the runs of one sensor from one summary per run, in the order of recording; summaries without rows are
    left out.
    """
    scale = 1 / summaries[0].header.sensitivity
    known = [summary for summary in summaries if summary.rows]
    means, errors, profiles = zip(*(_of_run(summary) for summary in known), strict=True) if known else ((), (), ())
    return Runs(
        summaries[0].header,
        scale * np.reshape(means, (-1, 3)),
        scale * np.reshape(errors, (-1, 3)),
        scale * np.reshape(profiles, (-1, PARTS, 3)),
    )


def _of_run(summary: Summary) -> tuple[Floats, Floats, Floats]:
    """Return the mean, its standard error and the profile of one run, in counts."""
    part = summary.segments
    has_rows, total = part.rows > 0, part.rows.sum()
    sums = np.where(has_rows[:, None], part.rows[:, None] * part.mean, 0.0)
    mean = sums.sum(axis=0) / total
    error = np.sqrt(part.rows[has_rows] @ part.variance[has_rows]) / total
    profile = [(sums[a:b].sum(axis=0), part.rows[a:b].sum()) for a, b in _spans(len(part.rows))]
    return mean, error, np.array([whole / rows - mean if rows else np.zeros(3) for whole, rows in profile])


@cache
def _spans(segments: int) -> list[tuple[int, int]]:
    """Return the segments [first, stop) of each part of the profile: at least one, the nearest to its middle."""
    edges = np.linspace(0, segments, PARTS + 1)
    middles = np.floor((edges[:-1] + edges[1:]) / 2).astype(int).tolist()
    bounds = np.rint(edges).astype(int).tolist()
    return [
        (a, b) if b > a else (middle, middle + 1) for a, b, middle in zip(bounds[:-1], bounds[1:], middles, strict=True)
    ]
