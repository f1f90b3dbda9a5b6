"""A fan beside the sensor spins up, again and again."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class SpinningMotor(SensorMechanism):
    """Every `cycle_s` the motor is switched on for three quarters of the time: f = F (1 - exp(-t / `spin_up_s`)).

    Its imbalance shakes with a (f / F)^2 sin p, p = 2 pi F (t - s (1 - exp(-t / s))), F = `speed_hz`, s = `spin_up_s`,
    a = `peak_g` or `peak_dps` on average of the axes. Reference: 15 mg or 0.5 dps at 23 Hz.
    """

    peak_g: float = 15e-3
    peak_dps: float = 0.5
    speed_hz: float = 23.0
    spin_up_s: float = 8.0
    cycle_s: float = 40.0

    @classmethod
    def at(cls, severity: float) -> Self:
        """A worse imbalance."""
        return cls(peak_g=cls.peak_g * severity, peak_dps=cls.peak_dps * severity)

    def wave(self, seconds: float) -> float:
        """The shaking in units of its largest, `seconds` after power-on."""
        since = seconds % self.cycle_s - self.cycle_s / 4
        if since <= 0:
            return 0.0
        risen = -math.expm1(-since / self.spin_up_s)
        return risen**2 * math.sin(2 * math.pi * self.speed_hz * (since - self.spin_up_s * risen))

    def put_on(self, site: Site) -> None:
        """Act along a direction of the place."""
        direction, peak = site.direction("motor"), site.by_unit(self.peak_g, self.peak_dps)

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            return plus(value, direction, peak * self.wave(at_ns * 1e-9))

        site.chain.sensed.append(sensed)
