"""Overlapping Allan deviation of a series sampled at a fixed interval, with confidence intervals.

With the running sum x of a series y of n values, at averaging factor m and so tau = m * interval::

    adev(tau)^2 = 1 / (2 m^2 M) * sum over i of (x[i+2m] - 2 x[i+m] + x[i])^2,     M = n + 1 - 2m terms

(IEEE Std 952, annex C; Riley, NIST SP 1065, "Overlapping Allan variance"). The sums of whole numbers are exact. In
addition to the running sum (8 bytes per value, one column at a time) only small blocks are needed. The decimated
estimator
(`allan_stream`) takes every m/8-th term: it has nearly the same confidence, is several times faster, and needs memory
that does not grow with the series.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers
from imuarray.characterise.allan_curve import (
    CONFIDENCE,
    IDENTIFY,
    AllanCurve,
    ChangeMoments,
    DifferenceMoments,
    SeriesShape,
    make_curve,
    octaves,
)
from imuarray.characterise.allan_stream import (
    AllanStream,
    CountColumn,
    Estimator,
    Values,
    compact_running_sum,
    running_sum,
    sums_of_squares,
    sums_of_squares_within,
)

__all__ = [
    "CONFIDENCE",
    "AllanCurve",
    "AllanStream",
    "Estimator",
    "allan_deviation",
    "allan_deviation_of_runs",
    "octaves",
]


_BLOCK = 1 << 16


def allan_deviation(
    values: npt.ArrayLike,
    interval_s: float,
    factors: Sequence[int] | None = None,
    confidence: float = CONFIDENCE,
    estimator: Estimator = "overlapping",
) -> AllanCurve:
    """Allan deviation of `values` (n,) or (n, k), column by column, sampled every `interval_s` seconds.

    `factors` are averaging factors from 1 to n // 2; octaves if None. `confidence` is the share of intervals that
    contain the true deviation. `estimator`: "overlapping" uses every term, "decimated" one term in m / 8 or fewer rows.
    ValueError for anything else: fewer than two values, values that are not real and finite, an interval that is not
    positive.
    """
    series = _checked(values, interval_s)
    used_factors = _factors(len(series), factors)
    if estimator not in get_args(Estimator):
        raise ValueError(f"estimator is {estimator!r}, one of {', '.join(get_args(Estimator))} is required")
    if estimator == "decimated":
        stream = AllanStream(interval_s, used_factors)
        stream.feed(series)
        return stream.curve(confidence)
    moments = [_moments(running_sum(column), used_factors) for column in series.reshape(len(series), -1).T]
    return make_curve(
        moments,
        used_factors,
        [1] * len(used_factors),
        SeriesShape(len(series), interval_s, series.shape[1:]),
        confidence,
    )


def allan_deviation_of_runs(columns: Sequence[CountColumn], interval_s: float, lengths: Sequence[int]) -> AllanCurve:
    """Return the overlapping Allan deviation, at octaves of the longest run, of k equally long columns of counts that
    are read block by block. They consist of runs of these `lengths`, one after the other with gaps between them: the
    mean is over all terms within runs. The result for a single run is identical to that of `allan_deviation`.

    The noise type is estimated from the longest run. One column's running sum is held in memory, 4 bytes per count if
    counts of 16 bits do not drift too far, and with several runs the position of every row in its run. ValueError for
    fewer than two counts.
    """
    sizes = np.asarray(lengths, np.int64)
    used_factors = _factors(int(sizes.max()), None)
    moments = []
    for column in columns:
        short = column.dtype.itemsize <= 2
        phase = compact_running_sum(column) if short else running_sum(column[: len(column)])
        whole = len(sizes) == 1
        moments.append(_moments(phase, used_factors) if whole else _moments_of_runs(column, phase, sizes, used_factors))
    kinds, number = np.unique(sizes, return_counts=True)
    runs = tuple(zip(kinds.tolist(), number.tolist(), strict=True)) if len(sizes) > 1 else ()
    shape = SeriesShape(int(sizes.sum()), interval_s, (len(columns),), runs)
    return make_curve(moments, used_factors, [1] * len(used_factors), shape, CONFIDENCE)


def _moments_of_runs(column: CountColumn, phase: Values, sizes: Integers, factors: Sequence[int]) -> DifferenceMoments:
    """Return the moments of a column of runs of these `sizes` (r,) with the running sum `phase` (n + 1,)."""
    starts = np.cumsum(sizes) - sizes
    place = np.arange(len(phase), dtype=np.int32)  # for each running sum, the number of values of its run
    place[1:] -= np.repeat(starts, sizes).astype(np.int32)
    changes = ChangeMoments()
    for start in range(0, len(column), _BLOCK):
        stop = min(start + _BLOCK, len(column))
        changes.feed_pairs(np.asarray(column[max(start - 1, 0) : stop]), place[max(start, 1) + 1 : stop + 1] > 1)
    longest = int(sizes.argmax())
    run = phase[starts[longest] : starts[longest] + sizes[longest] + 1]
    averages = [_averages(run, m) for m in factors]
    return DifferenceMoments(sums_of_squares_within(phase, place, factors), averages, changes.kurtosis())


def _checked(values: npt.ArrayLike, interval_s: float) -> npt.NDArray[Any]:
    """Return the series as an array; ValueError."""
    series = np.asarray(values)
    if series.ndim not in (1, 2) or len(series) < 2 or series.size == 0 or series.dtype.kind not in "biuf":
        required = "an (n,) or (n, k) series of at least 2 real numbers is required"
        raise ValueError(f"{required}, not {series.dtype} {series.shape}")
    if not 0 < interval_s < np.inf:
        raise ValueError(f"interval_s is {interval_s}, a positive number is required")
    return series


def _factors(rows: int, factors: Sequence[int] | None) -> list[int]:
    """Return the averaging factors, octaves if None; ValueError."""
    candidates = np.asarray(octaves(rows) if factors is None else factors)
    if (
        candidates.ndim != 1
        or candidates.dtype.kind not in "iu"
        or candidates.min() < 1
        or candidates.max() > rows // 2
    ):
        raise ValueError(
            f"averaging factors are whole numbers from 1 to {rows // 2} (half of {rows} values), not {factors}"
        )
    return [int(m) for m in candidates]


def _moments(phase: npt.NDArray[Any], factors: Sequence[int]) -> DifferenceMoments:
    """Sums of squares, averages and kurtosis of the column with this running sum."""
    changes = ChangeMoments()
    for start in range(0, len(phase) - 1, _BLOCK):
        changes.feed(np.diff(phase[start : start + _BLOCK + 1]))
    return DifferenceMoments(
        sums_of_squares(phase, factors), [_averages(phase, m) for m in factors], changes.kurtosis()
    )


def _averages(phase: npt.NDArray[Any], m: int) -> npt.NDArray[np.float64]:
    """Return consecutive averages over m values; the middle ones if there are very many."""
    count = (len(phase) - 1) // m
    first = max(0, (count - IDENTIFY) // 2)
    ends = phase[first * m : (min(count, first + IDENTIFY)) * m + 1 : m].astype(float)
    return np.asarray(np.diff(ends) / m)
