"""Overlapping Allan deviation of a series sampled at a fixed interval, with confidence intervals.

With the running sum x of a series y of n values, at averaging factor m and so tau = m * interval::

    adev(tau)^2 = 1 / (2 m^2 M) * sum over i of (x[i+2m] - 2 x[i+m] + x[i])^2,     M = n + 1 - 2m terms

(IEEE Std 952, annex C; Riley, NIST SP 1065, "Overlapping Allan variance"). Whole numbers are summed as int64, so that
the running sum and its differences are exact. Beside that sum (8 bytes a value, one column at a time) only small blocks
are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.characterise.freedom import Noise, degrees_of_freedom, identify_noise, interval

CONFIDENCE = 0.95
"""Share of intervals that hold the true deviation."""

_BLOCK = 8192
"""Terms at once: they stay in the cache, and OpenBLAS adds up to 10,000 products without waking other threads."""

_IDENTIFY = 8192
"""The noise type is told from at most so many averages, the middle ones: their autocorrelation is then sure to 0.01."""


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviations in the unit of the series: a row per tau, and a column per column of the series if it had any.

    `tau_s` and `terms` (squares averaged) are (t,); `deviation`, `low` and `high` (ends of its confidence interval),
    `freedom` (equivalent degrees of freedom) and `noise` (the type that the interval assumes) are (t,) or (t, k).
    """

    tau_s: npt.NDArray[np.float64]
    deviation: npt.NDArray[np.float64]
    terms: npt.NDArray[np.int64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    freedom: npt.NDArray[np.float64]
    noise: npt.NDArray[np.str_]


def octaves(rows: int) -> tuple[int, ...]:
    """Averaging factors 1, 2, 4, ... up to a third of `rows`, where too few terms are left to mean anything."""
    return tuple(1 << power for power in range(max(rows // 3, 1).bit_length()))


def allan_deviation(
    values: npt.ArrayLike, interval_s: float, factors: Sequence[int] | None = None, confidence: float = CONFIDENCE
) -> AllanCurve:
    """Allan deviation of `values` (n,) or (n, k), column by column, sampled every `interval_s` seconds.

    `factors` are averaging factors from 1 to n // 2; octaves if None. `confidence` is the share of intervals that hold
    the true deviation. ValueError for anything else: fewer than two values, values that are not real and finite, an
    interval that is not positive.
    """
    series = _checked(values, interval_s)
    chosen = _factors(len(series), factors)
    terms = len(series) + 1 - 2 * chosen
    results = [_column(column, chosen.tolist()) for column in series.reshape(len(series), -1).T]
    freedom = [_freedom(noises, chosen.tolist(), terms.tolist()) for _, noises in results]
    shape = (len(chosen), *series.shape[1:])
    deviations = np.array([deviation for deviation, _ in results], np.float64).T.reshape(shape)
    freedoms = np.array(freedom, np.float64).T.reshape(shape)
    low, high = interval(deviations, freedoms, confidence)
    noises = np.array([noises for _, noises in results]).T.reshape(shape)
    return AllanCurve(chosen * np.float64(interval_s), deviations, terms, low, high, freedoms, noises)


def _checked(values: npt.ArrayLike, interval_s: float) -> npt.NDArray[Any]:
    """The series as an array; ValueError."""
    series = np.asarray(values)
    if series.ndim not in (1, 2) or len(series) < 2 or series.size == 0 or series.dtype.kind not in "biuf":
        wanted = "an (n,) or (n, k) series of at least 2 real numbers is wanted"
        raise ValueError(f"{wanted}, not {series.dtype} {series.shape}")
    if not 0 < interval_s < np.inf:
        raise ValueError(f"interval_s is {interval_s}, a positive number is wanted")
    return series


def _factors(rows: int, factors: Sequence[int] | None) -> npt.NDArray[np.int64]:
    """The averaging factors (t,), octaves if None; ValueError."""
    chosen = np.asarray(octaves(rows) if factors is None else factors)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or chosen.min() < 1 or chosen.max() > rows // 2:
        raise ValueError(
            f"averaging factors are whole numbers from 1 to {rows // 2} (half of {rows} values), not {factors}"
        )
    return chosen.astype(np.int64)


def _freedom(noises: list[Noise], factors: list[int], terms: list[int]) -> list[float]:
    return [degrees_of_freedom(*point) for point in zip(noises, factors, terms, strict=True)]


def _column(values: npt.NDArray[Any], factors: list[int]) -> tuple[list[float], list[Noise]]:
    """Deviation and noise type of one column at each factor; one too long to tell has the type of the next shorter."""
    phase = _running_sum(values)
    deviations, noises = [], []
    known: dict[int, Noise] = {}
    for m in sorted(set(factors)):
        known[m] = identify_noise(_averages(phase, m)) or (list(known.values()) or ["white"])[-1]
    for m in factors:
        deviations.append(float(np.sqrt(_sum_of_squares(phase, m) / (2.0 * (len(phase) - 2 * m)))) / m)
        noises.append(known[m])
    return deviations, noises


def _running_sum(values: npt.NDArray[Any]) -> npt.NDArray[np.int64] | npt.NDArray[np.float64]:
    """0 and the running sum (n + 1,): exact for whole numbers, else of the distance from the mean, to keep it small."""
    if values.dtype.kind in "biu" and _fits(values):
        total = np.zeros(len(values) + 1, np.int64)
        for start in range(0, len(values), _BLOCK):  # by blocks, else NumPy makes a whole copy as int64 first
            part = total[start + 1 : start + 1 + _BLOCK]
            np.cumsum(values[start : start + _BLOCK], dtype=np.int64, out=part)
            part += total[start]
        return total
    phase = np.zeros(len(values) + 1)
    with np.errstate(invalid="ignore", over="ignore"):
        np.subtract(values, values.mean(dtype=np.float64), out=phase[1:])
        np.cumsum(phase[1:], out=phase[1:])
    if not np.isfinite(phase[-1]):
        raise ValueError("the series holds values that are not finite")
    return phase


def _fits(values: npt.NDArray[Any]) -> bool:
    """Whether second differences of the sums stay in int64; the sums needn't: those of wrapped sums are right."""
    if values.dtype.itemsize <= 4:
        return len(values) < 1 << 30
    return (int(values.max()) - int(values.min())) * len(values) < 1 << 62


def _averages(phase: npt.NDArray[np.int64] | npt.NDArray[np.float64], m: int) -> npt.NDArray[np.float64]:
    """Averages over m values, side by side; the middle ones if there are very many."""
    count = (len(phase) - 1) // m
    first = max(0, (count - _IDENTIFY) // 2)
    ends = phase[first * m : (min(count, first + _IDENTIFY)) * m + 1 : m]
    return np.asarray(np.diff(ends) / m, float)


def _sum_of_squares(phase: npt.NDArray[np.int64] | npt.NDArray[np.float64], m: int) -> float:
    """Sum of squared second differences at distance m, a block at a time."""
    terms, total = len(phase) - 2 * m, 0.0
    work = np.empty(min(_BLOCK, terms), phase.dtype)
    squares = np.empty(len(work))
    for start in range(0, terms, _BLOCK):
        stop = min(start + _BLOCK, terms)
        block, real = work[: stop - start], squares[: stop - start]
        middle = phase[start + m : stop + m]
        np.subtract(phase[start + 2 * m : stop + 2 * m], middle, out=block)
        np.subtract(block, middle, out=block)
        np.add(block, phase[start:stop], out=block)
        real[:] = block
        total += float(real @ real)
    return total
