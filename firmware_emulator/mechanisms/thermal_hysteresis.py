"""Solder that yields: the way up in temperature is not the way down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class ThermalHysteresis(SensorMechanism):
    """error = s (p - T), p following T with a backlash of +-w kelvin (Prandtl's play operator), w = `backlash_k`.

    p starts at the first temperature. Warming long enough gives -s w, cooling +s w, however slowly. s w is `size_g` or
    `size_dps` on average of the axes. Reference: 10 mg or 0.3 dps, 3 K.
    """

    size_g: float = 10e-3
    size_dps: float = 0.3
    backlash_k: float = 3.0

    @classmethod
    def at(cls, severity: float) -> Self:
        """A wider loop."""
        return cls(size_g=cls.size_g * severity, size_dps=cls.size_dps * severity)

    def put_on(self, site: Site) -> None:
        """Sign and share of each axis are the part's own."""
        direction, width = site.direction("hysteresis"), self.backlash_k
        per_k = site.by_unit(self.size_g, self.size_dps) / width
        follower: float | None = None

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            nonlocal follower
            degc = stimulus.temperature_degc
            follower = degc if follower is None else min(max(follower, degc - width), degc + width)
            return plus(value, direction, per_k * (follower - degc))

        site.chain.sensed.append(sensed)
