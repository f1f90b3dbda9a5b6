"""Least squares in correlated noise: white noise plus a first-order Gauss-Markov process.

Means of segments of a sensor's output are correlated, because its bias wanders. Their covariance is modelled as::

    C[i, j] = (1 - white) exp(-|t_i - t_j| / correlation time) + white (i = j),     times an unknown variance

Correlation time and white share are unknown, and uncertainties from the best-fitting pair alone are too small.
Therefore a grid of pairs is used, which is refined around the likely ones. Each pair is weighted by its restricted
likelihood (Harville, J. Am. Stat. Assoc. 72, 1977, p. 320); their differences are part of the variance.

The differences of neighbours z_i = y_i - r_i y_(i-1), r_i = exp(-dt_i / correlation time), have a tridiagonal
covariance, so every pair costs one pass over the data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats

_CELLS = 6
_ENOUGH = 8.0
"""Effective number of grid points under the likelihood; with fewer the grid is refined."""

_RIDGE = 1e-12
"""Relative ridge for the normal equations of collinear regressors, whose standard errors become very large."""

_LOG_ODDS = (-4.0, 6.0)
"""Limits of the log odds of the white share: 0.02 to 0.998."""


@dataclass(frozen=True)
class CorrelatedNoise:
    """A correlation time and the share of the variance that is white."""

    correlation_s: float
    white: float


def likely_noises(
    score: Callable[[Sequence[CorrelatedNoise]], Floats], shortest_s: float, longest_s: float
) -> tuple[CorrelatedNoise, ...]:
    """Return a grid of noises (g) around the likely ones; `score` returns their log likelihoods (g,). Correlation times
    are between `shortest_s` and `longest_s`.
    """
    box = np.array([np.log([shortest_s, max(longest_s, 2 * shortest_s)]), _LOG_ODDS])
    for _ in range(4):
        points = np.array(list(product(*(np.linspace(low, high, _CELLS) for low, high in box))))
        noises = tuple(CorrelatedNoise(float(np.exp(time)), float(1 / (1 + np.exp(-odds)))) for time, odds in points)
        share = weights(score(noises))
        if 1 / (share**2).sum() > _ENOUGH:
            break
        centre = share @ points
        reach = np.maximum(3 * np.sqrt(share @ (points - centre) ** 2), np.diff(box)[:, 0] / (_CELLS - 1))
        box = np.clip(np.stack([centre - reach, centre + reach], axis=1), box[:, :1], box[:, 1:])
    return noises


def products(columns: Floats, gaps_s: Floats, noise: CorrelatedNoise) -> tuple[Floats, float]:
    """Return ``columns.T @ inverse(C) @ columns`` (k, k) for columns (n, k), and the logarithm of C's determinant.

    `gaps_s` (n - 1,) are the times between neighbours; an infinite gap separates two independent series.
    """
    from scipy.linalg.lapack import dpttrf, dpttrs  # slow to import

    decay = np.exp(-gaps_s / noise.correlation_s)
    steps = columns.copy()
    steps[1:] -= decay[:, None] * columns[:-1]
    diagonal = np.concatenate([[1.0], (1 - noise.white) * (1 - decay**2) + noise.white * (1 + decay**2)])
    diagonal, subdiagonal, _ = dpttrf(diagonal, -noise.white * decay)
    solved, _ = dpttrs(diagonal, subdiagonal, steps)
    return np.asarray(steps.T @ solved), float(np.log(diagonal).sum())


def regress(sums: Floats, log_determinant: Floats, rows: int) -> tuple[Floats, Floats]:
    """Solve least squares from `products` (g, 1 + p, 1 + p) of a series (first) and its p regressors, over `rows`,
    under g noises. Return the coefficients' covariances (g, p, p) and log restricted likelihoods (g,).
    """
    cross = sums[..., 1:, 0]
    inner = sums[..., 1:, 1:] * (1 + _RIDGE * np.eye(sums.shape[-1] - 1))
    inverse = np.linalg.inv(inner)
    freedom = rows - inner.shape[-1]
    remaining = sums[..., 0, 0] - np.einsum("...i,...ij,...j->...", cross, inverse, cross)
    # The residual of a series that is exactly a combination of its regressors is zero.
    remaining = np.maximum(remaining, 1e-12 * np.maximum(sums[..., 0, 0], 1e-300))
    likelihood = -(log_determinant + np.linalg.slogdet(inner)[1] + freedom * np.log(remaining)) / 2
    return (remaining / freedom)[..., None, None] * inverse, likelihood


def weights(log_likelihood: Floats, axis: int | tuple[int, ...] = -1) -> Floats:
    """Return likelihoods divided by their sum along `axis`."""
    raised = np.exp(log_likelihood - log_likelihood.max(axis=axis, keepdims=True))
    return np.asarray(raised / raised.sum(axis=axis, keepdims=True))


@dataclass(frozen=True)
class MeanVariance:
    """Estimated variance of a run's mean: values (g,) under g noises, the probabilities `share` (g,) of these, and the
    degrees of freedom of each value.
    """

    values: Floats
    share: Floats
    own_freedom: int

    @property
    def mean(self) -> float:
        """The expected variance."""
        return float(self.share @ self.values)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of a chi-squared of this mean and variance."""
        scatter = float(self.share @ (self.values**2 * (1 + 2 / self.own_freedom))) - self.mean**2
        return 2 * self.mean**2 / scatter if scatter > 0 else float(self.own_freedom)

    def chance_of(self, variance: float, freedom: int) -> float:
        """Return the probability that run means that differ by this noise alone have this variance or a larger one: the
        upper tail of F, averaged over the noises.
        """
        from scipy.special import fdtrc  # slow to import

        ratios = variance / np.maximum(self.values, 1e-300)
        return float(self.share @ fdtrc(freedom, self.own_freedom, ratios))


def mean_of_series(values: Floats, gaps_s: Floats, starts: npt.NDArray[np.int64]) -> MeanVariance:
    """Return the variance of the mean of a run, averaged over several runs.

    `values` (n,) are all runs in sequence, with infinite `gaps_s` (n - 1,) between runs, which begin at rows `starts`
    (r,). All runs have the same noise and different means.
    """
    finite = gaps_s[np.isfinite(gaps_s)]
    lengths = np.diff([*starts, len(values)])
    member = np.zeros((len(values), len(starts)))
    member[np.arange(len(values)), np.repeat(np.arange(len(starts)), lengths)] = 1.0
    step = float(np.median(finite)) if len(finite) else 1.0
    centred = values - np.repeat(np.add.reduceat(values, starts) / lengths, lengths)
    columns = np.column_stack([centred, member])

    def fit(noises: Sequence[CorrelatedNoise]) -> tuple[Floats, Floats]:
        sums = [products(columns, gaps_s, noise) for noise in noises]
        return regress(np.array([total for total, _ in sums]), np.array([total for _, total in sums]), len(values))

    noises = likely_noises(lambda grid: fit(grid)[1], step / 2, 2 * step * float(lengths.max()))
    covariances, likelihood = fit(noises)
    variances = np.diagonal(covariances, axis1=-2, axis2=-1).mean(axis=1)
    return MeanVariance(variances, weights(likelihood), len(values) - len(starts))
