"""An Allan curve: deviations at averaging times, their confidence intervals, and the type of noise at each.

Two coefficients are read off it. For white noise of two-sided spectral density N^2 the Allan deviation is N / sqrt(tau)
(IEEE Std 952, annex C: angle random walk). Data sheets give the one-sided density, sqrt(2) N, which for white readings
is std / sqrt(rate / 2). The floor of flicker noise with the coefficient B is B sqrt(2 ln 2 / pi) = 0.664 B (the same
annex: bias instability).

Confidence: an overlapping Allan variance is the mean of squared second differences of the integrated series, and these
are correlated. For Gaussian noise whose second differences have the correlation rho(j) at lag j, the mean of M squares
has::

    edf = M / sum over |j| < M of (1 - |j|/M) rho(j)^2

degrees of freedom (Greenhall and Riley, "Uncertainty of stability variances based on finite differences", PTTI 2003;
Riley, NIST SP 1065, "Confidence intervals"), and edf * estimate / truth is nearly chi-squared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import log, pi, sqrt
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Noise = Literal["white", "flicker", "random walk"]
"""Power laws of the series itself: spectrum flat, 1/f, 1/f^2; slope of the Allan deviation -1/2, 0, +1/2."""

MIN_AVERAGES = 30
"""Fewest averages from which the noise type is identified (SP 1065, "Lag 1 autocorrelation")."""

_POINTS = 64
"""Lags per averaging factor in the sum above; more change the result by less than a thousandth."""

_REACH = 32
"""Lags beyond this many averaging factors are negligible: for flicker rho falls as lag^-2, for the others it ends at 2.
"""


@cache
def degrees_of_freedom(noise: Noise, factor: int, terms: int, stride: int = 1) -> float:
    """Return the equivalent degrees of freedom of an overlapping Allan variance: `terms` squares at an averaging
    `factor`.

    The terms start at every `stride`-th row. Sums over many lags are taken over every step-th of them.
    """
    step = max(1, min(factor // stride, terms) // _POINTS)
    lags = np.arange(0, min(terms, _REACH * factor // stride), step)
    shares = (1 - lags / terms) * _correlation(noise, lags * stride / factor, factor) ** 2
    return float(terms / (step * (2 * shares.sum() - shares[0])))


def _correlation(noise: Noise, lag: npt.NDArray[np.float64], factor: int) -> npt.NDArray[np.float64]:
    """Return the correlation of second differences at lags in units of the averaging factor; ``lag[0]`` is 0.

    The fourth difference of the integrated noise's generalised autocovariance. For white noise and its running sum it
    is exact at every factor; flicker noise is taken as continuous, which is the limit of long factors.
    """

    def covariance(at: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        size = np.abs(at)
        if noise == "white":
            return size
        if noise == "flicker":
            return size**2 * np.log(np.where(size > 0, size, 1.0))
        return size**3 - size / factor**2

    fourth = (
        6 * covariance(lag)
        - 4 * (covariance(lag + 1) + covariance(lag - 1))
        + covariance(lag + 2)
        + covariance(lag - 2)
    )
    return np.asarray(fourth / fourth[0])


def identify_noise(averages: npt.NDArray[np.float64], factor: int = 1) -> Noise | None:
    """Return the noise type of averages (n,) over `factor` values each; None if there are fewer than `MIN_AVERAGES`.

    A straight line is taken out. With the lag-1 autocorrelation r, r / (1 + r) is 0 for white noise and 1/2 for flicker
    noise (Riley and Greenhall, "Power law noise identification using the lag 1 autocorrelation", EFTF 2004); noise with
    a ratio nearer to that of white noise, or below it, is white. The others are distinguished by r of the differences,
    which averaging changes: -0.22 for flicker noise, from 0 at factor 1 to 1/4 for a random walk.
    """
    if len(averages) < MIN_AVERAGES:
        return None
    series = _detrend(averages)
    r = _lag1(series)
    if r < 1 / 3:
        return "white"
    unit_lag = np.array([0.0, 1.0])
    limit = (_correlation("flicker", unit_lag, factor)[1] + _correlation("random walk", unit_lag, factor)[1]) / 2
    return "flicker" if _lag1(np.diff(series)) < limit else "random walk"


def _detrend(series: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the residual from the least-squares line."""
    at = np.arange(len(series)) - (len(series) - 1) / 2
    centred = series - series.mean()
    return np.asarray(centred - at * (at @ centred / (at @ at)))


