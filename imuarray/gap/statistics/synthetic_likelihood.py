"""Synthetic likelihood: the likelihood of a recording's statistics under a model that can only be simulated.

Every statistic is compared with the median and the scatter of the replicates. Student's t with few degrees of freedom
limits the influence of a single extreme statistic, and the sum of log densities is multiplied by the share of the
statistics that is independent (Kish's effective number), so that dependent ones do not count twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from imuarray.arrays import Booleans, Floats

FREEDOM = 5.0
"""Degrees of freedom of the t distribution: z = 3, 10, 100 cost 3.1, 9.1 and 22.8 nats."""

FORM = 0.05
"""Relative error that is assumed for the shift of a statistic by an effect, since no effect has exactly the form that
is simulated.
"""

OUTLIER_SHARE = 0.1
"""Share of the replicates that may be outliers without widening the scatter of the others."""

LARGEST_SCORE = 100.0
"""Limit of scores, and the score of a statistic that has a value in the recording but never under a hypothesis."""


@dataclass(frozen=True)
class SyntheticLikelihood:
    """Distribution of n statistics under a model: `location` and `scale` (n,), and which statistics `always` or `never`
    have a value.

    If an effect has several possible outcomes, as a bias with two states has, `branches` (k, n) are the locations of
    these outcomes, each with the scatter `width` (n,) without the effect.
    """

    location: Floats
    scale: Floats
    always: Booleans
    never: Booleans
    branches: Floats | None = None
    width: Floats | None = None

    def scores(self, values: Floats) -> Floats:
        """Return signed deviations (..., n) in standard deviations, limited to `LARGEST_SCORE`; nan where the values or
        the model have no value, since a missing statistic does not count as a difference.
        """
        return np.asarray(np.clip((values - self.location) / self.scale, -LARGEST_SCORE, LARGEST_SCORE))

    def log_density(self, values: Floats, shift: Floats | None = None) -> Floats:
        """Return the log density (n,) of each statistic, 0 where the recording or the model has no value.

        `shift` (n,) is the shift by the effects of the model, whose form may be slightly wrong (`FORM`). A recorded
        statistic that never has a value under the model has the density of `LARGEST_SCORE`.
        """
        form = np.zeros_like(values) if shift is None else FORM * np.nan_to_num(np.abs(shift))
        scale = np.hypot(np.where(np.isfinite(self.scale), self.scale, 1.0), form)
        strange = np.isfinite(values) & self.never
        density = _student(values - self.location, scale)
        if self.branches is not None and self.width is not None:
            width = np.hypot(np.where(np.isfinite(self.width), self.width, 1.0), form)
            each = _student(values - self.branches, width)
            of_branches = logsumexp(each, axis=0) - np.log(len(each))
            known = np.isfinite(of_branches) & np.isfinite(density)
            density[known] = np.logaddexp(density[known], of_branches[known]) - np.log(2)
        density = np.where(self._is_silent(values), 0.0, density)
        costly = -(FREEDOM + 1) / 2 * np.log1p(LARGEST_SCORE**2 / FREEDOM) - np.log(scale)
        return np.asarray(np.where(strange, costly, np.nan_to_num(density)))

    def of(self, chosen: Booleans) -> SyntheticLikelihood:
        """Return the distribution of the `chosen` statistics."""
        return SyntheticLikelihood(
            self.location[chosen],
            self.scale[chosen],
            self.always[chosen],
            self.never[chosen],
            None if self.branches is None else self.branches[:, chosen],
            None if self.width is None else self.width[chosen],
        )

    @property
    def is_silent(self) -> Booleans:
        """Mask (n,) of the statistics that the fit makes equal in all replicates."""
        return np.asarray(self.scale < _SAME * (1 + np.abs(self.location)))

    def _is_silent(self, values: Floats) -> Booleans:
        """Return the mask (n,) of the statistics that also have this value in the recording."""
        return np.asarray(self.is_silent & (np.abs(values - self.location) < 10 * _SAME * (1 + np.abs(self.location))))


def _student(deviations: Floats, scale: Floats) -> Floats:
    """Return the log density of deviations from the location, up to an additive constant."""
    scores = np.clip(deviations / scale, -LARGEST_SCORE, LARGEST_SCORE)
    return np.asarray(-(FREEDOM + 1) / 2 * np.log1p(scores**2 / FREEDOM) - np.log(scale))


def likelihood_of(replicates: Floats, floor: Floats) -> SyntheticLikelihood:
    """Return the distribution of statistics from replicates (b, n); `floor` (n,) is the least scale of each."""
    has_value = np.isfinite(replicates)
    count = np.count_nonzero(has_value, axis=0)
    known = count > len(replicates) // 2
    location, scale = np.full((2, replicates.shape[1]), np.nan)
    if known.any():
        location[known] = _median(replicates[:, known])
        scale[known] = _scatter(replicates[:, known], location[known])
    least = np.maximum(floor, _ROUNDING * (1 + np.abs(location)))
    return SyntheticLikelihood(
        location, np.fmax(scale, least), np.asarray(has_value.all(axis=0)), np.asarray(~has_value.any(axis=0))
    )


def independent_share(scores: Floats) -> float:
    """Return the share of n statistics that is independent, from their scores (b, n) in b replicates: the inverse of
    the mean, over statistics, of the sum of squared correlations, less the sum expected by chance in b replicates.
    """
    known = np.isfinite(scores).all(axis=0)
    standard_scores = np.clip(scores[:, known], -_CLIPPED, _CLIPPED)
    spread = standard_scores.std(axis=0)
    standard_scores = (standard_scores - standard_scores.mean(axis=0))[:, spread > 0] / spread[spread > 0]
    count, statistics = standard_scores.shape
    if statistics < 2:
        return 1.0
    gram = standard_scores @ standard_scores.T / count  # the sum of its squares equals that of all correlations
    squares = float((gram**2).sum())
    chance = statistics * (statistics - 1) / (count - 1)
    return float(min(1.0, statistics / max(squares - chance, statistics)))


def _scatter(values: Floats, middle: Floats) -> Floats:
    """Return the standard deviation (n,) about the median. Deviations are limited to five robust standard deviations,
    or to the `1 - OUTLIER_SHARE` quantile if that is larger: a statistic that scatters widely in half of the replicates
    and hardly in the others, as turn-on biases do, has no outliers.
    """
    deviations = np.abs(values - middle)
    robust = 5 * 1.4826 * _median(deviations)
    limit = np.where(robust > 0, np.maximum(robust, _quantile(deviations, 1 - OUTLIER_SHARE)), 0.0)
    near = np.where(limit > 0, np.minimum(deviations, np.where(limit > 0, limit, 1.0)), deviations)
    count = np.count_nonzero(np.isfinite(values), axis=0)
    return np.asarray(np.sqrt(np.nansum(near**2, axis=0) / np.maximum(count - 1, 1)))


def _quantile(values: Floats, share: float) -> Floats:
    """Return the quantile (n,) of the finite values of (b, n): the least value that at least the `share` of them does
    not exceed.
    """
    count = np.count_nonzero(np.isfinite(values), axis=0)
    places = np.maximum(np.ceil(share * count).astype(int) - 1, 0)
    return np.asarray(np.sort(values, axis=0)[places, np.arange(values.shape[1])])  # nan is sorted to the end


def _median(values: Floats) -> Floats:
    """Return the median (n,) of the finite values of (b, n); `numpy.median` takes four times as long, and with missing
    values twenty times.
    """
    whole = np.isfinite(values).all(axis=0)
    medians = np.empty(values.shape[1])
    ordered = np.sort(values[:, whole], axis=0)
    medians[whole] = (ordered[(len(values) - 1) // 2] + ordered[len(values) // 2]) / 2
    medians[~whole] = np.nanmedian(values[:, ~whole], axis=0)
    return medians


_ROUNDING = 1e-9
"""Least scale of a statistic, relative to 1 plus the size of its location."""

_SAME = 1e-7
"""Scale, relative to 1 plus the size of the location, below which a statistic counts as equal in all replicates."""

_CLIPPED = 8.0
"""Limit of the scores from which correlations are computed."""
