"""Mains hum on the supply: a fundamental with harmonics, whose frequency the power stations let wander."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, Stopwatch, plus
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class MainsRipple(SensorMechanism):
    """error = s (sin p + h2 sin 2p + h3 sin 3p), dp/dt = 2 pi (`mains_hz` + w), with h2, h3 = `harmonics`.

    w wanders with `wander_hz` rms and a correlation time of `wander_s` (first-order Gauss-Markov; the European grid
    keeps within 20 mHz). s, `peak_g` or `peak_dps`, acts on each axis by the part's own sensitivity to its supply.
    Reference: 5 mg or 0.15 dps.
    """

    peak_g: float = 5e-3
    peak_dps: float = 0.15
    mains_hz: float = 50.0
    harmonics: tuple[float, float] = (0.3, 0.15)
    wander_hz: float = 0.02
    wander_s: float = 60.0

    resembles: ClassVar[tuple[str, ...]] = ("tone",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more ripple."""
        return cls(peak_g=cls.peak_g * severity, peak_dps=cls.peak_dps * severity)

    def put_on(self, site: Site) -> None:
        """The ripple reaches every axis in the same phase."""
        random, elapsed = site.run_random("mains"), Stopwatch()
        direction, peak = site.direction("mains"), site.by_unit(self.peak_g, self.peak_dps)
        phase, wander = random.uniform(0.0, 2 * math.pi), random.normal(0.0, self.wander_hz)
        second, third = self.harmonics

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            nonlocal phase, wander
            seconds = elapsed(at_ns)
            kept = math.exp(-seconds / self.wander_s)
            wander = wander * kept + self.wander_hz * math.sqrt(1 - kept * kept) * random.standard_normal()
            phase = (phase + 2 * math.pi * (self.mains_hz + wander) * seconds) % (2 * math.pi)
            wave = math.sin(phase) + second * math.sin(2 * phase) + third * math.sin(3 * phase)
            return plus(value, direction, peak * wave)

        site.chain.sensed.append(sensed)
