"""`axis_error`: the axes of the sensor differ from the configuration."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Reals
from imuarray.simulate.effect import Effect
from imuarray.simulate.signal import Analog, Place, per_row

_NOMINAL = "+X+Y+Z"
_AXES = re.compile(r"([+-])([XYZ])" * 3)


@dataclass(frozen=True)
class AxisError(Effect):
    """y_k = s_k x_a(k): the sensor's axis k is in truth the signed axis s_k, a(k) of the sensor as configured.

    `axes`, such as "+Y+X-Z", gives the true directions of x, y and z. Left-handed values are allowed, since a forgotten
    minus sign produces them. Everything that acts along the sensor's axes, including specific force on a gyroscope, is
    exchanged with them. The error is in the table that maps sensors to the box (the paper's Table 1). In data: two axes
    are exchanged, or one has the wrong sign, in all phases; nothing else changes.
    """

    name: ClassVar[str] = "axis_error"
    axes: str = field(default=_NOMINAL)

    def __post_init__(self) -> None:
        """Raise ValueError unless X, Y and Z occur once each, with a sign."""
        super().__post_init__()
        match = _AXES.fullmatch(self.axes)
        if match is None or len(set(match.groups()[1::2])) < 3:
            raise ValueError(f"axes: {self.axes!r}; each of X, Y, Z once, signed, such as '+Y+X-Z'")

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) which axes differ from the nominal ones."""
        return tuple(self.axes[at : at + 2] != _NOMINAL[at : at + 2] for at in (0, 2, 4))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Exchange axes and signs of the signal and of the specific force."""
        if self.axes == _NOMINAL:
            return analog
        return replace(analog, value=self._exchanged(analog.value), force_g=self._exchanged(analog.force_g))

    def _exchanged(self, vectors: Reals) -> Reals:
        x, y, z = (1.0 if sign == "+" else -1.0 for sign in self.axes[::2])
        exchanged = np.take(vectors, ["XYZ".index(axis) for axis in self.axes[1::2]], axis=1)
        return exchanged * per_row((x, y, z), exchanged)
