"""A decimation filter with a long pipeline: what comes out went in a while ago."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class PipelineDelay(SensorMechanism):
    """The chip feels the world as it was `delay_s` ago: a group delay that its data sheet is silent about.

    Reference: 20 ms.
    """

    delay_s: float = 0.02

    resembles: ClassVar[tuple[str, ...]] = ("skew",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A longer pipeline."""
        return cls(delay_s=cls.delay_s * severity)

    def put_on(self, site: Site) -> None:
        """Heat comes from the world as it is now: it does not go through the filter."""
        delay_ns, world = round(self.delay_s * 1e9), site.world

        def felt(at_ns: int, stimulus: Stimulus) -> Stimulus:
            before = world(max(0, at_ns - delay_ns))
            if before is stimulus:
                return stimulus
            return before._replace(temperature_degc=stimulus.temperature_degc)

        site.chain.felt.append(felt)
