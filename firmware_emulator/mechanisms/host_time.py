"""Clock and scheduling of the polling computer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from firmware_emulator.element import stream
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import Site

ROUNDS = 8


@dataclass(frozen=True)
class HostResonator(Mechanism):
    """The host's clock is a cheap resonator whose frequency changes as it warms up.

    The rate error is e (1 - exp(-t / w)), e = `error`, w = `warm_up_s`, so the displayed time is t + e (t - w (1 -
    exp(-t / w))).

    Ceramic resonators are within 0.5 %. Reference: 0.5 % fast, with a warm-up time of 30 s.
    """

    error: float = 5e-3
    warm_up_s: float = 30.0

    place: ClassVar[str] = "host"
    resembles: ClassVar[tuple[str, ...]] = ("clock_error",)
    scaled: ClassVar[tuple[str, ...]] = ("error",)

    def ahead_ns(self, at_ns: int) -> float:
        """Return the error of the displayed time in ns."""
        warm_ns = self.warm_up_s * 1e9
        return self.error * (at_ns + warm_ns * math.expm1(-at_ns / warm_ns))

    def shown(self, at_ns: int) -> int:
        """Return the displayed time in ns."""
        return at_ns + round(self.ahead_ns(at_ns))

    def when(self, shown_ns: int) -> int:
        """Return the earliest time of the world with that displayed time, by fixed-point iteration."""
        at_ns = shown_ns
        for _ in range(ROUNDS):
            at_ns = shown_ns - round(self.ahead_ns(at_ns))
        while self.shown(at_ns) < shown_ns:
            at_ns += 1
        return at_ns

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Add the clock error to the host."""
        board.host.clocks.append((self.shown, self.when))


@dataclass(frozen=True)
class SchedulerLatency(Mechanism):
    """Other programs on the host run between the reading of the clock and the transfer.

    A `share` of the transactions waits, exponentially distributed with mean `mean_ms`. Reference: 3 % wait 1 ms.
    """

    share: float = 0.03
    mean_ms: float = 1.0

    place: ClassVar[str] = "host"
    resembles: ClassVar[tuple[str, ...]] = ("jitter",)
    scaled: ClassVar[tuple[str, ...]] = ("mean_ms",)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Add latency to every transaction of every adapter."""
        random = stream(board.seed, f"scheduler, run {board.run}")

        def wait_ns() -> int:
            return round(random.exponential(self.mean_ms * 1e6)) if random.random() < self.share else 0

        board.host.waits_ns.append(wait_ns)


COARSEST_MS = 15.0


@dataclass(frozen=True)
class CoarseTimestamps(Mechanism):
    """A kernel with a tick: the clock is constant between two ticks, and sleeping programs wake up at ticks.

    Times are rounded down to whole ticks of `tick_ms`. Reference: 10 ms, the jiffy of a kernel with HZ=100.

    The tick is at most `COARSEST_MS`, because two readings within a longer tick would have the same time.
    """

    tick_ms: float = 10.0

    place: ClassVar[str] = "host"
    scaled: ClassVar[tuple[str, ...]] = ("tick_ms",)
    largest: ClassVar[float] = COARSEST_MS

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Replace the clock of the host by a coarse one."""
        tick_ns = round(self.tick_ms * 1e6)
        board.host.clocks.append(
            (lambda at_ns: at_ns // tick_ns * tick_ns, lambda shown_ns: -(-shown_ns // tick_ns) * tick_ns)
        )
