"""Scores of one statistic, pooled over the phases, runs and axes of a sensor.

The largest of thousands of scores shows a deviation that is large somewhere. A small deviation that returns in every
phase is no larger than the largest by chance, and neither is a large one of a statistic with heavy tails. The sum of
the normal scores of the statistic over its places,

    S = sum(z) / sqrt(number of places)                                 (Stouffer et al. 1949)

shows both: once for each axis, and once for the whole sensor. Places are not independent, since the noise, the attitude
and the fit are common to them; S is therefore scored by the other campaigns, as each single statistic is.

Only statistics of the domains `POOLED` are pooled: those of which the base model fits nothing. A fit that is slightly
wrong, of a filter for example, shifts the correlations of all phases alike, and the sum would call that a gap.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from imuarray.arrays import Floats, Indices
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.tails import normal_scores_by_others

POOLED = frozenset({"codes", "distribution"})
"""Domains whose statistics are pooled. In random controls without a gap, pooled correlations, Allan deviations and
shares of lost rows exceeded chance in up to 7 of 43 campaigns, those of these two domains in 2 and 3.
"""

FEWEST_PLACES = 3
"""Places from which a statistic is pooled: two say little more than the larger of them."""

_LEAST_SPREAD = 0.1
"""Least scatter of S: that of a statistic which has one value in nearly all campaigns is not known."""


class PooledScores(NamedTuple):
    """Normal scores (b, k) of k pooled statistics in b campaigns, and the places (k,) of the single statistic of each
    that deviates most in the first campaign.

    They are comparable with those of single statistics: chance exceeds them among the pooled statistics as often as
    among the single ones, of which there are more.
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
    known = np.isfinite(normal)
    sums = np.stack([np.nansum(normal[:, places], axis=1) for places in pools], axis=1)
    counts = np.stack([known[:, places].sum(axis=1) for places in pools], axis=1)
    pooled = np.where(counts >= FEWEST_PLACES, sums / np.sqrt(np.maximum(counts, 1)), np.nan)
    scores = normal_scores_by_others(_standardised_by_others(pooled), [keys[places[0]] for places in pools])
    sizes = np.nan_to_num(np.abs(normal[0]))
    strongest = np.array([places[int(sizes[places].argmax())] for places in pools], np.intp)
    return PooledScores(_among_fewer(scores, known.any(axis=0).sum()), strongest)


def _pools(keys: Sequence[Key]) -> Iterator[Indices]:
    """The places of each statistic of a sensor, and of each of its axes if there are several."""
    by_sensor: dict[tuple[str, str], list[int]] = {}
    for at, key in enumerate(keys):
        if key.domain in POOLED:
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
    """Values (b, k) less the median of the other campaigns, over the standard deviation of these."""
    scores = np.full_like(values, np.nan)
    known = np.isfinite(values).sum(axis=0) > FEWEST_PLACES
    for at in range(len(values)):
        others = np.delete(values[:, known], at, axis=0)
        spread = np.maximum(np.nanstd(others, axis=0), _LEAST_SPREAD)
        scores[at, known] = (values[at, known] - np.nanmedian(others, axis=0)) / spread
    return scores


def _among_fewer(scores: Floats, singles: int) -> Floats:
    """Normal scores (b, k) that chance exceeds among `singles` statistics as often as `scores` among their own k."""
    share = log_ndtr(-np.abs(scores)) + np.log(scores.shape[1] / max(singles, 1))
    return np.asarray(np.copysign(np.maximum(-ndtri_exp(np.minimum(share, -1e-9)), 0.0), scores))
