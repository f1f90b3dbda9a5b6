"""`thermal_bias`: the bias depends on the temperature of the sensing element."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.signal import Analog, Place, Triple, per_row


@dataclass(frozen=True)
class ThermalBias(Effect):
    """y = x + slope (T - reference) + quadratic (T - reference)^2, T the element's temperature in degC.

    `slope` in the sensor's unit per degC, `quadratic` per degC^2, `reference_degc` where it vanishes. Typical slopes
    are in BMA-115, ADX-62 and L3G-71; those of the paper's sensors in its Table 8, which found no use for a quadratic
    term. In data: readings at rest that follow the thermometer.
    """

    name: ClassVar[str] = "thermal_bias"
    slope: Triple = per_axis(suffix="_{u}_per_degc")
    quadratic: Triple = per_axis(suffix="_{u}_per_degc2")
    reference_degc: float = scalar(25.0, low=-273.15, high=1000.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the thermal bias to the value."""
        if self.slope == self.quadratic == (0.0, 0.0, 0.0):
            return analog
        value = analog.value
        warmer = (analog.temperature_degc - self.reference_degc).astype(value.dtype)[:, None]
        if not any(self.quadratic):
            return replace(analog, value=value + warmer @ np.array([self.slope], value.dtype))
        slope = per_row(self.slope, value) + warmer * per_row(self.quadratic, value)
        return replace(analog, value=value + warmer * slope)
