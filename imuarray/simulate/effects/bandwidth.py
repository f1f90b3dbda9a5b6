"""`bandwidth`: noise that remembers the reading before."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.signal import lfilter

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Analog, Place

_FORGOTTEN = 12 * math.log(10.0)  # time constants after which 1e-12 is left of the past


@dataclass(frozen=True)
class Bandwidth(Effect):
    """White noise w becomes n[k] = phi n[k-1] + sqrt(1 - phi^2) w[k], phi = exp(-2 pi cutoff / rows_per_s).

    First-order low-passed noise of the same rms, `cutoff_hz` its -3 dB frequency where that lies well below the rows'
    rate; the paper's gyroscope (Appendix A, Figure 13: correlation 0.4 from one row to the next at 350 Hz) has 51 Hz,
    not the 110 Hz that it was set to. In data: correlation phi^k at lag k, an Allan deviation that flattens at the
    shortest times.
    """

    name: ClassVar[str] = "bandwidth"
    cutoff_hz: float = scalar(math.inf)

    def __post_init__(self) -> None:
        """ValueError for a cutoff below 10 mHz."""
        super().__post_init__()
        require("cutoff_hz", self.cutoff_hz, 1e-2)

    def lookback(self, at: Place) -> int:
        """Rows until 1e-12 is left of what was before them."""
        return math.ceil(_FORGOTTEN / self._decay(at))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Filters the noise, stationary from the first row on."""
        if math.isinf(self.cutoff_hz):
            return analog
        decay = self._decay(at)
        phi, share = math.exp(-decay), math.sqrt(-math.expm1(-2 * decay))
        white = analog.noise.astype(float)
        noise, _ = lfilter([share], [1.0, -phi], white, axis=0, zi=(1 - share) * white[:1])
        return replace(analog, noise=np.asarray(noise, analog.noise.dtype))

    def _decay(self, at: Place) -> float:
        """Time constants per row."""
        return 2 * math.pi * self.cutoff_hz / at.rows_per_s