def _lag1(series: npt.NDArray[np.float64]) -> float:
    """Return the lag-1 autocorrelation; 0 for a constant series."""
    centred = series - series.mean()
    power = float(centred @ centred)
    return float(centred[1:] @ centred[:-1]) / power if power > 0 else 0.0


def interval(
    deviation: npt.NDArray[np.float64], freedom: npt.NDArray[np.float64], confidence: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return ends of the interval of deviations by the chi-squared distribution (SP 1065, "Confidence intervals")."""
    from scipy.special import gammaincinv  # the inverse chi-squared distribution; scipy.stats is slow to import

    tail = (1 - confidence) / 2
    low = deviation * np.sqrt(freedom / (2 * gammaincinv(freedom / 2, 1 - tail)))
    high = deviation * np.sqrt(freedom / (2 * gammaincinv(freedom / 2, tail)))
    return low, high


CONFIDENCE = 0.95
"""Share of intervals that contain the true deviation."""

IDENTIFY = 8192
"""The largest number of averages from which the noise type is estimated: their autocorrelation is then known to 0.01.
"""

STARTS = 8
"""Fewest starts of the decimated estimator per averaging time; more starts add hardly any information."""


Runs = tuple[tuple[int, int], ...]
"""Lengths of the runs without a gap in a series, and the number of runs of each length; empty for a single run."""


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviations in the unit of the series: a row per tau, and a column per column of a 2-D series.

    `tau_s`, `terms` (squares averaged) and `stride` (rows between their starts, 1: fully overlapping) are (t,);
    `deviation`, `low` and `high` (ends of its confidence interval), `freedom` (equivalent degrees of freedom) and
    `noise` (the type that the interval assumes) are (t,) or (t, k). The series had `rows` values, one every
    `interval_s`; `kurtosis`, () or (k,), is the excess kurtosis of its white noise (0: Gaussian). A series with gaps is
    several `runs` (lengths, their number); no term spans a gap.
    """

    tau_s: npt.NDArray[np.float64]
    deviation: npt.NDArray[np.float64]
    terms: npt.NDArray[np.int64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    freedom: npt.NDArray[np.float64]
    noise: npt.NDArray[np.str_]
    stride: npt.NDArray[np.int64]
    interval_s: float
    rows: int
    kurtosis: npt.NDArray[np.float64]
    runs: Runs = ()

    def column(self, number: int) -> AllanCurve:
        """Return the curve of one column of a two-dimensional series."""
        parts = {name: getattr(self, name)[:, number] for name in ("deviation", "low", "high", "freedom", "noise")}
        return replace(self, **parts, kurtosis=self.kurtosis[number])


@dataclass(frozen=True)
class SeriesShape:
    """Length of a series, time between its rows, and shape of a row: () for one column alone, (k,) for k of them;
    `runs` if it has gaps.
    """

    rows: int
    interval_s: float
    columns: tuple[int, ...]
    runs: Runs = ()

    @property
    def parts(self) -> Runs:
        """The runs, a single one too."""
        return self.runs or ((self.rows, 1),)


@dataclass(frozen=True)
class DifferenceMoments:
    """Moments of one column, per averaging factor: `sums` of squared second differences, and the first, or the middle,
    `averages` side by side; `kurtosis` of its white noise.
    """

    sums: Sequence[float]
    averages: Sequence[npt.NDArray[np.float64]]
    kurtosis: float = 0.0


_BLOCK = 32768
"""Values of a column that are processed at once."""


class ChangeMoments:
    """Second and fourth moment of the changes of a column from row to row, block by block."""

    def __init__(self) -> None:
        self._last: npt.NDArray[np.float64] = np.zeros(0)
        self._number, self._squares, self._fourths = 0, 0.0, 0.0
        self._scale = 0.0  # fourth powers of any unit would overflow

    def feed(self, values: npt.NDArray[Any]) -> None:
        """Add the next values (n,)."""
        for start in range(0, len(values), _BLOCK):
            block = np.concatenate([self._last, np.asarray(values[start : start + _BLOCK], np.float64)])
            self._add(np.diff(block))
            self._last = block[-1:]

    def feed_pairs(self, values: npt.NDArray[Any], in_one_run: npt.NDArray[np.bool_]) -> None:
        """Add the changes between values (n,) that `in_one_run` (n - 1,) marks."""
        self._add(np.diff(np.asarray(values, np.float64))[in_one_run])

    def _add(self, changes: npt.NDArray[np.float64]) -> None:
        self._scale = self._scale or float(np.abs(changes).max(initial=0.0))
        squares = (changes / (self._scale or 1.0)) ** 2
        self._number += len(squares)
        self._squares += float(squares.sum())
        self._fourths += float(np.einsum("i,i", squares, squares))  # for "@", OpenBLAS would start threads

    def kurtosis(self) -> float:
        """Return the excess kurtosis of the white noise in the column: twice that of the changes, because the fourth
        cumulants and the variances of two readings add up. A drift hardly affects the changes. 0 for a constant column.
        """
        if not self._squares:
            return 0.0
        return 2 * (self._fourths * self._number / self._squares**2 - 3)


def octaves(rows: int) -> tuple[int, ...]:
    """Return the averaging factors 1, 2, 4, ... up to a third of `rows`; longer averaging times have too few terms."""
    return tuple(1 << power for power in range(max(rows // 3, 1).bit_length()))


def stride_of(factor: int) -> int:
    """Return the rows between the starts of the decimated estimator: the largest divisor of `factor` up to an eighth of
    it.

    It is a divisor so that the running sum is needed only at multiples of the stride.
    """
    limit = factor // STARTS
    return next((stride for stride in range(limit, 0, -1) if factor % stride == 0), 1)


def make_curve(
    columns: Sequence[DifferenceMoments],
    factors: Sequence[int],
    strides: Sequence[int],
    series: SeriesShape,
    confidence: float,
) -> AllanCurve:
    """Return the curve of a series from the moments of its columns at each factor."""
    rows, interval_s, shape = series.rows, series.interval_s, series.columns
    m, stride = np.array(factors, np.int64), np.array(strides, np.int64)
    pairs_of_run = np.array(
        [np.maximum(length // stride + 1 - 2 * (m // stride), 0) for length, _ in series.parts]
    )  # (r, t)
    number = np.array([count for _, count in series.parts])
    terms = number @ pairs_of_run
    sums = np.array([column.sums for column in columns]).T.reshape(len(m), *shape)
    across = (slice(None), *[None] * len(shape))
    deviations = np.sqrt(sums / (2.0 * terms[across])) / m[across]
    noises = [_noises(column.averages, factors) for column in columns]
    points = list(zip(factors, pairs_of_run.T.tolist(), strides, strict=True))
    counts = number.tolist()
    freedom = [
        [
            _pooled_freedom(noise, m, counts, per_run, step)
            for noise, (m, per_run, step) in zip(row, points, strict=True)
        ]
        for row in noises
    ]
    freedoms = np.array(freedom).T.reshape(deviations.shape)
    low, high = interval(deviations, freedoms, confidence)
    kinds = np.array(noises).T.reshape(deviations.shape)
    tau_s = m * np.float64(interval_s)
    kurtosis = np.array([column.kurtosis for column in columns]).reshape(shape)
    return AllanCurve(
        tau_s, deviations, terms, low, high, freedoms, kinds, stride, float(interval_s), rows, kurtosis, series.runs
    )


def _pooled_freedom(noise: Noise, factor: int, number: Sequence[int], terms: Sequence[int], stride: int) -> float:
    """Return the degrees of freedom of the mean over all runs: `number` independent runs have `terms` terms each."""
    used = [(count, size) for count, size in zip(number, terms, strict=True) if size > 0]
    total = sum(count * size for count, size in used)
    return total**2 / sum(count * size**2 / degrees_of_freedom(noise, factor, size, stride) for count, size in used)


def _noises(averages: Sequence[npt.NDArray[np.float64]], factors: Sequence[int]) -> list[Noise]:
    """Return the noise type at each factor; a factor with too few averages has the type of the next shorter one."""
    noises: dict[int, Noise] = {}
    for m, values in sorted(zip(factors, averages, strict=True), key=lambda pair: pair[0]):
        noises[m] = identify_noise(values, m) or (list(noises.values()) or ["white"])[-1]
    return [noises[m] for m in factors]


FLOOR = sqrt(2 * log(2) / pi)
"""Floor of the Allan deviation over the coefficient of bias instability: 0.664."""

_SPAN = 8.0
"""Ratio of averaging times over which the slope is computed: three octaves, about a decade."""

_SLOPE_TOLERANCES = (0.02, 0.05, 0.1)
"""Largest deviations of the slope from -1/2. They are tried in this order, so that the part of a curve that agrees best
with white noise is used.
"""

_SLOPE_FREEDOM = 20.0
"""Fewest degrees of freedom of a point from which a slope is computed."""

_FLOOR_FREEDOM = 5.0
"""Fewest degrees of freedom of the lowest point; points with fewer scatter too much."""


@dataclass(frozen=True)
class WhiteNoiseEstimate:
    """`density` N in unit / sqrt(Hz), two-sided, and the range of taus from which it was estimated."""

    density: float
    shortest_s: float
    longest_s: float


@dataclass(frozen=True)
class Floor:
    """`instability` B in the series' unit from the lowest point of the curve, that point's interval (as B) and its tau.

    `is_bound`: the lowest point is at an end of the curve, so that the floor itself was not measured.
    """

    instability: float
    low: float
    high: float
    tau_s: float
    is_bound: bool


def white_noise(
    tau_s: npt.NDArray[np.float64], deviation: npt.NDArray[np.float64], freedom: npt.NDArray[np.float64]
) -> WhiteNoiseEstimate | None:
    """Estimate white noise from the shortest three octaves of one curve (t,) with slope -1/2; None if no part has that
    slope.
    """
    if deviation.min() <= 0:
        return None
    parts = list(_parts(tau_s, freedom))
    for tolerance in _SLOPE_TOLERANCES:
        for part in parts:
            if _excess(tau_s[part], deviation[part], float(freedom[part][-1])) <= tolerance:
                density = float(np.exp(np.mean(np.log(deviation[part] * np.sqrt(tau_s[part])))))
                return WhiteNoiseEstimate(density, float(tau_s[part][0]), float(tau_s[part][-1]))
    return None


def _parts(tau_s: npt.NDArray[np.float64], freedom: npt.NDArray[np.float64]) -> Iterator[slice]:
    """Yield the parts of a curve that span three octaves with enough degrees of freedom, shortest taus first."""
    for first in range(len(tau_s)):
        last = int(np.searchsorted(tau_s, _SPAN * tau_s[first] * (1 - 1e-9)))
        if last < len(tau_s) and freedom[last] >= _SLOPE_FREEDOM:
            yield slice(first, last + 1)


def _excess(tau_s: npt.NDArray[np.float64], deviation: npt.NDArray[np.float64], freedom: float) -> float:
    """Return the difference of the slope from -1/2 beyond two standard errors, which are those of the last point."""
    span = np.log(tau_s) - np.log(tau_s).mean()
    slope = float(span @ np.log(deviation) / (span @ span))
    error = 1 / sqrt(2 * freedom) / float(span[-1] - span[0])
    return abs(slope + 0.5) - 2 * error


def floor(
    tau_s: npt.NDArray[np.float64],
    deviation: npt.NDArray[np.float64],
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
    freedom: npt.NDArray[np.float64],
) -> Floor | None:
    """Return the lowest point of one curve (t,) among those with enough degrees of freedom; None if no point has
    enough, or for a constant series.
    """
    sure = np.flatnonzero(freedom >= _FLOOR_FREEDOM)
    if len(sure) == 0 or deviation.min() <= 0:
        return None
    at = int(sure[np.argmin(deviation[sure])])
    value, least, most = (float(ends[at]) / FLOOR for ends in (deviation, low, high))
    return Floor(value, least, most, float(tau_s[at]), at in (sure[0], sure[-1]))
