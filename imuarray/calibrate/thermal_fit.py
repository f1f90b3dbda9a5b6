"""One sensor through one heating: a parabola in its lagged temperature and a line in time, under noise that remembers.

Per axis ``counts = offset + slope (T - reference) + quadratic (T - reference)^2 + drift t + noise``, T behind a
first-order lag that the three axes share. The lag has no closed form: a grid of lags is fitted and each is as heavy as
its likelihood, so that not knowing it is part of a slope's standard error.

The curvature is in every fit, significant or not. Without it a ramp that spent most of its time at one end would tell
the slope at that end, with an error that knows nothing of the rest, and a lag would be taken for the curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri, stdtrit

from imuarray.calibrate.correlated import Noise, Regression, likely_noises, products, regress, weights
from imuarray.calibrate.segments import Segments, Thermometer

Floats = npt.NDArray[np.float64]

_LAGS = 16
_WHITE = Noise(1.0, 1.0)
_LONGEST_LAG = 1 / 4
"""Of the time that the log covers: a slower lag is not told from drift."""

_INTERVAL_DROP = 1.92
"""Half the 95 % quantile of chi-squared with one degree of freedom: a likelihood interval's ends."""

_CURVED = 1e-3
"""A quadratic term is told if chance alone gave as large a one with less than this probability."""

_FEWEST_FREE = 16.0
"""Degrees of freedom that a variance is taken to have at least. With 3 intervals of 95 % held the truth in 99 % of
warmings by one ramp, with none at all (infinitely many) in 87 % where the wander is half of the white noise.
"""

_STRAIGHT = 1e-6
"""Temperatures the squares of which are a straight line in temperature and time but for this share of their variance
(two levels, say) tell no curvature: none is fitted.
"""


@dataclass(frozen=True)
class AxesFit:
    """The three axes of one sensor, arrays (3,): in counts, degC and s. `slope` is that at the reference, with a
    curvature allowed for; `quadratic` is 0 where it was not significant, its standard error nan where none was fitted;
    `lag_interval_s` (2,) is the 95 % likelihood interval of the lag.
    """

    reference_degc: float
    offset_lsb: Floats
    slope_lsb_per_degc: Floats
    slope_sem_lsb_per_degc: Floats
    drift_lsb_per_s: Floats
    drift_sem_lsb_per_s: Floats
    quadratic_lsb_per_degc2: Floats
    quadratic_sem_lsb_per_degc2: Floats
    lag_s: float
    lag_interval_s: Floats


class _Scaled(NamedTuple):
    """The series with unit spread, times from -1 to 1: what keeps normal equations well conditioned."""

    gaps_s: Floats
    clock: Floats
    half_s: float
    warm: Floats
    """(n, l) lagged temperatures minus the reference."""
    lags_s: Floats
    curved: bool
    """Whether a quadratic term is fitted."""


def fit_axes(segments: Segments, thermometer: Thermometer, reference_degc: float) -> AxesFit:
    """Fit the segment means (n, 3) of one sensor; n of 20 at least."""
    span_s = float(segments.time_s[-1] - segments.time_s[0])
    gaps_s = np.diff(segments.time_s)
    lags_s = np.concatenate([[0.0], np.geomspace(np.median(gaps_s) / 2, span_s * _LONGEST_LAG, _LAGS)])
    warm = thermometer.lagged(segments.time_s, lags_s.tolist()) - reference_degc
    middle_s = float(segments.time_s.mean())
    half_s = span_s / 2
    clock = (segments.time_s - middle_s) / half_s
    series = _Scaled(gaps_s, clock, half_s, warm, lags_s, _tells_curvature(clock, warm[:, 0]))
    axes = [_Axis(series, column) for column in segments.mean.T]
    # The likely noise depends on the lag, so it is looked for at the lag that white noise makes the likeliest.
    start = int(np.sum([axis.fit((_WHITE,)).likelihood[0] for axis in axes], axis=0).argmax())
    for axis in axes:
        axis.find_noises(start)
    likelihood = np.sum([axis.likelihood for axis in axes], axis=0)
    share = weights(likelihood)
    results = np.array([axis.result(share) for axis in axes])
    inside = lags_s[likelihood >= likelihood.max() - _INTERVAL_DROP]
    offset, slope, slope_sem, drift, drift_sem, quadratic, quadratic_sem = results.T
    return AxesFit(
        reference_degc,
        offset,
        slope,
        slope_sem,
        drift / half_s,
        drift_sem / half_s,
        quadratic,
        quadratic_sem,
        _peak(lags_s, likelihood),
        np.array([_below(lags_s, inside[0]), _above(lags_s, inside[-1])]),
    )


