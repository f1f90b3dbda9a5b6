"""Noise coefficients fitted to an Allan curve, with intervals and a verdict on the fit.

The Allan variance of a sum of independent noises is the sum of theirs (IEEE Std 952, annex C; the squares of the
coefficients are fitted, none below zero)::

    avar(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3 + R^2 tau^2 / 2

Q, quantisation, is that of an integrating sensor that counts increments of angle or velocity; rounding the readings of
a rate to whole counts adds to N instead. N is white noise (angle random walk), B flicker noise (bias instability), K a
random walk of the reading (rate random walk), R a ramp.

Estimates at neighbouring tau are computed from the same rows. They are weighted by the inverse of their covariance
under the fitted noise (generalised least squares; weights and fit alternate until they agree; no square is negative:
Lawson and Hanson, "Solving Least Squares Problems", 1974). The sum of squared residuals is nearly chi-squared; a small
tail probability shows that the curve is not a sum of these noises. In simulations 1 % of good fits are rejected, for
short and for long series.

Covariance: the estimates at averaging factors m and m' are computed from the same series and are therefore correlated.
With second differences D of the integrated series, M terms at m, M' at m', and Gaussian noise (the fourth moment of
normal variables)::

    cov(avar_m, avar_m') = 1 / (4 m^2 m'^2 M M') * sum over i, j of (2 r(j - i)^2 + 4 mu mu' r(j - i))

where r is the covariance of D at m and D at m', a ninefold difference of the generalised autocovariance of the
integrated noise, and mu is their mean, which is 0 without a ramp (Greenhall and Riley, "Uncertainty of stability
variances based on finite differences", PTTI 2003, for m = m'). r is linear in the squares of the model's coefficients,
so that the sums are computed once for each length of series and hold for every model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import log, pi
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.characterise.allan_curve import CONFIDENCE, AllanCurve, Runs
from imuarray.kernels import non_negative
from imuarray.printable import percent, series

Term = Literal["quantisation", "white", "flicker", "random walk", "ramp"]
"""The terms of an Allan variance, with their slopes: -2, -1, 0, 1, 2 (IEEE Std 952, annex C)."""

TERMS: tuple[Term, ...] = ("quantisation", "white", "flicker", "random walk", "ramp")

RANDOM: tuple[Term, ...] = TERMS[:-1]

_FINE = 12
"""Lags per averaging factor near the kinks of r; twice as many change a correlation by less than 0.003."""

_FAR = 12.0
"""Multiple of the longer factor beyond which r of flicker noise is computed from its fourth derivative, which has a
smaller rounding error.
"""

_WIDER = 1.06
"""Ratio of neighbouring lags far from the kinks."""


_MOST_LENGTHS = 24
"""Largest number of lengths of runs for which covariances are computed: a log of a night with stalls has hundreds of
lengths, most of them short.
"""


def merge_similar(runs: Runs) -> Runs:
    """Return the runs (rows, number). If they have more than `_MOST_LENGTHS` different lengths, runs of similar lengths
    are replaced by the same number of runs of their mean length: covariances change little within a tenth of the
    length.
    """
    if len(runs) <= _MOST_LENGTHS:
        return runs
    rows, number = np.array(runs, float).T
    edges = np.geomspace(rows.min(), rows.max(), _MOST_LENGTHS + 1)
    groups = np.clip(np.searchsorted(edges, rows, side="right"), 1, _MOST_LENGTHS)
    grouped = []
    for group in np.unique(groups):
        inside = groups == group
        count = number[inside].sum()
        grouped.append((round(float(rows[inside] @ number[inside] / count)), int(count)))
    return tuple(grouped)


def variances(term: Term, factor: Floats) -> Floats:
    """Return the Allan variance at averaging factors (t,) of one term whose coefficient is 1, an interval of 1 s
    assumed.

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
    """Return the generalised autocovariance of the integrated noise at lags in rows, coefficient and interval 1."""
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
    """Return the covariance (t, t) of Allan variances of a series of `rows` values; `theta` (5,) squared coefficients
    by `TERMS`.

    An interval of 1 s is assumed. Every start counts; the decimated estimator scatters by a hundredth or two more.
    """
    sums = _sums(factors, rows)
    random, ramp = theta[:-1], theta[-1]
    gaussian = 2 * (sums.squares.reshape(*sums.squares.shape[:2], -1) @ np.outer(random, random).ravel())
    if not ramp:
        return np.asarray(gaussian)
    m = np.array(factors, float)
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
            weights = np.where(np.arange(kinds)[:, None] == 0, 1.0, gaps) * starts  # quantisation: single lags only
            scale = 4.0 * m**2 * n**2 * (rows + 1 - 2 * m) * (rows + 1 - 2 * n)
            products = (r * weights) @ r.T
            products[:, 0] = products[0]
            squares[i, j] = squares[j, i] = products / scale
            means[i, j] = means[j, i] = (r * weights).sum(axis=1) / scale
    return Sums(squares, means)


