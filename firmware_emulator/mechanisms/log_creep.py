"""Ageing since power-on: the bias creeps with the logarithm of time, in the same way after every power-up."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class LogCreep(SensorMechanism):
    """error = c log10(1 + t / `onset_s`), t since power-on, c `per_decade_g` or `per_decade_dps` on average.

    Dielectric absorption in the front end (Curie 1889, von Schweidler 1907). Reference: 4 mg or 0.15 dps a decade.
    """

    per_decade_g: float = 4e-3
    per_decade_dps: float = 0.15
    onset_s: float = 1.0

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more creep."""
        return cls(per_decade_g=cls.per_decade_g * severity, per_decade_dps=cls.per_decade_dps * severity)

    def put_on(self, site: Site) -> None:
        """The world's clock starts at power-on."""
        direction, creep = site.direction("creep"), site.by_unit(self.per_decade_g, self.per_decade_dps)

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            return plus(value, direction, creep * math.log10(1 + at_ns * 1e-9 / self.onset_s))

        site.chain.sensed.append(sensed)
