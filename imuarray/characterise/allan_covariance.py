"""Covariance of Allan variances at different averaging times, for the noise of a model.

Averaging factors m and m' see the same series, so that their estimates are correlated. With second differences D of the
integrated series, M terms at m, M' at m', and Gaussian noise (the fourth moment of normal variables)::

    cov(avar_m, avar_m') = 1 / (4 m^2 m'^2 M M') * sum over i, j of (2 r(j - i)^2 + 4 mu mu' r(j - i))

where r is the covariance of D at m and D at m', a ninefold difference of the generalised autocovariance of the
integrated noise, and mu their mean, which a ramp alone makes other than 0 (Greenhall and Riley, "Uncertainty of
stability variances based on finite differences", PTTI 2003, who need m = m' only). r is linear in the squares of the
model's coefficients, so that the sums are taken once for a length of series and hold for every model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import log, pi
from typing import Literal

import numpy as np

from imuarray.arrays import Floats

Term = Literal["quantisation", "white", "flicker", "random walk", "ramp"]
"""The terms of an Allan variance, with their slopes: -2, -1, 0, 1, 2 (IEEE Std 952, annex C)."""

TERMS: tuple[Term, ...] = ("quantisation", "white", "flicker", "random walk", "ramp")

RANDOM: tuple[Term, ...] = TERMS[:-1]

_FINE = 12
"""Lags per averaging factor near the kinks of r; twice as many change a correlation by less than 0.003."""

_FAR = 12.0
"""Beyond this multiple of the longer factor, r of flicker noise is computed from its fourth derivative: less rounding.
"""

_WIDER = 1.06
"""Lags far from the kinks stand so much further from them each."""


def variances(term: Term, factor: Floats) -> Floats:
    """Allan variance at averaging factors (t,) of one term whose coefficient is 1, an interval of 1 s assumed.

    3 Q^2 / tau^2, N^2 / tau, (2 ln 2 / pi) B^2, K^2 tau / 3 and R^2 tau^2 / 2 (IEEE Std 952, annex C). The random walk
    is that of the readings, which step from one to the next: (2 m^2 + 1) / (6 m), which tends to m / 3.
    """
    m = np.asarray(factor, float)
    if term == "quantisation":
        return 3 / m**2
    if term == "white":
        return 1 / m
    if term == "flicker":
        return np.full_like(m, 2 * log(2) / pi)
    return (2 * m**2 + 1) / (6 * m) if term == "random walk" else m**2 / 2


def _autocovariance(term: Term, lag: Floats) -> Floats:
    """Generalised autocovariance of the integrated noise at lags in rows, coefficient and interval 1."""
    size = np.abs(lag)
    if term == "quantisation":
        return np.asarray(size == 0, float)
    if term == "white":
        return -size / 2
    if term == "flicker":
        return size**2 * np.log(np.where(size > 0, size, 1.0)) / (2 * pi)
    return (size**3 - size) / 12


@dataclass(frozen=True)
class Sums:
    """Sums over all pairs of starts, over 4 m^2 m'^2 M M', for t factors: `squares` (t, t, 4, 4) of r of one term
    times r of another, and `means` (t, t, 4) of r of one term; terms as in `RANDOM`.
    """

    squares: Floats
    means: Floats


def covariance(factors: tuple[int, ...], rows: int, theta: Floats) -> Floats:
    """Covariance (t, t) of Allan variances of a series of `rows` values; `theta` (5,) squared coefficients by `TERMS`.

    An interval of 1 s is assumed. Every start counts; the decimated estimator scatters by a hundredth or two more.
    """
    sums = _sums(factors, rows)
    random, ramp = theta[:-1], theta[-1]
    m = np.array(factors, float)
    gaussian = 2 * (sums.squares @ random @ random)
    return np.asarray(gaussian + 4 * ramp * np.outer(m**2, m**2) * (sums.means @ random))


@lru_cache(maxsize=64)
def _sums(factors: tuple[int, ...], rows: int) -> Sums:
    count, kinds = len(factors), len(RANDOM)
    squares, means = np.zeros((count, count, kinds, kinds)), np.zeros((count, count, kinds))
    for i, m in enumerate(factors):
        for j in range(i, count):
            n = factors[j]
            lags, starts, gaps = _lags(m, n, rows)
            r = np.array([_cross(term, lags, m, n) for term in RANDOM])
            weights = np.where(np.arange(kinds)[:, None] == 0, 1.0, gaps) * starts  # quantisation: at single lags only
            scale = 4.0 * m**2 * n**2 * (rows + 1 - 2 * m) * (rows + 1 - 2 * n)
            products = (r * weights) @ r.T
            products[:, 0] = products[0]
            squares[i, j] = squares[j, i] = products / scale
            means[i, j] = means[j, i] = (r * weights).sum(axis=1) / scale
    return Sums(squares, means)


def _cross(term: Term, lags: Floats, m: int, n: int) -> Floats:
    """Covariance of second differences: at distance m from some start, at n from `lags` rows later."""
    binomial = (1, -2, 1)
    shifts = np.array([b * n - a * m for a in range(3) for b in range(3)], float)
    signs = np.outer(binomial, binomial).ravel().astype(float)
    products = np.asarray(signs @ _autocovariance(term, lags + shifts[:, None]))
    if term == "quantisation":
        return products
    if term == "flicker":
        away = np.abs(lags + n - m)
        far = away > _FAR * n
        return np.where(far, -((m * n / np.where(far, away, 1.0)) ** 2) / pi, products)
    apart = (lags >= 2 * m) | (lags <= -2 * n)  # nothing in common; what is left of |lag|^3 there is rounding
    return np.where(apart, 0.0, products)


def _lags(m: int, n: int, rows: int) -> tuple[Floats, Floats, Floats]:
    """Lags at which r is taken, m <= n; how many pairs of starts have each, and how many lags each stands for.

    Close together where r has kinks, near three multiples of n; further away ever wider apart.
    """
    first, last = -(rows - 2 * m), rows - 2 * n
    near = np.arange(0, 3 * _FINE + 1) / _FINE
    far = 3 * _WIDER ** np.arange(1, 1 + np.ceil(np.log(max(2 * rows / (3 * m), 1)) / np.log(_WIDER)))
    around = m * np.concatenate([-far[::-1], -near[:0:-1], near, far])
    lags = np.unique(np.clip(np.rint(np.concatenate([m - b * n + around for b in range(3)])), first, last))
    gaps = np.diff(lags, prepend=lags[0] - 1, append=lags[-1] + 1)
    starts = np.minimum(rows + 1 - 2 * m, rows + 1 - 2 * n - lags) - np.maximum(0, -lags)
    return lags, starts, (gaps[1:] + gaps[:-1]) / 2