def _cross(term: Term, lags: Floats, m: int, n: int) -> Floats:
    """Return covariance of a second difference at distance m with one at distance n that starts `lags` rows later."""
    binomial = (1, -2, 1)
    shifts = np.array([b * n - a * m for a in range(3) for b in range(3)], float)
    signs = np.outer(binomial, binomial).ravel().astype(float)
    products = np.asarray(signs @ _autocovariance(term, lags + shifts[:, None]))
    if term == "quantisation":
        return products
    if term == "flicker":
        distance = np.abs(lags + n - m)
        far = distance > _FAR * n
        return np.where(far, -((m * n / np.where(far, distance, 1.0)) ** 2) / pi, products)
    is_disjoint = (lags >= 2 * m) | (lags <= -2 * n)  # no rows in common; the remainder of |lag|^3 is rounding
    return np.where(is_disjoint, 0.0, products)


def _lags(m: int, n: int, rows: int) -> tuple[Floats, Floats, Floats]:
    """Return the lags at which r is taken, for m <= n; the number of pairs of starts at each lag; and the number of
    lags that each represents.

    Lags are dense where r has kinks, near three multiples of n, and increasingly sparse elsewhere.
    """
    first, last = -(rows - 2 * m), rows - 2 * n
    near = np.arange(0, 3 * _FINE + 1) / _FINE
    far = 3 * _WIDER ** np.arange(1, 1 + np.ceil(np.log(max(2 * rows / (3 * m), 1)) / np.log(_WIDER)))
    around = m * np.concatenate([-far[::-1], -near[:0:-1], near, far])
    lags = np.unique(np.clip(np.rint(np.concatenate([m - b * n + around for b in range(3)])), first, last))
    gaps = np.diff(lags, prepend=lags[0] - 1, append=lags[-1] + 1)
    starts = np.minimum(rows + 1 - 2 * m, rows + 1 - 2 * n - lags) - np.maximum(0, -lags)
    return lags, starts, (gaps[1:] + gaps[:-1]) / 2


_NEEDED = 5.41
"""Growth of the misfit on removal of a term from which on the term is needed. A term that is truly zero exceeds it with
a probability of 1 %: it is fitted as zero with probability 1/2, and otherwise the growth is chi-squared with one degree
of freedom.
"""

_SURE = 1.0
"""Half-width of an interval, relative to the squared coefficient, from which on the interval includes zero."""

_LEAST_SPREAD = 1e-6
"""Least relative standard deviation of an Allan variance."""

_LEAST_SIZE = 1e-3
"""Least eigenvalue of the correlation of the variances; noise has at least 0.007, and the sums are exact to 0.003."""

_WHITE = TERMS.index("white")

_LEAST_KURTOSIS = -1.5
"""Least excess kurtosis that is used. Readings with only two codes have -2, for which the computed error of the
variance would be 0.
"""

_TURNS = 30
_TURNS_OF_BOUND = 3
_CONVERGED = 1e-6


