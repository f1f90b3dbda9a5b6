"""Codes of a converter and their density: only even codes, missing codes, clipped ends.

The probabilities assume independent readings. They are too small for noise that is correlated over many rows (a drift
of several codes), so shares and counts are given as well.

Clipping (`Rails`): a rail is the last code of a sensor. It is an end of the codes' bits; the code of range times
sensitivity, if readings reach but do not exceed it; or an accumulation of readings at the largest code, because a
range, a filter or a driver may end elsewhere. A density falls towards its ends, so that the last code is no more
frequent than any code before it. An accumulation that contradicts this is a rail if it is near the end of the range.
Elsewhere it is a rail if a smooth motion that reverses there does not explain it and another axis moves meanwhile. (At
rest, the readings of a coarse sensor with one face down accumulate as well, but then the other axes do not move.)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan, sqrt

import numpy as np
import numpy.typing as npt
from scipy.special import bdtrc, betainc, ndtr

from imuarray.arrays import Integers
from imuarray.characterise.repeats import equal_rows
from imuarray.log import SensorLog

RARE = 1e-3
"""Share of the readings, those with the rarest codes, ignored for the usual step: a glitch may produce any code."""

NARROW = 2.0
"""Least spread in steps for tests of even codes and of the ends: for Gaussian noise with this spread the shares of even
and odd codes differ by (4 / pi) exp(-pi^2 spread^2 / 2) < 4e-9."""

LISTED = 8
"""The number of gaps between codes that are listed, the most improbable first."""


@dataclass(frozen=True)
class Histogram:
    """The `codes` (c,) that occurred, ascending, and the number of readings with each: `counts` (c,)."""

    codes: Integers
    counts: Integers

    def merge(self, other: Histogram) -> Histogram:
        """Return the histogram of both together."""
        if len(self.codes) == 0 or len(other.codes) == 0:
            return self if len(self.codes) else other
        codes = np.union1d(self.codes, other.codes)
        counts = np.zeros(len(codes), np.int64)
        for part in (self, other):
            counts[np.searchsorted(codes, part.codes)] += part.counts
        return Histogram(codes, counts)


NOTHING = Histogram(np.zeros(0, np.int64), np.zeros(0, np.int64))


def histogram(values: npt.NDArray[np.integer]) -> Histogram:
    """Return the histogram of whole numbers (n,), merged from blocks; memory grows with the number of codes only."""
    if len(values) == 0:
        return NOTHING
    low, high = int(values.min()), int(values.max())
    if high - low > 4 * len(values) + 1024:
        codes, counts = np.unique(values, return_counts=True)
        return Histogram(codes.astype(np.int64), counts.astype(np.int64))
    counts = np.bincount(values.astype(np.int64) - low)
    codes = np.flatnonzero(counts)
    return Histogram(codes + low, counts[codes])


def histograms(values: npt.NDArray[np.int64]) -> list[Histogram]:
    """Return the histogram of each row of (k, n), all counted at once unless the range of the codes is much larger than
    n.
    """
    if values.shape[1] == 0:
        return [NOTHING] * len(values)
    low = values.min(axis=1)
    width = int((values.max(axis=1) - low).max()) + 1
    if width > 4 * values.shape[1] + 1024:
        return [histogram(row) for row in values]
    places = values + (width * np.arange(len(values)) - low)[:, np.newaxis]
    counts = np.bincount(places.ravel(), minlength=len(values) * width).reshape(-1, width)
    occurring = [row.nonzero()[0] for row in counts]
    return [Histogram(codes + first, row[codes]) for codes, first, row in zip(occurring, low, counts, strict=True)]


@dataclass(frozen=True)
class CodeGap:
    """Codes `first` to `last` on the usual grid that never occur, though the ones before and after do.

    `p_value` is an upper bound of the probability of that anywhere in the histogram for a density with a single
    maximum: each of the m codes is at least as likely as the rarer of the two neighbours, and if that occurs n times,
    the probability that none of the m does is (1 + m)^-n. It is multiplied by the number of neighbours that are tested.
    """

    first: int
    last: int
    p_value: float


@dataclass(frozen=True)
class End:
    """The lowest or highest `code`, the `share` of readings that have it, and the probability `p_value` of a share at
    least as large.

    A density falls towards its ends, so that the last code is at most as frequent as the one before (binomial
    distribution of both together). nan if the spread is too narrow.
    """

    code: int
    share: float
    p_value: float


@dataclass(frozen=True)
class CodeDensity:
    """Moments and code-density test of one column of counts; nan where there are too few readings.

    `skewness` and `excess_kurtosis` are unbiased for Gaussian noise and have standard errors (Joanes and Gill, The
    Statistician 47, 1998; Cramer, "Mathematical methods of statistics", 29.3). `even_share` is the share of even codes
    in all readings, `even_p` the probability of a share at least as far from one half. `step` is the greatest common
    divisor of the differences of codes, `usual_step` that of all but the rarest codes; 0 for a constant column.
    `missing_codes` on the grid of the usual step between `low_end` and `high_end`; the most improbable gaps are
    `missing`. `span_share` of the readings are at or beyond an end of the converter's span (nan if unknown).
    """

    readings: int
    mean: float
    std: float
    skewness: float
    skewness_error: float
    excess_kurtosis: float
    kurtosis_error: float
    even_share: float
    even_p: float
    step: int
    usual_step: int
    missing_codes: int
    missing: tuple[CodeGap, ...]
    low_end: End
    high_end: End
    span_share: float


def code_density(distribution: Histogram, span: tuple[int, int] | None = None) -> CodeDensity:
    """Return the statistics of a histogram of codes; `span` is the lowest and the highest code of the converter.
    ValueError without readings.
    """
    readings = int(distribution.counts.sum())
    if readings == 0:
        raise ValueError("a histogram needs readings")
    moments = _moments(distribution, readings)
    std = moments[1]
    step = _step(distribution.codes)
    usual = usual_step(distribution)
    even_share = float(distribution.counts[distribution.codes % 2 == 0].sum()) / readings
    even_p = 2 * float(ndtr(-abs(2 * even_share - 1) * sqrt(readings))) if std >= NARROW else nan
    gaps, missing = _missing(distribution, usual)
    low, high = _end(distribution, 0, usual, std), _end(distribution, -1, -usual, std)
    beyond = (
        nan
        if span is None
        else float(distribution.counts[(distribution.codes <= span[0]) | (distribution.codes >= span[1])].sum())
    )
    share = beyond / readings
    return CodeDensity(readings, *moments, even_share, even_p, step, usual, missing, gaps, low, high, share)


def _moments(distribution: Histogram, n: int) -> tuple[float, float, float, float, float, float]:
    """Return the mean, standard deviation (n - 1), skewness and excess kurtosis, each with its standard error."""
    origin = int(distribution.codes[0])
    codes = (distribution.codes - origin).astype(np.float64)
    mean = float(distribution.counts @ codes) / n
    second, third, fourth = (float(distribution.counts @ (codes - mean) ** power) / n for power in (2, 3, 4))
    std = sqrt(second * n / (n - 1)) if n > 1 else nan
    if n < 4 or second == 0:
        return origin + mean, std, nan, nan, nan, nan
    skewness = third / second**1.5 * sqrt(n * (n - 1)) / (n - 2)
    kurtosis = ((n + 1) * (fourth / second**2 - 3) + 6) * (n - 1) / ((n - 2) * (n - 3))
    skewness_error = sqrt(6 * n * (n - 1) / ((n - 2) * (n + 1) * (n + 3)))
    kurtosis_error = 2 * skewness_error * sqrt((n * n - 1) / ((n - 3) * (n + 5)))
    return origin + mean, std, skewness, skewness_error, kurtosis, kurtosis_error


def usual_step(distribution: Histogram) -> int:
    """Return the greatest common divisor of the distances of all but the rarest codes; 0 for a constant column."""
    return _step(_frequent(distribution, int(distribution.counts.sum())))


def _frequent(distribution: Histogram, readings: int) -> Integers:
    """Return the codes without the rarest ones, ascending."""
    order = np.argsort(distribution.counts, kind="stable")
    rare = int(np.searchsorted(np.cumsum(distribution.counts[order]), RARE * readings, side="right"))
    return np.sort(distribution.codes[order[rare:]])


def _step(codes: Integers) -> int:
    """Return the greatest common divisor of the distances of codes (c,), 0 of a single one."""
    return int(np.gcd.reduce(np.diff(codes))) if len(codes) > 1 else 0


def _missing(distribution: Histogram, step: int) -> tuple[tuple[CodeGap, ...], int]:
    """Return the most improbable gaps, and how many codes are missing in all."""
    codes, counts = _grid_counts(distribution, step)
    if len(codes) < 2:
        return (), 0
    absent = np.diff(codes) // step - 1
    rarer = np.minimum(counts[:-1], counts[1:])
    p_value = np.minimum(1.0, len(absent) * (1.0 + absent) ** -rarer.astype(np.float64))
    listed = [at for at in np.argsort(p_value, kind="stable")[:LISTED].tolist() if absent[at]]
    gaps = [CodeGap(int(codes[at]) + step, int(codes[at + 1]) - step, float(p_value[at])) for at in listed]
    return tuple(gaps), int(absent.sum())


def _grid_counts(distribution: Histogram, step: int) -> tuple[Integers, Integers]:
    """Return the integers and counts on the grid of the most frequent code."""
    if step == 0:
        return distribution.codes[:0], distribution.counts[:0]
    on_grid = (distribution.codes - distribution.codes[np.argmax(distribution.counts)]) % step == 0
    return distribution.codes[on_grid], distribution.counts[on_grid]


def _end(distribution: Histogram, at: int, inwards: int, std: float) -> End:
    """Return the code number `at` of a histogram, compared with the code one step inwards."""
    code, count = int(distribution.codes[at]), int(distribution.counts[at])
    p_value = nan
    if inwards and std >= NARROW * abs(inwards):
        next_count = int(distribution.counts[distribution.codes == code + inwards].sum())
        p_value = float(betainc(count, (count + next_count) - count + 1, 0.5)) if count > 0 else 1.0
    return End(code, count / int(distribution.counts.sum()), p_value)


Counts = npt.NDArray[np.int64]

LEAST_PILE = 5
"""Fewest readings of an accumulation: two equal peaks are more probable than one in a million."""

BEFORE = 8
"""Number of codes before the last one with which it is compared."""

FALLING = 1 / (BEFORE + 1)
TURNING = FALLING**0.5
"""Largest share of the last code in its readings and those of the `BEFORE` codes before it: `FALLING` if the density
falls towards its end, `TURNING` if a smooth motion reverses there (the time for which x = x_max - t^2 exceeds a code
grows with the square root of the distance from x_max).
"""

SURE = 1e-6
"""Significance level of an accumulation of readings."""

NOMINAL = 2
"""Largest distance in codes of the end of a range from range times sensitivity: 2047 or 2048, rounded or truncated."""

NEAR_RANGE = 0.1
"""Largest relative distance of a rail from the range's end: chips measure a little beyond their stated range."""

