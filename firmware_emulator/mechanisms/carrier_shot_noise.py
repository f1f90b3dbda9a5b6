"""Shot noise: the front end counts charge carriers that come one by one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class CarrierShotNoise(SensorMechanism):
    """Two leakage currents of opposite sign, each `carriers` a conversion on average; each carrier moves the output.

    error = q (N1 - N2), N Poisson with mean `carriers`: variance 2 q^2 `carriers` (Schottky 1918). The charge step q is
    `step_g` or `step_dps`. Reference: 5 mg or 0.15 dps rms.
    """

    carriers: float = 8.0
    step_g: float = 1.25e-3
    step_dps: float = 0.0375

    resembles: ClassVar[tuple[str, ...]] = ("white_noise",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Larger currents: more carriers, each with the charge that it has."""
        return cls(carriers=cls.carriers * severity**2)

    def put_on(self, site: Site) -> None:
        """One pair of currents an axis."""
        random, step = site.run_random("carriers"), site.by_unit(self.step_g, self.step_dps)

        def noise(at_ns: int, value: Triple, rms: Triple, bandwidth_hz: float) -> Triple:
            a, b, c, d, e, f = random.poisson(self.carriers, 6).tolist()
            x, y, z = value
            return x + step * (a - b), y + step * (c - d), z + step * (e - f)

        site.chain.noise.append(noise)
