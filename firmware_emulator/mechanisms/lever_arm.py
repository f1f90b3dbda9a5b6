"""A sensor that sits beside the point about which the box turns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.attitude import cross
from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import ACCELEROMETERS, Site, plus
from firmware_emulator.world import Stimulus

HALF_NS = 500_000


@dataclass(frozen=True)
class LeverArm(SensorMechanism):
    """f' = f + a x r + w x (w x r), r of length `arm_m` in a direction of the part's own, a the change of the rate w.

    Rigid-body kinematics; a by central difference over 1 ms. Reference: 50 mm.
    """

    arm_m: float = 0.05

    touches: ClassVar[tuple[str, ...]] = ACCELEROMETERS
    resembles: ClassVar[tuple[str, ...]] = ("size_effect",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A longer arm."""
        return cls(arm_m=cls.arm_m * severity)

    def put_on(self, site: Site) -> None:
        """Act in the box frame."""
        x, y, z = site.direction("arm")
        share = self.arm_m / math.sqrt(x * x + y * y + z * z)
        arm, world = (x * share, y * share, z * share), site.world

        def felt(at_ns: int, stimulus: Stimulus) -> Stimulus:
            before, after = world(max(0, at_ns - HALF_NS)), world(at_ns + HALF_NS)
            if before is after is stimulus:
                return stimulus
            speeding = plus(after.rate_box, before.rate_box, -1.0)
            force = plus(stimulus.force_box, cross(speeding, arm), 0.5e9 / HALF_NS)
            turning: Triple = cross(stimulus.rate_box, cross(stimulus.rate_box, arm))
            return stimulus._replace(force_box=plus(force, turning, 1.0))

        site.chain.felt.append(felt)
