"""The shadow register fails to hold: a reading whose halves belong to two conversions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.line import LAYOUTS, Codes
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class TornReads(SensorMechanism):
    """Torn readings: with probability `share` a reading has the high byte of the one before and its own low byte, on
    all axes.

    Wrong by 256 codes (64 of the BMA180's) when the two differ in the high byte, as around 0. Reference: 1 %.
    """

    share: float = 0.01

    resembles: ClassVar[tuple[str, ...]] = ("glitches",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one that acts more often."""
        return cls(share=min(1.0, cls.share * severity))

    def put_on(self, site: Site) -> None:
        """Act in the latch, before the wire."""
        random = site.run_random("tears")
        low = 0xFF >> LAYOUTS[site.chip].shift
        before: Codes | None = None

        def latch(at_ns: int, codes: Codes) -> Codes:
            nonlocal before
            old, before = before, codes
            if old is None or random.random() >= self.share:
                return codes
            x, y, z = (high & ~low | code & low for high, code in zip(old, codes, strict=True))
            return x, y, z

        site.links.latches.append(latch)
