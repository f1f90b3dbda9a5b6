"""The converter's reference is noisy: what is large comes out noisier than what is small."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class ReferenceNoise(SensorMechanism):
    """output = input / (1 + `share` n), n white and Gaussian, one for all axes of a conversion. Reference: 1.5 %."""

    share: float = 0.015

    @classmethod
    def at(cls, severity: float) -> Self:
        """A noisier reference."""
        return cls(share=cls.share * severity)

    def put_on(self, site: Site) -> None:
        """Axes are wrong together, each by its own size."""
        random = site.run_random("reference")

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            gain = 1 / max(0.5, 1 + self.share * random.standard_normal())
            return value[0] * gain, value[1] * gain, value[2] * gain

        site.chain.amplified.append(amplified)
