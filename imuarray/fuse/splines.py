"""Cubic splines that know where their data pauses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]


def between_gaps(known: Times, rows: Floats, at: Times, gap_ns: float, derivative: int = 0) -> Floats:
    """Rows (k, c) at times `known` (k,) ns, interpolated at `at` (n,) ns, or their derivative per second: (n, c).

    One spline for each stretch without a row that is not finite and without a pause longer than `gap_ns`; NaN outside
    the stretches.
    """
    result = np.full((len(at), rows.shape[1]), np.nan)
    whole = np.asarray(np.isfinite(rows).all(axis=1))
    ends = np.flatnonzero(~whole[1:] | ~whole[:-1] | (np.diff(known) > gap_ns)) + 1
    for run in np.split(np.arange(len(known)), ends):
        if len(run) > 1:
            inside = (at >= known[run[0]]) & (at <= known[run[-1]])
            spline = CubicSpline((known[run] - known[0]) * 1e-9, rows[run])
            result[inside] = spline((at[inside] - known[0]) * 1e-9, nu=derivative)
    return result
