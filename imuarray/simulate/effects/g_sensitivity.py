"""`g_sensitivity`: specific force changes the reading of a sensor of another quantity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect
from imuarray.simulate.parameters import numbers, several
from imuarray.simulate.signal import Analog, Place


@dataclass(frozen=True)
class GSensitivity(Effect):
    """y = x + response f, f the specific force in g along the sensor's own axes.

    `response` (3x3, row after row) in the sensor's unit per g: entry ij is what force along axis j adds to axis i. A
    vibrating gyroscope is sensitive to force by its nature: the paper's section 5.2.2 and Table 4 (differences over 2 g
    of at most 0.038 dps; L3G-76). In data: a gyroscope at rest has another bias on every face of the box.
    """

    name: ClassVar[str] = "g_sensitivity"
    response: tuple[float, ...] = several(9, suffix="_{u}_per_g")

    def __post_init__(self) -> None:
        """Raise ValueError unless there are nine finite numbers."""
        super().__post_init__()
        object.__setattr__(self, "response", numbers("response", self.response, 9))

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) which axes respond to force."""
        return tuple(any(self.response[at : at + 3]) for at in (0, 3, 6))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the response to specific force."""
        if not any(self.response):
            return analog
        columns = np.reshape(self.response, (3, 3)).T.astype(analog.value.dtype)
        return replace(analog, value=analog.value + analog.force_g @ columns)
