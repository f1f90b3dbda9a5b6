"""`turn_on_bias`: the bias changes each time the sensor is switched on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, per_axis
from imuarray.simulate.signal import Analog, Place, Triple, per_row


@dataclass(frozen=True)
class TurnOnBias(Effect):
    """y = x + b, b ~ N(0, rms^2) drawn for each axis once a boot.

    `rms` in the sensor's unit. The spread of the means of 15 runs in the left half of the paper's Table 11: 2.4 to 7.7
    times the in-run variation for its gyroscopes. In data: run means that differ by more than what is within runs
    explains.
    """

    name: ClassVar[str] = "turn_on_bias"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the bias of this boot to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        x, y, z = (np.array(self.rms) * at.boot_generator(self.name).standard_normal(3)).tolist()
        return replace(analog, value=analog.value + per_row((x, y, z), analog.value))
