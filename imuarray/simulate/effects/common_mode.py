"""`common_mode`: all units of one design wander together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis, require, scalar
from imuarray.simulate.processes import gauss_markov
from imuarray.simulate.signal import Analog, Place, Triple


@dataclass(frozen=True)
class CommonMode(Effect):
    """y = x + rms c(t), c one Gauss-Markov process for all sensors of a chip design, along each one's own axes.

    `rms` in the sensor's unit, `time_constant_s` in s: correlation exp(-|t| / time_constant), axes independent. The
    share that units of one design have in common of what supply and surroundings do to them: what anti-parallel
    mounting cancels (the paper's Section 2.1). Sensors meet it row by row, so those of a design are to be read equally
    often. In data: slow drift that correlates between sensors in their own axes, not in the box's.
    """

    name: ClassVar[str] = "common_mode"
    rms: Triple = per_axis(suffix="_{u}")
    time_constant_s: float = scalar(100.0)

    def __post_init__(self) -> None:
        """ValueError for a negative rms, or a time constant outside 1 ms to 1e9 s."""
        super().__post_init__()
        require("rms", min(self.rms), 0.0)
        require("time_constant_s", self.time_constant_s, 1e-3, 1e9)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Adds to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        process = gauss_markov(self.time_constant_s, at, self.name, at.sensor.chip, self.rms)
        return replace(analog, value=process.added_to(analog.value, analog.first))
