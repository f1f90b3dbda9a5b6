"""Statistics of rates: shares with their intervals, ranks, how far probabilities are to be believed.

Intervals hold 95 %: Wilson's for shares (JASA 22, 1927), the percentile bootstrap for everything else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import floor, inf, nan, sqrt
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from imuarray.arrays import Booleans, Floats

Numbers = Sequence[float] | Floats

CONFIDENCE = 0.95
BINS = 10
"""Of probabilities, equally wide."""

_DRAWS = 1000
_MEANS = 200
_ROUNDING = 1e-9


class Estimate(NamedTuple):
    """A figure with its 95 % interval, of so many `cases`; nan where there are none."""

    value: float
    low: float
    high: float
    cases: int


NOTHING = Estimate(nan, nan, nan, 0)


class Bin(NamedTuple):
    """Probabilities between `low` and `high`: so many, their mean, and the share of them that came true."""

    low: float
    high: float
    cases: int
    mean: float
    right: float


class Chance(NamedTuple):
    """A share of hits with its labels permuted once, and what permutations give on average, and their deviation."""

    hits: int
    mean: float
    deviation: float


def rate(hits: int, cases: int) -> Estimate:
    """A share of cases, with Wilson's interval."""
    if not cases:
        return NOTHING
    interval = stats.binomtest(hits, cases).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(hits / cases, float(interval.low), float(interval.high), cases)


def bootstrapped(statistic: Callable[..., float], *samples: Numbers, seed: int) -> Estimate:
    """`statistic` of samples (n,), (m,), ... that are drawn anew, each by itself; `cases` are those of the first.

    No interval (nan) if a sample has a single value.
    """
    arrays = [np.asarray(sample, float) for sample in samples]
    if not all(map(len, arrays)):
        return NOTHING
    value, cases = float(statistic(*arrays)), len(arrays[0])
    if min(map(len, arrays)) < 2:
        return Estimate(value, nan, nan, cases)
    drawn = stats.bootstrap(
        tuple(arrays),
        statistic,
        n_resamples=_DRAWS,
        vectorized=False,
        confidence_level=CONFIDENCE,
        method="percentile",
        random_state=np.random.default_rng(seed),
    )
    interval = drawn.confidence_interval
    return Estimate(value, float(interval.low), float(interval.high), cases)


def of_groups(
    statistic: Callable[[Floats, Booleans], float], groups: Sequence[tuple[Numbers, Any]], seed: int
) -> Estimate:
    """`statistic` of probabilities (n,) and whether they came true (n,), which come in groups, one of a case: groups
    are drawn anew, as what belongs to one case is not independent. `cases` counts the probabilities.
    """
    filled = [(np.asarray(one, float), np.asarray(right, bool)) for one, right in groups if len(one)]
    if not filled:
        return NOTHING
    said, came = (np.concatenate(parts) for parts in zip(*filled, strict=True))
    sizes = np.array([len(one) for one, _ in filled])
    starts = np.cumsum(sizes) - sizes

    def joined(places: Floats) -> float:
        chosen = places.astype(int)
        many = sizes[chosen]
        rows = np.arange(many.sum()) + np.repeat(starts[chosen] - (np.cumsum(many) - many), many)
        return statistic(said[rows], came[rows])

    return bootstrapped(joined, np.arange(len(filled), dtype=float), seed=seed)._replace(cases=len(said))


def auroc(positives: Numbers, negatives: Numbers) -> float:
    """The chance that a score of `positives` (n,) is above one of `negatives` (m,), ties counting half: the area under
    the receiver operating characteristic (Hanley and McNeil, Radiology 143, 1982). nan without either.
    """
    many = len(positives) * len(negatives)
    if not many:
        return nan
    ranks = stats.rankdata(np.concatenate([positives, negatives]))[: len(positives)]
    return float((ranks.sum() - len(positives) * (len(positives) + 1) / 2) / many)


def limit_of(negatives: Numbers, most: float) -> float:
    """The least limit that no more than a share `most` of `negatives` (n,) is above; -inf without any."""
    allowed = floor(most * len(negatives) + _ROUNDING)
    return float(np.sort(negatives)[::-1][allowed]) if allowed < len(negatives) else -inf


def reliability(probabilities: Numbers, right: Any, bins: int = BINS) -> tuple[Bin, ...]:
    """Probabilities (n,) against whether they came true (n,), in bins that are equally wide; 1 is in the last."""
    chances, came = np.asarray(probabilities, float), np.asarray(right, bool)
    places = np.minimum((chances * bins).astype(int), bins - 1)
    found = []
    for place in range(bins):
        own = places == place
        mean, share = (float(chances[own].mean()), float(came[own].mean())) if own.any() else (nan, nan)
        found.append(Bin(place / bins, (place + 1) / bins, int(own.sum()), mean, share))
    return tuple(found)


def calibration_error(probabilities: Numbers, right: Any, bins: int = BINS) -> float:
    """Expected calibration error: how far the mean of a bin is from the share that came true, over all bins as filled
    as they are (Naeini, Cooper and Hauskrecht, AAAI 2015). nan without any.
    """
    filled = [one for one in reliability(probabilities, right, bins) if one.cases]
    total = sum(one.cases for one in filled)
    return sum(one.cases * abs(one.mean - one.right) for one in filled) / total if total else nan


def calibration_error_by_chance(probabilities: Floats, seed: int) -> float:
    """The mean error of probabilities (n,) that are right: of few no bin is full, and its share is off by chance."""
    random = np.random.default_rng(seed)
    drawn = (random.random(len(probabilities)) < probabilities for _ in range(_MEANS))
    return float(np.mean([calibration_error(probabilities, came) for came in drawn]))


def brier(probabilities: Numbers, right: Any) -> float:
    """Mean squared difference of probabilities (n,) and what came (n,), 0 or 1 (Brier, Mon. Weather Rev. 78, 1950)."""
    return float(np.mean((np.asarray(probabilities, float) - np.asarray(right, bool)) ** 2))


def permuted(hits: Any, seed: int) -> Chance:
    """`hits` (n, n): whether answer i (row) hits label j (column). Labels permuted once; mean and deviation of the
    share that permutations hit are exact (Hoeffding, Ann. Math. Stat. 22, 1951).
    """
    table = np.asarray(hits, bool)
    many = len(table)
    if not many:
        return Chance(0, nan, nan)
    order = np.random.default_rng(seed).permutation(many)
    mean, rows, columns = float(table.mean()), table.mean(axis=1), table.mean(axis=0)
    squares = many * many * (mean + mean**2) - many * float((rows**2).sum() + (columns**2).sum())  # of what is left
    deviation = sqrt(max(squares, 0.0) / (many - 1)) / many if many > 1 else 0.0  # without both means
    return Chance(int(table[np.arange(many), order].sum()), mean, deviation)
