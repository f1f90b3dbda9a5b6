"""A kernel that ticks: the clock stands still between two ticks, and sleepers wake on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import Site

COARSEST_MS = 15.0


@dataclass(frozen=True)
class CoarseTimestamps(Mechanism):
    """Times are cut to whole ticks of `tick_ms`. Reference: 10 ms, the jiffy of a kernel with HZ=100.

    At most `COARSEST_MS`: two readings within a tick would bear the same time.
    """

    tick_ms: float = 10.0

    place: ClassVar[str] = "host"

    @classmethod
    def at(cls, severity: float) -> Self:
        """A longer tick."""
        return cls(tick_ms=min(COARSEST_MS, cls.tick_ms * severity))

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """One clock for all."""
        tick_ns = round(self.tick_ms * 1e6)
        board.host.clocks.append(
            (lambda at_ns: at_ns // tick_ns * tick_ns, lambda shown_ns: -(-shown_ns // tick_ns) * tick_ns)
        )
