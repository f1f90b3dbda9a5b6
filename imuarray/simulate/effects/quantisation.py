"""`quantisation`: codes come in coarser steps than one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.signal import Analog, Codes, Place


@dataclass(frozen=True)
class Quantisation(Effect):
    """Codes are rounded to multiples of `step_lsb` counts, and end at the last multiple within the code span; of them
    those bits are cleared that are set in the number `dead_bits` (4: bit 2).

    Rounding to one count belongs to the converter and is always there. Two counts are an ADXL345 at 1600 Hz and more
    (ADX-47), four a BMA180 read out with 12 bits (BMA-61). Where the converter's step is coarser already, codes are
    multiples of both. In data: codes that never occur; readings that stand still and jump where there is less noise
    than half a step, rounding noise of step / sqrt(12) rms where there is more. A dead bit, a line that is shorted to
    ground, leaves out every other stretch of 2^bit codes: what belongs there reads a stretch too low.
    """

    name: ClassVar[str] = "quantisation"
    step_lsb: float = scalar(1.0)
    dead_bits: float = scalar(0.0)

    def __post_init__(self) -> None:
        """ValueError unless they are whole numbers, the step 1 or more."""
        super().__post_init__()
        require("step_lsb", self.step_lsb, 1, 4096)
        require("dead_bits", self.dead_bits, 0, 32767)
        for name in ("step_lsb", "dead_bits"):
            if (value := getattr(self, name)) != int(value):
                raise ValueError(f"{name}: {value}; a whole number is wanted")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Sets the converter's step and code ends."""
        if self.step_lsb == 1:
            return analog
        step = math.lcm(analog.step, int(self.step_lsb))
        lowest, highest = -(-analog.lowest // step) * step, analog.highest // step * step
        return replace(analog, step=step, lowest=lowest, highest=highest)

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Clears the dead bits, of negative codes in two's complement."""
        return replace(codes, counts=codes.counts & ~int(self.dead_bits)) if self.dead_bits else codes
