"""Assessment of a recording by replicates of one model: its scores, the significant ones, and residuals.

Gaps are localised by comparing scores with the largest ones by chance, down a tree of the array: the array, its chips,
their units, the axes, domains of statistics, and single statistics. A node is significant if its parent is, and if its
largest score exceeds the largest one by chance among it and its siblings. Siblings with larger scores, which were
tested before it, do not count (step-down: Westfall and Young 1993; the hierarchy of Meinshausen, Biometrika 95, 2008).
Each step down thus accounts for the selection, and nothing is tested below a node that is not significant. The pooled
scores of a sensor in a log (`imuarray.gap.statistics.pooled`) belong to the statistic of the pool that deviates most.

A cause of a wrong form can fit every single statistic by its scatter: rare glitches of either sign make a skewness of 5
as likely as one of -5, but not forty phases with skewness of one sign. The residuals of the repaired model are
therefore averaged over phases and over axes as well, and the averages are compared with those of its replicates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import Pairs, scorer_of, scores_by_others
from imuarray.gap.statistics.pooled import PooledScores, equal_shares
from imuarray.gap.statistics.synthetic_likelihood import FORM, SyntheticLikelihood, likelihood_of
from imuarray.gap.statistics.tails import NO_TAILS, Tails, normal_scores_by_others, tails_of
from imuarray.log.format import SensorHeader

MORE = 1.25
"""Factor by which the remainder must exceed chance to be significant, because no effect has exactly the form of the
real one.
"""


@dataclass(frozen=True)
class Assessment:
    """A recording compared with one model.

    Scores (m,) of pairs in standard deviations and as `normal` scores (`imuarray.gap.statistics.tails`); scores (n,) of
    their `parts`, the `deviation` of these from the model's location, and the model's `likelihood`; the probability `p`
    of a largest normal score of this size by chance. Chance reaches `limit` in one of twenty campaigns; `furthest` is
    its largest value. `tails` are those of the scores of pairs.
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
    """Assess a recording by replicates (b, n) of the model. The chance level follows from the scores `chance` (b, m) of
    replicates; by default each replicate is scored by the others.
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
        scores,
        normal,
        likelihood.scores(real),
        deviation,
        likelihood,
        p,
        float(np.quantile(largest, 0.95)),
        furthest,
        tails,
    )


def largest_of(scores: Floats) -> Floats:
    """Return the largest absolute score (...,) of scores (..., m); 0 without scores."""
    return np.asarray(np.nan_to_num(np.abs(scores)).max(axis=-1, initial=0.0))


LEVEL = 0.05
"""Share of campaigns without a gap in which a gap is detected."""

FEWEST_REPLICATES = math.ceil(1 / LEVEL) - 1
"""Least number of replicates with which a p-value of `LEVEL` is possible (`p_value`)."""

LEVELS = ("array", "chip", "sensor", "axis", "domain", "statistic")
"""The levels of the tree, from its root."""


@dataclass(frozen=True)
class Node:
    """A place in the array, named by its `path` from the array, (). `largest` is its largest absolute score; `p` the
    probability of a score of this size by chance among it and its siblings, at least its parent's. A node that is not
    significant has no children.
    """

    path: tuple[str, ...]
    largest: float
    p: float
    is_significant: bool
    children: tuple[Node, ...]

    @property
    def level(self) -> str:
        """The level of the node, one of `LEVELS`."""
        return LEVELS[len(self.path)]

    def significant(self, level: str) -> tuple[Node, ...]:
        """Return the significant nodes of a level below it (or itself), the largest score first."""
        nodes = [node for node in self._all() if node.is_significant and node.level == level]
        return tuple(sorted(nodes, key=lambda node: -node.largest))

    def _all(self) -> Iterator[Node]:
        yield self
        for child in self.children:
            yield from child._all()


@dataclass(frozen=True)
class Localisation:
    """The scores (m,) under `keys` that are beyond chance: the tree, and the p of each significant statistic by its
    place, the largest score first. Chance reaches `limit` with a single score in the share `level` of all campaigns.
    """

    root: Node
    p_by_place: Mapping[int, float]
    limit: float

    @property
    def p(self) -> float:
        """The p-value of the hypothesis that there is no gap."""
        return self.root.p

    @property
    def is_gap(self) -> bool:
        """True if the whole array is significant."""
        return self.root.is_significant


def localise(
    keys: Sequence[Key],
    headers: Mapping[str, SensorHeader],
    scores: Floats,
    chance: Floats,
    pooled: PooledScores | None = None,
    level: float = LEVEL,
) -> Localisation:
    """Localise the gap by the scores (m,) of a recording and (b, m) of replicates without a gap, and the `pooled`
    scores of the recording and of the replicates. Each domain has the same share of the level (`equal_shares`).

    `level` is the share of false alarms; ValueError if there are too few replicates for it.
    """
    if 1 / (len(chance) + 1) > level:
        fewest = math.ceil(1 / level) - 1
        raise ValueError(f"replicates: {len(chance)} were scored; a share of false alarms of {level:g} needs {fewest}")
    paths = [_path(number, key, headers[key.sensor]) for number, key in enumerate(keys)]
    limit = float(np.quantile(np.nan_to_num(np.abs(chance)).max(axis=1), 1 - level))
    sizes = equal_shares(np.vstack([scores, chance]), keys)
    if pooled is not None:
        paths += [paths[at] for at in pooled.places.tolist()]
        sizes = np.hstack([sizes, pooled.scores])
    root = _Tree(paths, sizes[0], sizes[1:], level).root()
    significant = {int(node.path[-1]): node.p for node in root.significant("statistic")}
    order = sorted(significant, key=lambda at: -sizes[0, at])
    return Localisation(root, {at: significant[at] for at in order}, limit)


def p_value(value: float, chance: Floats) -> float:
    """Return the p-value of a value by `chance` (b,): the share of `chance` and the value itself that is at least as
    large. It is never 0, and exact if the value has the same distribution (the Monte Carlo test of Barnard 1963).
    """
    return float((1 + np.count_nonzero(chance >= value)) / (1 + len(chance)))


class _Tree:
    """Sizes (n,) of scores and those of chance (b, n), each at the end of a path."""

    def __init__(self, paths: Sequence[tuple[str, ...]], sizes: Floats, chance: Floats, level: float) -> None:
        self._paths, self._level, self._sizes, self._chance = paths, level, sizes, chance

    def root(self) -> Node:
        """Return the node of the whole array, which has no siblings."""
        columns = list(range(len(self._paths)))
        return self._node((), columns, self._largest(columns), 0.0)

    def _node(self, path: tuple[str, ...], columns: list[int], chance: Floats, parent_p: float) -> Node:
        """Return the node; `chance` is the largest score among it and the siblings tested after it, in each
        replicate.
        """
        largest = float(self._sizes[columns].max(initial=0.0))
        p = max(parent_p, p_value(largest, chance))
        is_significant = p <= self._level
        children = tuple(self._below(path, columns, p)) if is_significant and len(path) + 1 < len(LEVELS) else ()
        return Node(path, largest, p, is_significant, children)

    def _below(self, path: tuple[str, ...], columns: list[int], p: float) -> Iterator[Node]:
        """Yield the children, those with the largest scores first; the p of each is at least that of the one before."""
        parts: dict[str, list[int]] = {}
        for column in columns:
            parts.setdefault(self._paths[column][len(path)], []).append(column)
        names = sorted(parts, key=lambda name: -self._sizes[parts[name]].max())
        chance = np.stack([self._largest(parts[name]) for name in reversed(names)])
        for name, largest in zip(names, np.maximum.accumulate(chance)[::-1], strict=True):
            node = self._node((*path, name), parts[name], largest, p)
            p = node.p
            yield node

    def _largest(self, columns: list[int]) -> Floats:
        return np.asarray(self._chance[:, columns].max(axis=1, initial=0.0))


def _path(number: int, key: Key, header: SensorHeader) -> tuple[str, ...]:
    """Return the path of a statistic; the last name is its number."""
    return header.chip, key.sensor, key.axis, key.domain, str(number)


LEAST = 12
"""Fewest statistics of a group. Levels of runs, and statistics of a whole log, occur twice on each axis and are judged
singly.
"""

_WILD = 5.0
_LEAST_SPREAD = 0.5
"""Least scatter of scores, to be divided by the root of their number, for averages that hardly scatter."""


class GroupResidual(NamedTuple):
    """One probe of one sensor over all phases, of one `axis` or of all ("").

    `places` of the group among n statistics; `score`: deviation of their mean from that of the replicates, in standard
    deviations, with an allowance for the causes' form; `furthest`: the largest score of any replicate in any group,
    each scored by the others (the same for all groups).
    """

    sensor: str
    axis: str
    probe: str
    places: Indices
    score: float
    furthest: float


def group_residuals(
    keys: Sequence[Key], before: SyntheticLikelihood, after: SyntheticLikelihood, real: Floats, replicates: Floats
) -> list[GroupResidual]:
    """Return the systematic residuals, the worst first, of n statistics of the recording (`real`) and of `replicates`
    (b, n) of the model with its causes.

    `after` is the likelihood of that model, `before` that of the base model. The causes are allowed a relative error of
    form of their shifts. Single statistics count up to five standard deviations, so that none dominates. The
    correlation of axes is ignored: effects are drawn for each axis, although a supply, or a bearing, acts on all axes
    alike.
    """
    scores, real_scores = (np.clip(after.scores(values), -_WILD, _WILD) for values in (replicates, real))
    shift = np.nan_to_num(np.abs(after.location - before.location))
    excused = np.minimum(FORM * shift / after.scale, _WILD)
    says = np.isfinite(real_scores) & np.isfinite(scores).all(axis=0) & ~after.is_silent
    groups = list(_groups(keys, says))
    if not groups:
        return []
    means = np.stack([scores[:, places].mean(axis=1) for *_, places in groups], axis=1)
    least = _LEAST_SPREAD / np.sqrt([len(places) for *_, places in groups])
    form = np.array([excused[places].mean() for *_, places in groups])
    deviation = np.array([real_scores[places].mean() for *_, places in groups]) - means.mean(axis=0)
    score_of_group = deviation / np.hypot(np.maximum(means.std(axis=0, ddof=1), least), form)
    furthest = float(np.abs(_by_others(means, least)).max())
    order = np.argsort(-np.abs(score_of_group))
    scored = zip(groups, score_of_group.tolist(), strict=True)
    groups_scored = [
        GroupResidual(sensor, axis, probe, places, score, furthest) for (sensor, axis, probe, places), score in scored
    ]
    return [groups_scored[at] for at in order.tolist()]


def _groups(keys: Sequence[Key], says: Booleans) -> Iterator[tuple[str, str, str, Indices]]:
    places: dict[tuple[str, str, str], list[int]] = {}
    for at in np.flatnonzero(says).tolist():
        if keys[at].domain == "cross_sensor":
            continue
        for axis in {keys[at].axis, ""}:
            places.setdefault((keys[at].sensor, axis, keys[at].probe), []).append(at)
    for place, members in places.items():
        if len(members) >= LEAST:
            yield place[0], place[1], place[2], np.array(members, np.intp)


def _by_others(means: Floats, least: Floats) -> Floats:
    """Return the means (b, g) of each replicate, in standard deviations (at least `least`) of those of the others."""
    count = len(means)
    deviation = (means - means.mean(axis=0)) * count / (count - 1)
    squares = ((means - means.mean(axis=0)) ** 2).sum(axis=0) - deviation**2 * (count - 1) / count
    return np.asarray(deviation / np.maximum(np.sqrt(np.maximum(squares, 0.0) / (count - 2)), least))
