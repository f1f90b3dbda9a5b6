"""Weighted least squares of axis values, frame by frame: ``values = directions @ truth_box + errors``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imuarray.fuse.frames import Estimate, entries

Floats = npt.NDArray[np.float64]


def weighted(values: Floats, weights: Floats, rows: Floats, noise: Floats) -> Estimate:
    """The weighted least squares of each frame, its covariance by the `noise` (m,) of the axes, and the axes in use."""
    used = weights > 0
    if (weights == weights[0]).all():  # the usual case: one gain for the whole block
        gain, solvable = _gains(weights[:1], rows)
        triad = values @ gain[0].T if solvable[0] else np.full((len(values), 3), np.nan)
        covariance = _covariances(gain, solvable, used[:1], noise)
        return Estimate(np.asarray(triad), np.broadcast_to(covariance, (len(values), 6)), used)
    gains, solvable = _gains(weights, rows)
    triad = np.einsum("nim,nm->ni", gains, values)
    triad[~solvable] = np.nan
    return Estimate(np.asarray(triad), _covariances(gains, solvable, used, noise), used)


def _covariances(gains: Floats, solvable: npt.NDArray[np.bool_], used: npt.NDArray[np.bool_], noise: Floats) -> Floats:
    """(n, 6) what the noise of the axes in use makes of the triads."""
    scatter = np.where(used[:, None, :], gains * noise, 0.0)
    covariance = entries(np.einsum("nim,njm->nij", scatter, scatter))
    covariance[~solvable] = np.nan
    return np.asarray(covariance)


def solve_frames(values: Floats, weights: Floats, rows: Floats) -> Floats:
    """Weighted least squares of ``values = rows @ truth_box`` for each frame: (n, 3), NaN where the axes do not span
    space.
    """
    if (weights == weights[0]).all():  # the usual case: one gain for the whole block
        gain, solvable = _gains(weights[:1], rows)
        return np.asarray(values @ gain[0].T if solvable[0] else np.full((len(values), 3), np.nan))
    gains, solvable = _gains(weights, rows)
    solution = np.einsum("nim,nm->ni", gains, values)
    solution[~solvable] = np.nan
    return np.asarray(solution)


def _gains(weights: Floats, rows: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """(n, 3, m) gains that turn axis values into a triad, and whether the weighted axes span space at all."""
    normal = np.einsum("nm,mi,mj->nij", weights, rows, rows, optimize=True)
    size = np.maximum(np.trace(normal, axis1=1, axis2=2), 1e-300)
    solvable = np.asarray(np.linalg.det(normal) > 1e-9 * size**3)
    normal[~solvable] = np.eye(3)
    return np.linalg.solve(normal, rows.T[None] * weights[:, None, :]), solvable
