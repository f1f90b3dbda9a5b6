"""The steps of a Kalman filter whose states decay each by itself, and its smoother.

Measurements come whitened: ``values = rows @ states + errors`` of unit variance. The smoother is that of Bierman
("Fixed interval smoothing with discrete measurements", International Journal of Control 18, 1973): it goes back over
the innovations and inverts no covariance of states, so that states known without doubt do no harm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class Normal(NamedTuple):
    """What is believed of n states: mean (n,) and covariance (n, n)."""

    mean: Floats
    covariance: Floats


class Innovation(NamedTuple):
    """What one step of measurements brought: the `rows` (p, n), the inverse of the innovations' covariance (p, p) and
    that times the innovations, (p,).
    """

    rows: Floats
    inverse: Floats
    weighted: Floats


class Adjoint(NamedTuple):
    """What all later measurements say of a predicted state: ``smoothed = predicted - covariance @ vector``, and its
    covariance less ``covariance @ matrix @ covariance``.
    """

    vector: Floats
    matrix: Floats


def predicted(before: Normal, left: Floats, added: Floats) -> Normal:
    """The states a while later: `left` (n,) of each, and `added` (n,) new variance."""
    covariance = before.covariance * np.outer(left, left)
    covariance[np.diag_indices_from(covariance)] += added
    return Normal(before.mean * left, covariance)


def corrected(before: Normal, rows: Floats, values: Floats) -> tuple[Normal, Innovation]:
    """The states after measurements `values` (p,) by `rows` (p, n), with errors of unit variance."""
    seen = rows @ before.covariance
    root = np.linalg.cholesky(seen @ rows.T + np.eye(len(rows)))
    inverse_root = np.linalg.inv(root)
    gain = inverse_root @ seen
    innovation = inverse_root @ (values - rows @ before.mean)
    after = Normal(before.mean + gain.T @ innovation, before.covariance - gain.T @ gain)
    return after, Innovation(rows, inverse_root.T @ inverse_root, inverse_root.T @ innovation)


def backwards(later: Adjoint, at: Normal, step: Innovation) -> Adjoint:
    """What these and all later measurements say of the state `at`, as predicted before them."""
    kept = np.eye(len(at.mean)) - at.covariance @ step.rows.T @ (step.inverse @ step.rows)
    vector = kept.T @ later.vector - step.rows.T @ step.weighted
    matrix = kept.T @ later.matrix @ kept + step.rows.T @ step.inverse @ step.rows
    return Adjoint(vector, (matrix + matrix.T) / 2)


def smoothed(at: Normal, adjoint: Adjoint) -> Normal:
    """The state `at` with all that came after it."""
    return Normal(
        at.mean - at.covariance @ adjoint.vector,
        at.covariance - at.covariance @ adjoint.matrix @ at.covariance,
    )
