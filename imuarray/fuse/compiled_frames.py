"""Compiled passes over frames (`_frames.c`), which return None where the package was installed without a C compiler,
and for arrays that they don't handle: callers then do the same with NumPy, to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times

try:
    from imuarray.fuse import _frames
except ImportError:  # installed without a C compiler
    COMPILED = False
else:
    COMPILED = True

_MOST_AXES = 96


def combine(counts: Sequence[npt.NDArray[Any]], gain: Floats, of_bias: Floats) -> Floats | None:
    """Return ``gain @ counts - of_bias`` (3, n) of arrays of counts (n, k) with m columns in total; `gain` is (m, 4),
    the last column zero, `of_bias` (3,). None without compiled code, and for counts that are not int16.
    """
    widths = tuple(part.shape[1] for part in counts)
    if not COMPILED or max(len(widths), *widths) > _MOST_AXES or any(part.dtype != np.int16 for part in counts):
        return None
    result = np.empty((3, len(counts[0])))
    _frames.triads((*(np.ascontiguousarray(part) for part in counts), gain, of_bias, result), widths, result.shape[1])
    return result


class Readings(NamedTuple):
    """Readings of one sensor on the grid: values (3, n) along its axes; valid, stale and late_s (n,). Or those of s
    sensors: values (3 s, n); valid, stale and late_s (s, n).
    """

    values: Floats
    valid: Booleans
    stale: Booleans
    late_s: Floats

    @classmethod
    def empty(cls, sensors: int, frames: int) -> Readings:
        """Return uninitialised readings of `sensors` sensors in `frames` frames."""
        shape = sensors, frames
        return cls(np.empty((3 * sensors, frames)), np.empty(shape, bool), np.empty(shape, bool), np.empty(shape))

    def of(self, number: int) -> Readings:
        """Return the readings of one of the sensors; they share memory with those of all."""
        rows = slice(3 * number, 3 * number + 3)
        return Readings(self.values[rows], self.valid[number], self.stale[number], self.late_s[number])


class Tolerance(NamedTuple):
    """Limits and flags of readings: half a frame and the age of a reading in ns; the flags of a row that the compiled
    code does not handle (`special`), that make a reading not valid (`doubtful`), and `stale`.
    """

    half_ns: int
    age_ns: float
    special: int
    doubtful: int
    stale: int


def nearest_readings(
    rows: tuple[Times, npt.NDArray[Any], npt.NDArray[np.uint16]],
    grid: Times,
    factors: tuple[Floats, Floats],
    tolerance: Tolerance,
    into: Readings,
) -> bool | None:
    """Set the readings of one sensor nearest to each time of the increasing `grid` (n,) from `rows`: time (k,), k > 0,
    counts (k, 3) and status (k,); the `factors` are bias and scale (3,) in counts. Return whether each valid reading is
    in one frame only; None without compiled code, for counts that are not int16, and if a row in use has a special
    flag.
    """
    time, counts, status = rows
    if not COMPILED or counts.dtype != np.int16 or time.dtype != np.int64 or status.dtype != np.uint16:
        return None
    inputs = tuple(np.ascontiguousarray(part) for part in (time, counts, status, np.asarray(grid, np.int64)))
    bias, scale = (np.ascontiguousarray(part, float) for part in factors)
    code: int = _frames.readings(
        (*inputs, bias, scale, *into), (len(time), len(grid)), tolerance.half_ns, tolerance.age_ns, tolerance[2:]
    )
    return None if code & 1 else not code


def find_consensus(values: Floats, rows: Floats, gain: Floats, tolerated: float) -> Floats | None:
    """Return the `consensus` (3, n) of valid `values` (m, n) along `rows` (m, 3), in triads; `gain` (3, m) is that of
    least squares. None without compiled code, for too many axes, and for axes that are not triads.
    """
    if not COMPILED or len(rows) > _MOST_AXES or len(rows) % 3:
        return None
    inverse = np.linalg.inv(rows.reshape(-1, 3, 3))
    result = np.empty((3, values.shape[1]))
    inputs = tuple(np.ascontiguousarray(part, float) for part in (values, rows, gain, inverse))
    _frames.consensus((*inputs, result), values.shape, tolerated)
    return result


def remove_motion(
    columns: Floats, derivatives: tuple[Floats, Floats], late: tuple[Booleans, Floats], directions: Floats, share: float
) -> bool:
    """Subtract from `columns` (m, n) the change of the motion, slope and curvature (3, n) in `derivatives`, from the
    frame to the reading, valid and late_s (s, n) in `late`; return False without compiled code.
    """
    if not COMPILED or not columns.flags.c_contiguous:
        return False
    slope, curvature = (np.ascontiguousarray(part) for part in derivatives)
    valid, late_s = (np.ascontiguousarray(part) for part in late)
    inputs = slope, curvature, valid, late_s, np.ascontiguousarray(directions, float)
    _frames.motion((*inputs, columns), valid.shape, share)
    return True


def delay_noise(
    grid: Times, slope: Floats, late: tuple[Booleans, Floats], periods_ns: tuple[float, float], weights: Floats
) -> npt.NDArray[np.float32] | None:
    """Return `Frames.delay_noise` (n, 2 s) of frames at `grid` (n,) with `slope` (n, 3), valid and late_s (s, n) in
    `late`. `periods_ns` are the period of the frames and the longest pause over which the slope is known, `weights`
    (10,) the `_SPLINE_WEIGHTS` of `alignment`. None without compiled code.
    """
    if not COMPILED:
        return None
    valid, late_s = (np.ascontiguousarray(part) for part in late)
    result = np.empty((2 * len(valid), len(grid)), np.float32)
    inputs = np.asarray(grid, np.int64), np.ascontiguousarray(slope.T), valid, late_s, weights
    _frames.delay_noise((*inputs, result), valid.shape, *periods_ns)
    return result.T


def spline_at(knots: Floats, rows: Floats, places: Floats) -> Floats | None:
    """Return the spline through rows (k, c) at knots (k,) (`imuarray.splines`) at increasing places (n,): (n, c). None
    without compiled code, and for fewer than four knots.
    """
    if not COMPILED or len(knots) < 4:
        return None
    widths, columns = np.diff(knots), np.ascontiguousarray(rows.T)
    result = np.empty((len(columns), len(places)))
    inputs = knots, widths, columns, _slopes(widths, columns), np.ascontiguousarray(places)
    _frames.at((*inputs, result), (*columns.shape, len(places)))
    return result.T


def spline_derivatives(knots: Floats, rows: Floats) -> tuple[Floats, Floats] | None:
    """Return the first and the second derivative (k, c) at the knots of the spline of `spline_at`; None as there."""
    if not COMPILED or len(knots) < 4:
        return None
    widths, columns = np.diff(knots), np.ascontiguousarray(rows.T)
    slopes, curvatures = _slopes(widths, columns), np.empty(columns.shape)
    _frames.curvatures((widths, columns, slopes, curvatures), columns.shape)
    return slopes.T, curvatures.T


def _slopes(widths: Floats, columns: Floats) -> Floats:
    """Return the slopes (c, k) of a spline through columns (c, k) whose knots are `widths` (k - 1,) apart."""
    result = np.empty(columns.shape)
    _frames.slopes((widths, columns, result, np.empty((5, columns.shape[1]))), columns.shape)
    return result


def quadratic(factors: Floats, triads: Floats) -> Floats | None:
    """Return the quadratic functions (6, n) of triads (3, n); `factors` (6, 10) are the factors of 1, x, y, z, xx, yy,
    zz, xy, xz and yz. None without compiled code.
    """
    if not COMPILED:
        return None
    result = np.empty((6, triads.shape[1]))
    inputs = np.ascontiguousarray(factors, float), np.ascontiguousarray(triads, float)
    _frames.covariances((*inputs, result), (triads.shape[1],))
    return result
