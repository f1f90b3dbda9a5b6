"""Assessment of a recording by replicates of one model: its scores, and how often chance gives as large a score."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.localisation import p_value
from imuarray.gap.statistics.pairs import Pairs, scorer_of, scores_by_others
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood, likelihood_of
from imuarray.gap.statistics.tails import NO_TAILS, Tails, normal_scores_by_others, tails_of

MORE = 1.25
"""Factor by which the remainder has to exceed chance to be significant: no effect has exactly the form of the
real one.
"""


@dataclass(frozen=True)
class Assessment:
    """A recording against one model.

    Scores (m,) of pairs in standard deviations and as `normal` scores (`imuarray.gap.statistics.tails`), those (n,) of
    their parts, the `deviation` of these from the model's location, the model's `likelihood`, and how often chance
    gives as large a normal score (`p`); `limit` is reached by chance in one of twenty campaigns, `furthest` is the
    largest chance value. `tails` of the scores of pairs.
    """

    scores: Floats
    normal: Floats
    parts: Floats
    deviation: Floats
    likelihood: SyntheticLikelihood
    p: float
    limit: float
    furthest: float = math.nan
    tails: Tails = NO_TAILS


def assess(pairs: Pairs, real: Floats, replicates: Floats, floor: Floats, chance: Floats | None = None) -> Assessment:
    """Assess a recording by replicates (b, n) of the model. The chance level is given by scores `chance` (b, m) of
    replicates, by default each scored by the others.
    """
    likelihood = likelihood_of(replicates, floor)
    chance = scores_by_others(pairs, replicates, floor) if chance is None else chance
    tails = tails_of(chance, pairs.keys)
    scores = scorer_of(pairs, likelihood, replicates)(real)
    normal = tails.normal(scores, pairs.keys)
    largest = largest_of(normal_scores_by_others(chance, pairs.keys))
    p, furthest = p_value(float(largest_of(normal)), largest), float(largest.max())
    deviation = real - likelihood.location
    return Assessment(
        scores, normal, likelihood.scores(real), deviation, likelihood, p, _high(largest), furthest, tails
    )


def largest_of(scores: Floats) -> Floats:
    """Return the largest absolute score (...,) of scores (..., m), 0 where there is none."""
    return np.asarray(np.nan_to_num(np.abs(scores)).max(axis=-1, initial=0.0))


def _high(largest: Floats) -> float:
    return float(np.quantile(largest, 0.95))
