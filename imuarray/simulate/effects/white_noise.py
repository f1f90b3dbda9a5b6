"""`white_noise`: every reading has an independent, normally distributed error."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Reals
from imuarray.simulate.effect import Effect, per_axis
from imuarray.simulate.signal import Analog, Place, Triple


@dataclass(frozen=True)
class WhiteNoise(Effect):
    """y = x + w, w ~ N(0, rms^2), independent from row to row and axis to axis.

    `rms` in the sensor's unit: the standard deviation of single readings at rest, as data sheets (BMA-110, ADX-67,
    L3G-74, once multiplied by the root of the bandwidth) and the paper's Tables 9 and 10 give it. `bandwidth` shapes
    this noise without weakening it. In data: a flat spectrum, an Allan deviation of slope -1/2.
    """

    name: ClassVar[str] = "white_noise"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add white noise to the noise."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        noise = at.stream(self.name, scale=self.rms).normal(analog.first, analog.first + len(analog.noise))
        earlier_rms = analog.white_rms
        if isinstance(earlier_rms, tuple):
            x, y, z = map(math.hypot, self.rms, earlier_rms)
            white_rms: Triple | Reals = (x, y, z)
        else:
            white_rms = np.hypot(self.rms, earlier_rms)
        return replace(analog, noise=noise if analog.is_silent else noise + analog.noise, white_rms=white_rms)
