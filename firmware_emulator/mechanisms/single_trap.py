"""Popcorn: one defect in the amplifier of one axis, which catches a carrier and keeps it for a while."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class SingleTrap(SensorMechanism):
    """Empty for `capture_s` on average, full for `emission_s`, both exponential; full adds `size_g` or `size_dps`.

    Share of time full: emission_s / (capture_s + emission_s) (Machlup 1954). Reference: 12 mg or 0.4 dps.
    """

    size_g: float = 12e-3
    size_dps: float = 0.4
    capture_s: float = 4.0
    emission_s: float = 1.0

    resembles: ClassVar[tuple[str, ...]] = ("popcorn_noise",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A larger step."""
        return cls(size_g=cls.size_g * severity, size_dps=cls.size_dps * severity)

    def put_on(self, site: Site) -> None:
        """Act in the amplifier of an axis that is the part's own."""
        random, size = site.run_random("trap"), site.by_unit(self.size_g, self.size_dps)
        axis = int(site.unit_random("trap").integers(3))
        place = (float(axis == 0), float(axis == 1), float(axis == 2))
        full, due_ns = False, random.exponential(self.capture_s * 1e9)
        site.note(f"trap in axis {'xyz'[axis]}")

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            nonlocal full, due_ns
            while at_ns >= due_ns:
                full = not full
                due_ns += random.exponential((self.emission_s if full else self.capture_s) * 1e9)
            return plus(value, place, size) if full else value

        site.chain.sensed.append(sensed)
