"""Drift of a bias while the box stands still: maximum likelihood of a first-order Gauss-Markov process in white noise.

Means over segments of T seconds of a process with variance v and time constant tau have the variance ``v 2 (tau/T)^2
(T/tau - 1 + exp(-T/tau))`` and, d apart, the covariance ``v (2 tau/T sinh(T/2tau))^2 exp(-d/tau)``: those of a sampled
process in white noise, so a Kalman filter gives their exact likelihood. The level of each stretch is unknown and is
integrated out, which also corrects for the degree of freedom that it takes (restricted maximum likelihood: Patterson
and Thompson, Biometrika 58, 1971). Several averaging times enter together: a process shows in means over long times,
white noise in those over short ones.

The filter runs for a grid of time constants and of ratios of drift to noise, first a coarse one, then a fine one about
the maximum. Standard errors and bounds weigh the grid by the likelihood, with a prior that is flat in the rms and in
the logarithm of the time constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.segments import SegmentMeans
from imuarray.calibrate.stability import Drift
from imuarray.kernels import drift_sums

MOST_SEGMENTS = 512
LEAST_SEGMENTS = 16
"""Fewest segments of the longest stretch from which drift can be estimated."""

SHORTEST = 2.0
"""Shortest time constant, in segments; a faster process is coloured noise."""

_NEARLY = 0.99
"""Required length as a share of the nominal: segments at the ends of a stretch may be a little short."""

_RATIOS = np.geomspace(0.02, 500.0, 28)
_TIMES = 14
_FINE = 24
_LIKELY = 6.0
"""Log likelihood below the maximum at which the fine grid ends."""

_INTERVAL = 1.92
"""Log likelihood below the maximum at the ends of a 95 % interval: half the quantile of chi-squared."""

_CONFIDENCE = 0.95


def fit_drift(stretches: Sequence[SegmentMeans], width_s: float) -> Drift | None:
    """Estimate the drift of one sensor from the means over segments of `width_s` (times in s, counts (n, 3)) of its
    stretches at rest; None if the longest has fewer than 16 segments, or no axis scatters.
    """
    stretches = [part for part in stretches if len(part.time_s) > 1]
    spans = [float(part.time_s[-1] - part.time_s[0]) + width_s for part in stretches]
    if max(spans, default=0.0) < LEAST_SEGMENTS * width_s * _NEARLY:
        return None
    levelled = [SegmentMeans(part.time_s, part.mean - part.mean.mean(axis=0)) for part in stretches]
    scale = np.concatenate([part.mean for part in levelled]).std(axis=0)
    moving = np.flatnonzero(scale > 0)
    if len(moving) == 0:
        return None
    parts = [SegmentMeans(part.time_s, part.mean[:, moving] / scale[moving]) for part in levelled]
    times = np.geomspace(SHORTEST * width_s, max(spans), _TIMES)
    coarse = _likelihood(parts, width_s, times, _RATIOS[:, None])
    fine = _likelihood(parts, width_s, *coarse.about_maximum())
    figures = np.zeros((3, 3))
    figures[:, moving] = np.stack(fine.rms()) * scale[moving]
    best, interval = fine.time_constant()
    return Drift(figures[0], figures[1], best, figures[2], interval, max(spans))


class _Grid(NamedTuple):
    """Log likelihood (t, u, k) of k axes for time constants (t,) and ratios (u, k) of the drift's rms to the noise of a
    mean; `noise` (t, u, k) is the most likely rms of that noise.
    """

    times: Floats
    ratios: Floats
    log_likelihood: Floats
    noise: Floats

    def about_maximum(self) -> tuple[Floats, Floats]:
        """Return time constants and ratios of a finer grid over the likely range."""
        profile = self._joint()
        times = _closer(self.times, profile.max(axis=(1, 2)))
        ratios = [_closer(column, profile[:, :, k].max(axis=0)) for k, column in enumerate(self.ratios.T)]
        return times, np.stack(ratios, axis=1)

    def rms(self) -> tuple[Floats, Floats, Floats]:
        """Return the rms of the drift (k,): the most likely value, its standard error, and the upper bound."""
        rms = self.ratios * self.noise
        profile = self._joint()
        best, sem, upper = (np.zeros(rms.shape[2]) for _ in range(3))
        for k in range(rms.shape[2]):
            axis, likely = rms[:, :, k], profile[:, :, k]
            time, ratio = np.unravel_index(int(likely.argmax()), likely.shape)
            best[k] = axis[time, ratio] if self.ratios[ratio, k] > _RATIOS[0] else 0.0
            weight = np.exp(likely - likely.max()) * np.abs(np.gradient(axis, axis=1))
            order = np.argsort(axis, axis=None)
            share = np.cumsum(weight.ravel()[order]) / weight.sum()
            upper[k] = axis.ravel()[order][np.searchsorted(share, _CONFIDENCE)]
            mean = np.average(axis, weights=weight)
            sem[k] = np.sqrt(np.average((axis - mean) ** 2, weights=weight))
        return best, sem, upper

    def time_constant(self) -> tuple[float, Floats]:
        """Return the most likely time constant and its interval (2,), nan where that reaches the end of the grid."""
        profile = self.log_likelihood.max(axis=1).sum(axis=1)
        inside = np.flatnonzero(profile > profile.max() - _INTERVAL)
        low, high = int(inside[0]), int(inside[-1])
        ends = [np.nan if low == 0 else self.times[low], np.nan if high == len(profile) - 1 else self.times[high]]
        return float(self.times[int(profile.argmax())]), np.array(ends)

    def _joint(self) -> Floats:
        """Return the log likelihood (t, u, k) of all axes, with the other axes at their maximum for the time
        constant.
        """
        best = self.log_likelihood.max(axis=1)
        others = best.sum(axis=1, keepdims=True) - best
        return np.asarray(self.log_likelihood + others[:, None, :])


def _closer(values: Floats, profile: Floats) -> Floats:
    """Return finer values (f,) over the likely ones, and one on either side."""
    inside = np.flatnonzero(profile > profile.max() - _LIKELY)
    low, high = max(0, int(inside[0]) - 1), min(len(values) - 1, int(inside[-1]) + 1)
    return np.geomspace(values[low], values[high], _FINE)


def _likelihood(parts: Sequence[SegmentMeans], width_s: float, times: Floats, ratios: Floats) -> _Grid:
    """Return the likelihood of a sampled process in white noise by Kalman filters for all points of the grid at once;
    `ratios` (u, k), or (u, 1) if all axes share them, so that their covariances are computed once.

    Covariances are in units of the noise's variance, which is estimated last; levels are integrated out.
    """
    share = (width_s / times)[:, None, None]
    shared = ratios**2 * (2 / share * np.sinh(share / 2)) ** 2
    noise = 1 + ratios**2 * 2 / share**2 * (share + np.expm1(-share)) - shared
    axes = parts[0].mean.shape[1]
    squares, logs, freedom = np.zeros((*shared.shape[:2], axes)), np.zeros(shared.shape), 0
    for part in parts:
        sums = _filtered(part, times[:, None, None], shared, noise)
        squares += sums.values - sums.mixed**2 / sums.ones
        logs += sums.logs + np.log(sums.ones)
        freedom += len(part.time_s) - 1
    variance = squares / freedom
    ratios = np.broadcast_to(ratios, (len(ratios), axes))
    return _Grid(times, ratios, -(freedom * np.log(variance) + logs) / 2, np.sqrt(variance))


class _LikelihoodSums(NamedTuple):
    """Sums over a stretch, each divided by the variance: squared innovations of the means (`values`), those of a
    constant 1 (`ones`), their products (`mixed`), and the logarithms of the variance.
    """

    values: Floats
    ones: Floats
    mixed: Floats
    logs: Floats


def _filtered(part: SegmentMeans, times: Floats, shared: Floats, noise: Floats) -> _LikelihoodSums:
    """Filter one stretch; `shared` is the variance of the sampled process, `noise` that of a mean about it. Compiled
    code goes from point to point of the grid; without it, all points are filtered at once.
    """
    steps = np.diff(part.time_s, append=np.inf)
    compiled = drift_sums(part.mean, np.exp(-steps[:, None] / times.ravel()), shared, noise)
    if compiled is not None:
        return _LikelihoodSums(*compiled)
    values, mixed, state = (np.zeros((*shared.shape[:2], part.mean.shape[1])) for _ in range(3))
    ones, logs, level, variance = *(np.zeros(shared.shape) for _ in range(3)), shared
    for mean, step in zip(part.mean, steps, strict=True):
        spread = variance + noise
        innovation, unit_innovation = mean - state, 1 - level
        values += innovation**2 / spread
        ones += unit_innovation**2 / spread
        mixed += innovation * unit_innovation / spread
        logs += np.log(spread)
        kept = np.exp(-step / times)
        gain = variance / spread
        state, level = kept * (state + gain * innovation), kept * (level + gain * unit_innovation)
        variance = kept**2 * variance * (1 - gain) + (1 - kept**2) * shared
    return _LikelihoodSums(values, ones, mixed, logs)
