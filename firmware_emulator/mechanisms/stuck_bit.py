"""One line of the output latch is shorted to ground: a bit that is always 0."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.line import Codes
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class StuckBit(SensorMechanism):
    """code & ~(1 << `bit`): codes keep to every other stretch of 2^bit, the mean falls by 2^(bit - 1).

    Reference: bit 2; each doubling of severity is the next bit.
    """

    bit: int = 2

    resembles: ClassVar[tuple[str, ...]] = ("quantisation",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A more significant bit."""
        return cls(bit=min(7, max(1, cls.bit + round(math.log2(severity)))))

    def put_on(self, site: Site) -> None:
        """The line is shared by all axes."""
        mask = ~(1 << self.bit)

        def latch(at_ns: int, codes: Codes) -> Codes:
            return codes[0] & mask, codes[1] & mask, codes[2] & mask

        site.links.latches.append(latch)
