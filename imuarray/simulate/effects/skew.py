"""`skew`: readings are older than their time stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.signal import Instants, Place


@dataclass(frozen=True)
class Skew(Effect):
    """instant = stamp - delay_s: the reading was taken `delay_s` seconds before its stamp (negative: after).

    Filters delay by their group delay, conversions take their turn (a quarter of 417 us an axis in the BMA180, BMA-94),
    samples wait in the chip until they are read; what is known of it is a log's attribute `delay_ns`. In data: nothing
    at rest; under motion the sensors of one array lag each other, most where the motion is fastest.
    """

    name: ClassVar[str] = "skew"
    delay_s: float = scalar(0.0, low=-1e3, high=1e3)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Shift the times of all readings by the same number of nanoseconds."""
        if not self.delay_s:
            return instants
        return replace(instants, instant_ns=instants.instant_ns - round(self.delay_s * 1e9))
