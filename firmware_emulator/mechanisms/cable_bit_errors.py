"""A cable too long for its pull-ups: now and then the adapter samples a bit on the slope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import WHILE_SET_UP_S, Site


@dataclass(frozen=True)
class CableBitErrors(SensorMechanism):
    """Every bit that the chip sends arrives flipped with probability `per_bit`, below the notice of acknowledges.

    I2C has no checksum. Only what the chip sends is hit: the adapter drives its own bits harder. Begins
    `WHILE_SET_UP_S` after power-on. Reference: 1e-5, some one in 2000 readings.
    """

    per_bit: float = 1e-5

    resembles: ClassVar[tuple[str, ...]] = ("glitches",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A worse cable."""
        return cls(per_bit=min(0.5, cls.per_bit * severity))

    def put_on(self, site: Site) -> None:
        """Act on the bytes as they arrive."""
        random = site.run_random("bits")
        gap = int(random.geometric(self.per_bit))
        begin_ns = round(WHILE_SET_UP_S * 1e9)

        def cable(at_ns: int, sent: bytes) -> bytes:
            nonlocal gap
            if at_ns < begin_ns:
                return sent
            bits, received = 8 * len(sent), bytearray(sent)
            while gap <= bits:
                received[(gap - 1) // 8] ^= 0x80 >> (gap - 1) % 8
                gap += int(random.geometric(self.per_bit))
            gap -= bits
            return bytes(received)

        site.links.cables.append(cable)
