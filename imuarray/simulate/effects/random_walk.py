"""`random_walk`: the bias wanders without bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis
from imuarray.simulate.processes import random_walk
from imuarray.simulate.signal import Analog, Place, Triple


@dataclass(frozen=True)
class RandomWalk(Effect):
    """y = x + b(t), a Wiener process: b = 0 at the first row, b(t + s) - b(t) ~ N(0, density^2 s).

    `density` in the sensor's unit per root second; axes are independent. In data: an Allan deviation of slope +1/2,
    density sqrt(tau / 3) (IEEE Std 952, Annex C: rate random walk).
    """

    name: ClassVar[str] = "random_walk"
    density: Triple = per_axis(suffix="_{u}_per_sqrt_s", low=0.0)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the random walk to the value."""
        if self.density == (0.0, 0.0, 0.0):
            return analog
        process = random_walk(at, self.name, self.density)
        return replace(analog, value=process.added_to(analog.value, analog.first))
