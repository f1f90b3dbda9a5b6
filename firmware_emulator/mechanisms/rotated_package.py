"""A square package soldered a quarter turn round."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.package_tilt import Rotation
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class RotatedPackage(SensorMechanism):
    """Turned by `quarters` quarter turns about the sensor's own z: x feels what y should, y the negative of x.

    It is either so or not: every severity is one quarter turn.
    """

    quarters: int = 1

    resembles: ClassVar[tuple[str, ...]] = ("axis_error",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """One quarter turn."""
        return cls()

    def put_on(self, site: Site) -> None:
        """The sensor's z axis in the box is the last column of its orientation."""
        x, y, z = (row[2] for row in site.orientation)
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[self.quarters % 4]
        site.chain.felt.append(Rotation((x, y, z), cosine, sine))
