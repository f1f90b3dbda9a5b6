"""Scores of one statistic, pooled over the phases, runs and axes of a sensor.

The largest of thousands of scores shows a deviation that is large somewhere. One of a statistic with heavy tails, which
returns in every phase, is no larger than the largest by chance. The sum of what the normal scores z of the statistic
exceed `BEYOND` by, over its n places,

    S = sum(sign(z) max(|z| - BEYOND, 0)) / sqrt(n),

shows it: once for each axis, and once for the whole sensor. Smaller scores are left out, since a fit that is slightly
wrong, of a filter for example, shifts the correlations of all phases alike, and their sum would call that a gap. Places
are not independent, since the noise, the attitude and the fit are common to them; S is therefore scored by the other
campaigns, as each single statistic is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.tails import normal_scores_by_others

BEYOND = 2.0
"""Normal score from which on a place counts. In 43 random controls without a gap, sums of all scores exceeded chance in
up to 7 for correlations, Allan deviations and lost rows, and what exceeds 2 in 3 of 48 for all statistics together.
"""

DISCOUNT = 0.8
"""Normal score by which pooled statistics count less than single ones: what the model lacks of a part without a fault
is small in each place and alike in many. In 208 random worlds without a mechanism they add 2 gaps to the 16 of single
ones with it, and 8 without; of 47 mechanisms they show one more in both cases.
"""

FEWEST_PLACES = 3
"""Places from which a statistic is pooled: two say little more than the larger of them."""

_LEAST_SPREAD = 0.3
"""Least root mean square of S: in most campaigns no score of a statistic exceeds `BEYOND`."""

_QUANTILES = (0.5, 0.9)
"""Quantiles of the largest score of a campaign that pooled statistics share with single ones. Scores of the former have
longer tails: at 95 % their largest was 6.6 where that of single ones was 4.6, and hid single deviations of 5.
"""

_LEAST_STRETCH = 0.1
"""Least difference between the two quantiles: a few pooled statistics may be equal in all campaigns."""


class PooledScores(NamedTuple):
    """Scores (b, k) of k pooled statistics in b campaigns, and the places (k,) of the single statistic of each that
    deviates most in the first campaign.

    They are comparable with the normal scores of single statistics: the largest of a campaign has the same median and
    the same 90 % quantile, less `DISCOUNT`. Neither hides the other.
    """

    scores: Floats
    places: Indices


def pooled_scores(normal: Floats, keys: Sequence[Key]) -> PooledScores:
    """Pools the normal scores (b, m) of campaigns under the keys.

    Each campaign is scored by the others: if all are of one kind, each is equally likely to be the most extreme.
    """
    pools = list(_pools(keys))
    if not pools:
        return PooledScores(np.zeros((len(normal), 0)), np.zeros(0, np.intp))
    sizes = np.nan_to_num(np.abs(normal))
    beyond = np.copysign(np.maximum(sizes - BEYOND, 0.0), np.nan_to_num(normal))
    pooled = np.stack([beyond[:, places].sum(axis=1) / np.sqrt(len(places)) for places in pools], axis=1)
    scores = normal_scores_by_others(_standardised_by_others(pooled), [keys[places[0]] for places in pools])
    strongest = np.array([places[int(sizes[0, places].argmax())] for places in pools], np.intp)
    return PooledScores(_with_largest_of(scores, sizes), strongest)


def _pools(keys: Sequence[Key]) -> Iterator[Indices]:
    """The places of each statistic of a sensor, and those of each of its axes if there are several."""
    by_sensor: dict[tuple[str, str], list[int]] = {}
    for at, key in enumerate(keys):
        by_sensor.setdefault((key.sensor, key.probe), []).append(at)
    for places in by_sensor.values():
        if len(places) < FEWEST_PLACES:
            continue
        yield np.array(places, np.intp)
        axes = {keys[at].axis for at in places}
        for axis in sorted(axes) if len(axes) > 1 else ():
            of_axis = [at for at in places if keys[at].axis == axis]
            if len(of_axis) >= FEWEST_PLACES:
                yield np.array(of_axis, np.intp)


def _standardised_by_others(values: Floats) -> Floats:
    """Values (b, k) over the root mean square of the other campaigns."""
    squares = values**2
    others = (squares.sum(axis=0) - squares) / max(len(values) - 1, 1)
    return np.asarray(values / np.maximum(np.sqrt(others), _LEAST_SPREAD))


def _with_largest_of(scores: Floats, singles: Floats) -> Floats:
    """The scores (b, k), stretched and shifted so that their largest in each campaign is distributed as the largest of
    `singles` (b, m) is, less `DISCOUNT`.
    """
    largest = np.abs(scores).max(axis=1)
    middle, high = np.quantile(largest, _QUANTILES)
    single_middle, single_high = np.quantile(singles.max(axis=1), _QUANTILES)
    stretch = (single_high - single_middle) / max(high - middle, _LEAST_STRETCH)
    sizes = single_middle + stretch * (np.abs(scores) - middle) - DISCOUNT
    return np.asarray(np.copysign(np.maximum(sizes, 0.0), scores))
