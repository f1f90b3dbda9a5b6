"""A fast path through decision windows without faults, which are nearly all of them, by compiled code (`_windows.c`).

It applies if every reading is present. Quantities that do not depend on the estimates from window to window are
computed for many windows at once: parity is linear, and a residual is that of the readings less that of the normal
model's contribution from seven time courses (a constant, the triad and its slope). For each window the states of the
normal model and four bounds remain, each cheaper than the quantity that it bounds: the gain of an error of an axis or a
sensor is at most the whole sum of squares of the mean residuals; an energy is at most that sum over the noise alone;
the limit of an energy is at least that of white noise; and an excluded sensor does not agree if one of its axes
disagrees. A window that the bounds do not decide is processed in full, with the state unchanged by the fast path; so is
every window without compiled code, because a call to NumPy costs more than the few numbers of a window.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.faults.exclusions import AGREES
from imuarray.fuse.faults.hypotheses import AXIS_GAIN, QUIET, DriftLimits, energy_limit
from imuarray.fuse.faults.window import KAPPA_WINDOWS, LEAST_SHARE, Q_WINDOWS, STATES, NormalModel, Parity, slopes

try:
    from imuarray.fuse.faults._windows import advance
except ImportError:  # installed without a C compiler
    COMPILED = False
else:
    COMPILED = True


QUIETEST = 0.2
"""Least share of the usual changes in a window from which noise is estimated: with less, a standstill may begin or end
in it."""

_UNEVEN = 1e-6
"""Determinant of a normal matrix over the cube of its trace above which `spans`, with the limit 1e-9, is not computed.
"""


class DriftCheck(NamedTuple):
    """The `limits` of drifts, the number of the `first` window of a series before which they are checked, and the
    number `every` of windows from one check to the next.
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
        self.out, self.included = out, ~out
        self._observable = white.observable
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
        self._changes = (np.diff(values, axis=1) ** 2).sum(axis=1) / (self._frames - 1)
        # The residuals contain no triad, so that the deleted residuals are these by weight over A's diagonal.
        own = np.where(white.observable, white.matrix.diagonal(), np.inf)
        self._precision = 1 / (own * variance**2)
        self._share = np.asarray(white.matrix.diagonal() * variance)
        # the least limit of an energy: that of white noise, or of a lasting error if that is less
        by_noise = float(energy_limit(self._frames, np.ones(1), np.zeros(1))[0])
        self._limit = min(by_noise, self._frames * AXIS_GAIN)
        normal = rows[self.included].T @ rows[self.included]
        self._even = float(np.linalg.det(normal) / np.trace(normal) ** 3)

    def __len__(self) -> int:
        return len(self._own)

    def advance(
        self, windows: range, normal: NormalModel, waiting: Sequence[Sequence[int]], check: DriftCheck | None
    ) -> int:
        """Process consecutive windows and update `normal`, up to the first one that the bounds do not decide or that
        fails a `check` of drifts (None: there is none); return their number. An excluded group of axes (`waiting`) that
        may agree with the others ends them as well. The caller ensures that no sensor stood still before them.
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
                *(self._own, self._courses, self._usual, self._jitter, self._moments, self._changes),
                *(self._blind, self._rows, self._gain, self._precision, self._share),
                *(normal.kept, normal.fresh, normal.variance, limits.state, limits.covariance, limits.shares, *learnt),
                np.array([self.included, self._observable, groups], float),
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
