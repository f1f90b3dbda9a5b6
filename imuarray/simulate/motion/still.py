"""A box that stands still, and the runs of a turn-on series."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import resting, standing_on
from imuarray.simulate.motion.felt import Felt
from imuarray.simulate.motion.timeline import consecutive, finite, nanoseconds, positive


@dataclass(frozen=True)
class Still:
    """A box at rest for `seconds` with the box axis `up` upwards; one phase, `name`.

    The temperature begins at `temperature_degc` and changes by `drift_degc_per_h`. `tilt_deg` are small angles by which
    box and table are turned about the level x and y axes: no table is level, no box square. ValueError for what can't
    be.
    """

    up: str = "+Z"
    seconds: float = 600.0
    temperature_degc: float = 25.0
    name: str = "static"
    drift_degc_per_h: float = 0.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        positive(seconds=self.seconds)
        finite(temperature_degc=self.temperature_degc, drift_degc_per_h=self.drift_degc_per_h)
        standing_on(self.up, self.tilt_deg)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The phase: the whole log."""
        return consecutive((self.name, nanoseconds(self.seconds), self.up))

    @cached_property
    def attitude(self) -> Reals:
        """The attitude (3, 3) from the box to the level frame."""
        return standing_on(self.up, self.tilt_deg)

    def felt(self, time_ns: Integers) -> Felt:
        """Return the reaction to gravity."""
        if self.drift_degc_per_h == 0:
            return resting(time_ns, self.attitude, self.temperature_degc)
        hours = np.clip(time_ns, 0, nanoseconds(self.seconds)) / 3.6e12
        return resting(time_ns, self.attitude, self.temperature_degc + self.drift_degc_per_h * hours)


def turn_on_run(k: int = 1, seconds: float = 300.0, temperature_degc: float = 25.0) -> Still:
    """Run `k` (1, 2, ...) of a turn-on series: the box stands still, five minutes as in the paper's section 4."""
    if k < 1:
        raise ValueError(f"k: {k}; runs are counted 1, 2, ...")
    return Still("+Z", seconds, temperature_degc, f"run {k}")
