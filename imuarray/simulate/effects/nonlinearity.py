"""`nonlinearity`: the response is slightly nonlinear."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis
from imuarray.simulate.signal import Analog, Place, Triple, per_row


@dataclass(frozen=True)
class Nonlinearity(Effect):
    """y = x + quadratic x^2 + cubic x^3, each axis for itself, x in the sensor's unit.

    `quadratic` per unit, `cubic` per unit squared. Data sheets bound the deviation from the best straight line, as a
    share of full scale: BMA-117, ADX-65, L3G-73. In data: the two readings of an axis along and against gravity have a
    mean that isn't the bias (quadratic, which opposed sensors of one design cancel: the paper's section 2.1), scale
    grows or falls with the range of motion (cubic), vibration shifts the mean (quadratic).
    """

    name: ClassVar[str] = "nonlinearity"
    quadratic: Triple = per_axis(suffix="_per_{u}")
    cubic: Triple = per_axis(suffix="_per_{u}2")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Apply the polynomial to the signal."""
        if not any((*self.quadratic, *self.cubic)):
            return analog
        x = analog.value
        return replace(analog, value=x + x * x * (per_row(self.quadratic, x) + per_row(self.cubic, x) * x))
