"""How likely statistics of a recording are under a model, of which nothing but replicates is known.

Every statistic is compared with the middle and the scatter that the replicates have; Student's t with few degrees of
freedom keeps a single wild one from deciding, and what statistics say twice because they depend on each other counts
once: their sum is tempered by the share of them that is independent (Kish's effective number).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from imuarray.arrays import Booleans, Floats

FREEDOM = 5.0
"""Of the t distribution: z = 3, 10, 100 cost 3.1, 9.1 and 22.8 nats."""

FORM = 0.05
"""A model that moves a statistic may be wrong by that share of the shift and still be the right one: no effect has
exactly the form that the simulator gives it."""

STRANGE = 100.0
"""Scores are cut off here; a hypothesis under which a recorded statistic has no value is charged as much."""


@dataclass(frozen=True)
class SyntheticLikelihood:
    """What a model makes of n statistics: `location` and `scale` (n,), and where it `always` or `never` says
    something. Where draws of an effect take it to different places, as of a bias with two states, these are the
    `branches` (k, n), each as wide as things scatter without the effect (`width`).
    """

    location: Floats
    scale: Floats
    always: Booleans
    never: Booleans
    branches: Floats | None = None
    width: Floats | None = None

    def scores(self, values: Floats) -> Floats:
        """(..., n) signed distances in standard deviations, at most `STRANGE`; nan where one side has no value: what is
        missing is not different.
        """
        return np.asarray(np.clip((values - self.location) / self.scale, -STRANGE, STRANGE))

    def log_density(self, values: Floats, moved: Floats | None = None) -> Floats:
        """(n,) of each statistic, 0 where the recording or the model has no value; `moved` (n,) is how far the model's
        own effects moved it, of which the form may be wrong. A model under which a recorded statistic vanishes pays.
        """
        form = np.zeros_like(values) if moved is None else FORM * np.nan_to_num(np.abs(moved))
        scale = np.hypot(np.where(np.isfinite(self.scale), self.scale, 1.0), form)
        strange = np.isfinite(values) & self.never
        density = _student(values - self.location, scale)
        if self.branches is not None and self.width is not None:
            width = np.hypot(np.where(np.isfinite(self.width), self.width, 1.0), form)
            each = _student(values - self.branches, width)
            apart = logsumexp(each, axis=0) - np.log(len(each))
            known = np.isfinite(apart) & np.isfinite(density)
            density[known] = np.logaddexp(density[known], apart[known]) - np.log(2)
        density = np.where(self._is_silent(values), 0.0, density)
        costly = -(FREEDOM + 1) / 2 * np.log1p(STRANGE**2 / FREEDOM) - np.log(scale)
        return np.asarray(np.where(strange, costly, np.nan_to_num(density)))

    def of(self, chosen: Booleans) -> SyntheticLikelihood:
        """That of some of the statistics."""
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
        """(n,) what the fit makes the same in every replicate."""
        return np.asarray(self.scale < _SAME * (1 + np.abs(self.location)))

    def _is_silent(self, values: Floats) -> Booleans:
        """(n,) where that goes for the recording too."""
        return np.asarray(self.is_silent & (np.abs(values - self.location) < 10 * _SAME * (1 + np.abs(self.location))))


def _student(apart: Floats, scale: Floats) -> Floats:
    """Log density but for a constant, of differences from the middle."""
    scores = np.clip(apart / scale, -STRANGE, STRANGE)
    return np.asarray(-(FREEDOM + 1) / 2 * np.log1p(scores**2 / FREEDOM) - np.log(scale))


def likeness_of(replicates: Floats, floor: Floats) -> SyntheticLikelihood:
    """Of replicates (b, n); `floor` (n,) is the least scatter that means anything."""
    spoken = np.isfinite(replicates)
    count = np.count_nonzero(spoken, axis=0)
    known = count > len(replicates) // 2
    location, scale = np.full((2, replicates.shape[1]), np.nan)
    if known.any():
        location[known] = _median(replicates[:, known])
        scale[known] = _scatter(replicates[:, known], location[known])
    least = np.maximum(floor, _ROUNDING * (1 + np.abs(location)))
    return SyntheticLikelihood(
        location, np.fmax(scale, least), np.asarray(spoken.all(axis=0)), np.asarray(~spoken.any(axis=0))
    )


def independent_share(scores: Floats) -> float:
    """Share of n statistics that is independent of the others, from their scores (b, n) in b replicates: 1 over the
    mean of each one's summed squared correlations, less what b replicates make of nothing.
    """
    known = np.isfinite(scores).all(axis=0)
    given = np.clip(scores[:, known], -_CLIPPED, _CLIPPED)
    spread = given.std(axis=0)
    given = (given - given.mean(axis=0))[:, spread > 0] / spread[spread > 0]
    count, statistics = given.shape
    if statistics < 2:
        return 1.0
    gram = given @ given.T / count  # its squares sum to those of all correlations
    squares = float((gram**2).sum())
    chance = statistics * (statistics - 1) / (count - 1)
    return float(min(1.0, statistics / max(squares - chance, statistics)))


def _scatter(values: Floats, middle: Floats) -> Floats:
    """(n,) standard deviation about the middle, of values not further from it than five of their median distances."""
    apart = np.abs(values - middle)
    limit = 5 * 1.4826 * _median(apart)
    near = np.where(limit > 0, np.minimum(apart, np.where(limit > 0, limit, 1.0)), apart)
    count = np.count_nonzero(np.isfinite(values), axis=0)
    return np.asarray(np.sqrt(np.nansum(near**2, axis=0) / np.maximum(count - 1, 1)))


def _median(values: Floats) -> Floats:
    """(n,) of what is known of (b, n); numpy's takes four times as long, for numbers that may be missing twenty."""
    whole = np.isfinite(values).all(axis=0)
    found = np.empty(values.shape[1])
    ordered = np.sort(values[:, whole], axis=0)
    found[whole] = (ordered[(len(values) - 1) // 2] + ordered[len(values) // 2]) / 2
    found[~whole] = np.nanmedian(values[:, ~whole], axis=0)
    return found


_ROUNDING = 1e-9
_SAME = 1e-7
_CLIPPED = 8.0
