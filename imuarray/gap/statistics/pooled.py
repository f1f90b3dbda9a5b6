"""Scores of all statistics of a sensor in a log, pooled.

The largest of thousands of scores shows a deviation that is large in one place. An effect that moves tens of statistics
a little, such as the levels of all faces, exceeds the largest score by chance in none of them. The norm of what the
normal scores z of a sensor in a log exceed `BEYOND` by,

    S = sqrt(sum(max(|z| - BEYOND, 0)^2)),

shows it: once for each log of a sensor, and once for all of its logs. Smaller scores are left out, since a fit that is
slightly wrong shifts many of them. Statistics are not independent, since the noise, the attitude and the fit are common
to them; S is therefore compared with its mean and scatter in the other campaigns, as each single statistic is.

A sensor that is late, or at another place in the box, deviates on all of its axes in the same direction in its response
to motion. The scores of each statistic of a motion are therefore summed over the axes too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.statistics.catalogue import Key

BEYOND = 1.0
"""Normal score from which on a place counts. With the largest single score alone 58 of 72 cases with a mechanism were
detected, and 7 of 120 without one; with this norm in addition 63 and 5, and 59 to 62 with other values from 0 to 1.5.
"""

FEWEST_PLACES = 6
"""Places from which scores are pooled: fewer say little more than the largest of them."""

_LEAST_SPREAD = 0.15
"""Least scatter of S."""

_QUANTILES = (0.5, 0.9)
"""Quantiles of the largest score of a campaign that pooled scores share with single ones. Pooled ones have longer
tails: with a common 95 % quantile they hid single deviations.
"""

_LEAST_STRETCH = 0.1
"""Least difference between the two quantiles: a few pooled scores may be equal in all campaigns."""


class PooledScores(NamedTuple):
    """Scores (b, k) of k pools and sums in b campaigns, and the places (k,) of the single statistic of each that
    deviates most in the first campaign.

    They are comparable with the normal scores of single statistics: the largest of a campaign has the same median and
    the same 90 % quantile. Neither hides the other.
    """

    scores: Floats
    places: Indices


def pooled_scores(normal: Floats, keys: Sequence[Key]) -> PooledScores:
    """Pools the normal scores (b, m) of campaigns under the keys.

    Each campaign is scored by the others: if all are of one kind, each is equally likely to be the most extreme.
    """
    sizes = np.nan_to_num(np.abs(normal))
    excess = np.maximum(sizes - BEYOND, 0.0)
    pools, axes = list(_pools(keys)), list(_motion_axes(keys))
    norms = [np.linalg.norm(excess[:, places], axis=1) for places in pools]
    sums = [np.nan_to_num(normal[:, places]).sum(axis=1) / np.sqrt(len(places)) for places in axes]
    scores = [np.zeros((len(normal), 0))]
    if norms:
        scores.append(_with_largest_of(_standardise_by_others(np.stack(norms, axis=1)), sizes))
    if sums:
        scores.append(_with_largest_of(np.abs(_standardise_by_others(np.stack(sums, axis=1))), sizes))
    strongest = [places[int(sizes[0, places].argmax())] for places in (*pools, *axes)]
    return PooledScores(np.concatenate(scores, axis=1), np.array(strongest, np.intp))


def _motion_axes(keys: Sequence[Key]) -> Iterator[Indices]:
    """Yield the places of each statistic of the response to a motion, on all axes of a sensor."""
    by_statistic: dict[tuple[int, str, int, str], list[int]] = {}
    for at, key in enumerate(keys):
        if key.domain == "motion":
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


def _standardise_by_others(values: Floats) -> Floats:
    """Return deviations (b, k) of values (b, k) from the mean of the other campaigns, over their standard deviation."""
    others = max(len(values) - 1, 1)
    means = (values.sum(axis=0) - values) / others
    squares = values**2
    variances = (squares.sum(axis=0) - squares) / others - means**2
    return np.asarray((values - means) / np.sqrt(np.maximum(variances, _LEAST_SPREAD**2)))


def _with_largest_of(scores: Floats, singles: Floats) -> Floats:
    """Return the scores (b, k), stretched and shifted so that their largest in each campaign is distributed as the
    largest of `singles` (b, m) is; 0 where that would be negative.
    """
    middle, high = np.quantile(scores.max(axis=1), _QUANTILES)
    single_middle, single_high = np.quantile(singles.max(axis=1), _QUANTILES)
    stretch = (single_high - single_middle) / max(high - middle, _LEAST_STRETCH)
    return np.asarray(np.maximum(single_middle + stretch * (scores - middle), 0.0))
