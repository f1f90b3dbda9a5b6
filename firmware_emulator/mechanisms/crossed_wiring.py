"""Two sensors of a kind, plugged in the wrong way round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class CrossedWiring(Mechanism):
    """Each of two sensors of one chip answers in the other's place, with its own unit and orientation.

    It is either so or not: every severity is the same.
    """

    place: ClassVar[str] = "pair"
    resembles: ClassVar[tuple[str, ...]] = ("channel_swap",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Crossed."""
        return cls()

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Chips are set up through the same crossed wires: ranges are those of the place."""
        first, second = sites
        board.crossed |= {first.name: second.name, second.name: first.name}
