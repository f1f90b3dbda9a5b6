"""Confidence of an Allan variance: which noise it is made of, and its equivalent degrees of freedom.

An overlapping Allan variance is the mean of squared second differences of the integrated series, and these are
correlated. For Gaussian noise whose second differences have the correlation rho(j) at lag j, the mean of M squares
has::

    edf = M / sum over |j| < M of (1 - |j|/M) rho(j)^2

degrees of freedom (Greenhall and Riley, "Uncertainty of stability variances based on finite differences", PTTI 2003;
Riley, NIST SP 1065, "Confidence intervals"), and edf * estimate / truth is nearly chi-squared.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt

Noise = Literal["white", "flicker", "random walk"]
"""Power laws of the series itself: spectrum flat, 1/f, 1/f^2; slope of the Allan deviation -1/2, 0, +1/2."""

MIN_AVERAGES = 30
"""Fewer averages than this don't tell the noise type (SP 1065, "Lag 1 autocorrelation")."""

_POINTS = 64
"""Lags per averaging factor in the sum above; more change the result by less than a thousandth."""

_REACH = 32
"""Lags beyond this many averaging factors are negligible: for flicker rho falls as lag^-2, for the others it ends at 2.
"""


@cache
def degrees_of_freedom(noise: Noise, factor: int, terms: int, stride: int = 1) -> float:
    """Equivalent degrees of freedom of an overlapping Allan variance: `terms` squares at an averaging `factor`.

    The terms start at every `stride`-th row. Sums over many lags are taken over every step-th of them.
    """
    step = max(1, min(factor // stride, terms) // _POINTS)
    lags = np.arange(0, min(terms, _REACH * factor // stride), step)
    shares = (1 - lags / terms) * _correlation(noise, lags * stride / factor, factor) ** 2
    return float(terms / (step * (2 * shares.sum() - shares[0])))


def _correlation(noise: Noise, lag: npt.NDArray[np.float64], factor: int) -> npt.NDArray[np.float64]:
    """Correlation of second differences at lags in units of the averaging factor; ``lag[0]`` is 0.

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
    """Noise type of averages (n,) over `factor` values each; None if there are fewer than `MIN_AVERAGES`.

    A straight line is taken out. With the lag-1 autocorrelation r, r / (1 + r) is 0 for white noise and 1/2 for flicker
    noise (Riley and Greenhall, "Power law noise identification using the lag 1 autocorrelation", EFTF 2004); what is
    nearer to white noise, or falls faster, is white. The rest is told apart by r of the differences, which averaging
    changes: -0.22 for flicker noise, from 0 at factor 1 to 1/4 for a random walk.
    """
    if len(averages) < MIN_AVERAGES:
        return None
    series = _without_line(averages)
    r = _lag1(series)
    if r < 1 / 3:
        return "white"
    unit_lag = np.array([0.0, 1.0])
    limit = (_correlation("flicker", unit_lag, factor)[1] + _correlation("random walk", unit_lag, factor)[1]) / 2
    return "flicker" if _lag1(np.diff(series)) < limit else "random walk"


def _without_line(series: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Residual from the least-squares line."""
    at = np.arange(len(series)) - (len(series) - 1) / 2
    centred = series - series.mean()
    return np.asarray(centred - at * (at @ centred / (at @ at)))


def _lag1(series: npt.NDArray[np.float64]) -> float:
    """Lag-1 autocorrelation; 0 for a constant series."""
    centred = series - series.mean()
    power = float(centred @ centred)
    return float(centred[1:] @ centred[:-1]) / power if power > 0 else 0.0


def interval(
    deviation: npt.NDArray[np.float64], freedom: npt.NDArray[np.float64], confidence: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Ends of the interval of deviations by the chi-squared distribution (SP 1065, "Confidence intervals")."""
    from scipy.special import gammaincinv  # the inverse chi-squared distribution without the weight of scipy.stats

    tail = (1 - confidence) / 2
    low = deviation * np.sqrt(freedom / (2 * gammaincinv(freedom / 2, 1 - tail)))
    high = deviation * np.sqrt(freedom / (2 * gammaincinv(freedom / 2, tail)))
    return low, high
