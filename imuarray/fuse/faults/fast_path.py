"""A fast path through decision windows without faults, which are nearly all of them.

It applies if every reading is present. Quantities that do not depend on the estimates from window to window are
computed for many windows at once: parity is linear, and a residual is that of the readings less that of the normal
model's contribution from seven time courses (a constant, the triad and its slope). For each window the states of the
normal model and four bounds remain, each cheaper than the quantity that it bounds: the gain of an error of an axis or a
sensor is at most the whole sum of squares of the mean residuals; an energy is at most that sum over the noise alone;
the limit of an energy is at least that of white noise; and an excluded sensor does not agree if one of its axes
disagrees. A window that the bounds do not decide is processed in full, with the state unchanged by the fast path.

Consecutive windows are processed by compiled code (`_windows.c`) if it was built. It computes the same much faster,
because a call to NumPy costs more than the few numbers of a window.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.faults.exclusions import AGREES
from imuarray.fuse.faults.hypotheses import AXIS_GAIN, QUIET, DriftLimits, least_energy_limit
from imuarray.fuse.faults.window import KAPPA_WINDOWS, LEAST_SHARE, Q_WINDOWS, STATES, NormalModel, Parity, slopes

try:
    from imuarray.fuse.faults._windows import advance
except ImportError:  # installed without a C compiler

    def advance(arrays: tuple[Floats, ...], sizes: tuple[int, ...], limits: tuple[float, ...]) -> int:
        """Process no window."""
        return 0


QUIETEST = 0.2
"""Least share of the usual changes in a window from which noise is estimated: with less, a standstill may begin or end
in it."""

_UNEVEN = 1e-6
"""Determinant of a normal matrix over the cube of its trace above which `spans`, with the limit 1e-9, is not computed.
"""


class WindowStatistics(NamedTuple):
    """A window without a fault: `residual` (n, m) and its `means` (m,), the `aged` covariances (m, 5, 5) of the normal
    model's states, the `moments` (m, 5, 5) of its regressors, their products (m, 5) with the residuals and their
    `usual` values (m, 5), and the axes `sound` (m,) from which the normal model is updated.
    """

    residual: Floats
    means: Floats
    aged: Floats
    moments: Floats
    products: Floats
    usual: Floats
    sound: Booleans


class DriftCheck(NamedTuple):
    """The `limits` of drifts, the number of the `first` window of a series before which they are checked, and after how
    many windows `every` further check follows.
    """

    limits: DriftLimits
    first: int
    every: int


class WindowSeries:
    """k consecutive windows of n frames of m axes with known noise: `variance` (m,) of single readings.

    `time` (k, n) ns, `values` (k, n, m) in SI; the axes `out` (m,) are excluded, `white` is the parity space of the
    others.
    """

    def __init__(
        self, time: Times, values: Floats, out: Booleans, white: Parity, rows: Floats, variance: Floats
    ) -> None:
        self._rows, self._gain = np.ascontiguousarray(rows), np.ascontiguousarray(white.gain)
        self._frames = time.shape[1]
        values = np.ascontiguousarray(values, float)
        self.out, self.included, self._all = out, ~out, not out.any()
        self.observable = white.observable
        self._blind = (np.eye(len(rows)) - rows @ white.gain).T.copy()  # removes the contribution of the triad
        shape, flat = values.shape, values.reshape(-1, len(rows))  # one product is faster than one for each window
        self._own = (flat @ self._blind).reshape(shape)
        triad = (flat @ white.gain.T).reshape(*shape[:2], 3)
        slope = slopes(time, triad)
        along = (slope.reshape(-1, 3) @ rows.T).reshape(shape)
        ones = np.ones((*triad.shape[:2], 1))
        self._courses = np.concatenate([ones, triad, slope], axis=2)
        self._usual = np.ones((len(time), len(rows), STATES))
        self._usual[:, :, 1:4] = triad.mean(axis=1)[:, None]
        self._usual[:, :, 4] = along.mean(axis=1)
        self._jitter = NormalModel.jitter_of((along**2).mean(axis=1))
        self._moments = _moments(triad, along)
        self.changes = (np.diff(values, axis=1) ** 2).sum(axis=1) / (self._frames - 1)
        # The residuals contain no triad, so that the deleted residuals are these by weight over A's diagonal.
        own = np.where(white.observable, white.matrix.diagonal(), np.inf)
        self._precision = 1 / (own * variance**2)
        self.share = np.asarray(white.matrix.diagonal() * variance)
        self.counts = np.full(len(rows), float(self._frames))
        self._limit = least_energy_limit(self._frames)
        normal = rows[self.included].T @ rows[self.included]
        self._even = float(np.linalg.det(normal) / np.trace(normal) ** 3)

    def advance(
        self, windows: range, normal: NormalModel, waiting: Sequence[Sequence[int]], check: DriftCheck | None
    ) -> int:
        """Process consecutive windows and update `normal`, up to the first one that needs `seen` or fails a `check` of
        drifts (None: there is none); return their number. The caller ensures that no sensor stood still before them.
        """
        axes = len(self._rows)
        first = (np.zeros((axes, STATES)), np.zeros((axes, STATES, STATES)), np.zeros((axes, axes)))
        limits, begin, every = check or DriftCheck(DriftLimits(*first, 0.0, 0.0), windows.stop, 1)
        groups = np.full(axes, -1.0)
        for group, members in enumerate(waiting):
            groups[list(members)] = group
        learnt = normal.learnt_now
        passed = advance(
            (
                *(self._own, self._courses, self._usual, self._jitter, self._moments, self.changes),
                *(self._blind, self._rows, self._gain, self._precision, self.share),
                *(normal.kept, normal.fresh, normal.variance, limits.state, limits.covariance, limits.shares, *learnt),
                np.array([self.included, self.observable, groups], float),
            ),
            (len(self._own), self._frames, axes, windows.start, windows.stop, begin, every),
            (
                *(self._limit, self._even, _UNEVEN, AXIS_GAIN, AGREES, QUIET, QUIETEST, normal.wander),
                *(LEAST_SHARE, Q_WINDOWS, KAPPA_WINDOWS, normal.longest_colour, limits.limit, limits.sigmas),
            ),
        )
        if passed:
            normal.relearn(learnt)
        return passed

    def usual(self, index: int, normal: NormalModel) -> Floats:
        """Return the mean regressors (m, 5) of a window, with the effect of the biases on the triad removed."""
        result: Floats = self._usual[index].copy()
        result[:, 1:4] -= self._gain @ normal.state[:, 0]
        return result

    def seen(self, index: int, normal: NormalModel, waiting: Sequence[Sequence[int]]) -> WindowStatistics | None:
        """Return the statistics of a window; None if it may show a fault, if one of the excluded groups of axes
        (`waiting`) may agree with the others, or if the bounds do not decide.
        """
        frames, rows, state = self._frames, self._rows, normal.state
        offset = self._gain @ state[:, 0]
        made = np.empty((7, len(rows)))
        made[0] = state[:, 0] - state[:, 1:4] @ offset
        made[1:4] = state[:, 1:4].T
        made[4:] = rows.T * state[:, 4]
        courses = self._courses[index]
        residual = self._own[index] - courses @ (made @ self._blind)
        products = courses.T @ residual
        means = products[0] / frames
        squares = np.einsum("nm,nm->m", residual, residual) - products[0] * means
        if not (squares * self._precision).max() < self._limit:
            return None
        usual = self.usual(index, normal)
        aged = normal.aged()
        noise = normal.colour * normal.variance + self._jitter[index]
        doubt = noise / frames + np.matmul(usual[:, None, :], np.matmul(aged, usual[:, :, None]))[:, 0, 0]
        sound = self._sound(doubt, means, waiting)
        if sound is None:
            return None
        shear = np.eye(STATES)
        shear[1:4, 0] = -offset
        with_residual = np.empty((len(rows), STATES))
        with_residual[:, 0] = products[0]
        with_residual[:, 1:4] = (products[1:4] - offset[:, None] * products[0]).T
        with_residual[:, 4] = (rows.T * products[4:]).sum(axis=0)
        moments = shear @ self._moments[index] @ shear.T
        if not self._all:
            aged = np.where(self.included[:, None, None], aged, normal.covariance)
        return WindowStatistics(residual, means, aged, moments, with_residual, usual, sound)

    def _sound(self, doubt: Floats, means: Floats, waiting: Sequence[Sequence[int]]) -> Booleans | None:
        """Return (m,) the axes without evidence of a fault; None if there may be a fault, or if one of the excluded
        groups of axes may agree.
        """
        weights = 1 / doubt if self._all else np.where(self.included, 1 / doubt, 0.0)
        least = weights.min() if self._all else weights[self.included].min()
        even = self._even * float(least / weights.max()) ** 3 > _UNEVEN
        most = float((weights * means) @ means)  # upper bound of the sum of squares, before the triad is fitted
        if most < AXIS_GAIN / 2 and even and not waiting:
            return self.included
        weighted = self._rows * weights[:, None]
        spread = _inverse(weighted.T @ self._rows)
        if spread is None:
            return None
        for axes in waiting:
            off = list(axes)
            others = ((self._rows[off] @ spread) * self._rows[off]).sum(axis=1)
            if not (means[off] ** 2 >= AGREES * (doubt[off] + others)).any():
                return None
        shown = weights * means - weighted @ (spread @ (weighted.T @ means))
        whole = float(shown @ means)  # the sum of squares, an upper bound of every gain
        if not whole < AXIS_GAIN:
            return None
        if whole < AXIS_GAIN / 2:
            return self.included
        own = weights - ((weighted @ spread) * weighted).sum(axis=1)
        observable = own > 1e-6 * weights
        gains = np.where(observable, shown**2 / np.where(observable, own, 1.0), 0.0)
        return np.asarray((gains < AXIS_GAIN / 2) & self.included)


def _inverse(normal: Floats) -> Floats | None:
    """Return the inverse (3, 3) of a symmetric matrix by its cofactors, several times faster than a general inverse;
    None if axes with this normal matrix do not determine a triad (as `imuarray.fuse.least_squares.spans`).
    """
    (a, b, c), (_, d, e), (_, _, f) = normal.tolist()
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * first + b * second + c * third
    if not determinant > 1e-9 * (a + d + f) ** 3:
        return None
    mixed = b * c - a * e
    cofactors = np.array([[first, second, third], [second, a * f - c * c, mixed], [third, mixed, a * d - b * b]])
    return np.asarray(cofactors / determinant)


def _moments(triad: Floats, along: Floats) -> Floats:
    """Return sums (k, m, 5, 5) over the frames of the products of (1, triad, slope along the axis), from triads (k, n,
    3) and slopes (k, n, m).
    """
    windows, frames, axes = along.shape
    result = np.empty((windows, axes, STATES, STATES))
    common = np.concatenate([np.ones((windows, frames, 1)), triad], axis=2)
    turned = common.transpose(0, 2, 1)
    result[:, :, :4, :4] = (turned @ common)[:, None]
    crossed = (turned @ along).transpose(0, 2, 1)
    result[:, :, :4, 4] = crossed
    result[:, :, 4, :4] = crossed
    result[:, :, 4, 4] = (along**2).sum(axis=1)
    return result
