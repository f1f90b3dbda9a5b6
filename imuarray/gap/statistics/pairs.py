"""The two parts of a campaign put together again: a statistic of the training part beside the same of the held-out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood, likeness_of

NOWHERE = -1
"""Place of a statistic that one part does not have."""

LEAST = 0.5**0.5
_WILD = 5.0
_FOLDS = 20


@dataclass(frozen=True)
class Pairs:
    """m statistics by their `keys`, and where each stands among the n of both parts: `train` and `held_out` (m,)."""

    keys: tuple[Key, ...]
    train: Indices
    held_out: Indices

    def sums(self, scores: Floats) -> Floats:
        """(..., m) of scores (..., n): of both parts over the root of two, or of the part that says something."""
        parts = [_taken(scores, places) for places in (self.train, self.held_out)]
        count = np.sum([np.isfinite(part) for part in parts], axis=0)
        total = np.nansum(parts, axis=0)
        return np.where(count > 0, total / np.sqrt(np.maximum(count, 1)), np.nan)

    def means(self, values: Floats) -> Floats:
        """(m,) of values (n,): the mean of the parts that say something."""
        parts = np.array([_taken(values, places) for places in (self.train, self.held_out)])
        count = np.isfinite(parts).sum(axis=0)
        return np.where(count > 0, np.nansum(parts, axis=0) / np.maximum(count, 1), np.nan)


def pairs_of(keys: Sequence[Key], held_out: Sequence[bool], logs: Sequence[int] | None = None) -> Pairs:
    """By the keys of both parts, and which of them are held out. `logs` numbers the log of each key so that those that
    belong together have the same number; without, each part's own numbers do.
    """
    found: dict[Key, list[int]] = {}
    for at, (key, out) in enumerate(zip(keys, held_out, strict=True)):
        same = key if logs is None else key._replace(log=logs[at])
        found.setdefault(same, [NOWHERE, NOWHERE])[out] = at
    places = np.array(list(found.values()), np.intp).reshape(-1, 2)
    return Pairs(tuple(found), places[:, 0], places[:, 1])


def scorer_of(pairs: Pairs, likeness: SyntheticLikelihood, replicates: Floats) -> Callable[[Floats], Floats]:
    """What scores values (..., n) of both parts in pairs (..., m), in standard deviations of the same `replicates`
    (b, n).
    """
    norm = spread_of(pairs.sums(likeness.scores(replicates)))
    return lambda values: np.asarray(pairs.sums(likeness.scores(values)) / norm)


def scores_by_others(pairs: Pairs, values: Floats, floor: Floats) -> Floats:
    """(b, m) of campaigns with values (b, n), each scored by what the others say (but a twentieth, with it): where all
    are of one kind, any of them is as likely as any other to be the strangest.
    """
    scores = np.empty((len(values), len(pairs.keys)))
    folds = min(_FOLDS, len(values))
    for fold in range(folds):
        own = np.arange(len(values)) % folds == fold
        others = values[~own]
        scores[own] = scorer_of(pairs, likeness_of(others, floor), others)(values[own])
    return scores


def spread_of(sums: Floats) -> Floats:
    """(m,) standard deviation of sums (b, m) over replicates, at least `LEAST`: parts that depend on each other make it
    larger than 1. A part that the fit makes zero makes it the root of a half; what is smaller still hardly ever says
    anything, and nothing is to be made of it when it does.
    """
    known = np.isfinite(sums).any(axis=0)
    spread = np.zeros(sums.shape[1])
    spread[known] = np.sqrt(np.nanmean(np.clip(sums[:, known], -_WILD, _WILD) ** 2, axis=0))
    return np.asarray(np.maximum(spread, LEAST))


def _taken(scores: Floats, places: Indices) -> Floats:
    return np.where(places >= 0, scores[..., places], np.nan)
