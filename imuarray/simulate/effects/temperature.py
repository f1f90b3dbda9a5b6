"""Effects of temperature: its delay in the element, slopes of bias and scale factor, errors of the thermometer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.motion.stimulus import temperature_at
from imuarray.simulate.signal import Analog, BoxStimulus, Motion, Place, Triple, by_axis

_STEPS = 50
"""Number of steps of the recursion per time constant."""
_SHORTEST_S, _LONGEST_S = 0.01, 10.0
"""Limits of a step in s. The lower one is shorter than any relevant change of temperature; the upper one is still short
enough to follow a heater that is switched on.
"""
_FORGOTTEN = 20.0
"""Number of time constants after which a share of 2e-9 of a difference in temperature remains."""


@dataclass(frozen=True)
class ThermalLag(Effect):
    """time_constant dT/dt = T_box - T, T the element's temperature, in equilibrium at time 0 and before.

    `time_constant_s` in s (0: no lag). The box's temperature is assumed to change linearly between steps of a fiftieth
    of the time constant (10 ms at least, 10 s at most), for which the recursion is exact. The effect acts on the
    temperature that `thermal_bias`, `thermal_scale` and the chip's own thermometer use. In data: a hysteresis loop of
    the readings plotted over the temperature of another chip; its area grows with the rate of heating.

    With a `slope`, in the sensor's unit per degC, the element itself does not lag; instead slope (T - reference) is
    added to the readings, T being the lagged temperature of another part, such as a board that warms up later than the
    chip and stresses it. The temperatures of the element and of its thermometer are unchanged.
    """

    name: ClassVar[str] = "thermal_lag"
    meaning: ClassVar[str] = "the sensing element, or a part of it, warms up later than the box"
    time_constant_s: float = scalar(0.0, low=0.0, high=1e6)
    slope: Triple = per_axis(suffix="_{u}_per_degc")
    reference_degc: float = scalar(25.0, low=-273.15, high=1000.0)

    def stimulus(self, stimulus: BoxStimulus, at: Place) -> BoxStimulus:
        """Replace the temperature of the element by the lagged one."""
        if self.time_constant_s == 0.0 or any(self.slope) or len(stimulus.time_ns) == 0:
            return stimulus
        return replace(stimulus, temperature_degc=self.temperature_degc(stimulus.time_ns, at.motion))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the bias of the part that lags."""
        if not any(self.slope) or len(analog.instant_ns) == 0:
            return analog
        part = replace(analog, temperature_degc=self.temperature_degc(analog.instant_ns, at.motion))
        bias = ThermalBias(self.slope, reference_degc=self.reference_degc)
        return replace(analog, value=bias.analog(part, at).value)

    def temperature_degc(self, time_ns: Integers, motion: Motion) -> Reals:
        """Return the element's temperature (n,) at times (n,), n > 0, in a box with this motion."""
        if self.time_constant_s == 0.0:
            return temperature_at(motion, time_ns)
        nodes_ns = self._nodes_ns(time_ns)
        lagged = self._lag(nodes_ns, motion)
        return np.asarray(np.interp((time_ns - nodes_ns[0]).astype(float), nodes_ns - nodes_ns[0], lagged))

    def _step_ns(self) -> int:
        return round(min(max(self.time_constant_s / _STEPS, _SHORTEST_S), _LONGEST_S) * 1e9)

    def _nodes_ns(self, time_ns: Integers) -> Integers:
        """Return the multiples of the step, from far enough before the first of these times to the last."""
        step_ns = self._step_ns()
        earliest_ns = int(time_ns.min()) - round(_FORGOTTEN * self.time_constant_s * 1e9)
        first = max(0, earliest_ns // step_ns)
        return np.arange(first, max(first, -(-int(time_ns.max()) // step_ns)) + 1) * step_ns

    def _lag(self, nodes_ns: Integers, motion: Motion) -> Reals:
        """Return the element's temperature at the nodes, starting in equilibrium at the first one."""
        from scipy.signal import lfilter  # imported late because SciPy takes long to load

        box = temperature_at(motion, nodes_ns)
        ratio = self._step_ns() * 1e-9 / self.time_constant_s
        phi = math.exp(-ratio)
        old = -math.expm1(-ratio) / ratio - phi  # weights of the box's temperature at the beginning and end of a step
        new = 1.0 - phi - old
        lagged, _ = lfilter([new, old], [1.0, -phi], box, zi=[(1.0 - new) * box[0]])
        return np.asarray(lagged)


@dataclass(frozen=True)
class ThermalScale(Effect):
    """y = x (1 + slope (T - reference)), T the element's temperature in degC.

    `slope` is the relative change per degC, `reference_degc` the temperature at which the effect is zero. Typical
    values are 1e-4 (BMA-116, ADX-64) and, for the HMC5883L, -3e-3 (HMC-57); the L3G4200D changes by 2 % from -40 to 85
    degC (L3G-72). In data: the change with temperature is proportional to the measured quantity, so it has opposite
    signs on opposite faces.
    """

    name: ClassVar[str] = "thermal_scale"
    meaning: ClassVar[str] = "the scale factor depends on the temperature of the sensing element"
    slope: Triple = per_axis(suffix="_per_degc")
    reference_degc: float = scalar(25.0, low=-273.15, high=1000.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Scale the value."""
        if self.slope == (0.0, 0.0, 0.0):
            return analog
        value = analog.value
        warmer = (analog.temperature_degc - self.reference_degc).astype(value.dtype)
        return replace(analog, value=value + value * by_axis(warmer, self.slope))


@dataclass(frozen=True)
class ThermalBias(Effect):
    """y = x + slope (T - reference) + quadratic (T - reference)^2, T the element's temperature in degC.

    `slope` is in the sensor's unit per degC, `quadratic` per degC^2, `reference_degc` the temperature at which the
    effect is zero. Typical slopes are in BMA-115, ADX-62 and L3G-71; those of the paper's sensors are in its Table 8.
    The paper needed no quadratic term. In data: readings at rest that follow the thermometer.
    """

    name: ClassVar[str] = "thermal_bias"
    meaning: ClassVar[str] = "the bias depends on the temperature of the sensing element"
    slope: Triple = per_axis(suffix="_{u}_per_degc")
    quadratic: Triple = per_axis(suffix="_{u}_per_degc2")
    reference_degc: float = scalar(25.0, low=-273.15, high=1000.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the thermal bias to the value."""
        if self.slope == self.quadratic == (0.0, 0.0, 0.0):
            return analog
        value = analog.value
        warmer = (analog.temperature_degc - self.reference_degc).astype(value.dtype)
        if not any(self.quadratic):
            return replace(analog, value=value + by_axis(warmer, self.slope))
        bias = np.empty_like(value)
        for axis, (slope, quadratic) in enumerate(zip(self.slope, self.quadratic, strict=True)):
            np.multiply(warmer, slope + warmer * quadratic, out=bias[:, axis])
        return replace(analog, value=value + bias)


@dataclass(frozen=True)
class Thermometer(Effect):
    """T_read = T + offset + w, w ~ N(0, rms^2) independent from row to row; T the element's temperature in degC.

    `offset_degc` and `rms_degc`; the measured quantity is not affected. The BMA180's thermometer is off by up to 5 degC
    (BMA-64), and the L3G4200D's has no specified zero (L3G-60). In data: the chip's temperature differs from the
    barometer's.
    """

    name: ClassVar[str] = "thermometer"
    meaning: ClassVar[str] = "the thermometer of the chip has an error"
    offset_degc: float = scalar(0.0, low=-1000.0, high=1000.0)
    rms_degc: float = scalar(0.0, low=0.0, high=1000.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add offset and noise to the temperature that the thermometer measures."""
        degc = analog.thermometer_degc
        if self.offset_degc:
            degc = degc + self.offset_degc
        if self.rms_degc:
            noise = at.stream(self.name, width=1).normal(analog.first, analog.first + len(degc))[:, 0]
            degc = degc + self.rms_degc * noise
        return replace(analog, thermometer_degc=degc)
