"""Cubic splines that know where their data pauses."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_banded

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
        spline = _Spline((known[run] - known[0]) * 1e-9, rows[run])
        result[inside] = spline.at((at[inside] - known[0]) * 1e-9)
    return result


def derivatives(known: Times, rows: Floats, gap_ns: float) -> tuple[Floats, Floats]:
    """First and second derivative (k, c) per second of rows (k, c) at their own times (k,) ns, by the splines of
    `between_gaps`; zero where there is none.
    """
    first, second = np.zeros(rows.shape), np.zeros(rows.shape)
    for run in _stretches(known, rows, gap_ns):
        spline = _Spline((known[run] - known[0]) * 1e-9, rows[run])
        first[run], second[run] = spline.slopes, spline.curvatures()
    return first, second


class _Spline:
    """The cubic spline through rows (k, c) at knots (k,), k > 1, whose third derivative is the same on either side of
    the first and last inner knot ("not a knot"; de Boor, "A Practical Guide to Splines", 1978, chapter IV): that of
    `scipy.interpolate.CubicSpline`, whose package takes half a second to import, and with its derivatives at the knots,
    which come with the solution, for nothing.
    """

    def __init__(self, knots: Floats, rows: Floats) -> None:
        self._knots, self._rows = knots, rows
        self._widths = np.diff(knots)[:, None]
        self._rises = np.diff(rows, axis=0) / self._widths
        self.slopes = self._solved()
        """(k, c) at the knots."""

    def curvatures(self) -> Floats:
        """(k, c) second derivatives at the knots."""
        square, cube = self._powers()
        last = 2 * square[-1:] + 6 * cube[-1:] * self._widths[-1:]
        return np.concatenate([2 * square, last])

    def at(self, places: Floats) -> Floats:
        """(n, c) at places (n,) from the first to the last knot."""
        piece = np.clip(np.searchsorted(self._knots, places, "right") - 1, 0, len(self._knots) - 2)
        square, cube = self._powers()
        beyond = (places - self._knots[piece])[:, None]
        return np.asarray(
            self._rows[piece] + beyond * (self.slopes[piece] + beyond * (square[piece] + beyond * cube[piece]))
        )

    def _powers(self) -> tuple[Floats, Floats]:
        """(k - 1, c) factors of the square and the cube of the way from the knot before."""
        bend = (self.slopes[:-1] + self.slopes[1:] - 2 * self._rises) / self._widths
        return (self._rises - self.slopes[:-1]) / self._widths - bend, bend / self._widths

    def _solved(self) -> Floats:
        """The slopes at the knots that make the second derivative continuous."""
        widths, rises, count = self._widths, self._rises, len(self._knots)
        if count == 2:
            return np.repeat(rises, 2, axis=0)
        wanted = np.empty(self._rows.shape)
        wanted[1:-1] = 3 * (widths[1:] * rises[:-1] + widths[:-1] * rises[1:])
        if count == 3:  # one parabola
            wanted[0], wanted[-1] = 2 * rises[0], 2 * rises[1]
            h, g = widths[0, 0], widths[1, 0]
            return np.asarray(
                np.linalg.solve(np.array([[1.0, 1.0, 0.0], [g, 2 * (h + g), h], [0.0, 1.0, 1.0]]), wanted)
            )
        bands = np.empty((3, count))
        bands[1, 1:-1] = 2 * (widths[:-1, 0] + widths[1:, 0])
        bands[0, 2:], bands[2, :-2] = widths[:-1, 0], widths[1:, 0]
        first, last = widths[0, 0] + widths[1, 0], widths[-2, 0] + widths[-1, 0]
        bands[1, 0], bands[0, 1] = widths[1, 0], first
        bands[1, -1], bands[2, -2] = widths[-2, 0], last
        wanted[0] = ((widths[0] + 2 * first) * widths[1] * rises[0] + widths[0] ** 2 * rises[1]) / first
        wanted[-1] = (widths[-1] ** 2 * rises[-2] + (2 * last + widths[-1]) * widths[-2] * rises[-1]) / last
        return np.asarray(solve_banded((1, 1), bands, wanted, overwrite_ab=True, overwrite_b=True, check_finite=False))


def _stretches(known: Times, rows: Floats, gap_ns: float) -> list[slice]:
    """The rows, two and more of them, between which nothing is missing."""
    whole = np.asarray(np.isfinite(rows).all(axis=1))
    ends = np.flatnonzero(~whole[1:] | ~whole[:-1] | (np.diff(known) > gap_ns)) + 1
    bounds = [0, *ends.tolist(), len(known)]
    return [slice(start, stop) for start, stop in itertools.pairwise(bounds) if stop - start > 1]