MOVING_STEPS = 20.0
"""Least spread of another axis, in steps of its codes, that shows motion while readings accumulate: noise alone seldom
has this spread, and a coarse sensor at rest has none.
"""

_BLOCK_ROWS = 1 << 14
"""Rows that are read at once, as in most passes over a log, so that an import needs no more memory than the others."""


@dataclass(frozen=True)
class Rails:
    """Lowest and highest code (3,) of each axis, at and beyond which readings are clipped: -inf and inf for an axis
    that is not clipped. `rows` (3,) is the number of clipped readings.
    """

    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    rows: Counts

    def clipped(self, counts: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
        """Return (n,) which rows (n, 3) have a clipped axis."""
        return np.asarray(((counts <= self.low) | (counts >= self.high)).any(axis=1))


def find_rails(sensor: SensorLog) -> Rails:
    """Find the rails of a triad; its rows are read twice at most."""
    distributions = [NOTHING] * 3
    readings = 0
    for block in sensor.blocks(_BLOCK_ROWS):
        counts = np.array(sensor.counts[block], np.int64, order="F")  # most statistics are faster along columns
        readings += 1 + int(np.count_nonzero(~equal_rows(counts[1:], counts[:-1])))
        distributions = [
            merged.merge(histogram(column)) for merged, column in zip(distributions, counts.T, strict=True)
        ]
    low, high = np.full(3, -inf), np.full(3, inf)
    if not len(sensor):
        return Rails(low, high, np.zeros(3, np.int64))
    nominal = round(sensor.range * sensor.sensitivity)
    span = -(1 << sensor.count_bits - 1), (1 << sensor.count_bits - 1) - 1
    doubtful: list[tuple[int, int]] = []
    for axis, codes in enumerate(distributions):
        for side in (-1, 1):
            code = int(codes.codes[-1 if side > 0 else 0])
            verdict = code == span[side > 0] or _is_rail(codes, side, nominal, readings / len(sensor))
            if verdict:
                (high if side > 0 else low)[axis] = code
            elif verdict is None:
                doubtful.append((axis, code))
    for axis, code in _moving(sensor, doubtful, [max(1, usual_step(codes)) for codes in distributions]):
        if code == distributions[axis].codes[-1]:
            high[axis] = code
        else:
            low[axis] = code
    rows = [
        int(codes.counts[(codes.codes <= low[axis]) | (codes.codes >= high[axis])].sum())
        for axis, codes in enumerate(distributions)
    ]
    return Rails(low, high, np.array(rows, np.int64))


def _is_rail(distribution: Histogram, side: int, nominal: int, new_share: float) -> bool | None:
    """Return whether the last code on a side is a rail; None if that depends on whether the box moved. `new_share` of
    the rows are readings of their own, and the others repeat them.
    """
    code = int(distribution.codes[-1 if side > 0 else 0])
    distance = side * code
    if 0 < nominal - NOMINAL <= distance <= nominal:
        return True
    is_near = abs(distance - nominal) <= NEAR_RANGE * nominal
    if not _is_pile(distribution, side, FALLING if is_near else TURNING, new_share):
        return False
    return True if is_near else None


def _is_pile(distribution: Histogram, side: int, share: float, new_share: float) -> bool:
    """Return whether the last code on a side is significantly more frequent than the `share` of its readings and those
    of the codes before it allows; `new_share` of its rows are readings of their own.
    """
    code = int(distribution.codes[-1 if side > 0 else 0])
    count = int(new_share * distribution.counts[-1 if side > 0 else 0])
    step = usual_step(distribution)
    if count < LEAST_PILE or step == 0:
        return False
    mean = float(distribution.codes @ distribution.counts) / float(distribution.counts.sum())
    if (
        float(distribution.counts @ (distribution.codes - mean) ** 2) / float(distribution.counts.sum())
        < (NARROW * step) ** 2
    ):
        return False
    inwards = side * (code - distribution.codes)
    codes_before = int(new_share * distribution.counts[(inwards > 0) & (inwards <= BEFORE * step)].sum())
    return bool(bdtrc(count - 1, count + codes_before, share) < SURE)


def _moving(sensor: SensorLog, piles: list[tuple[int, int]], steps: list[int]) -> list[tuple[int, int]]:
    """Return the piles (axis, code) during which another axis moves."""
    sums = np.zeros((len(piles), 3, 3))
    for block in sensor.blocks(_BLOCK_ROWS) if piles else ():
        counts = np.asarray(sensor.counts[block], float)
        for number, (axis, code) in enumerate(piles):
            rows = counts[counts[:, axis] == code]
            sums[number] += [np.full(3, float(len(rows))), rows.sum(axis=0), (rows**2).sum(axis=0)]
    moving = []
    for (axis, code), (rows, total, squares) in zip(piles, sums, strict=True):
        spread = np.sqrt(np.maximum(squares / rows - (total / rows) ** 2, 0.0)) / np.array(steps)
        if np.delete(spread, axis).max() > MOVING_STEPS:
            moving.append((axis, code))
    return moving
