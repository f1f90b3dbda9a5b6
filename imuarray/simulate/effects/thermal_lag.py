"""`thermal_lag`: the element warms up later than the box."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.signal import lfilter

from imuarray.arrays import Integers, Reals
from imuarray.simulate.effect import Effect, per_axis, require, scalar
from imuarray.simulate.signal import Analog, Felt, Motion, Place, Triple

_STEPS = 50
"""Steps of the recursion per time constant."""
_SHORTEST_S, _LONGEST_S = 0.01, 10.0
"""Steps: shorter than any change of temperature that matters; short enough for a heater that is switched on."""
_FORGOTTEN = 20.0
"""Time constants after which 2e-9 is left of a difference in temperature."""


@dataclass(frozen=True)
class ThermalLag(Effect):
    """time_constant dT/dt = T_box - T, T the element's temperature; in equilibrium at time 0, and before.

    `time_constant_s` in s (0: no lag). The box's temperature is taken to change linearly between steps of a fiftieth of
    the time constant (10 ms at least, 10 s at most), for which the recursion is exact. Acts with `thermal_bias` and
    `thermal_scale`, and on what the chip's own thermometer reads. In data: a loop in readings over the temperature of
    another chip, its area growing with the speed of heating.

    With a `slope`, in the sensor's unit per degC, only a part of the bias of each axis lags, not the whole element:
    slope (T - T_box) is added. A stress in the package that relaxes does so, on one axis and not on the others.
    """

    name: ClassVar[str] = "thermal_lag"
    time_constant_s: float = scalar(0.0)
    slope: Triple = per_axis(suffix="_{u}_per_degc")

    def __post_init__(self) -> None:
        """ValueError for a time constant outside 0 to 1e6 s."""
        super().__post_init__()
        require("time_constant_s", self.time_constant_s, 0.0, 1e6)

    def felt(self, felt: Felt, at: Place) -> Felt:
        """Another temperature."""
        if any(self.slope) or self.time_constant_s == 0.0 or len(felt.time_ns) == 0:
            return felt
        return replace(felt, temperature_degc=self._lagged_at(felt.time_ns, at.motion))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Adds the part of the bias that lags."""
        if not any(self.slope) or self.time_constant_s == 0.0 or len(analog.instant_ns) == 0:
            return analog
        time_ns = analog.instant_ns
        apart = self._lagged_at(time_ns, at.motion) - at.motion.felt(time_ns).temperature_degc
        value = analog.value
        return replace(analog, value=value + np.asarray(apart[:, None] * np.array(self.slope), value.dtype))

    def _lagged_at(self, time_ns: Integers, motion: Motion) -> Reals:
        """(n,) temperature of the element at these times."""
        nodes_ns = self._nodes_ns(time_ns)
        since_ns = (time_ns - nodes_ns[0]).astype(float)
        return np.asarray(np.interp(since_ns, nodes_ns - nodes_ns[0], self._lagged(nodes_ns, motion)))

    def _step_ns(self) -> int:
        return round(min(max(self.time_constant_s / _STEPS, _SHORTEST_S), _LONGEST_S) * 1e9)

    def _nodes_ns(self, time_ns: Integers) -> Integers:
        """Multiples of the step, from long enough before the first of these times to the last."""
        step_ns = self._step_ns()
        earliest_ns = int(time_ns.min()) - round(_FORGOTTEN * self.time_constant_s * 1e9)
        first = max(0, earliest_ns // step_ns)
        return np.arange(first, max(first, -(-int(time_ns.max()) // step_ns)) + 1) * step_ns

    def _lagged(self, nodes_ns: Integers, motion: Motion) -> Reals:
        """The element's temperature at the nodes, from equilibrium at the first one."""
        box = motion.felt(nodes_ns).temperature_degc
        ratio = self._step_ns() * 1e-9 / self.time_constant_s
        phi = math.exp(-ratio)
        old = -math.expm1(-ratio) / ratio - phi  # what the box's temperature at a step's begin and end counts
        new = 1.0 - phi - old
        lagged, _ = lfilter([new, old], [1.0, -phi], box, zi=[(1.0 - new) * box[0]])
        return np.asarray(lagged)
