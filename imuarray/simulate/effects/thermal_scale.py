"""`thermal_scale`: the scale factor depends on the temperature of the sensing element."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.signal import Analog, Place, Triple, per_row


@dataclass(frozen=True)
class ThermalScale(Effect):
    """y = x (1 + slope (T - reference)), T the element's temperature in degC.

    `slope` is a share of one per degC, `reference_degc` where it vanishes. Typical are 1e-4 (BMA-116, ADX-64) and
    -3e-3 for the HMC5883L (HMC-57); the L3G4200D changes by 2 % from -40 to 85 degC (L3G-72). In data: what follows the
    thermometer is proportional to what is measured: opposite on opposite faces.
    """

    name: ClassVar[str] = "thermal_scale"
    slope: Triple = per_axis(suffix="_per_degc")
    reference_degc: float = scalar(25.0, low=-273.15, high=1000.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Scale the value."""
        if self.slope == (0.0, 0.0, 0.0):
            return analog
        value = analog.value
        warmer = (analog.temperature_degc - self.reference_degc).astype(value.dtype)[:, None]
        return replace(analog, value=value + value * (warmer * per_row(self.slope, value)))
