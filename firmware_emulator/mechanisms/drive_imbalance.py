"""The mass of a gyroscope hangs a little beside the line of its drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.attitude import cross
from firmware_emulator.chip import Triple
from firmware_emulator.element import applied, transposed
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import GYROSCOPES, Site, plus
from firmware_emulator.world import STANDARD_GRAVITY, Stimulus


@dataclass(frozen=True)
class DriveImbalance(SensorMechanism):
    """error = m x f: a pendulous mass with its lever m feels the torque of the specific force f (IEEE Std 1431).

    m is `imbalance_dps_per_g` along each axis on average, f in g. Reference: 0.3 dps/g.
    """

    imbalance_dps_per_g: float = 0.3

    touches: ClassVar[tuple[str, ...]] = GYROSCOPES
    resembles: ClassVar[tuple[str, ...]] = ("g_sensitivity",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A longer lever."""
        return cls(imbalance_dps_per_g=cls.imbalance_dps_per_g * severity)

    def put_on(self, site: Site) -> None:
        """Act along axes of the part's own."""
        lever, from_box = site.direction("imbalance"), transposed(site.orientation)
        factor = self.imbalance_dps_per_g / STANDARD_GRAVITY

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            return plus(value, cross(lever, applied(from_box, stimulus.force_box)), factor)

        site.chain.sensed.append(sensed)
