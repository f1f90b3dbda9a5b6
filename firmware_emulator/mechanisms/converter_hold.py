"""The converter latches up for a while: the same triad over and over, said to be new."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.line import Codes
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class ConverterHold(SensorMechanism):
    """Free for `free_s` on average, exponential; then held for `held_s`. Reference: 1 s in every 20 s or so."""

    held_s: float = 1.0
    free_s: float = 20.0

    resembles: ClassVar[tuple[str, ...]] = ("stuck",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Longer holds."""
        return cls(held_s=cls.held_s * severity)

    def put_on(self, site: Site) -> None:
        """All axes share the converter."""
        random = site.run_random("holds")
        next_ns = random.exponential(self.free_s * 1e9)
        until_ns, held = -1.0, (0, 0, 0)

        def latch(at_ns: int, codes: Codes) -> Codes:
            nonlocal next_ns, until_ns, held
            if at_ns < until_ns:
                return held
            if at_ns >= next_ns:
                until_ns, held = at_ns + self.held_s * 1e9, codes
                next_ns = until_ns + random.exponential(self.free_s * 1e9)
                site.note(f"held from {at_ns * 1e-9:.3f} s")
            return codes

        site.links.latches.append(latch)
