"""Normal behaviour of each axis of an array: noise, slow bias, and errors of calibration that are visible in motion
only.

An axis reads ``value = row @ triad + regressors @ state + noise``. The state contains a bias, three relative errors of
its response to the box components, and a delay. A small Kalman filter for each axis estimates its state from the parity
residuals, so that errors of calibration, delays between chips and drift are not mistaken for faults; unknown parts of
the state count as uncertainty. The colour of the noise is estimated from the change between windows.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.units import STANDARD_GRAVITY

STATES = 5
"""Bias, three errors of response, delay."""

_ONE = np.eye(STATES)

BIAS_SI: Mapping[str, float] = MappingProxyType(
    {"specific_force": 0.15 * STANDARD_GRAVITY, "angular_rate": np.radians(5.0)}
)
"""Standard deviation of the bias of an axis at the start of a log: the biases of uncalibrated units are up to twice as
large (Tables 3 and 4 of the paper; BMA-112, ADX-60, L3G-70)."""

RESPONSE = 0.04
"""Standard deviation of each error of response: 2 % of scale and, for uncalibrated units, some degrees of misalignment
(BMA-119, ADX-66; the boards of the paper's section 5.2.1).
"""

DELAY_S = 0.003
"""Standard deviation of the delay between the filters of two chips."""

JITTER_S = 0.00036
"""Standard deviation of the age of a single reading: it is uniform over one conversion, here at 800 per second (L3G-30
... L3G-33: the highest rate), so it is a conversion over the square root of twelve.
"""

_KEEPS_S = 3600.0
"""Time constant with which errors of response and delay return to their prior: they change with temperature."""

_WANDER = 0.05
"""Random walk of the bias in one second, relative to the noise of a single reading."""

_A_CHANGE = 1e-3
"""Least mean square of changes of an axis, relative to the others, from which its noise is estimated."""

LEAST_SHARE = 0.05
"""Least share of its own variance in an axis's residual from which the noise is estimated."""

KAPPA_WINDOWS = 100
Q_WINDOWS = 50


class Learnt(NamedTuple):
    """The part of a `NormalModel` that windows change once the noise is settled: `state` (m, 5), `covariance` (m, 5, 5)
    and (m,) `colour`, `change`, the number of windows `seen` and the means of the window `before`, NaN if not known.
    """

    state: Floats
    covariance: Floats
    colour: Floats
    change: Floats
    seen: Floats
    before: Floats


class NormalModel:
    """The running model of every axis: states (m, 5) with covariances (m, 5, 5).

    `noise` (m,) is the standard deviation of a single reading in SI, NaN if it is to be estimated from the first
    windows. `colour` (m,) is the variance of a window's mean relative to that by white noise, between 1 and the
    window's length. `change` (m,) is the mean square of the axis's own change from one reading to the next.
    """

    def __init__(self, noise: Floats, quantity: str, window: int, period_s: float) -> None:
        self.learnt = ~(noise > 0)
        self.variance = np.where(self.learnt, np.nan, noise**2)
        size = len(noise)
        self.state = np.zeros((size, STATES))
        prior = np.array([BIAS_SI[quantity], RESPONSE, RESPONSE, RESPONSE, DELAY_S]) ** 2
        self._prior = np.diag(prior)
        self.covariance = np.tile(self._prior, (size, 1, 1))
        self.colour = np.full(size, max(1.0, window / 2))
        self.change = 2 * self.variance
        self._begun = ~self.learnt
        self.longest_colour = float(window)
        keep = np.exp(-window * period_s / _KEEPS_S)
        self._keep = np.array([1.0, keep, keep, keep, keep])
        self.kept = np.outer(self._keep, self._keep)
        """Share (5, 5) of a covariance that remains after a window."""
        self.fresh = self._prior * (1 - np.diag(self._keep) ** 2)
        """Covariance (5, 5) that a window adds."""
        self.wander = _WANDER**2 * window * period_s
        self._seen = np.zeros(size)
        self._before: Floats | None = None

    @property
    def begun(self) -> bool:
        """True if there is a noise for every axis."""
        return bool(self._begun.all())

    def begin(self, changes: Floats) -> None:
        """Estimate the noise of axes without a measured one from the mean square of their changes (m,) in their first
        window. These include motion, so the estimate is an upper one, which `learn_noise` reduces. An axis without
        changes (NaN or nearly zero) gets the noise of the others until it shows changes.
        """
        usual = float(np.median(changes[changes > 0])) if (changes > 0).any() else 0.0
        fresh = ~self._begun & (changes > _A_CHANGE * usual)
        self.variance = np.where(fresh, changes, self.variance)
        self._begun |= fresh
        known = float(np.median(self.variance[self._begun])) if self._begun.any() else 1.0
        self.variance = np.where(self._begun, self.variance, known)
        self.change = np.where(fresh | ~self._begun | np.isnan(self.change), 2 * self.variance, self.change)

    @property
    def settled(self) -> bool:
        """True if the noise of every axis will not change any more."""
        return self.begun and not bool((self.learnt & (self._seen < Q_WINDOWS)).any())

    @property
    def learnt_now(self) -> Learnt:
        """A copy of the part that windows change."""
        before = np.full(len(self._seen), np.nan) if self._before is None else self._before
        every = (self.state, self.covariance, self.colour, self.change, self._seen, before)
        return Learnt(*(np.array(each, float, order="C") for each in every))

    def relearn(self, learnt: Learnt) -> None:
        """Replace the part that windows change."""
        self.state, self.covariance, self.colour, self.change, self._seen, self._before = learnt

    def regressors(self, triad: Floats, slope: Floats, rows: Floats) -> Floats:
        """Return the regressors (m, n, 5) of a window with triads (n, 3) and their slopes (n, 3)."""
        result = np.empty((len(rows), len(triad), STATES))
        result[..., 0] = 1.0
        result[..., 1:4] = triad
        result[..., 4] = rows @ slope.T
        return result

    def explains(self, regressors: Floats) -> Floats:
        """Return the contribution (n, m) of the states to the readings of a window."""
        return np.asarray((regressors @ self.state[:, :, None])[..., 0].T)

    def jitter(self, regressors: Floats) -> Floats:
        """Return the mean variance (m,) of single readings of a window, with regressors (m, n, 5), by the unknown part
        of their age.
        """
        return self.jitter_of((regressors[..., 4] ** 2).mean(axis=1))

    @staticmethod
    def jitter_of(squares: Floats) -> Floats:
        """Return the same for mean squares (...) of the slopes along axes."""
        return np.asarray(JITTER_S**2 * squares)

    def doubt(self, regressors: Floats) -> Floats:
        """Return the variance (m,) by the states' uncertainty for one row of regressors (m, 5)."""
        return np.asarray(((self.covariance @ regressors[:, :, None])[..., 0] * regressors).sum(axis=1))

    def doubt_within(self, centred: Floats) -> Floats:
        """Return the mean variance (m,) by the states' uncertainty within a window; `centred` (m, n, 5) are regressors
        less their mean.
        """
        return np.asarray(((centred @ self.covariance) * centred).sum(axis=(1, 2)) / centred.shape[1])

    def age(self, which: Booleans) -> None:
        """Predict the states one window ahead: biases wander, and errors of responses return to their prior. Excluded
        axes do not age, because they must return with the state they had.
        """
        self.covariance = np.where(which[:, None, None], self.aged(), self.covariance)

    def aged(self) -> Floats:
        """Return the covariances (m, 5, 5) one window later."""
        older = self.covariance * self.kept
        older += self.fresh
        older[:, 0, 0] += self.wander * self.variance
        return older

    def learn(self, regressors: Floats, residual: Floats, which: Booleans) -> None:
        """Update the states of the axes `which` by the residuals (n, m) of a window; invalid residuals and their
        regressors are 0.
        """
        axes = np.flatnonzero(which)
        rows = regressors[axes]
        turned = rows.transpose(0, 2, 1)
        self.learn_sums(turned @ rows, (turned @ residual.T[axes, :, None])[..., 0], which)

    def learn_sums(self, moments: Floats, products: Floats, which: Booleans) -> None:
        """Update the states by sums over a window for the p axes `which`: products of the regressors with each other
        (p, 5, 5) and with the residuals (p, 5). Readings have less weight where their unknown age matters, as in a
        jerk.
        """
        axes = slice(None) if which.all() else np.flatnonzero(which)
        age = self.jitter_of(moments[:, 4, 4] / np.maximum(moments[:, 0, 0], 1.0))
        weight = 1 / ((self.colour * self.variance)[axes] + age)[:, None]
        covariance = self.covariance[axes]
        gain = covariance @ (moments * weight[:, :, None])
        gain += _ONE
        covariance = np.linalg.solve(gain, covariance)
        covariance = (covariance + covariance.transpose(0, 2, 1)) * 0.5
        self.covariance[axes] = covariance
        self.state[axes] += (covariance @ (products * weight)[:, :, None])[..., 0]

    def learn_noise(self, own: Floats, means: Floats, share: Floats, counts: Floats, which: Booleans) -> None:
        """Update colour, change and, unless measured, noise from residuals (n, m) of a window and their means (m,);
        `share` (m,) is the share of an axis's own variance in its residual, `counts` (m,) the number of its readings.
        """
        share = np.maximum(share, LEAST_SHARE)
        seen, every = self._seen, bool(which.all())
        steps = own[1:] - own[:-1]
        step = np.einsum("nm,nm->m", steps, steps) / ((len(own) - 1) * share)
        rate = 1 / np.minimum(seen + 2, Q_WINDOWS)
        change = self.change + rate * (np.minimum(step, 4 * self.change) - self.change)
        self.change = change if every else np.where(which, change, self.change)
        if self.learnt.any():
            within = own.var(axis=0) / share * (len(own) / max(1, len(own) - 1))
            moved = self.variance + rate * (np.minimum(within, 2 * self.variance) - self.variance)
            self.variance = np.where(self.learnt & which & (seen < Q_WINDOWS), moved, self.variance)
        if self._before is not None:
            spread = counts * (means - self._before) ** 2 / (2 * share * self.variance)
            rate = 1 / np.minimum(seen + 10, KAPPA_WINDOWS)
            colour = self.colour + rate * (np.minimum(spread, 9 * self.colour) - self.colour)
            colour = np.minimum(np.maximum(colour, 1.0), self.longest_colour)
            self.colour = np.where(which & np.isfinite(spread), colour, self.colour)
        self._before = means if every else np.where(which, means, np.nan)
        self._seen = seen + which
