"""Scores of all statistics of a sensor in a log, pooled.

The largest of thousands of scores detects a deviation that is large in one place. An effect that changes tens of
statistics slightly, for example the levels of all faces, exceeds the largest score that is expected by chance in none
of them. It is detected by the norm of the excess of the normal scores z of a sensor in a log over `BEYOND`,

    S = sqrt(sum(max(|z| - BEYOND, 0)^2)),

which is computed for each log of a sensor and for all of its logs. Smaller scores are left out, since a slightly wrong
fit shifts many of them. Statistics are not independent, since they share the noise, the attitude and the fit; S is
therefore compared with its mean and scatter in the other campaigns, as each single statistic is.

The response to motion of a sensor that is late, or mounted at another place in the box, deviates in the same direction
on all of its axes, and so do the readings of a die by its supply, temperature or power-on. The scores of each statistic
of a motion, and those of `SHARED` statistics, are therefore also summed over the axes.

Statistics of a domain with few of them, such as those over temperature, would be masked by the thousands that describe
the noise of each phase. Each domain has the same share of the level (`equal_shares`), and pools and sums together have
a smaller one than the single statistics (`_WEIGHT`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.statistics.catalogue import Key

BEYOND = 1.0
"""Normal score above which a statistic contributes to the norm. Using only the largest single score, 58 of 72 cases
with a mechanism were detected, and one was reported in 7 of 120 cases without; with this norm in addition, 63 and 5.
Other values from 0 to 1.5 detected 59 to 62.
"""

FEWEST_PLACES = 6
"""Least number of statistics of a sensor whose scores are pooled: the pool of fewer adds little to the largest of them.
"""

_LEAST_SPREAD, _LEAST_SPREAD_OF_SUMS = 0.15, 0.7
"""Least standard deviation by which a pooled score, and a sum over axes, is divided. A sum varies by less than 1 only
if the scores are those of differences below the least meaningful one.
"""

_QUANTILES = (0.5, 0.9)
"""Quantiles of the largest score of a campaign that are made equal for pooled and single scores. Pooled scores have
longer tails: when the 95 % quantiles were made equal, single deviations were missed.
"""

_LEAST_STRETCH = 0.1
"""Least difference between the two quantiles that is assumed: a few pooled scores may be equal in all campaigns."""


SHARED = frozenset(
    {"mean_halves", "wander", "slow_between_axes", "thermal_slope", "thermal_square", "thermal_change", "run_rms"}
)
"""Statistics that the supply, the temperature or the power-on of a die changes on all of its axes. Their scores are
summed over the axes of a sensor.
"""

_WEIGHT = 0.3
"""Share of the level of single scores that pools and sums have. With equal weights, effects that a single statistic
shows had twice the p-value that they have without pools.
"""


class PooledScores(NamedTuple):
    """Scores (b, k) of k pools and sums in b campaigns, and for each the place (k,) of the single statistic that
    deviates most in the first campaign.

    They are comparable with the scores that `equal_shares` returns for single statistics: the largest score of a
    campaign has the same median and the same 90 % quantile before it is reduced by `_WEIGHT`, so that neither kind
    masks the other.
    """

    scores: Floats
    places: Indices


def pooled_scores(normal: Floats, keys: Sequence[Key]) -> PooledScores:
    """Pool the normal scores (b, m) of b campaigns for m keys.

    Each campaign is scored against the others: if all have the same distribution, each is equally likely to be the most
    extreme.
    """
    sizes, singles = np.nan_to_num(np.abs(normal)), equal_shares(normal, keys)
    excess = np.maximum(sizes - BEYOND, 0.0)
    pools, axes = list(_pools(keys)), list(_shared_axes(keys))
    scores = [np.zeros((len(normal), 0))]
    if pools:
        norms = np.stack([np.linalg.norm(excess[:, places], axis=1) for places in pools], axis=1)
        scores.append(_with_largest_of(_standardise_by_others(norms, _LEAST_SPREAD), singles))
    if axes:
        sums = [np.nan_to_num(normal[:, places]).sum(axis=1) / np.sqrt(len(places)) for places in axes]
        standardised = _standardise_by_others(np.stack(sums, axis=1), _LEAST_SPREAD_OF_SUMS)
        scores.append(_with_largest_of(np.abs(standardised), singles))
    strongest = [places[int(sizes[0, places].argmax())] for places in (*pools, *axes)]
    return PooledScores(np.concatenate(scores, axis=1), np.array(strongest, np.intp))


def equal_shares(normal: Floats, keys: Sequence[Key]) -> Floats:
    """Return the absolute normal scores (b, m) of b campaigns for m keys, raised so that each domain has the same share
    of the level, whatever the number of its statistics.

    The probability that one of n scores exceeds z is about n exp(-z^2 / 2). A domain with k of n statistics therefore
    has z^2 + 2 ln(n / k) instead of z^2 (a weighted Bonferroni test: Holm, Scand. J. Stat. 6, 1979).
    """
    known = np.isfinite(normal).any(axis=0)
    _, domains = np.unique([key.domain for key in keys], return_inverse=True)
    counts = np.bincount(domains, weights=known)
    raised = 2 * np.log(max(known.sum(), 1) / np.maximum(counts, 1))
    return np.asarray(np.sqrt(np.nan_to_num(normal) ** 2 + raised[domains]))


def _shared_axes(keys: Sequence[Key]) -> Iterator[Indices]:
    """Yield, for each statistic of the response to a motion and each shared one, its places on all axes of a
    sensor.
    """
    by_statistic: dict[tuple[int, str, int, str], list[int]] = {}
    for at, key in enumerate(keys):
        if key.domain == "motion" or key.probe in SHARED:
            by_statistic.setdefault((key.log, key.sensor, key.phase_number, key.probe), []).append(at)
    yield from (np.array(places, np.intp) for places in by_statistic.values() if len(places) > 1)


def _pools(keys: Sequence[Key]) -> Iterator[Indices]:
    """Yield the places of each sensor in each log, and those of the sensor in all logs if there are several."""
    by_sensor: dict[str, dict[int, list[int]]] = {}
    for at, key in enumerate(keys):
        by_sensor.setdefault(key.sensor, {}).setdefault(key.log, []).append(at)
    for by_log in by_sensor.values():
        pools = list(by_log.values())
        if len(pools) > 1:
            pools.append([at for places in pools for at in places])
        yield from (np.array(places, np.intp) for places in pools if len(places) >= FEWEST_PLACES)


def _standardise_by_others(values: Floats, least: float) -> Floats:
    """Return deviations (b, k) of values (b, k) from the mean of the other campaigns, divided by their standard
    deviation or the `least` one.
    """
    others = max(len(values) - 1, 1)
    means = (values.sum(axis=0) - values) / others
    squares = values**2
    variances = (squares.sum(axis=0) - squares) / others - means**2
    return np.asarray((values - means) / np.sqrt(np.maximum(variances, least**2)))


def _with_largest_of(scores: Floats, singles: Floats) -> Floats:
    """Return the scores (b, k), scaled and shifted so that the largest of each campaign has the same `_QUANTILES` as
    the largest of `singles` (b, m), and reduced to their share of the level; negative results are set to 0.
    """
    middle, high = np.quantile(scores.max(axis=1), _QUANTILES)
    single_middle, single_high = np.quantile(singles.max(axis=1), _QUANTILES)
    stretch = (single_high - single_middle) / max(high - middle, _LEAST_STRETCH)
    equal = np.maximum(single_middle + stretch * (scores - middle), 0.0)
    return np.asarray(np.sqrt(np.maximum(equal**2 + 2 * np.log(_WEIGHT), 0.0)))
