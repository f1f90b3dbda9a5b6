"""One decision window of an array: its readings, and what is seen in them when some of the axes are believed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from imuarray.fuse.faults.lever import slope
from imuarray.fuse.faults.normal import Normal
from imuarray.fuse.faults.parity import Parity, Spaces, parity
from imuarray.fuse.solve import solve_frames

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Times = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Window:
    """n consecutive frames of m axes: time (n,) ns, values (n, m) in SI, valid and stale (n, m)."""

    time: Times
    values: Floats
    valid: Flags
    stale: Flags | None

    @cached_property
    def present(self) -> Flags:
        """(m,) the axes that have enough readings to be judged: two."""
        return np.asarray(self.valid.sum(axis=0) >= 2)

    @cached_property
    def changes(self) -> Floats:
        """(m,) mean square of the change from reading to reading, NaN where no two valid ones follow each other."""
        both = self.valid[1:] & self.valid[:-1]
        squares = np.where(both, np.diff(self.values, axis=0), 0.0) ** 2
        counts = both.sum(axis=0)
        return np.where(counts > 0, squares.sum(axis=0) / np.maximum(counts, 1), np.nan)


@dataclass(frozen=True)
class Look:
    """A window as the axes `included` (m,) see it.

    `triad` (n, 3) is their estimate; `residual` (n, m) is what each axis (also one that is not included) reads beside
    that and its model of what is normal, 0 where it has no valid reading; `means` (m,) of it over the `counts` (m,)
    valid readings, with variances `doubt` (m,) of each axis alone. `white` is the parity space of single readings,
    `slow` that of the means. `regressors` (m, n, 5) are those of the normal model, 0 for invalid readings.
    """

    included: Flags
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
        """(m, 5) the mean regressors."""
        return np.asarray(self.regressors.sum(axis=1) / self.counts[:, None])

    @property
    def spread(self) -> Floats:
        """(m,) variance of the mean residual of an axis that is not included."""
        others = ((self.rows @ self.slow.spread) * self.rows).sum(axis=1)
        return np.asarray(self.doubt + others)

    def energies(self, normal: Normal) -> tuple[Floats, Floats]:
        """(m,) the sum of squares, in variances, of each included axis' deleted residual about its mean; and the share
        of that variance that is no noise but doubt about calibration, and so the same from reading to reading.
        """
        centred = np.where(self.residual == 0, 0.0, self.residual - self.means)
        deleted = self.white.deleted
        found = (centred @ deleted.T) ** 2
        noise = np.where(self.white.told, 1 / np.where(self.white.told, self.white.matrix.diagonal(), 1.0), np.inf)
        known = self.regressors - self.regressors.mean(axis=1, keepdims=True)
        lasting = deleted**2 @ normal.doubt_within(known)
        noise = noise + deleted**2 @ normal.jitter(self.regressors)
        return found.sum(axis=0) / (noise + lasting), lasting / (noise + lasting)


def look(window: Window, normal: Normal, rows: Floats, included: Flags, spaces: Spaces) -> Look | None:
    """The window as the axes `included` see it; None where these don't tell all of a triad."""
    weights = np.where(included, 1 / normal.variance, 0.0)
    white = spaces(weights)
    if white is None:
        return None
    bias, valid = normal.state[:, 0], window.valid
    triad, told = _solve(window.values - bias, valid, white, weights, rows)
    regressors = normal.regressors(triad, slope(window.time, triad), rows)
    errors = window.values - normal.explains(regressors)
    triad, _ = _solve(errors, valid, white, weights, rows)
    residual = errors - triad @ rows.T
    valid = valid & told[:, None]
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
    return Look(included, triad, residual, means, counts, doubt, white, slow, regressors, rows)


def _solve(values: Floats, valid: Flags, space: Parity, weights: Floats, rows: Floats) -> tuple[Floats, Flags]:
    """The triads (n, 3) that the valid readings of the weighted axes tell, and whether they do (n,); where they don't,
    that of the frame before.
    """
    if valid[:, weights > 0].all():
        return np.asarray(values @ space.gain.T), np.ones(len(values), bool)
    triad = solve_frames(np.where(valid, values, 0.0), weights * valid, rows)
    told = np.isfinite(triad[:, 0])
    if told.all() or not told.any():
        return np.nan_to_num(triad), told
    last = np.maximum.accumulate(np.where(told, np.arange(len(triad)), -1))
    return np.asarray(triad[np.where(last < 0, told.argmax(), last)]), told
