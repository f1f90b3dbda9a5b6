"""The least squares behind a noise fit: squared coefficients from Allan variances, weighted by their covariance.

Weights follow from the fit and the fit from the weights, alternately until they agree; no square is negative (Lawson
and Hanson, "Solving Least Squares Problems", 1974). Terms are numbers, their places in `TERMS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from imuarray.arrays import Floats
from imuarray.characterise.allan_covariance import TERMS, covariance, variances
from imuarray.characterise.allan_curve import Runs

_NEEDED = 5.41
"""Least growth of the misfit when a term is removed. One that is not there does so with a chance of 1 %: with 1/2 it is
fitted as zero, else its square has one degree of freedom."""

_SURE = 1.0
"""Half an interval as a share of the square, from which on zero is within it."""

_LEAST_SPREAD = 1e-6
"""Standard deviation of an Allan variance, as a share of it, at the least."""

_LEAST_SIZE = 1e-3
"""Least eigenvalue of their correlation; noise has 0.007 and more, and the sums behind it are taken to 0.003."""

_WHITE = TERMS.index("white")

_LEAST_KURTOSIS = -1.5
"""Readings of two codes have -2; their variance would be taken for exactly known."""

_TURNS = 30
_TURNS_OF_BOUND = 3
_CONVERGED = 1e-6


@dataclass(frozen=True)
class AllanEstimate:
    """Data of the fit: Allan variances (t,) at averaging factors of a series of `rows` values every `interval_s`.

    They are in units of `size` squared, in which the largest is 1. `kurtosis`: of the white noise, in excess of that of
    a normal distribution. `runs` of a series with gaps, whose estimates are independent.
    """

    variance: Floats
    size: float
    factors: tuple[int, ...]
    rows: int
    interval_s: float
    kurtosis: float = 0.0
    runs: Runs = ()
    _solutions: dict[tuple[int, ...], Solution] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def design(self) -> Floats:
        """Variance (t, 5) of each term whose coefficient is 1, an interval of 1 s assumed."""
        return np.stack([variances(term, np.array(self.factors)) for term in TERMS], axis=1)

    @cached_property
    def _weights(self) -> list[tuple[int, int, Floats]]:
        """Length and number of the runs of each length, and the share (t,) of the terms that one of them has."""
        runs = self.runs or ((self.rows, 1),)
        terms = np.array([[max(rows + 1 - 2 * m, 0) for m in self.factors] for rows, _ in runs], float)
        total = np.array([number for _, number in runs]) @ terms
        return [(rows, number, part / total) for (rows, number), part in zip(runs, terms, strict=True)]

    def whitener(self, theta: Floats) -> Floats:
        """Matrix (t, t) that makes the variances uncorrelated and of unit variance if `theta` is the truth.

        A ramp alone has no scatter, and quantisation alone hardly any: both are given a little.
        """
        decorrelated, spread = self._scatter(theta)
        return decorrelated / spread

    def solution(self, terms: Sequence[int]) -> Solution:
        """Squared coefficients of `terms`, fitted and weighted in turn; worked out once for each set of terms."""
        key = tuple(terms)
        if key not in self._solutions:
            self._solutions[key] = _solve(self, terms)
        return self._solutions[key]

    def misfit(self, theta: Floats) -> float:
        """Return how far the variances lie from what `theta` says; nearly chi-squared if it is the truth.

        By the cube roots of the variances: those of chi-squared numbers are nearly normal, even of few degrees of
        freedom (Wilson and Hilferty, PNAS 17, 1931).
        """
        model = self.design @ theta
        decorrelated, spread = self._scatter(theta)
        share = (spread / model) ** 2 / 9  # 2 / (9 degrees of freedom)
        roots = (np.cbrt(self.variance / model) - (1 - share)) / np.sqrt(share)
        return float(np.sum((decorrelated @ roots) ** 2))

    def _scatter(self, theta: Floats) -> tuple[Floats, Floats]:
        """Matrix (t, t) that decorrelates, and standard deviations (t,).

        A fourth cumulant k of independent readings adds k / (n m m') to the covariance of Allan variances at m and m':
        each is a quadratic form of the n readings whose diagonal is 1 / (n m), but for the ends of the series.
        """
        white = np.outer(*[theta[_WHITE] * self.design[:, _WHITE]] * 2)
        covariance_ = np.zeros_like(white)
        for rows, number, weights in self._weights:
            points = np.flatnonzero(weights)
            factors = tuple(self.factors[point] for point in points.tolist())
            some = covariance(factors, rows, theta)
            some = some + max(self.kurtosis, _LEAST_KURTOSIS) / rows * white[np.ix_(points, points)]
            covariance_[np.ix_(points, points)] += number * np.outer(weights[points], weights[points]) * some
        spread = np.sqrt(np.diag(covariance_) + (_LEAST_SPREAD * (self.design @ theta)) ** 2)
        sizes, ways = np.linalg.eigh(covariance_ / np.outer(spread, spread))
        return np.asarray((ways / np.sqrt(np.maximum(sizes, _LEAST_SIZE))).T), spread


@dataclass(frozen=True)
class Solution:
    """Squared coefficients (5,) by `TERMS`, their misfit, and what was fitted: whitened design (t, 5) and variances."""

    theta: Floats
    misfit: float
    design: Floats
    target: Floats


def needed(estimate: AllanEstimate, wanted: Sequence[int]) -> list[int]:
    """The terms that are needed: each is tested against the best fit without it, weighted as if it were not there."""
    terms = list(wanted)
    while len(terms) > 1:
        gains = {term: _gain(estimate, terms, term) for term in terms}
        least = min(gains, key=gains.__getitem__)
        if gains[least] >= _NEEDED:
            break
        terms.remove(least)
    return terms


def _gain(estimate: AllanEstimate, terms: Sequence[int], term: int) -> float:
    """Return the gain in fit by one of the terms over the others alone."""
    others = estimate.solution([other for other in terms if other != term])
    return others.misfit - _non_negative(others.design, others.target, terms)[1]


def _solve(estimate: AllanEstimate, terms: Sequence[int]) -> Solution:
    """Solve as `AllanEstimate.solution` does."""
    design = estimate.design
    theta, _ = _non_negative(design / estimate.variance[:, None], np.ones(len(estimate.variance)), terms)
    for _ in range(_TURNS):
        whitener, last = estimate.whitener(theta), theta
        white, target = whitener @ design, whitener @ estimate.variance
        theta, misfit = _non_negative(white, target, terms)
        if not theta.any():  # a curve so far from the terms that correlated residuals turn all of them away
            return Solution(last, float(np.sum((white @ last - target) ** 2)), white, target)
        if np.all(np.abs(design @ (theta - last)) <= _CONVERGED * (design @ last)):
            break
    return Solution(theta, misfit, white, target)


def _non_negative(design: Floats, target: Floats, terms: Sequence[int]) -> tuple[Floats, float]:
    """Least squares without negative coefficients, columns scaled alike: all coefficients, and the misfit."""
    from scipy.optimize import nnls

    chosen = list(terms)
    theta, scale = np.zeros(design.shape[1]), np.linalg.norm(design[:, chosen], axis=0)
    solution, residual = nnls(design[:, chosen] / scale, target)
    theta[chosen] = solution / scale
    return theta, float(residual) ** 2


def interval_of(
    estimate: AllanEstimate, term: int, terms: Sequence[int], confidence: float
) -> tuple[float, tuple[float, float]]:
    """Squared coefficient of one of the terms, and its interval.

    Normal in its logarithm; if zero is as near as the normal distribution's own lower end, from zero to where an
    estimate as low as this would be as rare.
    """
    from scipy.special import ndtri

    theta, z = estimate.solution(terms).theta.copy(), float(ndtri((1 + confidence) / 2))
    value, high = float(theta[term]), float(theta[term])
    share = z * _error(estimate, theta, term, terms) / value if value else np.inf
    if share < _SURE:
        return value, (value * np.exp(-share), value * np.exp(share))
    for _ in range(_TURNS_OF_BOUND):
        theta[term] = high
        high = value + z * _error(estimate, theta, term, terms)
    return value, (0.0, high)


def _error(estimate: AllanEstimate, theta: Floats, term: int, terms: Sequence[int]) -> float:
    """Standard error of one squared coefficient if `theta` are the true ones."""
    white = estimate.whitener(theta) @ estimate.design[:, list(terms)]
    scale = np.linalg.norm(white, axis=0)
    at = list(terms).index(term)
    return float(np.sqrt(np.linalg.pinv((white / scale).T @ (white / scale))[at, at]) / scale[at])
