"""Statistics of rates: proportions with intervals, ranks, and the calibration of probabilities.

Intervals have 95 % confidence: Wilson's for proportions (JASA 22, 1927), the percentile bootstrap for everything else.
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
"""Number of probability bins of equal width."""

_DRAWS = 1000
_MEANS = 200
_ROUNDING = 1e-9


class RateEstimate(NamedTuple):
    """A figure with its 95 % interval over `cases` cases; nan without cases."""

    value: float
    low: float
    high: float
    cases: int


NOTHING = RateEstimate(nan, nan, nan, 0)


class Bin(NamedTuple):
    """Probabilities between `low` and `high`: their number, their mean, and the share of them that were right."""

    low: float
    high: float
    cases: int
    mean: float
    right: float


class Chance(NamedTuple):
    """The hits with labels permuted once, and the mean share and standard deviation over all permutations."""

    hits: int
    mean: float
    deviation: float


def rate(hits: int, cases: int) -> RateEstimate:
    """Return a proportion of cases with Wilson's interval."""
    if not cases:
        return NOTHING
    interval = stats.binomtest(hits, cases).proportion_ci(CONFIDENCE, method="wilson")
    return RateEstimate(hits / cases, float(interval.low), float(interval.high), cases)


def bootstrap(statistic: Callable[..., float], *samples: Numbers, seed: int) -> RateEstimate:
    """Return `statistic` of samples (n,), (m,), ..., each resampled independently; `cases` counts the first sample.

    The interval is nan if a sample has a single value.
    """
    arrays = [np.asarray(sample, float) for sample in samples]
    if not all(map(len, arrays)):
        return NOTHING
    value, cases = float(statistic(*arrays)), len(arrays[0])
    if min(map(len, arrays)) < 2:
        return RateEstimate(value, nan, nan, cases)
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
    return RateEstimate(value, float(interval.low), float(interval.high), cases)


def bootstrap_groups(
    statistic: Callable[[Floats, Booleans], float], groups: Sequence[tuple[Numbers, Any]], seed: int
) -> RateEstimate:
    """Return `statistic` of probabilities (n,) and whether they were right (n,), grouped by case. Whole groups are
    resampled, because values of one case are not independent. `cases` counts the probabilities.
    """
    filled = [(np.asarray(values, float), np.asarray(right, bool)) for values, right in groups if len(values)]
    if not filled:
        return NOTHING
    values, outcomes = (np.concatenate(parts) for parts in zip(*filled, strict=True))
    sizes = np.array([len(values) for values, _ in filled])
    starts = np.cumsum(sizes) - sizes

    def joined(places: Floats) -> float:
        chosen = places.astype(int)
        many = sizes[chosen]
        rows = np.arange(many.sum()) + np.repeat(starts[chosen] - (np.cumsum(many) - many), many)
        return statistic(values[rows], outcomes[rows])

    return bootstrap(joined, np.arange(len(filled), dtype=float), seed=seed)._replace(cases=len(values))


def auroc(positives: Numbers, negatives: Numbers) -> float:
    """Return the probability that a score of `positives` (n,) exceeds one of `negatives` (m,), ties counting half: the
    area under the receiver operating characteristic (Hanley and McNeil, Radiology 143, 1982). nan without either.
    """
    many = len(positives) * len(negatives)
    if not many:
        return nan
    ranks = stats.rankdata(np.concatenate([positives, negatives]))[: len(positives)]
    return float((ranks.sum() - len(positives) * (len(positives) + 1) / 2) / many)


def limit_of(negatives: Numbers, most: float) -> float:
    """Return the smallest limit that at most the share `most` of `negatives` (n,) exceeds; -inf without negatives."""
    allowed = floor(most * len(negatives) + _ROUNDING)
    return float(np.sort(negatives)[::-1][allowed]) if allowed < len(negatives) else -inf


def reliability(probabilities: Numbers, right: Any) -> tuple[Bin, ...]:
    """Return the bin probabilities (n,) by value and compare them with whether they were right (n,); 1 is in the last
    bin.
    """
    chances, outcomes = np.asarray(probabilities, float), np.asarray(right, bool)
    places = np.minimum((chances * BINS).astype(int), BINS - 1)
    filled = []
    for place in range(BINS):
        own = places == place
        mean, share = (float(chances[own].mean()), float(outcomes[own].mean())) if own.any() else (nan, nan)
        filled.append(Bin(place / BINS, (place + 1) / BINS, int(own.sum()), mean, share))
    return tuple(filled)


def calibration_error(probabilities: Numbers, right: Any) -> float:
    """Return the expected calibration error: the distance between mean probability and share right, averaged over bins
    by their number of values (Naeini, Cooper and Hauskrecht, AAAI 2015). nan without values.
    """
    filled = [bin_ for bin_ in reliability(probabilities, right) if bin_.cases]
    total = sum(bin_.cases for bin_ in filled)
    return sum(bin_.cases * abs(bin_.mean - bin_.right) for bin_ in filled) / total if total else nan


def calibration_error_by_chance(probabilities: Floats, seed: int) -> float:
    """Return the mean calibration error that correct probabilities (n,) have by chance, because with few values the
    share of a bin scatters.
    """
    random = np.random.default_rng(seed)
    drawn = (random.random(len(probabilities)) < probabilities for _ in range(_MEANS))
    return float(np.mean([calibration_error(probabilities, outcomes) for outcomes in drawn]))


def brier(probabilities: Numbers, right: Any) -> float:
    """Return the mean squared difference of probabilities (n,) and outcomes (n,), 0 or 1 (Brier, Mon. Weather Rev. 78,
    1950).
    """
    return float(np.mean((np.asarray(probabilities, float) - np.asarray(right, bool)) ** 2))


def permute_labels(hits: Any, seed: int) -> Chance:
    """Permute the labels of `hits` (n, n), which are True if answer i (row) hits label j (column). The number of hits
    is that of one permutation; mean and standard deviation of the share are exact over all permutations (Hoeffding,
    Ann. Math. Stat. 22, 1951).
    """
    table = np.asarray(hits, bool)
    many = len(table)
    if not many:
        return Chance(0, nan, nan)
    order = np.random.default_rng(seed).permutation(many)
    mean, rows, columns = float(table.mean()), table.mean(axis=1), table.mean(axis=0)
    squares = many * many * (mean + mean**2) - many * float((rows**2).sum() + (columns**2).sum())  # residuals
    deviation = sqrt(max(squares, 0.0) / (many - 1)) / many if many > 1 else 0.0  # after subtraction of both means
    return Chance(int(table[np.arange(many), order].sum()), mean, deviation)
