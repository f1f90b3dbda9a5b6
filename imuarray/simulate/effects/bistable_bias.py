"""`bistable_bias`: after some boots the bias is different."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.signal import Analog, Place, Triple, per_row


@dataclass(frozen=True)
class BistableBias(Effect):
    """y = x + offset for a whole run, in a run with this probability, all three axes together.

    `offset` in the sensor's unit. The paper's Gyro3 comes up with one of two sets of biases, (-13, 6, -2) LSB apart
    (Table 7). In data: run means in two groups, the same ones on all axes.
    """

    name: ClassVar[str] = "bistable_bias"
    offset: Triple = per_axis(suffix="_{u}")
    probability: float = scalar(0.0, low=0.0, high=1.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the offset to the value."""
        if at.boot_generator(self.name).random() >= self.probability:
            return analog
        return replace(analog, value=analog.value + per_row(self.offset, analog.value))
