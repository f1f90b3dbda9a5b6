"""A chip warms itself: its thermometer, beside the regulator on the die, is warmer than the box."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class SelfHeating(SensorMechanism):
    """Self-heating: the chip's thermometer shows T + `rise_k` (1 - exp(-t / `settling_s`)), t since power-on; bias
    follows the mass, T.

    rise = power x thermal resistance; only chips whose thermometer has a zero. Reference: 3 K after 5 s.
    """

    rise_k: float = 3.0
    settling_s: float = 5.0

    touches: ClassVar[tuple[str, ...]] = ("bma180",)
    resembles: ClassVar[tuple[str, ...]] = ("thermometer",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more power."""
        return cls(rise_k=cls.rise_k * severity)

    def put_on(self, site: Site) -> None:
        """Act on the thermometer alone."""

        def thermometer(at_ns: int, degc: float) -> float:
            return degc - self.rise_k * math.expm1(-at_ns * 1e-9 / self.settling_s)

        site.chain.thermometer.append(thermometer)
