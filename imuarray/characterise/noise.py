"""Streaming statistics of a sensor at rest: mean, spread, correlation from row to row, codes and flags.

Rows are read in batches and blocks, never all at once, and the parts are merged (Chan, Golub and LeVeque, "Updating
formulae and a pairwise algorithm for computing sample variances", 1979).

Stale, saturated and suspect rows are excluded from mean, spread and correlation: a stale row repeats the one before, a
suspect row may be in other units, and a saturated row is clipped. Without saturated rows the spread is too small, so
the number of these rows is given with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.characterise.stretch import Spans, flags_of
from imuarray.log import SensorLog
from imuarray.log.format import FLAGS, SATURATED, STALE, SUSPECT

LEFT_OUT = STALE | SATURATED | SUSPECT
"""Flags of rows that are not counted as readings."""

BATCHES = 32
"""The number of batch means; the standard error of the mean is computed from their scatter."""

_MIN_BATCH = 8
_BLOCK = 1 << 16


@dataclass(frozen=True)
class NoiseStatistics:
    """One sensor's rows at rest, in counts, per column (k,); nan where there are too few rows.

    `rows` is the number of rows, `used` the number of rows that count as readings, `flags` the number of rows per flag
    of the log. `mean` and `std` (about that mean, n - 1) of the used rows; `sem` the standard error of the mean, from
    the scatter of the means of up to 32 equally long batches, which includes any correlation shorter than a batch;
    `lag1` the autocorrelation of one used row and the next; `even_share` the share of even codes among the used rows.
    """

    rows: int
    used: int
    flags: Mapping[str, int]
    mean: Floats
    std: Floats
    sem: Floats
    lag1: Floats
    even_share: Floats


class _RunningMoments(NamedTuple):
    """Number of rows, their mean (k,) and the sum of squares about it (k,)."""

    number: int
    mean: Floats
    squares: Floats

    def merge(self, other: _RunningMoments) -> _RunningMoments:
        """Return the moments of both together."""
        number = self.number + other.number
        if number == 0:
            return self
        difference = other.mean - self.mean
        mean = self.mean + difference * (other.number / number)
        squares = self.squares + other.squares + difference**2 * (self.number * other.number / number)
        return _RunningMoments(number, mean, squares)


def noise_statistics(sensor: SensorLog, rows: slice, left_out: Spans = ()) -> NoiseStatistics:
    """Return the statistics of a sensor's `rows`, a stretch at rest, without those in the spans `left_out`."""
    zeros = np.zeros(int(sensor.counts.shape[1]))
    total, even = _RunningMoments(0, zeros, zeros), zeros
    pairs, both, product = 0, zeros, zeros  # of neighbouring rows in a block, relative to a fixed origin
    flags = dict.fromkeys(FLAGS, 0)
    means: list[Floats] = []
    origin: Floats | None = None
    for batch in _batches(rows):
        in_batch = _RunningMoments(0, zeros, zeros)
        for counts in _read_used(sensor, batch, flags, left_out):
            origin = counts.mean(axis=1) if origin is None else origin
            levels = counts - origin[:, np.newaxis]
            moments = _moments(levels)
            in_batch = in_batch.merge(moments._replace(mean=moments.mean + origin))
            pairs += levels.shape[1] - 1
            both = both + 2 * moments.mean * levels.shape[1] - levels[:, 0] - levels[:, -1]
            product = product + (levels[:, :-1] * levels[:, 1:]).sum(axis=1)
            even = even + (counts.shape[1] - (counts & 1).sum(axis=1))
        total = total.merge(in_batch)
        if in_batch.number:
            means.append(in_batch.mean)
    number = total.number
    std = sem = lag1 = mean = share = np.full(len(zeros), np.nan)
    if number:
        mean, share = total.mean, even / number
    if number > 1:
        std = np.sqrt(total.squares / (number - 1))
    if len(means) > 1:
        sem = np.std(means, axis=0, ddof=1) / np.sqrt(len(means))
    if origin is not None and pairs:
        offset = total.mean - origin
        covariance = (product - offset * both) / pairs + offset**2
        lag1 = covariance / np.where(total.squares > 0, total.squares / number, np.nan)
    return NoiseStatistics(rows.stop - rows.start, number, flags, mean, std, sem, lag1, share)


def _read_used(
    sensor: SensorLog, rows: slice, flags: dict[str, int], left_out: Spans
) -> Iterator[npt.NDArray[np.integer]]:
    """Yield the counts (k, n) of rows that count as readings, by blocks; flagged rows are added up in `flags`."""
    for start in range(rows.start, rows.stop, _BLOCK):
        part = slice(start, min(start + _BLOCK, rows.stop))
        status = np.asarray(sensor.status[part])
        for name, flag in FLAGS.items() if status.any() else ():
            flags[name] += int(np.count_nonzero(status & flag))
        used = ((flags_of(sensor, part, left_out) if left_out else status) & LEFT_OUT) == 0
        if used.any():
            selection = slice(None) if used.all() else used  # avoids a copy
            yield np.ascontiguousarray(np.asarray(sensor.counts[part])[selection].T)


def _batches(rows: slice) -> Iterator[slice]:
    """Return equally long slices that cover `rows`: 32, or fewer of at least 8 rows, but at least one."""
    count = max(1, min(BATCHES, (rows.stop - rows.start) // _MIN_BATCH))
    edges = np.linspace(rows.start, rows.stop, count + 1).round().astype(int).tolist()
    return (slice(start, stop) for start, stop in pairwise(edges) if stop > start)


def _moments(levels: Floats) -> _RunningMoments:
    """Return the moments of the rows of (k, n)."""
    mean = levels.mean(axis=1)
    squares = ((levels - mean[:, np.newaxis]) ** 2).sum(axis=1)
    return _RunningMoments(levels.shape[1], mean, squares)
