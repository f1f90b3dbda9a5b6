"""Decision windows of an array: their readings, their parity residuals, and the size effect.

The parity space of an array is the part of its readings that no motion of the box can explain. Readings of one instant
are ``values = rows @ truth_box + errors``. With weights W (inverse variances, 0 for an excluded axis), ``A = W - W rows
(rows' W rows)^-1 rows' W`` removes the truth, and ``d = A @ values`` depends on the errors only. The generalised
likelihood ratio of "these axes F have an error, of any size" against "none has" is ``d_F' A_FF^-1 d_F``, chi-square
with as many degrees of freedom as axes (Daly, Gai and Harrison, Journal of Guidance and Control 2, 1979; Sturza,
Navigation 35, 1988).

The size effect (`lever_arms`) is the additional specific force at sensors away from the origin while the box turns.
`WindowResiduals` are the residuals of one window with respect to the included axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.faults.normal import NormalModel
from imuarray.fuse.least_squares import frame_gains, spans


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
        shown = self.matrix @ errors
        return np.asarray(
            np.where(self.observable, shown**2 / np.where(self.observable, self.matrix.diagonal(), 1.0), 0.0)
        )

    def sensor_gains(self, errors: Floats) -> Floats:
        """Return the same (m / 3,) for an error in all axes of one triad: three degrees of freedom."""
        sensors = len(errors) // 3
        blocks = np.einsum("sisj->sij", self.matrix.reshape(sensors, 3, sensors, 3))
        shown = (self.matrix @ errors).reshape(sensors, 3, 1)
        scale = np.maximum(np.einsum("sii->s", blocks), 1e-300)
        firm = blocks + (1e-9 * scale)[:, None, None] * np.eye(3)
        shows = self.observable.reshape(sensors, 3).any(axis=1)
        return np.asarray(np.where(shows, (shown * np.linalg.solve(firm, shown)).sum(axis=(1, 2)), 0.0))


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
        both = self.valid[1:] & self.valid[:-1]
        squares = np.where(both, np.diff(self.values, axis=0), 0.0) ** 2
        counts = both.sum(axis=0)
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
        others = ((self.rows @ self.slow.spread) * self.rows).sum(axis=1)
        return np.asarray(self.doubt + others)

    @cached_property
    def deleted_squares(self) -> Floats:
        """Sum of squares (m,) of each axis's deleted residual about its mean."""
        centred = np.where(self.residual == 0, 0.0, self.residual - self.means)
        squares: Floats = (centred @ self.white.deleted.T) ** 2
        return np.asarray(squares.sum(axis=0))

    def energies(self, normal: NormalModel) -> tuple[Floats, Floats]:
        """Return the sum of squares (m,) of each included axis's deleted residual about its mean, over its variance;
        and the share (m,) of that variance that is uncertainty of the calibration and thus equal in all readings.
        """
        deleted = self.white.deleted
        noise = np.where(
            self.white.observable, 1 / np.where(self.white.observable, self.white.matrix.diagonal(), 1.0), np.inf
        )
        known = self.regressors - self.regressors.mean(axis=1, keepdims=True)
        lasting = deleted**2 @ normal.doubt_within(known)
        noise = noise + deleted**2 @ normal.jitter(self.regressors)
        return self.deleted_squares / (noise + lasting), lasting / (noise + lasting)


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
