"""`clock_error`: the log's clock goes wrong by a constant ratio."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Instants, Place


@dataclass(frozen=True)
class ClockError(Effect):
    """instant = stamp (1 + error_ppm 1e-6): what is stamped t happened that much later, counted from the epoch.

    `error_ppm` in millionths, positive for a log whose clock is slow: the fractional frequency error of IEEE 1139, its
    sign that of true over logged time. A quartz is off by tens, an oscillator without one by up to a hundred thousand
    (BMA-107: 10 %). In data: everything happens faster by that ratio; lines of the spectrum are shifted, a known
    profile of motion or temperature is left behind further and further.
    """

    name: ClassVar[str] = "clock_error"
    error_ppm: float = scalar(0.0)

    def __post_init__(self) -> None:
        """ValueError beyond a factor of a half or three halves."""
        super().__post_init__()
        require("error_ppm", self.error_ppm, -5e5, 5e5)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Stretches time."""
        if not self.error_ppm:
            return instants
        late_ns = np.rint(instants.stamp_ns * (self.error_ppm * 1e-6)).astype(np.int64)
        return replace(instants, instant_ns=instants.instant_ns + late_ns)
