"""Detection and localisation of a gap: scores against the largest that chance gives, down a tree of the array.

The tree's levels are the array, its chips, their units, the axes, domains of statistics, and single statistics. A node
is significant if its parent is and its largest score exceeds the largest among it and its siblings without a gap, where
siblings with larger scores, which were tested before it, do not count (step-down: Westfall and Young 1993; the
hierarchy of Meinshausen, Biometrika 95, 2008). Every step down thus pays for the choice it makes, and nothing is tested
below a node that is not significant. The pooled scores of a sensor in a log
(`imuarray.gap.statistics.pooled`) count where the recording deviates most among these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pooled import PooledScores
from imuarray.log.format import SensorHeader

LEVEL = 0.05
"""Share of campaigns without a gap in which one is detected."""

LEVELS = ("array", "chip", "sensor", "axis", "domain", "statistic")
"""The levels of the tree, from its root."""


@dataclass(frozen=True)
class Node:
    """A place named by its `path` from the array, (): its `largest` score in size, and `p`: how often chance gives as
    large a score among it and its siblings, not below its parent's. Nodes that are not significant have no children.
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

    def found(self, level: str) -> tuple[Node, ...]:
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
    place, the largest score first. `limit`: reached by chance by a single score in `level` of all campaigns.
    """

    root: Node
    p_by_place: Mapping[int, float]
    limit: float

    @property
    def p(self) -> float:
        """p of there being no gap."""
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
    """Localise the gap by scores (m,) of a recording and (b, m) of replicates without a gap, and the `pooled` scores
    of the recording and these.

    `level` is the share of false alarms; ValueError if there are too few replicates for it.
    """
    if (least := 1 / (len(chance) + 1)) > level:
        raise ValueError(f"level: {level}; {len(chance)} scored replicates allow no level below {least:.3g}")
    paths = [_path(number, key, headers[key.sensor]) for number, key in enumerate(keys)]
    limit = float(np.quantile(np.nan_to_num(np.abs(chance)).max(axis=1), 1 - level))
    if pooled is not None:
        paths += [paths[at] for at in pooled.places.tolist()]
        scores, chance = np.append(scores, pooled.scores[0]), np.hstack([chance, pooled.scores[1:]])
    root = _Tree(paths, scores, chance, level).root()
    significant = {int(node.path[-1]): node.p for node in root.found("statistic")}
    order = sorted(significant, key=lambda at: -abs(scores[at]))
    return Localisation(root, {at: significant[at] for at in order}, limit)


def p_value(value: float, chance: Floats) -> float:
    """Return the share of `chance` (b,) and the value itself that is as large: never 0, and exact if the value has the
    same distribution (the Monte Carlo test of Barnard 1963).
    """
    return float((1 + np.count_nonzero(chance >= value)) / (1 + len(chance)))


class _Tree:
    """Scores (n,) and those of chance (b, n), each at the end of a path."""

    def __init__(self, paths: Sequence[tuple[str, ...]], scores: Floats, chance: Floats, level: float) -> None:
        self.scores = scores
        self._paths, self._level = paths, level
        self._sizes, self._chance = np.nan_to_num(np.abs(scores)), np.nan_to_num(np.abs(chance))

    def root(self) -> Node:
        """Return the whole array; it has no siblings."""
        columns = list(range(len(self._paths)))
        return self._node((), columns, self._largest(columns), 0.0)

    def _node(self, path: tuple[str, ...], columns: list[int], chance: Floats, parent_p: float) -> Node:
        """`chance` is the largest score among the node and the siblings tested after it, in each replicate."""
        largest = float(self._sizes[columns].max(initial=0.0))
        p = max(parent_p, p_value(largest, chance))
        is_significant = p <= self._level
        children = tuple(self._below(path, columns, p)) if is_significant and len(path) + 1 < len(LEVELS) else ()
        return Node(path, largest, p, is_significant, children)

    def _below(self, path: tuple[str, ...], columns: list[int], p: float) -> Iterator[Node]:
        """Yield the children, those with the largest scores first; none has a smaller p than the one before it."""
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
