"""A recording judged by replicates of one model: its scores, and how often chance makes as large a one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.localisation import p_value
from imuarray.gap.statistics.pairs import Pairs, scorer_of, scores_by_others
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood, likelihood_of

MORE = 1.25
"""What is left has to be so much beyond chance to be something else: no effect has exactly the form of the real one."""


@dataclass(frozen=True)
class Assessment:
    """The recording beside one model: scores (m,) of pairs and (n,) of their parts, how far these lie `apart`, what the
    model makes of them, and how often chance makes as large a score (`p`); `limit` is what chance reaches in one of
    twenty campaigns, `furthest` what it reached in any.
    """

    scores: Floats
    parts: Floats
    apart: Floats
    likelihood: SyntheticLikelihood
    p: float
    limit: float
    furthest: float = math.nan


def assess(pairs: Pairs, real: Floats, replicates: Floats, floor: Floats, chance: Floats | None = None) -> Assessment:
    """By replicates (b, n) of the model; how far chance goes is said by `chance` (b, m), scores of theirs, each by the
    others if there are none yet.
    """
    likelihood = likelihood_of(replicates, floor)
    scores, parts = scorer_of(pairs, likelihood, replicates)(real), likelihood.scores(real)
    largest = largest_of(scores_by_others(pairs, replicates, floor) if chance is None else chance)
    p, furthest = p_value(float(largest_of(scores)), largest), float(largest.max())
    return Assessment(scores, parts, real - likelihood.location, likelihood, p, _high(largest), furthest)


def largest_of(scores: Floats) -> Floats:
    """(...,) of scores (..., m), 0 where nothing is said."""
    return np.asarray(np.nan_to_num(np.abs(scores)).max(axis=-1, initial=0.0))


def _high(largest: Floats) -> float:
    return float(np.quantile(largest, 0.95))
