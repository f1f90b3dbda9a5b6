"""Two converters take turns, and their offsets differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus

SAME_BURST_NS = 1_000_000


@dataclass(frozen=True)
class InterleavedConverters(SensorMechanism):
    """Every other reading has +o, the ones between -o, o = `offset_g` or `offset_dps`.

    Time-interleaved converters (Black and Hodges 1980), which change places after every burst; conversions within
    `SAME_BURST_NS` belong together. Reference: 4 mg or 0.15 dps.
    """

    offset_g: float = 4e-3
    offset_dps: float = 0.15

    @classmethod
    def at(cls, severity: float) -> Self:
        """Offsets farther apart."""
        return cls(offset_g=cls.offset_g * severity, offset_dps=cls.offset_dps * severity)

    def put_on(self, site: Site) -> None:
        """All axes go through both."""
        offset, before_ns = site.by_unit(self.offset_g, self.offset_dps), 0

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            nonlocal offset, before_ns
            if at_ns > before_ns + SAME_BURST_NS:
                offset = -offset
            before_ns = at_ns
            return plus(value, (1.0, 1.0, 1.0), offset)

        site.chain.amplified.append(amplified)
