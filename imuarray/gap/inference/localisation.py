"""Whether there is a gap, and where: scores against the largest that chance makes, down a tree of the array.

The tree's levels are the array, its chips, their units, the axes, domains of statistics, and single statistics. A node
is found where its parent is and its largest score is beyond what the largest among it and its siblings is without a gap
(Westfall and Young 1993; the hierarchy of Meinshausen, Biometrika 95, 2008). So every step down pays for the choice it
makes, and nothing is looked for where nothing was found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.catalogue import Key
from imuarray.log.format import SensorHeader

LEVEL = 0.05
"""Share of campaigns without a gap in which one is found."""

LEVELS = ("array", "chip", "sensor", "axis", "domain", "statistic")
"""Of the tree, from its root."""


@dataclass(frozen=True)
class Node:
    """A place, named by its `path` down from the array, (); `largest` of its scores' sizes, and `p`: how often chance
    makes one as large among it and its siblings, not below its parent's. Nodes that were not found have no children.
    """

    path: tuple[str, ...]
    largest: float
    p: float
    is_found: bool
    children: tuple[Node, ...]

    @property
    def level(self) -> str:
        """Which of `LEVELS` it is of."""
        return LEVELS[len(self.path)]

    def found(self, level: str) -> tuple[Node, ...]:
        """All below it, or itself, of this level that were found, the largest score first."""
        nodes = [node for node in self._all() if node.is_found and node.level == level]
        return tuple(sorted(nodes, key=lambda node: -node.largest))

    def _all(self) -> Iterator[Node]:
        yield self
        for child in self.children:
            yield from child._all()


@dataclass(frozen=True)
class Localisation:
    """Where scores (m,) under `keys` are beyond chance: the tree, and the p of each statistic that was found, by its
    place, the largest score first. `limit`: chance reaches it in `level` of all campaigns.
    """

    root: Node
    found: Mapping[int, float]
    limit: float

    @property
    def p(self) -> float:
        """Of there being no gap at all."""
        return self.root.p

    @property
    def is_gap(self) -> bool:
        """Whether anything was found."""
        return self.root.is_found


def located(
    keys: Sequence[Key], headers: Mapping[str, SensorHeader], scores: Floats, chance: Floats, level: float = LEVEL
) -> Localisation:
    """Scores (m,) of a recording beside those (b, m) of replicates without a gap.

    `level` is the share of false alarms; ValueError if there are too few replicates to tell.
    """
    if (least := 1 / (len(chance) + 1)) > level:
        raise ValueError(f"level: {level}; {len(chance)} scored replicates tell nothing below {least:.3g}")
    paths = [_path(number, key, headers[key.sensor]) for number, key in enumerate(keys)]
    root = _Tree(paths, scores, chance, level).root()
    found = {int(node.path[-1]): node.p for node in root.found("statistic")}
    order = sorted(found, key=lambda at: -abs(scores[at]))
    limit = float(np.quantile(np.nan_to_num(np.abs(chance)).max(axis=1), 1 - level))
    return Localisation(root, {at: found[at] for at in order}, limit)


def p_value(value: float, chance: Floats) -> float:
    """Share of `chance` (b,) and the value itself that is as large: never 0, and exact if the value is of the same kind
    (the Monte Carlo test of Barnard 1963).
    """
    return float((1 + np.count_nonzero(chance >= value)) / (1 + len(chance)))


class _Tree:
    """Scores (n,) and those of chance (b, n), each at the end of a path."""

    def __init__(self, paths: Sequence[tuple[str, ...]], scores: Floats, chance: Floats, level: float) -> None:
        self.scores = scores
        self._paths, self._level = paths, level
        self._sizes, self._chance = np.nan_to_num(np.abs(scores)), np.nan_to_num(np.abs(chance))

    def root(self) -> Node:
        """The whole array; it has no siblings."""
        columns = list(range(len(self._paths)))
        return self._node((), columns, self._largest(columns), 0.0)

    def _node(self, path: tuple[str, ...], columns: list[int], chance: Floats, parent_p: float) -> Node:
        """`chance` is the largest score among the node and its siblings in each replicate."""
        largest = float(self._sizes[columns].max(initial=0.0))
        p = max(parent_p, p_value(largest, chance))
        is_found = p <= self._level
        children = tuple(self._below(path, columns, p)) if is_found and len(path) + 1 < len(LEVELS) else ()
        return Node(path, largest, p, is_found, children)

    def _below(self, path: tuple[str, ...], columns: list[int], p: float) -> Iterator[Node]:
        parts: dict[str, list[int]] = {}
        for column in columns:
            parts.setdefault(self._paths[column][len(path)], []).append(column)
        chance = self._largest(columns)
        for name, members in parts.items():
            yield self._node((*path, name), members, chance, p)

    def _largest(self, columns: list[int]) -> Floats:
        return np.asarray(self._chance[:, columns].max(axis=1, initial=0.0))


def _path(number: int, key: Key, header: SensorHeader) -> tuple[str, ...]:
    """The last name is the statistic's number."""
    return header.chip, key.sensor, key.axis, key.domain, str(number)
