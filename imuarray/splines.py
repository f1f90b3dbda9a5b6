"""Cubic splines through rows, for alignment in time and for recorded trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imuarray.arrays import Floats, Reals

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


def cubic_spline(knots: Reals, rows: Floats) -> CubicSpline:
    """Return the cubic spline through rows (k, c) at knots (k,), k > 1, whose third derivative is the same on either
    side of the first and last inner knot ("not a knot"; de Boor, "A Practical Guide to Splines", 1978, chapter IV).
    """
    from scipy.interpolate import CubicSpline  # would add a third of a second to every command

    return CubicSpline(knots, rows)
