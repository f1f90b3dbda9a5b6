"""The short way from counts to triads, where there is nothing to think about: every reading was taken at its frame's
time, none is in doubt, and the technique weighs its axes alike in every frame. Then the result is one matrix times the
counts, less a constant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from imuarray.fuse.align import Unit
from imuarray.fuse.frames import Estimate, Floats, Times
from imuarray.fuse.solve import ConstantGain
from imuarray.log import Block
from imuarray.log.format import SATURATED, SUSPECT

Counts = npt.NDArray[Any]


@runtime_checkable
class FixedWeighing(Protocol):
    """A technique that does with every whole frame the same."""

    def whole(self) -> tuple[Floats, Callable[[Floats], Estimate]]:
        """The gain (3, m) that makes a triad of values, and what makes the estimate of frames, all axes valid, of their
        triads (n, 3).
        """
        ...


class Plain:
    """One quantity by a technique that weighs alike in every frame."""

    def __init__(self, technique: FixedWeighing, units: Sequence[Unit]) -> None:
        gain, self._estimate = technique.whole()
        bias = np.concatenate([unit.known.bias_lsb for unit in units])
        scale = np.concatenate([unit.known.lsb_per_si for unit in units])
        self._triads = ConstantGain(gain / scale, bias)

    def __call__(self, counts: Sequence[Counts]) -> Estimate:
        """The estimate of the frames whose counts (n, 3) of each sensor these are."""
        return self._estimate(self._triads(counts))


def plain_of(techniques: Mapping[str, object], units: Mapping[str, Sequence[Unit]]) -> dict[str, Plain]:
    """The short way of every quantity; empty if one of them has none."""
    found = {
        quantity: Plain(technique, units[quantity])
        for quantity, technique in techniques.items()
        if isinstance(technique, FixedWeighing) and all(_is_plain(unit) for unit in units[quantity])
    }
    return found if len(found) == len(techniques) else {}


def _is_plain(unit: Unit) -> bool:
    """Whether nothing but its counts says what it feels, and when."""
    known = unit.known
    return unit.warmth is None and known.g_sensitivity_lsb_per_g is None and not unit.delay_s and not unit.conversion_s


def plain_counts(blocks: Sequence[Block | None], grid: Times) -> list[Counts] | None:
    """The counts (n, 3) of each sensor at the times `grid` (n,), n > 0; None unless all are there and sound."""
    found = []
    for block in blocks:
        if block is None:
            return None
        first = int(np.searchsorted(block.time, grid[0]))
        rows = slice(first, first + len(grid))
        if not np.array_equal(block.time[rows], grid) or (block.status[rows] & (SATURATED | SUSPECT)).any():
            return None
        found.append(block.counts[rows])
    return found
