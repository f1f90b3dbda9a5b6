"""Cubic splines that know where their data pauses."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]


def between_gaps(known: Times, rows: Floats, at: Times, gap_ns: float) -> Floats:
    """Rows (k, c) at times `known` (k,) ns, interpolated at `at` (n,) ns: (n, c).

    One spline for each stretch without a row that is not finite and without a pause longer than `gap_ns`; NaN outside
    the stretches.
    """
    result = np.full((len(at), rows.shape[1]), np.nan)
    for run in _stretches(known, rows, gap_ns):
        inside = (at >= known[run][0]) & (at <= known[run][-1])
        spline = CubicSpline((known[run] - known[0]) * 1e-9, rows[run])
        result[inside] = spline((at[inside] - known[0]) * 1e-9)
    return result


def derivatives(known: Times, rows: Floats, gap_ns: float) -> tuple[Floats, Floats]:
    """First and second derivative (k, c) per second of rows (k, c) at their own times (k,) ns, by the splines of
    `between_gaps`; zero where there is none.
    """
    first, second = np.zeros(rows.shape), np.zeros(rows.shape)
    for run in _stretches(known, rows, gap_ns):
        seconds = (known[run] - known[0]) * 1e-9
        spline = CubicSpline(seconds, rows[run])
        first[run], second[run] = spline(seconds, nu=1), spline(seconds, nu=2)
    return first, second


def _stretches(known: Times, rows: Floats, gap_ns: float) -> list[slice]:
    """The rows, two and more of them, between which nothing is missing."""
    whole = np.asarray(np.isfinite(rows).all(axis=1))
    ends = np.flatnonzero(~whole[1:] | ~whole[:-1] | (np.diff(known) > gap_ns)) + 1
    bounds = [0, *ends.tolist(), len(known)]
    return [slice(start, stop) for start, stop in itertools.pairwise(bounds) if stop - start > 1]
