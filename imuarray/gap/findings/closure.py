"""The closure: how far the causes reduce the excess of squared scores on held-out data.

The statistics that count are those that deviate on the training part; their scores on the held-out part, before and
after the causes are added to the model, give the closure. Domains have equal weights, whatever their number of
statistics, and no score counts for more than `LARGEST`. Without a gap the mean square of scores is 1, which is
subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.findings.diagnosis import Gap, Interval
from imuarray.gap.inference.assessment import Assessment
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import Pairs

LARGEST = 100.0
DEVIATES, BY_ITSELF = 3.5, 5.0
"""Least score on the training part of a statistic that counts; on the held-out part, for statistics that the training
part cannot show.
"""

BEYOND_CHOICE = 8.0
"""Least score on the held-out part of a statistic that counts whatever the training part shows: so far out, chance and
the choice of the largest add little to it.
"""

_DRAWS = 400
_FAR = 10.0
_LEAST_EXCESS = 1.0
"""Least mean squared excess of which a closed share is given."""


class ClosureEstimate(NamedTuple):
    """Root mean square scores before and after, and the closed share of the excess with its 95 % interval; None if
    there is too little to close.
    """

    before: float
    after: float
    closed: float | None
    interval: Interval | None


@dataclass(frozen=True)
class DeviatingStatistics:
    """The statistics that count: keys, places (k,) among all, weights (k,), and scores `before` and `after` (k,), on
    held-out data, or on both parts for what one part alone shows.
    """

    keys: tuple[Key, ...]
    places: Indices
    weights: Floats
    before: Floats
    after: Floats

    def closure(self, seed: int) -> ClosureEstimate:
        """Return the closure over all statistics, with an interval by bootstrap of blocks (one sensor, phase and
        domain); each draw adds the chance of the recording once more.
        """
        if len(self.keys) == 0:
            return ClosureEstimate(1.0, 1.0, None, None)
        excess = np.stack([_squares(self.before) - 1, _squares(self.after) - 1])
        before, after = (excess @ self.weights / self.weights.sum()).tolist()
        roots = (float(np.sqrt(max(before + 1, 0.0))), float(np.sqrt(max(after + 1, 0.0))))
        if before < _LEAST_EXCESS:
            return ClosureEstimate(*roots, None, None)
        return ClosureEstimate(*roots, min(1.0, 1 - after / before), self._interval(seed))

    def of(self, chosen: Booleans) -> DeviatingStatistics:
        """Return some of the statistics, with equal weights for domains."""
        keys = tuple(key for key, is_chosen in zip(self.keys, chosen, strict=True) if is_chosen)
        return DeviatingStatistics(keys, self.places[chosen], _weights(keys), self.before[chosen], self.after[chosen])

    def domains(self) -> tuple[str, ...]:
        """Return the domains of the statistics."""
        return tuple(dict.fromkeys(key.domain for key in self.keys))

    def _interval(self, seed: int) -> Interval | None:
        """Return the interval over the draws that have a gap.

        Chance adds 1 to a squared score in each draw. Without it, the interval of few blocks would be too narrow, and
        that of a single block would have width 0.
        """
        stream = np.random.default_rng(seed)
        blocks = list(_blocks(self.keys).values())
        chance = stream.standard_normal((_DRAWS, len(self.keys)))
        excess = np.stack([_squares(scores + chance) - 2 for scores in (self.before, self.after)])
        weighted = np.stack([(excess[:, :, rows] * self.weights[rows]).sum(axis=-1) for rows in blocks], axis=-1)
        weights = np.array([self.weights[rows].sum() for rows in blocks])
        draws = stream.integers(0, len(blocks), (_DRAWS, len(blocks)))
        total = np.take_along_axis(weighted, np.broadcast_to(draws, weighted.shape), axis=-1).sum(axis=-1)
        before, after = total / weights[draws].sum(axis=-1)
        has_gap = before >= _LEAST_EXCESS
        if not has_gap.any():
            return None
        closed = np.clip(1 - after[has_gap] / before[has_gap], -_FAR, 1.0)
        low, high = np.quantile(closed, (0.025, 0.975)).tolist()
        return low, high


def deviating(pairs: Pairs, before: Floats, after: Floats, silent: Booleans) -> DeviatingStatistics:
    """Return the statistics that deviate on the training part, from scores (n,) of all statistics.

    A statistic that the training part lacks, or that the fit makes zero there (`silent` (n,)), such as the level of
    another run, is selected by its score on the held-out part, with a higher threshold. Any other statistic that
    deviates on the held-out part alone needs a still higher one: the first half of a heating may hardly show the bend
    that the second half shows.
    """
    train, held_out = (np.where(places >= 0, before[places], np.nan) for places in (pairs.train, pairs.held_out))
    alone = ~np.isfinite(train) | ((pairs.train >= 0) & silent[pairs.train])
    held_out_size = np.abs(np.nan_to_num(held_out))
    size = np.where(alone, held_out_size - (BY_ITSELF - DEVIATES), np.abs(np.nan_to_num(train)))
    chosen = np.isfinite(held_out) & ((size > DEVIATES) | (held_out_size > BEYOND_CHOICE))
    if not chosen.any():
        chosen = np.isfinite(held_out) & (held_out_size > DEVIATES)
    places = pairs.held_out[chosen]
    keys = tuple(key for key, is_chosen in zip(pairs.keys, chosen, strict=True) if is_chosen)
    return _of(keys, places, before, after)


def deviating_in_either(pairs: Pairs, before: Floats, after: Floats) -> DeviatingStatistics:
    """Return the statistics that deviate in one part alone, for events that occur in one part only."""
    chosen = [
        (key, at)
        for places in (pairs.train, pairs.held_out)
        for key, at in zip(pairs.keys, places.tolist(), strict=True)
        if at >= 0 and abs(np.nan_to_num(before[at])) > BY_ITSELF
    ]
    return _of(tuple(key for key, _ in chosen), np.array([at for _, at in chosen], np.intp), before, after)


def gap_of(counted: DeviatingStatistics, floor: float, seed: int) -> Gap:
    """Return the gap overall, and by domain."""
    whole = counted.closure(seed)
    domains = {}
    for domain in counted.domains():
        chosen = np.array([key.domain == domain for key in counted.keys], bool)
        part = counted.of(chosen).closure(seed)
        domains[domain] = (part.before, part.after, part.closed)
    return Gap(whole.before, whole.after, floor, whole.closed, whole.interval, domains)


def floor_of(counted: DeviatingStatistics, before: Assessment, replicates: Floats) -> float:
    """Return the root mean square score of the same statistics without a gap: the median of replicates."""
    if len(counted.places) == 0:
        return 1.0
    squares = np.nan_to_num(before.likelihood.scores(replicates)[:, counted.places]) ** 2
    return float(np.sqrt(np.median(squares @ counted.weights / counted.weights.sum())))


def _of(keys: tuple[Key, ...], places: Indices, before: Floats, after: Floats) -> DeviatingStatistics:
    return DeviatingStatistics(
        keys, places, _weights(keys), np.nan_to_num(before[places]), np.nan_to_num(after[places])
    )


def _weights(keys: Sequence[Key]) -> Floats:
    """Return the weights (k,): one over the number of statistics of the same domain."""
    domains = [key.domain for key in keys]
    return np.array([1 / domains.count(domain) for domain in domains])


def _blocks(keys: Sequence[Key]) -> dict[tuple[object, ...], list[int]]:
    blocks: dict[tuple[object, ...], list[int]] = {}
    for at, key in enumerate(keys):
        blocks.setdefault((key.log, key.phase_number, key.sensor, key.domain), []).append(at)
    return blocks


def _squares(scores: Floats) -> Floats:
    return np.asarray(np.minimum(np.abs(scores), LARGEST) ** 2)
