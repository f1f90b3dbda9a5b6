"""The output stage runs out of supply before the converter runs out of codes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site

KNEE = 8


@dataclass(frozen=True)
class SoftClipping(SensorMechanism):
    """output = x / (1 + |x / A|^8)^(1/8), A = `share` of the full scale: straight up to 3/4 A, never above A.

    Reference: half of the full scale, less as severity grows.
    """

    share: float = 0.5

    resembles: ClassVar[tuple[str, ...]] = ("saturation",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with less supply."""
        return cls(share=cls.share / severity)

    def put_on(self, site: Site) -> None:
        """Noise is clipped with the signal."""

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            most = self.share * full_scale
            x, y, z = (component / (1 + abs(component / most) ** KNEE) ** (1 / KNEE) for component in value)
            return x, y, z

        site.chain.amplified.append(amplified)
