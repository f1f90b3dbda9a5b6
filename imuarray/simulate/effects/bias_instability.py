"""`bias_instability`: the bias wanders within bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.processes import gauss_markov
from imuarray.simulate.signal import Analog, Place, Triple

RATIO = 4.0
"""Ratio of neighbouring time constants of flicker noise: with it the sum is 1/f within 1 % between the fastest and the
slowest.
"""


@dataclass(frozen=True)
class BiasInstability(Effect):
    """y = x + b(t), b first-order Gauss-Markov: stationary, N(0, rms^2), correlation exp(-|t| / time_constant).

    `rms` in the sensor's unit, `time_constant_s` in s; axes are independent. It stands for the in-run variation of the
    paper's Table 5 and the right half of its Table 11. In data: the Allan deviation leaves its slope of -1/2; the
    process's own peaks with 0.62 rms at 1.9 time constants (IEEE Std 952, Annex C).

    With `fastest_time_constant_s` it is flicker noise (1/f): n processes of variance rms^2 / n, time constants by a
    factor of 4 from `time_constant_s` down to that. In data: an Allan deviation that is flat, rms / sqrt(n), between
    the fastest and the slowest (IEEE Std 952, Annex C, bias instability). 0: a single process.
    """

    name: ClassVar[str] = "bias_instability"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)
    time_constant_s: float = scalar(100.0, low=1e-3, high=1e9)
    fastest_time_constant_s: float = scalar(0.0, low=0.0, high=1e9)

    @property
    def time_constants_s(self) -> tuple[float, ...]:
        """Return the time constants of its processes, the slowest first."""
        fastest_s = max(self.fastest_time_constant_s, 1e-3)
        octaves = math.log(self.time_constant_s / fastest_s, RATIO) if self.fastest_time_constant_s else 0.0
        return tuple(self.time_constant_s / RATIO**step for step in range(1 + max(0, math.floor(octaves + 1e-9))))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the processes to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        value, times_s = analog.value, self.time_constants_s
        x, y, z = (size / math.sqrt(len(times_s)) for size in self.rms)
        for time_s in times_s:
            value = gauss_markov(time_s, at, self.name, scale=(x, y, z)).added_to(value, analog.first)
        return replace(analog, value=value)
