"""`jitter`: every reading is stamped a little off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Instants, Place


@dataclass(frozen=True)
class Jitter(Effect):
    """instant = stamp + w, w ~ N(0, rms_s^2), independent from row to row.

    `rms_s` in seconds: what the scheduler of the logging computer puts between a burst and the reading of its clock. In
    data: nothing at rest; under motion noise in proportion to how fast the signal changes, rms_s |dx/dt|.
    """

    name: ClassVar[str] = "jitter"
    rms_s: float = scalar(0.0)

    def __post_init__(self) -> None:
        """ValueError for a negative or an absurd one."""
        super().__post_init__()
        require("rms_s", self.rms_s, 0.0, 1e3)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Moves every instant by a draw of its own."""
        if not self.rms_s:
            return instants
        drawn = at.stream(self.name, width=1).normal(instants.first, instants.first + len(instants.stamp_ns))
        off_ns = np.rint(drawn[:, 0].astype(float) * (self.rms_s * 1e9)).astype(np.int64)
        return replace(instants, instant_ns=instants.instant_ns + off_ns)
