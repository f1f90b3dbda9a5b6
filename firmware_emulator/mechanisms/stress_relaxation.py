"""The package gives way: small slips of the glue, now here, now there, whose sum wanders off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class StressRelaxation(SensorMechanism):
    """Slips at `slips_per_s` on each axis (Poisson), each of a size with Laplace's distribution of scale b.

    Variance grows by 2 b^2 `slips_per_s` a second: over times much longer than between slips a random walk of
    K = b sqrt(2 slips_per_s). Reference: K = 0.8 mg or 0.025 dps per sqrt(s).
    """

    slips_per_s: float = 2.0
    scale_g: float = 0.4e-3
    scale_dps: float = 0.0125

    resembles: ClassVar[tuple[str, ...]] = ("random_walk",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Larger slips."""
        return cls(scale_g=cls.scale_g * severity, scale_dps=cls.scale_dps * severity)

    def put_on(self, site: Site) -> None:
        """Each axis slips by itself."""
        random, scale = site.run_random("slips"), site.by_unit(self.scale_g, self.scale_dps)
        mean_ns = 1e9 / self.slips_per_s
        due_ns = [random.exponential(mean_ns) for _ in range(3)]
        moved = [0.0, 0.0, 0.0]

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            for axis in range(3):
                while at_ns >= due_ns[axis]:
                    due_ns[axis] += random.exponential(mean_ns)
                    moved[axis] += random.laplace(0.0, scale)
            return value[0] + moved[0], value[1] + moved[1], value[2] + moved[2]

        site.chain.sensed.append(sensed)
