"""`bias_instability`: the bias wanders within bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, per_axis, scalar
from imuarray.simulate.processes import gauss_markov
from imuarray.simulate.signal import Analog, Place, Triple


@dataclass(frozen=True)
class BiasInstability(Effect):
    """y = x + b(t), b first-order Gauss-Markov: stationary, N(0, rms^2), correlation exp(-|t| / time_constant).

    `rms` in the sensor's unit, `time_constant_s` in s; axes are independent. It stands for the in-run variation of the
    paper's Table 5 and the right half of its Table 11. In data: the Allan deviation leaves its slope of -1/2; the
    process's own peaks with 0.62 rms at 1.9 time constants (IEEE Std 952, Annex C). Several of them, time constants
    a decade apart, make flicker noise.
    """

    name: ClassVar[str] = "bias_instability"
    rms: Triple = per_axis(suffix="_{u}", low=0.0)
    time_constant_s: float = scalar(100.0, low=1e-3, high=1e9)

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Adds to the value."""
        if self.rms == (0.0, 0.0, 0.0):
            return analog
        process = gauss_markov(self.time_constant_s, at, self.name, scale=self.rms)
        return replace(analog, value=process.added_to(analog.value, analog.first))
