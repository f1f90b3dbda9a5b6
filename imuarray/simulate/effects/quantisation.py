"""`quantisation`: codes come in steps larger than one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from imuarray.simulate.effect import Effect, per_axis, require, scalar
from imuarray.simulate.signal import Analog, Codes, Place, Triple

Whole = npt.NDArray[np.signedinteger[Any]]


@dataclass(frozen=True)
class Quantisation(Effect):
    """Codes of each axis are rounded to multiples of `step_lsb` counts, and end at the last multiple within the code
    span. Of every `carry_lsb` codes the last `missing_lsb` never occur; the code of the carry replaces them. Bits
    that are set in the number `dead_bits` (4: bit 2) are cleared.

    Rounding to one count belongs to the converter and is always applied. Steps of two counts occur in an ADXL345 at
    1600 Hz and above (ADX-47), steps of four in a BMA180 that is read with 12 bits (BMA-61). If the converter's step is
    coarser already, codes are multiples of both. In data: codes that never occur; with noise of less than half a step,
    readings that are constant and then jump; with more noise, rounding noise of step / sqrt(12) rms. A dead bit (a line
    that is shorted to ground) removes every other stretch of 2^bit codes: readings from it are a stretch too low. Codes
    are missing before a carry if the converter's capacitor (or resistor) for the bit that is carried to is smaller than
    those of all lower bits together by more than a count: a differential nonlinearity of -1 (IEEE Std 1241). An offset
    that the chip adds after its converter, such as a trim (BMA-46), moves carries away from multiples.
    """

    name: ClassVar[str] = "quantisation"
    step_lsb: Triple = per_axis(1.0, low=1, high=4096)
    dead_bits: float = scalar(0.0, low=0, high=32767)
    carry_lsb: float = scalar(1.0, low=1, high=4096)
    missing_lsb: float = scalar(0.0)
    carry_at_lsb: float = scalar(0.0)

    def __post_init__(self) -> None:
        """Raise ValueError unless the parameters are whole numbers and at least one code remains before a carry."""
        super().__post_init__()
        require("missing_lsb", self.missing_lsb, 0, self.carry_lsb - 1)
        require("carry_at_lsb", self.carry_at_lsb, 0, self.carry_lsb - 1)
        numbers = [("step_lsb", step) for step in self.step_lsb]
        numbers += [(name, getattr(self, name)) for name in ("dead_bits", "carry_lsb", "missing_lsb", "carry_at_lsb")]
        for name, value in numbers:
            if value != int(value):
                raise ValueError(f"{name}: {value}; a whole number is required")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Set the converter's step and code ends."""
        if max(self.step_lsb) == 1:
            return analog
        is_same = len(set(self.step_lsb)) == 1
        own = np.array(self.step_lsb[0] if is_same else [self.step_lsb]).astype(int)  # (1, 3) counts as columns of rows
        step = np.lcm(analog.step, own)
        step = int(step) if np.ndim(step) == 0 else step
        lowest, highest = -(-analog.lowest // step) * step, analog.highest // step * step
        return replace(analog, step=step, lowest=lowest, highest=highest)

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Replace missing codes by the carry, and clear the dead bits; negative codes are in two's complement."""
        changed = self.dead_bits or self.missing_lsb
        return replace(codes, counts=self.coded(codes.counts)) if changed else codes

    def coded(self, counts: Whole) -> Whole:
        """Return the codes that replace these."""
        if self.missing_lsb:
            carry, largest = int(self.carry_lsb), np.iinfo(counts.dtype).max
            short = carry - (counts - int(self.carry_at_lsb)) % carry
            carried = np.minimum(counts, largest - short) + short
            counts = np.where(short <= int(self.missing_lsb), carried, counts)
        return counts & ~int(self.dead_bits) if self.dead_bits else counts
