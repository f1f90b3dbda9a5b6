"""A capacitor that is read from one side: its plates come closer the more they are pulled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site
from firmware_emulator.world import Stimulus

CLOSEST = 0.8


@dataclass(frozen=True)
class PlateGap(SensorMechanism):
    """C = C0 / (1 - u): output = x / (1 - x / gap), where `gap_g` or `gap_dps` is the input that would close the gap.

    Differential plates cancel the even part; here one of the two is broken. Reference: 80 g (1 g reads 1.0127) or
    8000 dps.
    """

    gap_g: float = 80.0
    gap_dps: float = 8000.0

    resembles: ClassVar[tuple[str, ...]] = ("nonlinearity",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A narrower gap."""
        return cls(gap_g=cls.gap_g / severity, gap_dps=cls.gap_dps / severity)

    def put_on(self, site: Site) -> None:
        """Each axis has its own plates; a stop keeps them from touching."""
        gap = site.by_unit(self.gap_g, self.gap_dps)

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            x, y, z = (component / (1 - min(component / gap, CLOSEST)) for component in value)
            return x, y, z

        site.chain.sensed.append(sensed)
