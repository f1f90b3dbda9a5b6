"""`scale`: the scale factor differs from the data sheet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis
from imuarray.simulate.signal import Analog, Place, Triple, per_row


@dataclass(frozen=True)
class Scale(Effect):
    """y = x (1 + error), each axis for itself.

    `error` as a share of one: 0.01 reads one per cent too much. Typical ones: 1 % (ADX-63), 2 and 3 % (the tolerances
    beside BMA-70 to BMA-76); L3G-75 names none. The paper's Table 3 has -1.7 to +2.9 % for its eighteen accelerometer
    axes. In data: opposite faces differ by more or less than 2 g, a known turn integrates to another angle.
    """

    name: ClassVar[str] = "scale"
    error: Triple = per_axis()

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Scale the signal."""
        if not any(self.error):
            return analog
        x, y, z = self.error
        return replace(analog, value=analog.value * per_row((1 + x, 1 + y, 1 + z), analog.value))
