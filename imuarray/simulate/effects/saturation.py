"""`saturation`: the signal saturates before the codes do."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, per_axis, require
from imuarray.simulate.signal import Analog, Place, Triple


@dataclass(frozen=True)
class Saturation(Effect):
    """y = x within [centre - limit, centre + limit], the nearer end of it outside; x is the signal of an axis with its
    noise.

    `limit` and `centre` of each axis in the sensor's unit. An offset that is added behind the element that gives out
    moves both ends. The end of the code span itself (BMA-60, ADX-46; L3G-40 to L3G-42 print
    spans 15 % beyond the range) belongs to the converter; this is the element or its amplifier giving out earlier, the
    "clipped" signal of the paper's section 2.3. In data: a flat top at codes that aren't the last ones, so that no flag
    tells.
    """

    name: ClassVar[str] = "saturation"
    limit: Triple = per_axis(math.inf, suffix="_{u}")
    centre: Triple = per_axis(0.0, suffix="_{u}")

    def __post_init__(self) -> None:
        """Raise ValueError for a negative limit."""
        super().__post_init__()
        for limit in self.limit:
            require("limit", limit, 0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Clip the sum of signal and noise; rows within the limit do not change in any bit."""
        total = analog.value + analog.noise
        limit, centre = np.array(self.limit, total.dtype), np.array(self.centre, total.dtype)
        beyond = np.abs(total - centre) > limit
        if not beyond.any():
            return analog
        ends = centre + np.copysign(limit, total - centre)
        noise = np.where(beyond, analog.noise.dtype.type(0), analog.noise)
        return replace(analog, value=np.where(beyond, ends, analog.value), noise=noise)