class _RunWeights(NamedTuple):
    """Runs of `rows` rows: the `factors` at which they have terms, their `places` in a matrix over all factors, and the
    shares in its entries of all these runs together.
    """

    rows: int
    factors: tuple[int, ...]
    places: tuple[npt.NDArray[np.intp], ...]
    shares: Floats


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
    _solutions: dict[tuple[int, ...], AllanSolution] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def design(self) -> Floats:
        """Variance (t, 5) of each term whose coefficient is 1, an interval of 1 s assumed."""
        return np.stack([variances(term, np.array(self.factors)) for term in TERMS], axis=1)

    @cached_property
    def _weights(self) -> list[_RunWeights]:
        """Return the runs of each length, with the share of the terms that one of them has."""
        runs = merge_similar(self.runs) or ((self.rows, 1),)
        terms = np.array([[max(rows + 1 - 2 * m, 0) for m in self.factors] for rows, _ in runs], float)
        total = np.array([number for _, number in runs]) @ terms
        listed = []
        for (rows, number), part in zip(runs, terms, strict=True):
            weights = part / total
            points = np.flatnonzero(weights)
            factors = tuple(self.factors[point] for point in points.tolist())
            shares = number * np.outer(weights[points], weights[points])
            listed.append(_RunWeights(rows, factors, np.ix_(points, points), shares))
        return listed

    def whitener(self, theta: Floats) -> Floats:
        """Return the matrix (t, t) that makes the variances uncorrelated and of unit variance if `theta` is the truth.

        A ramp alone has no scatter and quantisation alone hardly any: for both, `_LEAST_SPREAD` is assumed.
        """
        decorrelated, spread = self._scatter(theta)
        return decorrelated / spread

    def solution(self, terms: Sequence[int]) -> AllanSolution:
        """Return the squared coefficients of `terms`, alternately fitted and weighted; computed once for each set of
        terms.
        """
        key = tuple(terms)
        if key not in self._solutions:
            self._solutions[key] = _solve(self, terms)
        return self._solutions[key]

    def misfit(self, theta: Floats) -> float:
        """Return the misfit of the variances with respect to `theta`; nearly chi-squared if that is the truth.

        It uses the cube roots of the variances, because those of chi-squared numbers are nearly normal, even with few
        degrees of freedom (Wilson and Hilferty, PNAS 17, 1931).
        """
        model = self.design @ theta
        decorrelated, spread = self._scatter(theta)
        share = (spread / model) ** 2 / 9  # 2 / (9 degrees of freedom)
        roots = (np.cbrt(self.variance / model) - (1 - share)) / np.sqrt(share)
        return float(np.sum((decorrelated @ roots) ** 2))

    def _scatter(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the matrix (t, t) that decorrelates, and standard deviations (t,).

        A fourth cumulant k of independent readings adds k / (n m m') to the covariance of Allan variances at m and m':
        each is a quadratic form of the n readings whose diagonal is 1 / (n m), but for the ends of the series.
        """
        white = np.outer(*[theta[_WHITE] * self.design[:, _WHITE]] * 2)
        covariance_ = np.zeros_like(white)
        for rows, factors, places, shares in self._weights:
            of_factors = covariance(factors, rows, theta)
            of_factors = of_factors + max(self.kurtosis, _LEAST_KURTOSIS) / rows * white[places]
            covariance_[places] += shares * of_factors
        spread = np.sqrt(np.diag(covariance_) + (_LEAST_SPREAD * (self.design @ theta)) ** 2)
        sizes, ways = np.linalg.eigh(covariance_ / np.outer(spread, spread))
        return np.asarray((ways / np.sqrt(np.maximum(sizes, _LEAST_SIZE))).T), spread


@dataclass(frozen=True)
class AllanSolution:
    """Squared coefficients (5,) by `TERMS`, their misfit, and the whitened design (t, 5) and whitened variances (t,)
    that they were fitted to.
    """

    theta: Floats
    misfit: float
    design: Floats
    target: Floats


def needed(estimate: AllanEstimate, fitted_terms: Sequence[int]) -> list[int]:
    """Return the needed terms; each is tested against the best fit without it, with that fit's weights."""
    terms = list(fitted_terms)
    while len(terms) > 1:
        gains = {term: _gain(estimate, terms, term) for term in terms}
        weakest = min(gains, key=gains.__getitem__)
        if gains[weakest] >= _NEEDED:
            break
        terms.remove(weakest)
    return terms


def _gain(estimate: AllanEstimate, terms: Sequence[int], term: int) -> float:
    """Return the gain in fit by one of the terms over the others alone."""
    without_term = estimate.solution([other for other in terms if other != term])
    return without_term.misfit - _non_negative(without_term.design, without_term.target, terms)[1]


def _solve(estimate: AllanEstimate, terms: Sequence[int]) -> AllanSolution:
    """Solve as described in `AllanEstimate.solution`."""
    design = estimate.design
    theta, _ = _non_negative(design / estimate.variance[:, None], np.ones(len(estimate.variance)), terms)
    for _ in range(_TURNS):
        whitener, last = estimate.whitener(theta), theta
        white, target = whitener @ design, whitener @ estimate.variance
        theta, misfit = _non_negative(white, target, terms)
        if not theta.any():  # the curve is so far from the terms that correlated residuals exclude all of them
            return AllanSolution(last, float(np.sum((white @ last - target) ** 2)), white, target)
        if np.all(np.abs(design @ (theta - last)) <= _CONVERGED * (design @ last)):
            break
    return AllanSolution(theta, misfit, white, target)


def _non_negative(design: Floats, target: Floats, terms: Sequence[int]) -> tuple[Floats, float]:
    """Solve least squares without negative coefficients, columns scaled alike: all coefficients, and the misfit."""
    included = list(terms)
    theta, scale = np.zeros(design.shape[1]), np.linalg.norm(design[:, included], axis=0)
    columns = design[:, included] / scale
    solution = non_negative(columns, target)
    if solution is None:
        from scipy.optimize import nnls  # its import takes longer than all fits of a log

        solution = nnls(columns, target)[0]
    theta[included] = solution / scale
    return theta, float(np.sum((columns @ solution - target) ** 2))


def interval_of(
    estimate: AllanEstimate, term: int, terms: Sequence[int], confidence: float
) -> tuple[float, tuple[float, float]]:
    """Return the squared coefficient of one of the terms, and its interval.

    The interval is normal in the logarithm; if it includes zero, it extends from zero to the true value for which an
    estimate this low has the same tail probability.
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
    """Return the standard error of one squared coefficient if `theta` are the true ones."""
    white = estimate.whitener(theta) @ estimate.design[:, list(terms)]
    scale = np.linalg.norm(white, axis=0)
    at = list(terms).index(term)
    return float(np.sqrt(np.linalg.pinv((white / scale).T @ (white / scale))[at, at]) / scale[at])


UNITS: dict[Term, str] = {
    "quantisation": "{unit} s",
    "white": "{unit}/sqrt(Hz)",
    "flicker": "{unit}",
    "random walk": "{unit}/sqrt(s)",
    "ramp": "{unit}/s",
}
"""The unit of each coefficient, for a series in `unit`."""

USUAL: tuple[Term, ...] = ("white", "flicker", "random walk")

BAD = 0.01
"""Significance level of a bad fit."""

_POWERS: dict[Term, float] = {"quantisation": 1.0, "white": 0.5, "flicker": 0.0, "random walk": -0.5, "ramp": -1.0}
"""Power of seconds in the unit of each coefficient."""

_FREEDOM = 5.0
"""Fewest degrees of freedom of a point in the fit; the scatter of others is too far from normal for least squares."""

_ROUNDING = 1e-12
"""Deviations below this share of the largest one are rounding errors, for example of readings that repeat."""


@dataclass(frozen=True)
class NoiseTerm:
    """One term of the fit: `value` with the ends of its interval in `unit`, composed of the series' unit and seconds.

    A term that is not `significant` has the value 0 and the interval from 0 to its upper limit.
    """

    term: Term
    value: float
    low: float
    high: float
    unit: str
    significant: bool


@dataclass(frozen=True)
class NoiseFit:
    """Coefficients of the requested terms, and the quality of the fit.

    `p_value`: the probability of a misfit of at least `misfit` (with `freedom` degrees) if the curve is a sum of these
    noises; nan without degrees of freedom. `deviation` is the fitted curve at `tau_s`; at `worst_tau_s` the measured
    one differs most, by the factor `worst_ratio`. `verdict` is empty for a good fit.
    """

    coefficients: tuple[NoiseTerm, ...]
    p_value: float
    misfit: float
    freedom: int
    tau_s: Floats
    deviation: Floats
    worst_ratio: float
    worst_tau_s: float
    verdict: str

    def __getitem__(self, term: Term) -> NoiseTerm:
        """Return the coefficient of one term; KeyError."""
        return {item.term: item for item in self.coefficients}[term]


def fit_noise(
    curve: AllanCurve,
    column: int = 0,
    terms: Sequence[Term] = USUAL,
    unit: str = "",
    shortest_s: float = 0.0,
    confidence: float = CONFIDENCE,
) -> NoiseFit | None:
    """Fit a sum of `terms` to one column of the curve from `shortest_s` on; None with fewer than two usable points.

    Points are usable if their deviation is not 0 (except for rounding) and they have at least 5 degrees of freedom;
    with fewer points than terms only the first terms are fitted. Terms are removed one after the other, the least
    needed first, as long as the misfit grows by less than 5.41. (A term that is not in the data is kept with a
    probability of 1 % in theory and 1 to 3 % in simulations. Weak flicker noise and a weak random walk can be mistaken
    for each other, and their intervals allow for that.) Low-pass filtered readings should be fitted from a few of the
    filter's time constants on: `shortest_s`. Flicker noise is taken as continuous; sampled without a filter its
    variance is higher by 44 % at the first factor, 5 % at 4 and 0.5 % at 16. ValueError for no or unknown terms.
    """
    if not terms or set(terms) - set(TERMS):
        raise ValueError(f"terms are one or more of {', '.join(TERMS)}, not {', '.join(terms) or 'none'}")
    points = _points(curve, column, shortest_s)
    if len(points) < 2:
        return None
    factors = np.rint(curve.tau_s[points] / curve.interval_s).astype(int)
    deviation = curve.deviation.reshape(len(curve.tau_s), -1)[points, column]
    size = float(deviation.max())
    kurtosis = float(curve.kurtosis.reshape(-1)[column])
    estimate = AllanEstimate(
        (deviation / size) ** 2, size, tuple(factors.tolist()), curve.rows, curve.interval_s, kurtosis, curve.runs
    )
    fitted_terms = [at for at, term in enumerate(TERMS) if term in terms][: len(points)]
    included = needed(estimate, fitted_terms)
    coefficients = tuple(
        _coefficient(estimate, term, included, fitted_terms, unit, confidence) for term in fitted_terms
    )
    return _assess(estimate, estimate.solution(included), len(included), coefficients)


def _points(curve: AllanCurve, column: int, shortest_s: float) -> npt.NDArray[np.intp]:
    """Return the indices of the points of the curve that carry information, shortest tau first, each once."""
    count = len(curve.tau_s)
    deviation, freedom = (part.reshape(count, -1)[:, column] for part in (curve.deviation, curve.freedom))
    sure = (freedom >= _FREEDOM) & (deviation > _ROUNDING * deviation.max())
    _, first = np.unique(curve.tau_s, return_index=True)
    inside = curve.tau_s[first] >= shortest_s * (1 - 1e-9)
    return np.asarray(first[inside & sure[first]])


def _coefficient(
    estimate: AllanEstimate,
    term: int,
    included: Sequence[int],
    fitted_terms: Sequence[int],
    unit: str,
    confidence: float,
) -> NoiseTerm:
    """Return the value and interval of one term in its unit.

    It comes from the fit with the terms that are needed (and this one) and from that with all of them, so that the
    interval allows for a removed term that is similar to this one. The interval of white noise is the mean of both: in
    simulations with other noise, from none to strong, it contains the true value in 92 to 98 % of cases. The intervals
    of the other terms, which are more similar to one another, span both.
    """
    significant, name = term in included, TERMS[term]
    models = [sorted({*included, term}), list(fitted_terms)]
    values, ends = zip(*(interval_of(estimate, term, terms, confidence) for terms in models), strict=True)
    if name == "white":
        low, high = (sum(end[side] for end in ends) / len(ends) for side in range(2))
    else:
        low, high = min(low for low, _ in ends), max(high for _, high in ends)
    squares = (values[0], low, high) if significant else (0.0, 0.0, high)
    scale = estimate.size * estimate.interval_s ** _POWERS[name]
    value, low, high = (float(np.sqrt(square)) * scale for square in squares)
    return NoiseTerm(name, value, low, high, UNITS[name].format(unit=unit), significant)


def _assess(
    estimate: AllanEstimate, solution: AllanSolution, count: int, coefficients: tuple[NoiseTerm, ...]
) -> NoiseFit:
    """Return the fit with its tail probability and the verdict."""
    from scipy.special import gammaincc  # the chi-squared distribution; scipy.stats is slow to import

    freedom = len(estimate.factors) - count
    misfit = estimate.misfit(solution.theta)
    p_value = float(gammaincc(freedom / 2, misfit / 2)) if freedom else float("nan")
    tau_s, fitted = np.array(estimate.factors) * estimate.interval_s, np.sqrt(estimate.design @ solution.theta)
    ratio = np.sqrt(estimate.variance) / fitted
    worst = int(np.argmax(np.abs(np.log(ratio))))
    verdict = _verdict(p_value, float(ratio[worst]), float(tau_s[worst]), coefficients)
    return NoiseFit(
        coefficients,
        p_value,
        misfit,
        freedom,
        tau_s,
        estimate.size * fitted,
        float(ratio[worst]),
        float(tau_s[worst]),
        verdict,
    )


def _verdict(p_value: float, ratio: float, tau_s: float, coefficients: Sequence[NoiseTerm]) -> str:
    """Describe the problem of a bad fit; empty for a good one."""
    if not p_value <= BAD:
        return ""
    terms = series([item.term for item in coefficients])
    share = f"{percent(abs(ratio - 1), 1)} {'above' if ratio > 1 else 'below'}"
    return (
        f"no sum of {terms} fits this curve (p = {p_value:.1g}): a line spectrum, a drift or a filter; it lies up to "
        f"{share} the fit, at tau = {tau_s:.3g} s, and the intervals do not hold"
    )
