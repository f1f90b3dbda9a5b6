"""The switch behind the range bits does not close after some power-ups: the register reads right, the range is not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Self

from firmware_emulator.chips.bma180_converter import RANGES as BMA180
from firmware_emulator.chips.l3g4200d_signal import RANGES_DPS as L3G4200D_DPS
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site

RANGES: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {"bma180": tuple(range_g for range_g, _ in BMA180.values()), "l3g4200d": tuple(dict.fromkeys(L3G4200D_DPS))}
)
"""Ranges of each chip, in g or dps, the smallest first."""


@dataclass(frozen=True)
class RangeSwitch(SensorMechanism):
    """A wrong range: after every `every`-th power-up the amplifier stays in the range below the one that the range bits
    ask, or above it where that is the smallest: codes are as much larger and clip at their ends; the offset is that of
    the range in force (BMA-79). In full resolution an ADXL345 has one scale in all ranges (ADX-40): it has nothing to
    switch.

    Looks like run 10 of BMA1 in the paper's Table 6. There or not, every fourth power-up: the next range shows whatever
    it is.
    """

    every: int = 4

    touches: ClassVar[tuple[str, ...]] = ("bma180", "l3g4200d")
    resembles: ClassVar[tuple[str, ...]] = ("range_reset",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return the same: it is there or not."""
        return cls()

    def put_on(self, site: Site) -> None:
        """Choose the part's own wrong power-ups; the first two never."""
        first = 2 + int(site.unit_random("range switch").integers(self.every))
        if site.run < first or (site.run - first) % self.every:
            return
        site.note(f"in a range of {_in_force(site.chip, site.full_scale):g}")
        site.chain.full_scale.append(lambda full_scale: _in_force(site.chip, full_scale))


def _in_force(chip: str, asked: float) -> float:
    ranges = RANGES[chip]
    place = min(range(len(ranges)), key=lambda at: abs(ranges[at] - asked))
    return ranges[place - 1 if place else 1]
