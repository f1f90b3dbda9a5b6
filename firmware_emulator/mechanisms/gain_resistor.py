"""The resistor that sets the amplifier's gain changes with temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site
from firmware_emulator.world import ROOM_DEGC, Stimulus


@dataclass(frozen=True)
class GainResistor(SensorMechanism):
    """gain = exp(k (T - 25)), k = `per_k` as of a diffused resistor, the same for all axes. Reference: 0.1 % per K."""

    per_k: float = 1e-3

    resembles: ClassVar[tuple[str, ...]] = ("thermal_scale",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A worse resistor."""
        return cls(per_k=cls.per_k * severity)

    def put_on(self, site: Site) -> None:
        """Bias is amplified too."""

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            gain = math.exp(self.per_k * (stimulus.temperature_degc - ROOM_DEGC))
            return value[0] * gain, value[1] * gain, value[2] * gain

        site.chain.sensed.append(sensed)
