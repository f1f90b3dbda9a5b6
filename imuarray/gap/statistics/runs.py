"""The same sensor in several logs of one kind, such as a turn-on series: variation from run to run, and the common
profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.recording.outliers import robust_std
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader

PARTS = 16
"""Points of a run's profile."""

_LEAST_SPREAD = 0.2


@dataclass(frozen=True)
class Runs:
    """Runs of one sensor, in its unit, along its own axes.

    `means` (r, 3); `errors` (r, 3), their standard errors if readings in a run are independent; `profiles` (r, 16, 3),
    the mean over parts of each run less the run's mean.
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
        """Robust standard deviation (3,) of the means, at least a fifth of that of independent readings: means of the
        same few hundred integers are often equal.
        """
        least = _LEAST_SPREAD * np.sqrt((self.errors**2).mean(axis=0))
        return np.asarray(np.maximum(robust_std(self.means), least))

    @property
    def joint_distance(self) -> Floats:
        """(r,) distance of each run from the median over all three axes."""
        return np.asarray(np.sqrt((self.deviations**2).sum(axis=1)))

    @property
    def gaps(self) -> Floats:
        """Distances (r - 1, 3) of neighbours among the sorted means."""
        return np.diff(np.sort(self.means, axis=0), axis=0)

    @cached_property
    def mean_profile(self) -> Floats:
        """Mean profile (16, 3) of the runs."""
        return np.asarray(self.profiles.mean(axis=0))


def runs_of(summaries: Sequence[Summary]) -> Runs:
    """Return the runs of one sensor, each by the phase that represents it, in the order of recording."""
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
    """Return the mean, its error and profile of one run, in counts."""
    part = summary.segments
    has_rows, total = part.rows > 0, part.rows.sum()
    sums = np.where(has_rows[:, None], part.rows[:, None] * part.mean, 0.0)
    mean = sums.sum(axis=0) / total
    error = np.sqrt(part.rows[has_rows] @ part.variance[has_rows]) / total
    profile = [(sums[a:b].sum(axis=0), part.rows[a:b].sum()) for a, b in _spans(len(part.rows))]
    return mean, error, np.array([whole / rows - mean if rows else np.zeros(3) for whole, rows in profile])


@cache
def _spans(segments: int) -> list[tuple[int, int]]:
    """Segments [first, stop) of each part of the profile; at least one, the nearest."""
    edges = np.linspace(0, segments, PARTS + 1)
    middles = np.floor((edges[:-1] + edges[1:]) / 2).astype(int).tolist()
    bounds = np.rint(edges).astype(int).tolist()
    return [
        (a, b) if b > a else (middle, middle + 1) for a, b, middle in zip(bounds[:-1], bounds[1:], middles, strict=True)
    ]
