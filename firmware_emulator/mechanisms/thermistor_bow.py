"""The compensation of temperature is straight, the physics are not: what is left bows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import ROOM_DEGC, Stimulus


@dataclass(frozen=True)
class ThermistorBow(SensorMechanism):
    """error = d (T - 25)^2, d on each axis `bow_g_per_k2` or `bow_dps_per_k2` on average. Reference: 50 ug/K^2 (20 mg
    at 45 degC) or 1.5 mdps/K^2.
    """

    bow_g_per_k2: float = 50e-6
    bow_dps_per_k2: float = 1.5e-3

    resembles: ClassVar[tuple[str, ...]] = ("thermal_bias",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more bow."""
        return cls(bow_g_per_k2=cls.bow_g_per_k2 * severity, bow_dps_per_k2=cls.bow_dps_per_k2 * severity)

    def put_on(self, site: Site) -> None:
        """Sign and share of each axis are the part's own."""
        direction, bow = site.direction("bow"), site.by_unit(self.bow_g_per_k2, self.bow_dps_per_k2)

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            return plus(value, direction, bow * (stimulus.temperature_degc - ROOM_DEGC) ** 2)

        site.chain.sensed.append(sensed)
