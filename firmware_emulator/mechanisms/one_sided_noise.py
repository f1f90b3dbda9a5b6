"""Noise that a rectifying contact lets through in one direction only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class OneSidedNoise(SensorMechanism):
    """Adds e - mean, e exponential with `mean_g` or `mean_dps`: variance mean^2, skewness 2.

    Reference: 8 mg or 0.25 dps.
    """

    mean_g: float = 8e-3
    mean_dps: float = 0.25

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more noise."""
        return cls(mean_g=cls.mean_g * severity, mean_dps=cls.mean_dps * severity)

    def put_on(self, site: Site) -> None:
        """Independent on each axis."""
        random, mean = site.run_random("rectifier"), site.by_unit(self.mean_g, self.mean_dps)

        def noise(at_ns: int, value: Triple, rms: Triple, bandwidth_hz: float) -> Triple:
            a, b, c = random.standard_exponential(3).tolist()
            return value[0] + mean * (a - 1), value[1] + mean * (b - 1), value[2] + mean * (c - 1)

        site.chain.noise.append(noise)
