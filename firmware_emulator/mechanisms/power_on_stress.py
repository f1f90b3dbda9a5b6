"""The die clamps anew whenever it warms up: each power-up freezes another stress into the bias."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class PowerOnStress(SensorMechanism):
    """Bias of each axis and power-up: Laplace's distribution of scale b (rms b sqrt 2), kept until power-off.

    Reference: b = 5 mg or 0.2 dps.
    """

    scale_g: float = 5e-3
    scale_dps: float = 0.2

    resembles: ClassVar[tuple[str, ...]] = ("turn_on_bias",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more stress."""
        return cls(scale_g=cls.scale_g * severity, scale_dps=cls.scale_dps * severity)

    def put_on(self, site: Site) -> None:
        """Drawn once, now."""
        x, y, z = site.run_random("stress").laplace(0.0, site.by_unit(self.scale_g, self.scale_dps), 3).tolist()

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            return plus(value, (x, y, z), 1.0)

        site.chain.sensed.append(sensed)
