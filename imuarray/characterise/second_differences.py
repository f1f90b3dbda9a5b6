"""Sums of squared second differences of a running sum, from which Allan variances are computed.

The running sum of whole numbers is kept as float64 of their distance from the first: exact while it stays below 2^53,
and so are its differences; the rest is float64 too, and no conversion is needed on the way to the sum of squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats

Values = npt.NDArray[Any]


class CountColumn(Protocol):
    """Whole numbers (n,) that are read on demand, such as a column of a log."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Their type."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> Values: ...


EXACT = 1 << 53
"""Whole numbers below this are exact in float64."""

_BLOCK = 32768
"""Number of second differences that are processed at once, for every distance in turn, so that they remain in the
cache."""

_DOT = 8192
"""Number of products that are summed at once: up to 10,000 OpenBLAS does not start threads."""


def running_sum(values: Values) -> Floats:
    """0 and the running sum (n + 1,) of the distance of `values` (n,) from a reference; ValueError if not finite.

    A reference changes no second difference; it is whole, and the sum exact, where the values are whole numbers that
    allow it, and else the mean, which keeps the sum small.
    """
    reference = values[0] if _fits(values) else values.mean(dtype=np.float64)
    phase = np.zeros(len(values) + 1)
    for start in range(0, len(values), _BLOCK):
        part = phase[start + 1 : start + 1 + _BLOCK]
        add_up(values[start : start + _BLOCK], reference, float(phase[start]), part)
    return phase


def compact_running_sum(values: CountColumn) -> Values:
    """Return the `running_sum` of counts of two bytes or fewer, read block by block: as int32, which halves its memory,
    where it stays below 2^31.
    """
    reference, phase, total = values[:1][0], np.zeros(len(values) + 1, np.int32), 0.0
    work = np.empty(min(_BLOCK, len(values)))
    for start in range(0, len(values), _BLOCK):
        part = work[: len(values) - start]
        add_up(values[start : start + _BLOCK], reference, total, part)
        if np.abs(part).max() > np.iinfo(np.int32).max:
            return running_sum(values[: len(values)])
        phase[start + 1 : start + 1 + len(part)] = part
        total = float(part[-1])
    return phase


def add_up(values: Values, reference: Any, total: float, out: Floats) -> None:
    """Write to `out` (b,) `total` plus the running sum of `values` (b,) less `reference`; ValueError if not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        if values.dtype.itemsize == 8 and isinstance(reference, np.integer) and _near(values, reference):
            out[:] = (values - reference).view(np.int64)  # float64 would round before it subtracts
        else:
            np.subtract(values, reference, out=out, dtype=np.float64)
        out[0] += total
        np.cumsum(out, out=out)
    if not np.isfinite(out[-1]):
        raise ValueError("the series contains values that are not finite")


def _near(values: Values, reference: np.integer[Any]) -> bool:
    """Return whether whole numbers are exact in float64 once the reference is taken off; their difference may wrap
    round.
    """
    return max(int(values.max()) - int(reference), int(reference) - int(values.min())) < EXACT


def _fits(values: Values) -> bool:
    """Return whether the running sum of the distance from one of the values is exact for certain."""
    if values.dtype.kind not in "biu":
        return False
    span = 1 << 8 * values.dtype.itemsize if values.dtype.itemsize <= 2 else int(values.max()) - int(values.min())
    return span * len(values) < EXACT


def sums_of_squares(phase: Values, distances: Sequence[int], first: int = 0) -> list[float]:
    """Return for each distance m the sum of (x[e] - 2 x[e-m] + x[e-2m])^2 over the ends e from `first` on, as far as x
    reaches; x is float64, or int32, whose differences are float64 all the same.
    """
    totals = [0.0] * len(distances)
    work = np.empty((2, min(2 * _BLOCK, len(phase))))
    for start in range(first, len(phase), _BLOCK):
        stop = min(start + _BLOCK, len(phase))
        for index, m in enumerate(distances):
            if stop > 2 * m:
                totals[index] += _square(_second_differences(phase, m, max(start, 2 * m), stop, work))
    return totals


def sums_of_squares_within(phase: Values, place: npt.NDArray[np.int32], distances: Sequence[int]) -> list[float]:
    """Return the same of a series with gaps: over the ends e whose `place` in their run, (n + 1,), is 2m or more."""
    totals = [0.0] * len(distances)
    work = np.empty((2, min(2 * _BLOCK, len(phase))))
    for start in range(0, len(phase), _BLOCK):
        stop = min(start + _BLOCK, len(phase))
        for index, m in enumerate(distances):
            begin = max(start, 2 * m)
            within = place[begin:stop] >= 2 * m
            if within.any():
                block = _second_differences(phase, m, begin, stop, work)
                block *= within
                totals[index] += _square(block)
    return totals


def _second_differences(phase: Values, m: int, start: int, stop: int, work: Floats) -> Floats:
    """Return the second differences that end from `start` to `stop`; at a short distance each first difference serves
    twice.
    """
    count = stop - start
    block, middle = work[0, :count], phase[start - m : stop - m]
    if 4 * m <= count:
        first = work[1, : count + m]
        np.subtract(phase[start - m : stop], phase[start - 2 * m : stop - m], out=first, dtype=np.float64)
        return np.subtract(first[m:], first[:count], out=block)
    np.subtract(phase[start:stop], middle, out=block, dtype=np.float64)
    np.subtract(block, middle, out=block)
    return np.add(block, phase[start - 2 * m : stop - 2 * m], out=block)


def _square(block: Floats) -> float:
    parts = (block[at : at + _DOT] for at in range(0, len(block), _DOT))
    return sum(float(np.dot(part, part)) for part in parts)
