"""Passes over long series. Those of `_series.c` are compiled. They return None if the package was installed without a C
compiler, and for arrays that they don't handle; callers then compute the same with NumPy, except for rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Indices, Times

try:
    from imuarray import _series
except ImportError:  # installed without a C compiler
    COMPILED = False
else:
    COMPILED = True

_BLOCK = 1 << 16
"""Number of values of a series for which the differences at all distances are summed together, so that they stay in the
cache.
"""


def true_runs(flags: Booleans) -> tuple[Indices, Indices]:
    """Return the first row of each run of true values in (n,), and the row after the last one of each."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return edges[::2], edges[1::2]


def window_medians(height: Floats, first: Indices, side: Indices) -> Floats | None:
    """Return the medians (b,) of `side` (b,), or (1,) for all, heights each from `first` (b,) on; no height is NaN.
    None without compiled code, and for windows of more than 256 heights or beyond the end.
    """
    if not COMPILED:
        return None
    result = np.empty(len(first))
    sides = np.ascontiguousarray(np.broadcast_to(side, first.shape), np.int64)
    arrays = np.ascontiguousarray(height, float), np.ascontiguousarray(first, np.int64), sides
    possible = _series.medians((*arrays, result), (len(height), len(first)))
    return result if possible else None


def add_windows(
    block: tuple[Times, npt.NDArray[Any], npt.NDArray[np.uint16]],
    turn: Floats,
    figures: tuple[Floats, Floats],
    windows: tuple[int, int],
    flags: int,
) -> bool:
    """Add to the `figures` of w windows, their rows (w,) and sums, squares, lowest and highest values (4, w, 3), those
    of a block of time (n,), counts (n, 3) and status (n,); `turn` (3, 3) turns counts into values. `windows` are the
    start of the first window and the width of all in ns; rows with one of the flags are ignored. Return False without
    compiled code, and for counts that are not int16.
    """
    time, counts, status = (np.ascontiguousarray(part) for part in block)
    if not COMPILED or counts.dtype != np.int16 or time.dtype != np.int64 or status.dtype != np.uint16:
        return False
    sizes = len(time), len(figures[0])
    _series.windows((time, counts, status, np.ascontiguousarray(turn, float), *figures), sizes, *windows, flags)
    return True


def second_difference_sums(series: npt.NDArray[Any], distances: Sequence[int], first: int) -> list[float] | None:
    """Return for each distance m the sum of (x[e] - 2 x[e-m] + x[e-2m])^2 over the ends e from `first` on of a `series`
    (n,) of int32 or float64. None without compiled code, and for other types.
    """
    if not COMPILED or series.dtype not in (np.int32, np.float64) or not series.flags.c_contiguous:
        return None
    totals, lags = np.zeros(len(distances)), np.array(distances, np.int64)
    for start in range(first, len(series), _BLOCK):
        stop = min(start + _BLOCK, len(series))
        sizes = len(series), len(lags)
        _series.second_differences((series, lags, totals), sizes, series.dtype.itemsize, start, stop)
    return totals.tolist()


def lagged_products(lines: Floats, lags: int) -> Floats | None:
    """Return the sums (r, l) of the products of each of `lines` (r, n) with itself, 0 to `lags` - 1 rows later. None
    without compiled code.
    """
    if not COMPILED:
        return None
    result = np.empty((len(lines), lags))
    _series.lagged_products((np.ascontiguousarray(lines, float), result), (*lines.shape, lags))
    return result


def part_powers(lines: Floats, starts: Indices) -> Floats | None:
    """Return the sums (4, s, k) of the powers 1 to 4 of `lines` (k, n) in the parts that begin at the rows `starts`
    (s,), the last of which ends with the lines. None without compiled code.
    """
    if not COMPILED:
        return None
    result = np.empty((4, len(starts), len(lines)))
    arrays = np.ascontiguousarray(lines, float), np.ascontiguousarray(starts, np.int64), result
    _series.part_powers(arrays, (*lines.shape, len(starts)))
    return result


def change_powers(lines: Floats, changes: Sequence[tuple[int, int, int, int]]) -> Floats | None:
    """Return the sums (2, d, k) of the squares and fourth powers of d kinds of second differences x[i + 2 m] - 2 x[i +
    m] + x[i] of `lines` (k, n): for each kind the first i, their number, the distance m and the step from one i to the
    next. None without compiled code.
    """
    if not COMPILED:
        return None
    result = np.empty((2, len(changes), len(lines)))
    arrays = np.ascontiguousarray(lines, float), np.array(changes, np.int64).reshape(-1, 4), result
    _series.change_powers(arrays, (*lines.shape, len(changes)))
    return result
