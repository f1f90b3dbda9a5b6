"""The converter that sets the bias current has one bit that comes up either way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class BiasCurrentDac(SensorMechanism):
    """A bias-current bit that is set in a `share` of power-ups: all three axes move at once, by `step_g` or `step_dps`
    on average.

    As Gyro3 of the paper's Table 7, which came up in two states. Reference: 15 mg or 0.5 dps.
    """

    step_g: float = 15e-3
    step_dps: float = 0.5
    share: float = 0.4

    resembles: ClassVar[tuple[str, ...]] = ("bistable_bias",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A larger step."""
        return cls(step_g=cls.step_g * severity, step_dps=cls.step_dps * severity)

    def put_on(self, site: Site) -> None:
        """Shift each axis by the part's own amount."""
        if site.run_random("bias current").random() >= self.share:
            return
        site.note("came up in the other state")
        direction, step = site.direction("bias current"), site.by_unit(self.step_g, self.step_dps)

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            return plus(value, direction, step)

        site.chain.sensed.append(sensed)
