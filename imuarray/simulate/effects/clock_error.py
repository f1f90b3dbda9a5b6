"""`clock_error`: the clock of the log is off by a ratio that is constant or settles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Instants, Place


@dataclass(frozen=True)
class ClockError(Effect):
    """instant = stamp (1 + error_ppm 1e-6), counted from the epoch: a reading stamped t was taken at that instant.

    `error_ppm` is the fractional frequency error of IEEE 1139 in millionths, positive for a log whose clock is slow;
    its sign is that of true minus logged time. A quartz is off by tens of ppm, an RC oscillator by up to a hundred
    thousand (BMA-107: 10 %). In data: everything happens faster by that ratio; lines of the spectrum are shifted, and
    the difference from a known profile of motion or temperature keeps growing.

    An oscillator that warms up from the epoch on has the additional error warm_up_ppm exp(-t / warm_up_s) at time t,
    which integrates to warm_up_ppm warm_up_s (1 - exp(-t / warm_up_s)). With warm_up_ppm = -error_ppm it is right when
    cold; with 0 its rate is constant.
    """

    name: ClassVar[str] = "clock_error"
    error_ppm: float = scalar(0.0, low=-5e5, high=5e5)
    warm_up_ppm: float = scalar(0.0, low=-5e5, high=5e5)
    warm_up_s: float = scalar(60.0, low=1e-3, high=1e9)

    def __post_init__(self) -> None:
        """Raise ValueError unless the ratio of the clocks stays between one half and three halves, also at the
        beginning.
        """
        super().__post_init__()
        require("error_ppm + warm_up_ppm", self.error_ppm + self.warm_up_ppm, -5e5, 5e5)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Scale the times of the readings."""
        if not self.error_ppm and not self.warm_up_ppm:
            return instants
        late_ns = instants.stamp_ns * (self.error_ppm * 1e-6)
        if self.warm_up_ppm:
            warm_ns = self.warm_up_s * 1e9
            late_ns -= np.expm1(-np.maximum(instants.stamp_ns, 0) / warm_ns) * (self.warm_up_ppm * 1e-6 * warm_ns)
        return replace(instants, instant_ns=instants.instant_ns + np.rint(late_ns).astype(np.int64))
