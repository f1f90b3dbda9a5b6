"""The multiplexer's switch kicks the supply: who converts just after it is off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus

LONG_AGO_NS = -(1 << 62)


@dataclass(frozen=True)
class MuxCrosstalk(Mechanism):
    """error = k exp(-t / `decay_ms`), t since the last switch, k `kick_g` or `kick_dps` on average of the axes.

    Who is read early in a segment feels it, and only in frames that come to the segment by a switch. Reference: 20 mg
    or 0.6 dps, 2 ms.
    """

    kick_g: float = 20e-3
    kick_dps: float = 0.6
    decay_ms: float = 2.0

    @classmethod
    def at(cls, severity: float) -> Self:
        """A stronger kick."""
        return cls(kick_g=cls.kick_g * severity, kick_dps=cls.kick_dps * severity)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """One multiplexer, heard by every site."""
        switched_ns = LONG_AGO_NS

        def switched(at_ns: int) -> None:
            nonlocal switched_ns
            switched_ns = at_ns

        def hear(site: Site) -> None:
            direction, kick = site.direction("kick"), site.by_unit(self.kick_g, self.kick_dps)

            def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
                since_ms = (at_ns - switched_ns) * 1e-6
                return plus(value, direction, kick * math.exp(-since_ms / self.decay_ms)) if since_ms >= 0 else value

            site.chain.sensed.append(sensed)

        board.host.switched.append(switched)
        for site in sites:
            hear(site)
