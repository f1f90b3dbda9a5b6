"""Rows of one sensor as they come, kept as long as they are wanted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imuarray.log import Block

FOREVER_NS = 1 << 62
"""Later than any time of a log."""


class Rows:
    """A window that slides over one sensor's rows: `append` at its end, `forget` at its beginning."""

    def __init__(self) -> None:
        self._parts: list[Block] = []
        self.newest_ns = -FOREVER_NS
        self.ended = False
        """Nothing comes any more."""

    def append(self, block: Block) -> None:
        """Rows that follow those that are there; ValueError if they don't."""
        if len(block.time) == 0:
            return
        if block.time[0] <= self.newest_ns:
            raise ValueError(f"row at {block.time[0]} ns comes after one at {self.newest_ns} ns")
        self._parts.append(block)
        self.newest_ns = int(block.time[-1])

    def __len__(self) -> int:
        return sum(len(part.time) for part in self._parts)

    @property
    def block(self) -> Block | None:
        """All rows that are kept; None if there are none."""
        if len(self._parts) > 1:
            self._parts = [joined(self._parts)]
        return self._parts[0] if self._parts else None

    def forget(self, before_ns: int) -> None:
        """Let go of the rows before a time."""
        kept = [part for part in self._parts if part.time[-1] >= before_ns]
        if kept and (first := int(np.searchsorted(kept[0].time, before_ns))):
            kept[0] = cut(kept[0], slice(first, None))
        self._parts = kept


def joined(parts: list[Block]) -> Block:
    """Rows one after the other. All parts have the same columns."""
    first = parts[0]
    degrees = [part.temperature_counts for part in parts if part.temperature_counts is not None]
    return Block(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.status for part in parts]),
        np.concatenate(degrees) if degrees else None,
        {name: np.concatenate([part.compensated[name] for part in parts]) for name in first.compensated},
    )


def cut(block: Block, rows: slice) -> Block:
    """Some rows of a block, copied: what they were cut from can go."""
    compensated: Mapping[str, np.ndarray] = {name: column[rows].copy() for name, column in block.compensated.items()}
    degrees = None if block.temperature_counts is None else block.temperature_counts[rows].copy()
    return Block(block.time[rows].copy(), block.counts[rows].copy(), block.status[rows].copy(), degrees, compensated)
