"""A battery that sags under load, and a sensor whose scale hangs on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import ACCELEROMETERS, Site
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class SupplyDroop(SensorMechanism):
    """scale = 1 - `droop` (1 - exp(-t / `sag_s`)), t since power-on: polarisation of a cell under load.

    Bias is not concerned: the bridge is ratiometric, its amplifier is not. Reference: 2 % within 40 s.
    """

    droop: float = 0.02
    sag_s: float = 40.0

    touches: ClassVar[tuple[str, ...]] = ACCELEROMETERS

    @classmethod
    def at(cls, severity: float) -> Self:
        """A weaker battery."""
        return cls(droop=cls.droop * severity)

    def put_on(self, site: Site) -> None:
        """Act on the stimulus, before the unit's bias."""

        def felt(at_ns: int, stimulus: Stimulus) -> Stimulus:
            share = 1 + self.droop * math.expm1(-at_ns * 1e-9 / self.sag_s)
            x, y, z = stimulus.force_box
            force: Triple = (x * share, y * share, z * share)
            return stimulus._replace(force_box=force)

        site.chain.felt.append(felt)
