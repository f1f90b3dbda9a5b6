"""`bandwidth`: readings that remember the one before."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.signal import lfilter

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Analog, Floats, Place

_FORGOTTEN = 12 * math.log(10.0)  # time constants after which 1e-12 is left of the past


@dataclass(frozen=True)
class Bandwidth(Effect):
    """White noise w becomes n[k] = phi n[k-1] + sqrt(1 - phi^2) w[k], phi = exp(-2 pi cutoff / rows_per_s).

    First-order low-passed noise of the same rms, `cutoff_hz` its -3 dB frequency where that lies well below the rows'
    rate; the paper's gyroscope (Appendix A, Figure 13: correlation 0.4 from one row to the next at 350 Hz) has 51 Hz,
    not the 110 Hz that it was set to. Of the signal, taken as straight between rows, that `share` passes the same
    filter (1: all that is filtered on the chip) and is late by 1 / (2 pi cutoff); 0 leaves the motion as it is, as of a
    noise that is born with a memory. In data: correlation phi^k at lag k, an Allan deviation that flattens at the
    shortest times; under motion a sensor that is behind the others.
    """

    name: ClassVar[str] = "bandwidth"
    cutoff_hz: float = scalar(math.inf)
    share: float = scalar(0.0)

    def __post_init__(self) -> None:
        """ValueError for a cutoff below 10 mHz, or a share outside 0 to 1."""
        super().__post_init__()
        require("cutoff_hz", self.cutoff_hz, 1e-2)
        require("share", self.share, 0.0, 1.0)

    def lookback(self, at: Place) -> int:
        """Rows until 1e-12 is left of what was before them."""
        return math.ceil(_FORGOTTEN / self._decay(at))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Filters the noise, stationary from the first row on, and the signal as if it had been at rest before."""
        if math.isinf(self.cutoff_hz):
            return analog
        decay = self._decay(at)
        phi, share = math.exp(-decay), math.sqrt(-math.expm1(-2 * decay))
        white = analog.noise.astype(float)
        noise, _ = lfilter([share], [1.0, -phi], white, axis=0, zi=(1 - share) * white[:1])
        return replace(analog, value=self._passed(analog.value, decay), noise=np.asarray(noise, analog.noise.dtype))

    def _passed(self, value: Floats, decay: float) -> Floats:
        """The signal (n, 3) after the filter, exactly so for straight lines between rows."""
        if not self.share:
            return value
        phi, mean = math.exp(-decay), -math.expm1(-decay) / decay
        signal = value.astype(float)
        late, _ = lfilter([1 - mean, mean - phi], [1.0, -phi], signal, axis=0, zi=mean * signal[:1])
        return np.asarray(value + self.share * (late - signal), value.dtype)

    def _decay(self, at: Place) -> float:
        """Time constants per row."""
        return 2 * math.pi * self.cutoff_hz / at.rows_per_s
