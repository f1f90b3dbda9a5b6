"""A converter with poorly matched capacitors: some codes never come, their neighbours come instead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.line import Codes
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site

PERIOD = 16


@dataclass(frozen=True)
class MissingCodes(SensorMechanism):
    """Missing codes: of every 16 codes the last `missing` before a carry are skipped: they come out as the code of the
    carry.

    Differential nonlinearity of -1 LSB at the carry of bit 4. Reference: 4 of 16.
    """

    missing: int = 4

    resembles: ClassVar[tuple[str, ...]] = ("quantisation",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more missing codes."""
        return cls(missing=min(PERIOD - 2, max(2, round(cls.missing * severity))))

    def put_on(self, site: Site) -> None:
        """One converter for all axes."""
        first = PERIOD - self.missing

        def carried(code: int) -> int:
            return code - code % PERIOD + PERIOD if code % PERIOD >= first else code

        def latch(at_ns: int, codes: Codes) -> Codes:
            return carried(codes[0]), carried(codes[1]), carried(codes[2])

        site.links.latches.append(latch)
