"""The switch behind the range bits does not close after some power-ups: the register reads right, the range is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class RangeSwitch(SensorMechanism):
    """After every `every`-th power-up the amplifier stays `octaves` octaves more sensitive than the range bits ask:
    codes are 2^octaves as large and clip at their ends; the offset is that of the range in force (BMA-79).

    Looks like run 10 of BMA1 in the paper's Table 6. Reference: one octave, every fourth power-up; each doubling of
    severity is one octave more.
    """

    octaves: int = 1
    every: int = 4

    resembles: ClassVar[tuple[str, ...]] = ("range_reset",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """More octaves."""
        return cls(octaves=min(3, max(1, round(severity).bit_length())))

    def put_on(self, site: Site) -> None:
        """Which power-ups are the wrong ones is the part's own; the first two never."""
        first = 2 + int(site.unit_random("range switch").integers(self.every))
        if site.run < first or (site.run - first) % self.every:
            return
        site.note(f"range {self.octaves} octaves low")
        share = 0.5**self.octaves
        site.chain.full_scale.append(lambda full_scale: full_scale * share)
