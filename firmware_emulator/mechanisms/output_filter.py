"""The output filter passes less than its register says: a low-pass of second order before the converter."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, Stopwatch
from firmware_emulator.world import Stimulus

NOISE_BANDWIDTH = math.pi / (2 * math.sqrt(2))
"""Equivalent noise bandwidth of a second-order Butterworth filter by its cut-off: 1.11."""
Step = tuple[float, float, float, float]
FAR_S = 0.2
"""Looks further apart than that are those before and after a chip is set up: what changed did so at once."""


@dataclass(frozen=True)
class OutputFilter(SensorMechanism):
    """Butterworth of second order at `cutoff_hz`: x'' + sqrt(2) w x' + w^2 x = w^2 u, w = 2 pi cutoff.

    White noise of density D gives x an rms of D sqrt(1.11 cutoff) and the autocorrelation
    exp(-a t) (cos a t + sin a t), a = w / sqrt(2); between two looks the state is propagated exactly. The stimulus is
    filtered too, exactly so if it is straight between looks; over a longer time without any, as when another range
    shifts the offset, as what it is at its end. Reference: 20 Hz, narrower as severity grows.
    """

    cutoff_hz: float = 20.0

    resembles: ClassVar[tuple[str, ...]] = ("bandwidth",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A lower cut-off."""
        return cls(cutoff_hz=cls.cutoff_hz / severity)

    @property
    def decay(self) -> float:
        """Real and imaginary part of the poles, per second."""
        return 2 * math.pi * self.cutoff_hz / math.sqrt(2)

    @property
    def delay_s(self) -> float:
        """The delay of a slow signal: sqrt(2) / w."""
        return 1 / self.decay

    def step(self, seconds: float) -> Step:
        """Transition matrix of (x, x') over that time, row by row, for an input of 0."""
        a = self.decay
        fade, cosine, sine = math.exp(-a * seconds), math.cos(a * seconds), math.sin(a * seconds)
        return fade * (cosine + sine), fade * sine / a, -2 * a * fade * sine, fade * (cosine - sine)

    def correlation(self, seconds: float) -> float:
        """Autocorrelation of the noise that passes."""
        return self.step(seconds)[0]

    def put_on(self, site: Site) -> None:
        """Signal and noise through a filter each, which is the same as both through one."""
        random = site.run_random("filter")
        site.chain.sensed.append(self._signal())
        site.chain.noise.insert(0, self._noise(lambda: float(random.standard_normal())))  # others' noise comes later

    def _signal(self) -> Callable[[int, Triple, Stimulus], Triple]:
        elapsed = Stopwatch()
        state: list[tuple[float, float]] = []
        before: Triple = (0.0, 0.0, 0.0)

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            nonlocal before
            seconds = elapsed(at_ns)
            if not state:
                state.extend((component, 0.0) for component in value)
                before = value
            if seconds > FAR_S:
                before = value
            a, b, c, d = self.step(seconds)
            for axis, (old, new) in enumerate(zip(before, value, strict=True)):
                x, speed = state[axis]
                slope = (new - old) / seconds if seconds > 0 else 0.0
                behind = slope * self.delay_s  # what follows a straight line, once it has settled
                off, faster = x - (old - behind), speed - slope
                state[axis] = new - behind + a * off + b * faster, slope + c * off + d * faster
            before = value
            return state[0][0], state[1][0], state[2][0]

        return sensed

    def _noise(self, draw: Callable[[], float]) -> Callable[[int, Triple, Triple, float], Triple]:
        elapsed = Stopwatch()
        unit = [(draw(), draw() * math.sqrt(2) * self.decay) for _ in range(3)]  # of variance 1
        steps: dict[float, tuple[Step, Triple]] = {}

        def noise(at_ns: int, value: Triple, rms: Triple, bandwidth_hz: float) -> Triple:
            seconds = elapsed(at_ns)
            if seconds not in steps:
                steps[seconds] = self.step(seconds), self.innovation(seconds)
            (a, b, c, d), (first, across, second) = steps[seconds]
            for axis, (x, speed) in enumerate(unit):
                draws = draw(), draw()
                unit[axis] = (
                    a * x + b * speed + first * draws[0],
                    c * x + d * speed + across * draws[0] + second * draws[1],
                )
            share = math.sqrt(min(1.0, NOISE_BANDWIDTH * self.cutoff_hz / bandwidth_hz))
            return rms[0] * share * unit[0][0], rms[1] * share * unit[1][0], rms[2] * share * unit[2][0]

        return noise

    def innovation(self, seconds: float) -> Triple:
        """Cholesky factor (11, 21, 22) of what noise adds to (x, x') in that time: P - F P F^T, P = diag(1, 2 a^2)."""
        a, b, c, d = self.step(seconds)
        power = 2 * self.decay**2
        xx = max(0.0, 1 - a * a - b * b * power)
        xv = -a * c - b * d * power
        vv = max(0.0, power - c * c - d * d * power)
        first = math.sqrt(xx)
        across = xv / first if first > 0 else 0.0
        return first, across, math.sqrt(max(0.0, vv - across * across))
