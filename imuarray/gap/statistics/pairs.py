"""Statistics of the training part paired with the same statistics of the held-out part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood, likelihood_of

ABSENT = -1
"""Place of a statistic that is missing in one part."""

LEAST = 0.5**0.5
"""Least standard deviation of a sum of scores: its value if the fit makes the score of one part zero."""

_WILD = 5.0
"""Limit of the sums of scores from which a standard deviation is computed."""

_FOLDS = 20
"""Number of folds of campaigns, each of which is scored against the others."""


@dataclass(frozen=True)
class Pairs:
    """m pairs of statistics: their `keys`, and the places `train` and `held_out` (m,) of both members among the n
    statistics of both parts.
    """

    keys: tuple[Key, ...]
    train: Indices
    held_out: Indices

    def sums(self, scores: Floats) -> Floats:
        """Return scores (..., m) of pairs from scores (..., n): the sum of both parts divided by the root of two, or
        the score of a single part if the other is missing.
        """
        parts = [_at(scores, places) for places in (self.train, self.held_out)]
        count = np.sum([np.isfinite(part) for part in parts], axis=0)
        total = np.nansum(parts, axis=0)
        return np.where(count > 0, total / np.sqrt(np.maximum(count, 1)), np.nan)

    def means(self, values: Floats) -> Floats:
        """Return the means (m,) of pairs of values (n,), over the parts with a value."""
        parts = np.array([_at(values, places) for places in (self.train, self.held_out)])
        count = np.isfinite(parts).sum(axis=0)
        return np.where(count > 0, np.nansum(parts, axis=0) / np.maximum(count, 1), np.nan)


def pairs_of(keys: Sequence[Key], held_out: Sequence[bool], logs: Sequence[int] | None = None) -> Pairs:
    """Pair the keys of both parts; `held_out` is true for the keys of the held-out part.

    `logs` gives each key a log number that is the same for corresponding logs of both parts; by default the keys' own
    log numbers are used.
    """
    places_of: dict[Key, list[int]] = {}
    for at, (key, out) in enumerate(zip(keys, held_out, strict=True)):
        same = key if logs is None else key._replace(log=logs[at])
        places_of.setdefault(same, [ABSENT, ABSENT])[out] = at
    places = np.array(list(places_of.values()), np.intp).reshape(-1, 2)
    return Pairs(tuple(places_of), places[:, 0], places[:, 1])


def scorer_of(pairs: Pairs, likelihood: SyntheticLikelihood, replicates: Floats) -> Callable[[Floats], Floats]:
    """Return a function that converts values (..., n) of both parts to scores of pairs (..., m), in standard deviations
    of the `replicates` (b, n).
    """
    norm = spread_of(pairs.sums(likelihood.scores(replicates)))
    return lambda values: np.asarray(pairs.sums(likelihood.scores(values)) / norm)


def scores_by_others(pairs: Pairs, values: Floats, floor: Floats) -> Floats:
    """Return scores (b, m) of campaigns with values (b, n), each scored against the campaigns outside its fold, which
    is a twentieth of all: if all have the same distribution, each is equally likely to be the most extreme.
    """
    scores = np.empty((len(values), len(pairs.keys)))
    folds = min(_FOLDS, len(values))
    for fold in range(folds):
        is_in_fold = np.arange(len(values)) % folds == fold
        others = values[~is_in_fold]
        scores[is_in_fold] = scorer_of(pairs, likelihood_of(others, floor), others)(values[is_in_fold])
    return scores


def spread_of(sums: Floats) -> Floats:
    """Return the standard deviation (m,) of sums (b, m) over replicates, at least `LEAST`.

    It is larger than 1 if the parts are correlated, and the root of a half if the fit makes the score of one part zero.
    Smaller values occur only where a statistic hardly ever differs from its usual value, and are not used.
    """
    known = np.isfinite(sums).any(axis=0)
    spread = np.zeros(sums.shape[1])
    spread[known] = np.sqrt(np.nanmean(np.clip(sums[:, known], -_WILD, _WILD) ** 2, axis=0))
    return np.asarray(np.maximum(spread, LEAST))


def _at(scores: Floats, places: Indices) -> Floats:
    return np.where(places >= 0, scores[..., places], np.nan)
