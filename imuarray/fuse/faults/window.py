"""Decision windows of an array: their readings, their parity residuals, the size effect, and the normal behaviour of
each axis.

The parity space of an array is the part of its readings that no motion of the box can explain. Readings of one instant
are ``values = rows @ truth_box + errors``. With weights W (inverse variances, 0 for an excluded axis), ``A = W - W rows
(rows' W rows)^-1 rows' W`` removes the truth, and ``d = A @ values`` depends on the errors only. The generalised
likelihood ratio of "these axes F have an error, of any size" against "none has" is ``d_F' A_FF^-1 d_F``, chi-square
with as many degrees of freedom as axes (Daly, Gai and Harrison, J. Guid. Control 2, 1979; Sturza, Navigation 35, 1988).

The size effect (`lever_arms`) is the additional specific force at sensors away from the origin while the box turns.
`WindowResiduals` are the residuals of one window with respect to the included axes.

Normal behaviour is noise, slow bias, and errors of calibration that are visible in motion only. An axis reads ``value =
row @ triad + regressors @ state + noise``. The state contains a bias, three relative errors of its response to the box
components, and a delay. A small Kalman filter for each axis estimates its state from the parity residuals, so that
errors of calibration, delays between chips and drift are not mistaken for faults; unknown parts of the state count as
uncertainty. The colour of the noise is estimated from the change between windows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.least_squares import frame_gains, spans
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
        typical = float(np.median(self.variance[self._begun])) if self._begun.any() else 1.0
        self.variance = np.where(self._begun, self.variance, typical)
        self.change = np.where(fresh | ~self._begun | np.isnan(self.change), 2 * self.variance, self.change)

    @property
    def settled(self) -> bool:
        """True if the noise of every axis will not change any more."""
        return self.begun and not bool((self.learnt & (self._seen < Q_WINDOWS)).any())

    @property
    def learnt_now(self) -> Learnt:
        """A copy of the part that windows change."""
        previous_means = np.full(len(self._seen), np.nan) if self._before is None else self._before
        values = (self.state, self.covariance, self.colour, self.change, self._seen, previous_means)
        return Learnt(*(np.array(value, float, order="C") for value in values))

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
        older = self.covariance * self.kept
        older += self.fresh
        older[:, 0, 0] += self.wander * self.variance
        self.covariance = np.where(which[:, None, None], older, self.covariance)

    def learn(self, regressors: Floats, residual: Floats, which: Booleans) -> None:
        """Update the states of the axes `which` by the residuals (n, m) of a window; invalid residuals and their
        regressors are 0. Readings have less weight where their unknown age matters, as in a jerk.
        """
        axes = np.flatnonzero(which)
        rows = regressors[axes]
        turned = rows.transpose(0, 2, 1)
        moments, products = turned @ rows, (turned @ residual.T[axes, :, None])[..., 0]
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
            within_window = own.var(axis=0) / share * (len(own) / max(1, len(own) - 1))
            moved = self.variance + rate * (np.minimum(within_window, 2 * self.variance) - self.variance)
            self.variance = np.where(self.learnt & which & (seen < Q_WINDOWS), moved, self.variance)
        if self._before is not None:
            between_windows = counts * (means - self._before) ** 2 / (2 * share * self.variance)
            rate = 1 / np.minimum(seen + 10, KAPPA_WINDOWS)
            colour = self.colour + rate * (np.minimum(between_windows, 9 * self.colour) - self.colour)
            colour = np.minimum(np.maximum(colour, 1.0), self.longest_colour)
            self.colour = np.where(which & np.isfinite(between_windows), colour, self.colour)
        self._before = means if every else np.where(which, means, np.nan)
        self._seen = seen + which


def slope(time: Times, triad: Floats) -> Floats:
    """Return the change per second (n, 3) of triads (n, 3): central differences, one-sided at the ends."""
    return np.asarray(slopes(time[None], triad[None])[0])


def slopes(time: Times, triads: Floats) -> Floats:
    """Return the change per second (k, n, 3) of triads (k, n, 3) of k windows at times (k, n)."""
    seconds = (time - time[:, :1]) * 1e-9
    result = np.empty_like(triads)
    result[:, 1:-1] = (triads[:, 2:] - triads[:, :-2]) / (seconds[:, 2:] - seconds[:, :-2])[:, :, None]
    result[:, 0] = (triads[:, 1] - triads[:, 0]) / (seconds[:, 1] - seconds[:, 0])[:, None]
    result[:, -1] = (triads[:, -1] - triads[:, -2]) / (seconds[:, -1] - seconds[:, -2])[:, None]
    return result


def lever_arms(time: Times, rate_box: Floats, positions_m: Floats, rows: Floats) -> Floats:
    """Return the specific force (n, m) along axes `rows` (m, 3) at `positions_m` (m, 3) less that at the origin, in
    m/s2, of a box that turns at `rate_box` (n, 3) rad/s: angular acceleration x r + rate x (rate x r). Unknown rates
    (NaN) count as 0.
    """
    rate = np.nan_to_num(rate_box)
    turning = slope(time, rate)[:, None, :]
    spinning = rate[:, None, :]
    force = np.cross(turning, positions_m) + np.cross(spinning, np.cross(spinning, positions_m))
    return np.asarray((force * rows).sum(axis=2))


@dataclass(frozen=True)
class Parity:
    """The parity space for one set of weights: `gain` (3, m) from readings to the triad, `matrix` (m, m) A, `spread`
    (3, 3) the triad's covariance, `observable` (m,) whether an error of the axis is visible.
    """

    gain: Floats
    matrix: Floats
    spread: Floats
    observable: Booleans

    @cached_property
    def deleted(self) -> Floats:
        """Matrix (m, m) of the deleted residuals: each axis less its prediction from all others; 0 for an axis whose
        error is not visible.
        """
        size = np.where(self.observable, self.matrix.diagonal(), 1.0)
        return np.asarray(np.where(self.observable[:, None], self.matrix / size[:, None], 0.0))

    def axis_gains(self, errors: Floats) -> Floats:
        """Return twice the log-likelihood ratio (m,) of an error in one axis, for `errors` (m,): one degree of
        freedom.
        """
        residuals = self.matrix @ errors
        return np.asarray(
            np.where(self.observable, residuals**2 / np.where(self.observable, self.matrix.diagonal(), 1.0), 0.0)
        )

    def sensor_gains(self, errors: Floats) -> Floats:
        """Return the same (m / 3,) for an error in all axes of one triad: three degrees of freedom."""
        sensors = len(errors) // 3
        blocks = np.einsum("sisj->sij", self.matrix.reshape(sensors, 3, sensors, 3))
        residuals = (self.matrix @ errors).reshape(sensors, 3, 1)
        scale = np.maximum(np.einsum("sii->s", blocks), 1e-300)
        firm = blocks + (1e-9 * scale)[:, None, None] * np.eye(3)
        shows = self.observable.reshape(sensors, 3).any(axis=1)
        return np.asarray(np.where(shows, (residuals * np.linalg.solve(firm, residuals)).sum(axis=(1, 2)), 0.0))


def parity(rows: Floats, weights: Floats) -> Parity | None:
    """Return the parity space of axes `rows` (m, 3) with `weights` (m,); None if the weighted axes do not span
    space.
    """
    weighted = rows * weights[:, None]
    normal = weighted.T @ rows
    if not spans(normal):
        return None
    spread = np.asarray(np.linalg.inv(normal), float)
    gain = spread @ weighted.T
    matrix = np.diag(weights) - weighted @ gain
    observable = matrix.diagonal() > 1e-6 * weights
    return Parity(np.asarray(gain), np.asarray(matrix), np.asarray(spread), np.asarray(observable & (weights > 0)))


_KEPT = 1024
"""Largest number of sets of valid axes whose gains are cached."""


class Spaces:
    """Parity spaces of one set of axes, and the gains of frames that lack readings. The results for the last weights
    are cached: weights change only when a sensor is excluded, and sensors of different rates leave the same gaps in
    every window.
    """

    def __init__(self, rows: Floats) -> None:
        self._rows = rows
        self._key = b""
        self._last: Parity | None = None
        self._gains: dict[bytes, tuple[Floats, bool]] = {}

    def __call__(self, weights: Floats) -> Parity | None:
        """Return `parity` of the rows with these weights; the last result is cached."""
        if (key := weights.tobytes()) != self._key:
            self._key, self._last, self._gains = key, parity(self._rows, weights), {}
        return self._last

    def gains(self, valid: Booleans, weights: Floats) -> tuple[Floats, Booleans]:
        """Return the gains (n, 3, m) of frames whose readings are `valid` (n, m), with the same `weights` (m,), and
        whether the readings determine a triad (n,).
        """
        self(weights)
        keys = [row.tobytes() for row in valid]
        unknown = [index for index, key in enumerate(keys) if key not in self._gains]
        if unknown:
            if len(self._gains) + len(unknown) > _KEPT:
                self._gains, unknown = {}, list(range(len(keys)))
            gains, observable = frame_gains(weights * valid[unknown], self._rows)
            self._gains |= {keys[index]: (gains[at], bool(observable[at])) for at, index in enumerate(unknown)}
        frames = [self._gains[key] for key in keys]
        return np.array([gain for gain, _ in frames]), np.array([is_observable for _, is_observable in frames])


@dataclass(frozen=True)
class DecisionWindow:
    """n consecutive frames of m axes: time (n,) ns, values (n, m) in SI, valid and stale (n, m)."""

    time: Times
    values: Floats
    valid: Booleans
    stale: Booleans | None

    @cached_property
    def present(self) -> Booleans:
        """The axes (m,) with at least two valid readings."""
        return np.asarray(self.valid.sum(axis=0) >= 2)

    @cached_property
    def changes(self) -> Floats:
        """Mean square (m,) of the change from reading to reading, NaN without two consecutive valid ones."""
        consecutive = self.valid[1:] & self.valid[:-1]
        squares = np.where(consecutive, np.diff(self.values, axis=0), 0.0) ** 2
        counts = consecutive.sum(axis=0)
        return np.where(counts > 0, squares.sum(axis=0) / np.maximum(counts, 1), np.nan)


@dataclass(frozen=True)
class WindowResiduals:
    """Residuals of a window with respect to the axes `included` (m,).

    `triad` (n, 3) is the estimate of these; `residual` (n, m) is the reading of each axis, included or not, less that
    estimate and its normal model, 0 without a valid reading; `means` (m,) are its means over the `counts` (m,) valid
    readings, with variances `doubt` (m,) of each single axis. `white` is the parity space of single readings, `slow`
    that of the means. `regressors` (m, n, 5) are those of the normal model, 0 for invalid readings.
    """

    included: Booleans
    triad: Floats
    residual: Floats
    means: Floats
    counts: Floats
    doubt: Floats
    white: Parity
    slow: Parity
    regressors: Floats
    rows: Floats

    @property
    def usual(self) -> Floats:
        """Mean regressors (m, 5)."""
        return np.asarray(self.regressors.sum(axis=1) / self.counts[:, None])

    @property
    def spread(self) -> Floats:
        """Variance (m,) of the mean residual of an axis that is not included."""
        variances = ((self.rows @ self.slow.spread) * self.rows).sum(axis=1)
        return np.asarray(self.doubt + variances)

    def energies(self, normal: NormalModel) -> tuple[Floats, Floats]:
        """Return the sum of squares (m,) of each included axis's deleted residual about its mean, over its variance;
        and the share (m,) of that variance that is uncertainty of the calibration and thus equal in all readings.
        """
        deleted = self.white.deleted
        scatter = np.where(self.residual == 0, 0.0, self.residual - self.means)
        squares = np.asarray((scatter @ deleted.T) ** 2).sum(axis=0)
        noise = np.where(
            self.white.observable, 1 / np.where(self.white.observable, self.white.matrix.diagonal(), 1.0), np.inf
        )
        centred = self.regressors - self.regressors.mean(axis=1, keepdims=True)
        doubt = deleted**2 @ normal.doubt_within(centred)
        noise = noise + deleted**2 @ normal.jitter(self.regressors)
        return squares / (noise + doubt), doubt / (noise + doubt)


def window_residuals(
    window: DecisionWindow, normal: NormalModel, rows: Floats, included: Booleans, spaces: Spaces
) -> WindowResiduals | None:
    """Return the residuals of a window by the axes `included`; None if these do not determine a triad."""
    weights = np.where(included, 1 / normal.variance, 0.0)
    white = spaces(weights)
    if white is None:
        return None
    bias, valid = normal.state[:, 0], window.valid
    solved = _FrameSolution.of(valid, white, weights, spaces)
    is_complete = bool(valid.all())
    values = window.values if is_complete else np.where(valid, window.values, bias)
    triad = solved(values - bias)
    regressors = normal.regressors(triad, slope(window.time, triad), rows)
    errors = window.values - normal.explains(regressors)
    triad = solved(errors if is_complete else np.where(valid, errors, 0.0))
    residual = errors - triad @ rows.T
    valid = valid & solved.observable[:, None]
    counts = np.maximum(valid.sum(axis=0), 1).astype(float)
    if not valid.all():
        residual = np.where(valid, residual, 0.0)
        regressors = regressors * valid.T[:, :, None]
    means = residual.sum(axis=0) / counts
    noise = normal.colour * normal.variance + normal.jitter(regressors)
    doubt = noise / counts + normal.doubt(regressors.sum(axis=1) / counts[:, None])
    slow = parity(rows, np.where(included, 1 / doubt, 0.0))
    if slow is None:
        return None
    return WindowResiduals(included, triad, residual, means, counts, doubt, white, slow, regressors, rows)


@dataclass(frozen=True)
class _FrameSolution:
    """Least-squares solution of the frames of a window: `gains` (n, 3, m), or (3, m) if all frames have the same, and
    whether the readings of each frame determine a triad, `observable` (n,).
    """

    gains: Floats
    observable: Booleans

    @classmethod
    def of(cls, valid: Booleans, white: Parity, weights: Floats, spaces: Spaces) -> _FrameSolution:
        """Return the solution for the `valid` (n, m) readings of the weighted axes."""
        if valid[:, weights > 0].all():
            return cls(white.gain, np.ones(len(valid), bool))
        return cls(*spaces.gains(valid, weights))

    def __call__(self, values: Floats) -> Floats:
        """Return the triads (n, 3) of values (n, m), which are 0 if not valid; a frame without a triad gets that of the
        frame before.
        """
        if self.gains.ndim == 2:
            return np.asarray(values @ self.gains.T)
        triad: Floats = np.einsum("nim,nm->ni", self.gains, values)
        if self.observable.all():
            return triad
        if not self.observable.any():
            return np.zeros_like(triad)
        last = np.maximum.accumulate(np.where(self.observable, np.arange(len(triad)), -1))
        return np.asarray(triad[np.where(last < 0, self.observable.argmax(), last)])
