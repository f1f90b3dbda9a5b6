"""`bias`: the reading differs from zero at zero input."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.signal import Analog, Place, Triple, per_row


@dataclass(frozen=True)
class Bias(Effect):
    """y = x + offset, the same in every run, or in every run but the first `from_boot` ones: after a fall, say.

    `offset` in the sensor's unit: zero-g and zero-rate levels of BMA-112, BMA-113, ADX-60, ADX-61 and L3G-70; the
    paper's Tables 3 and 4 for its own 27 axes. What changes from boot to boot is `turn_on_bias`, what changes with
    temperature `thermal_bias`. In data: the mean of two opposite faces.
    """

    name: ClassVar[str] = "bias"
    offset: Triple = per_axis(suffix="_{u}")
    from_boot: float = scalar(0.0, low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Shift the signal."""
        if at.streams.boot < self.from_boot or not any(self.offset):
            return analog
        return replace(analog, value=analog.value + per_row(self.offset, analog.value))
