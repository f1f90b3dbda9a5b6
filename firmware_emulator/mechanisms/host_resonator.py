"""The host keeps time with a cheap resonator that drifts away as it warms up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import Site

ROUNDS = 8


@dataclass(frozen=True)
class HostResonator(Mechanism):
    """Rate error e (1 - exp(-t / `warm_up_s`)), e = `error`: shown = t + e (t - w (1 - exp(-t / w))).

    A ceramic resonator is within 0.5 %. Reference: 0.5 % fast, after 30 s.
    """

    error: float = 5e-3
    warm_up_s: float = 30.0

    place: ClassVar[str] = "host"
    resembles: ClassVar[tuple[str, ...]] = ("clock_error",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A worse resonator."""
        return cls(error=cls.error * severity)

    def ahead_ns(self, at_ns: int) -> float:
        """Return by how much the display is ahead."""
        warm_ns = self.warm_up_s * 1e9
        return self.error * (at_ns + warm_ns * math.expm1(-at_ns / warm_ns))

    def shown(self, at_ns: int) -> int:
        """The display."""
        return at_ns + round(self.ahead_ns(at_ns))

    def when(self, shown_ns: int) -> int:
        """The earliest time of the world with that display, by fixed point."""
        at_ns = shown_ns
        for _ in range(ROUNDS):
            at_ns = shown_ns - round(self.ahead_ns(at_ns))
        while self.shown(at_ns) < shown_ns:
            at_ns += 1
        return at_ns

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """One clock for all."""
        board.host.clocks.append((self.shown, self.when))
