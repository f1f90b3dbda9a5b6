"""Other programs on the host: between the look at the clock and the transfer somebody else had the processor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.element import stream
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class SchedulerLatency(Mechanism):
    """A `share` of transactions waits, exponentially with mean `mean_ms`. Reference: 3 % wait 1 ms."""

    share: float = 0.03
    mean_ms: float = 1.0

    place: ClassVar[str] = "host"
    resembles: ClassVar[tuple[str, ...]] = ("jitter",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Longer waits."""
        return cls(mean_ms=cls.mean_ms * severity)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Act on every transaction of every adapter."""
        random = stream(board.seed, f"scheduler, run {board.run}")

        def wait_ns() -> int:
            return round(random.exponential(self.mean_ms * 1e6)) if random.random() < self.share else 0

        board.host.waits_ns.append(wait_ns)
