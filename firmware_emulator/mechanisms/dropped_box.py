"""The box fell from the bench after the first recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class DroppedBox(SensorMechanism):
    """A box that was dropped: from power-up number 1 on, the bias of each axis is shifted for good, by `shift_g` or
    `shift_dps` on average.

    Permanent deformation of the die's attachment; data sheets of the time give no figure. Reference: 15 mg or 0.5 dps.
    """

    shift_g: float = 15e-3
    shift_dps: float = 0.5

    resembles: ClassVar[tuple[str, ...]] = ("bias", "turn_on_bias")

    @classmethod
    def at(cls, severity: float) -> Self:
        """A harder fall."""
        return cls(shift_g=cls.shift_g * severity, shift_dps=cls.shift_dps * severity)

    def put_on(self, site: Site) -> None:
        """Change nothing before the fall."""
        if site.run == 0:
            return
        direction, shift = site.direction("fall"), site.by_unit(self.shift_g, self.shift_dps)

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            return plus(value, direction, shift)

        site.chain.sensed.append(sensed)
