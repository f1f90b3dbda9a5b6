"""`size_effect`: a sensor away from the origin of the box senses the rotation of the box as specific force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, per_axis
from imuarray.simulate.signal import Felt, Place, Triple


@dataclass(frozen=True)
class SizeEffect(Effect):
    """force = force at the origin + angular_acceleration x r + rate x (rate x r), r the sensor's place in the box.

    `position_mm` in the box frame; rigid-body kinematics. In data: while the box turns, accelerometers differ by what
    grows with their distance and the square of the rate.
    """

    name: ClassVar[str] = "size_effect"
    position_mm: Triple = per_axis()

    def felt(self, felt: Felt, at: Place) -> Felt:
        """Add the rotational part of the specific force; a force that is constant remains so if there is no
        rotation.
        """
        rate, acceleration = felt.rate_box, felt.angular_acceleration_box
        if rate.strides[0] == acceleration.strides[0] == 0:
            rate, acceleration = rate[:1], acceleration[:1]
        place = np.array(self.position_mm) * 1e-3
        added = np.cross(acceleration, place) + np.cross(rate, np.cross(rate, place))
        return replace(felt, force_box=felt.force_box + added) if added.any() else felt


def with_position(effects: Sequence[Effect], position_mm: Triple) -> tuple[Effect, ...]:
    """Return the effects of a sensor at this position, unless one of them already states the position."""
    if not any(position_mm) or any(isinstance(effect, SizeEffect) for effect in effects):
        return tuple(effects)
    return (SizeEffect(position_mm), *effects)
