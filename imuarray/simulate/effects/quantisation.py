"""`quantisation`: codes come in coarser steps than one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Analog, Place


@dataclass(frozen=True)
class Quantisation(Effect):
    """Codes are rounded to multiples of `step_lsb` counts, and end at the last multiple within the code span.

    Rounding to one count belongs to the converter and is always there. Two counts are an ADXL345 at 1600 Hz and more
    (ADX-47), four a BMA180 read out with 12 bits (BMA-61). Where the converter's step is coarser already, codes are
    multiples of both. In data: codes that never occur; readings that stand still and jump where there is less noise
    than half a step, rounding noise of step / sqrt(12) rms where there is more.
    """

    name: ClassVar[str] = "quantisation"
    step_lsb: float = scalar(1.0)

    def __post_init__(self) -> None:
        """ValueError unless it is 1, 2, 3, ..."""
        super().__post_init__()
        require("step_lsb", self.step_lsb, 1, 4096)
        if self.step_lsb != int(self.step_lsb):
            raise ValueError(f"step_lsb: {self.step_lsb}; a whole number is wanted")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Sets the converter's step and code ends."""
        if self.step_lsb == 1:
            return analog
        step = math.lcm(analog.step, int(self.step_lsb))
        lowest, highest = -(-analog.lowest // step) * step, analog.highest // step * step
        return replace(analog, step=step, lowest=lowest, highest=highest)
