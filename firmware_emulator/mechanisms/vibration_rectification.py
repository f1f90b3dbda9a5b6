"""Asymmetric stops: shaking that has no mean gives the output one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, Stopwatch, plus
from firmware_emulator.world import STANDARD_GRAVITY, Stimulus


@dataclass(frozen=True)
class VibrationRectification(SensorMechanism):
    """error = c v^2, v^2 the mean square in g^2 of how far the force is from its own mean, both over `memory_s`.

    c is `per_g2_g` or `per_g2_dps` on average of the axes (IEEE Std 836). Reference: 0.3 g/g^2 or 10 dps/g^2: a part
    near its resonance.
    """

    per_g2_g: float = 0.3
    per_g2_dps: float = 10.0
    memory_s: float = 2.0

    @classmethod
    def at(cls, severity: float) -> Self:
        """Stops farther from symmetry."""
        return cls(per_g2_g=cls.per_g2_g * severity, per_g2_dps=cls.per_g2_dps * severity)

    def put_on(self, site: Site) -> None:
        """Act along axes of the part's own."""
        direction, factor = site.direction("stops"), site.by_unit(self.per_g2_g, self.per_g2_dps)
        elapsed = Stopwatch()
        mean: Triple | None = None
        square = 0.0

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            nonlocal mean, square
            seconds, force = elapsed(at_ns), stimulus.force_box
            mean = force if mean is None else mean
            share = seconds / (seconds + self.memory_s)
            away = plus(force, mean, -1.0)
            mean = plus(mean, away, share)
            square += (sum(component * component for component in away) / STANDARD_GRAVITY**2 - square) * share
            return plus(value, direction, factor * square)

        site.chain.sensed.append(sensed)
