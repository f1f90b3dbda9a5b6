"""`common_mode`: the biases of all units of one design, or of one group, wander together."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, per_axis, require, scalar
from imuarray.simulate.processes import gauss_markov
from imuarray.simulate.signal import Analog, Place, Triple


@dataclass(frozen=True)
class CommonMode(Effect):
    """y = x + rms c(t), c one Gauss-Markov process for all sensors of a chip design, or for those of whatever chip that
    name the same `group`, along each one's own axes.

    `rms` in the sensor's unit, `time_constant_s` in s: correlation exp(-|t| / time_constant). Axes have so much of the
    variance in common as `axes_shared` says (0: independent, 1: one process, as what a supply puts into all axes). The
    share that units of one design have in common of what supply and surroundings do to them: what anti-parallel
    mounting cancels (the paper's Section 2.1); or what a supply does to all that hang on it. Sensors meet it row by
    row, so those that share it are to be read equally often. In data: slow drift that correlates between sensors in
    their own axes, not in the box's.
    """

    name: ClassVar[str] = "common_mode"
    rms: Triple = per_axis(suffix="_{u}")
    time_constant_s: float = scalar(100.0)
    axes_shared: float = scalar(0.0)
    group: str = field(default="")

    def __post_init__(self) -> None:
        """ValueError for a negative rms, a time constant outside 1 ms to 1e9 s, or a share outside 0 to 1."""
        super().__post_init__()
        require("rms", min(self.rms), 0.0)
        require("time_constant_s", self.time_constant_s, 1e-3, 1e9)
        require("axes_shared", self.axes_shared, 0.0, 1.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Adds to the value."""
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
