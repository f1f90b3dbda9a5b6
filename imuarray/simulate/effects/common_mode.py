"""`common_mode`: the biases of all units of one design, or of one group, wander together."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.processes import gauss_markov
from imuarray.simulate.signal import Analog, Place, Triple


@dataclass(frozen=True)
class CommonMode(Effect):
    """y = x + rms c(t), c one Gauss-Markov process for all sensors of a chip design, or for all sensors that name the
    same `group`, along the own axes of each sensor.

    `rms` in the sensor's unit, `time_constant_s` in s: correlation exp(-|t| / time_constant). `axes_shared` is the
    share of the variance that the three axes have in common (0: independent; 1: one process, such as a supply voltage
    that affects all axes). The effect describes what supply and environment do alike to all units of one design, which
    anti-parallel mounting cancels (the paper's Section 2.1), or to all sensors on one supply. Sensors share it row by
    row and therefore must have equal rates. In data: slow drift that correlates between sensors along their own axes,
    not along the box axes.
    """

    name: ClassVar[str] = "common_mode"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)
    time_constant_s: float = scalar(100.0, low=1e-3, high=1e9)
    axes_shared: float = scalar(0.0, low=0.0, high=1.0)
    group: str = field(default="")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the common process to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        sharing = self.group or at.sensor.chip
        value = analog.value
        if self.axes_shared < 1:
            x, y, z = (rms * math.sqrt(1 - self.axes_shared) for rms in self.rms)
            value = gauss_markov(self.time_constant_s, at, self.name, sharing, (x, y, z)).added_to(value, analog.first)
        if self.axes_shared > 0:
            single = gauss_markov(self.time_constant_s, at, self.name, f"{sharing}, all axes")
            course = single.rows(analog.first, analog.first + len(value), value.dtype)[:, :1]
            value = value + course * np.asarray([rms * math.sqrt(self.axes_shared) for rms in self.rms], value.dtype)
        return replace(analog, value=value)