class _Axis:
    """One axis: its likely noises, and its fits at all lags under all of them."""

    def __init__(self, series: _Scaled, counts: Floats) -> None:
        self.series = series
        self.mean = float(counts.mean())
        self.scale = float(counts.std()) or 1.0
        self.counts = (counts - self.mean) / self.scale

    def find_noises(self, lag: int) -> None:
        """Look for the likely noises at one lag, and fit all lags under them."""
        shortest_s, longest_s = float(np.median(self.series.gaps_s)) / 2, 2 * self.series.half_s
        self.noises = likely_noises(lambda noises: self.fit(noises, [lag]).restricted[:, 0], shortest_s, longest_s)
        self.fits = self.fit(self.noises)
        self.likelihood: Floats = self.fits.likelihood.max(axis=0)

    def fit(self, noises: Sequence[Noise], lags: Sequence[int] | None = None) -> Regression:
        """Fits (g, l) under g noises at l lags (all if None): slope, constant, drift, and curvature if it is fitted."""
        warm = self.series.warm if lags is None else self.series.warm[:, list(lags)]
        squares = [warm**2] if self.series.curved else []
        columns = np.column_stack([self.counts, np.ones(len(warm)), self.series.clock, warm, *squares])
        sums, determinants = zip(*(products(columns, self.series.gaps_s, noise) for noise in noises), strict=True)
        count = warm.shape[1]
        chosen = np.array([[0, 3 + lag, 1, 2, 3 + count + lag][: 4 + self.series.curved] for lag in range(count)])
        picked = np.array(sums)[:, chosen[:, :, None], chosen[:, None, :]]
        return regress(picked, np.array(determinants)[:, None], len(warm))

    def result(self, lag_share: Floats) -> tuple[float, ...]:
        """Offset, slope and its standard error, drift and its standard error, quadratic and its standard error, over
        noises and lags.
        """
        values, variance = _mixed(self.fits, weights(self.fits.restricted, axis=0) * lag_share)
        sem = self.scale * np.sqrt(variance)
        slope, constant, drift = (self.scale * values[:3]).tolist()
        quadratic, quadratic_sem = 0.0, np.nan
        if self.series.curved:
            chance = 2 * ndtr(-abs(values[3]) / np.sqrt(max(variance[3], 1e-300)))
            quadratic, quadratic_sem = self.scale * float(values[3]) * (chance < _CURVED), float(sem[3])
        return self.mean + constant, slope, float(sem[0]), drift, float(sem[2]), quadratic, quadratic_sem


def _tells_curvature(clock: Floats, warm: Floats) -> bool:
    """Whether squares of temperatures (n,) are anything but a straight line in temperature and time."""
    squares = warm**2
    design = np.column_stack([np.ones(len(warm)), clock, warm])
    apart = squares - design @ np.linalg.lstsq(design, squares, rcond=None)[0]
    return bool(np.var(apart) > _STRAIGHT * np.var(warm) ** 2)


def _mixed(fits: Regression, share: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of each coefficient over fits of these shares: the fits' own variance and what they disagree
    about.

    The own variance is itself known as well only as the noises are: with the degrees of freedom of a chi-squared that
    scatters as it does over the fits (Satterthwaite, Biometrics Bulletin 2, 1946) it is enlarged, so that a normal's
    95 % quantile makes the interval that Student's makes.
    """
    values = np.tensordot(share, fits.coefficients, share.ndim)
    own = np.diagonal(fits.covariance, axis1=-2, axis2=-1)
    mean = np.tensordot(share, own, share.ndim)
    scatter = np.tensordot(share, (own - mean) ** 2, share.ndim)
    freedom = np.maximum(2 * mean**2 / np.maximum(scatter, 1e-12 * mean**2 + 1e-300), _FEWEST_FREE)
    enlarged = mean * (stdtrit(freedom, 0.975) / ndtri(0.975)) ** 2
    return values, enlarged + np.tensordot(share, (fits.coefficients - values) ** 2, share.ndim)


def _peak(lags_s: Floats, likelihood: Floats) -> float:
    """The most likely lag: the top of a parabola over the logarithm of the three best neighbours on the grid."""
    best = int(likelihood.argmax())
    if best <= 1 or best == len(lags_s) - 1:
        return float(lags_s[best])
    left, top, right = likelihood[best - 1 : best + 2]
    step = np.log(lags_s[best + 1] / lags_s[best])
    return float(lags_s[best] * np.exp(step * (left - right) / (2 * (left - 2 * top + right))))


def _below(lags_s: Floats, lag_s: float) -> float:
    """The next shorter lag of the grid."""
    return float(lags_s[max(0, int(np.searchsorted(lags_s, lag_s)) - 1)])


def _above(lags_s: Floats, lag_s: float) -> float:
    """The next longer lag of the grid."""
    return float(lags_s[min(len(lags_s) - 1, int(np.searchsorted(lags_s, lag_s)) + 1)])
