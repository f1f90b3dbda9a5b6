"""`thermometer`: the thermometer of the chip has an error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.signal import Analog, Place


@dataclass(frozen=True)
class Thermometer(Effect):
    """T_read = T + offset + w, w ~ N(0, rms^2) independent from row to row; T the element's temperature in degC.

    `offset_degc` and `rms_degc`; the measured quantity is not affected. The BMA180's thermometer is off by up to 5 degC
    (BMA-64), and the L3G4200D's has no specified zero (L3G-60). In data: the chip's temperature differs from the
    barometer's.
    """

    name: ClassVar[str] = "thermometer"
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
