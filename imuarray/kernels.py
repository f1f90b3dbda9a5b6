"""Compiled recursions (`_kernels.c`). They return None if the package was installed without a C compiler; callers then
compute the same with NumPy, except for rounding.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Booleans, Floats

try:
    from imuarray import _kernels
except ImportError:  # installed without a C compiler
    COMPILED = False
else:
    COMPILED = True

_MOST = 16


def tridiagonal(before: Floats, after: Floats, alone: Floats) -> Floats | None:
    """Solve ``x[i] = alone[i] + before[i] x[i - 1] + after[i] x[i + 1]`` for x (c, k); the sum of the two factors (k,)
    of every row is below one. None without compiled code.
    """
    if not COMPILED:
        return None
    result = np.array(alone, float, order="C")
    factors = (np.ascontiguousarray(before, float), np.ascontiguousarray(after, float))
    _kernels.tridiagonal((*factors, result, np.empty(len(before)), np.empty(len(before))), (len(result), len(before)))
    return result


def drift_sums(means: Floats, kept: Floats, shared: Floats, noise: Floats) -> Sequence[Floats] | None:
    """Filter the means (n, a) of a stretch at every point of a grid (t, u): `kept` (n, t) is the factor by which a
    state decays until the next mean, `shared` and `noise` (t, u, s) are variances, s = 1 or a.

    Returns sums over the stretch for each point of the grid: the squared innovations of the means (t, u, a), the
    squared innovations of a constant level of 1 (t, u, s), and the products of both (t, u, a), each divided by the
    variance, and the logarithms of the variance (t, u, s). None without compiled code.
    """
    (count, axes), (times, ratios, own) = means.shape, shared.shape
    if not COMPILED or axes > _MOST:
        return None
    grids = tuple(np.empty((times, ratios, size)) for size in (axes, own, axes, own))
    arrays = tuple(np.ascontiguousarray(part, float) for part in (means, kept, shared, noise))
    _kernels.drift((*arrays, *grids), (count, axes, times, ratios, own))
    return grids


def track_differences(
    before: tuple[Floats, Floats],
    moments: tuple[Floats, Floats, Booleans],
    walks: Floats,
    blend: tuple[Floats, Floats, Floats],
) -> tuple[Floats, Floats] | None:
    """Track the differences (m, 3) of axes and their covariances (m, 3, 3), with the initial values `before`, over k
    segments. `moments` are products (k, m, 3, 3), residuals (k, m, 3) and flags of axes that moved (k, m); `walks` (k,
    m, 3) are variances that are added before each segment; `blend` are the matrices (m, m) `through` and `turned`, and
    the weights (m,).

    Returns the differences (k + 1, m, 3) and covariances (k + 1, m, 3, 3) before, between and after. None without
    compiled code.
    """
    if not COMPILED:
        return None
    products, residuals, moved = moments
    count, axes = moved.shape
    result = np.empty((count + 1, axes, 3)), np.empty((count + 1, axes, 3, 3))
    for rows, first in zip(result, before, strict=True):
        rows[0] = first
    arrays = tuple(np.ascontiguousarray(part, float) for part in (products, residuals, walks, *blend))
    _kernels.track((*arrays, np.ascontiguousarray(moved, bool), *result), (count, axes))
    return result


def non_negative(design: Floats, target: Floats) -> Floats | None:
    """Fit ``target = design @ x`` (n,) by least squares with x (k,) >= 0. None without compiled code, or if it does not
    converge.
    """
    rows, columns = design.shape
    if not COMPILED or columns > _MOST:
        return None
    result = np.empty(columns)
    arrays = (np.ascontiguousarray(design, float), np.ascontiguousarray(target, float))
    converged = _kernels.non_negative((*arrays, result, np.empty(rows * (columns + 1))), (rows, columns))
    return result if converged else None
