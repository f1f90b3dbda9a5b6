"""Mechanisms of an element's response: scale, linearity, cross-sensitivity, bandwidth and delay."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from firmware_emulator.chip import Triple
from firmware_emulator.element import applied, transposed
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import GYROSCOPES, Site, Stopwatch, plus
from firmware_emulator.world import STANDARD_GRAVITY, WorldStimulus, cross


@dataclass(frozen=True)
class ReferenceVoltage(SensorMechanism):
    """The converter's reference voltage is wrong: all codes, including bias and noise, are too small.

    code = input / (1 + `error`): the reference is too high by the share `error`. Reference size: 3 %.
    """

    error: float = 0.03

    resembles: ClassVar[tuple[str, ...]] = ("scale",)
    scaled: ClassVar[tuple[str, ...]] = ("error",)

    def put_on(self, site: Site) -> None:
        """Scale all axes alike, because they share the reference."""
        share = 1 / (1 + self.error)

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            return value[0] * share, value[1] * share, value[2] * share

        site.chain.amplified.append(amplified)


CLOSEST = 0.8


@dataclass(frozen=True)
class PlateGap(SensorMechanism):
    """A capacitor that is measured on one side: the gap between its plates decreases with the force.

    C = C0 / (1 - u): output = x / (1 - x / gap), where `gap_g` or `gap_dps` is the input that would close the gap.

    Differential plates cancel the even part; here one of the two is broken. Reference: 80 g (1 g reads 1.0127) or 8000
    dps.
    """

    gap_g: float = 80.0
    gap_dps: float = 8000.0

    resembles: ClassVar[tuple[str, ...]] = ("nonlinearity",)
    inverse: ClassVar[tuple[str, ...]] = ("gap_g", "gap_dps")

    def put_on(self, site: Site) -> None:
        """Act on each axis separately, with a stop that limits the movement of the plates."""
        gap = site.by_unit(self.gap_g, self.gap_dps)

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            x, y, z = (component / (1 - min(component / gap, CLOSEST)) for component in value)
            return x, y, z

        site.chain.sensed.append(sensed)


KNEE = 8


@dataclass(frozen=True)
class SoftClipping(SensorMechanism):
    """The output stage saturates below the full scale of the converter.

    output = x / (1 + |x / A|^8)^(1/8), A = `share` of the full scale: it is linear up to about 3/4 A and never exceeds
    A.

    Reference: half of the full scale, less as severity grows.
    """

    share: float = 0.5

    resembles: ClassVar[tuple[str, ...]] = ("saturation",)
    inverse: ClassVar[tuple[str, ...]] = ("share",)

    def put_on(self, site: Site) -> None:
        """Clip the sum of signal and noise."""

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            limit = self.share * full_scale
            x, y, z = (component / (1 + abs(component / limit) ** KNEE) ** (1 / KNEE) for component in value)
            return x, y, z

        site.chain.amplified.append(amplified)


@dataclass(frozen=True)
class DriveImbalance(SensorMechanism):
    """The mass of a gyroscope is not balanced about its drive axis.

    error = m x f: a pendulous mass with its lever m responds to the torque of the specific force f (IEEE Std 1431).

    m is `imbalance_dps_per_g` along each axis on average, f in g. Reference: 0.3 dps/g.
    """

    imbalance_dps_per_g: float = 0.3

    touches: ClassVar[tuple[str, ...]] = GYROSCOPES
    resembles: ClassVar[tuple[str, ...]] = ("g_sensitivity",)
    scaled: ClassVar[tuple[str, ...]] = ("imbalance_dps_per_g",)

    def put_on(self, site: Site) -> None:
        """Act along axes that depend on the part."""
        lever, from_box = site.direction("imbalance"), transposed(site.orientation)
        factor = self.imbalance_dps_per_g / STANDARD_GRAVITY

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            return plus(value, cross(lever, applied(from_box, stimulus.force_box)), factor)

        site.chain.sensed.append(sensed)


@dataclass(frozen=True)
class VibrationRectification(SensorMechanism):
    """Asymmetric stops: vibration with zero mean changes the mean of the output.

    error = c v^2, v^2 the variance of the force in g^2; variance and mean are both taken over `memory_s`.

    c is `per_g2_g` or `per_g2_dps`, averaged over the axes (IEEE Std 836). Reference: 0.3 g/g^2 or 10 dps/g^2: a part
    near its resonance.
    """

    per_g2_g: float = 0.3
    per_g2_dps: float = 10.0
    memory_s: float = 2.0
    scaled: ClassVar[tuple[str, ...]] = ("per_g2_g", "per_g2_dps")

    def put_on(self, site: Site) -> None:
        """Act along axes that depend on the part."""
        elapsed = Stopwatch()
        mean: Triple | None = None
        square = 0.0

        def variance(at_ns: int, stimulus: WorldStimulus) -> float:
            nonlocal mean, square
            seconds, force = elapsed(at_ns), stimulus.force_box
            mean = force if mean is None else mean
            share = seconds / (seconds + self.memory_s)
            deviation = plus(force, mean, -1.0)
            mean = plus(mean, deviation, share)
            square += (sum(component * component for component in deviation) / STANDARD_GRAVITY**2 - square) * share
            return square

        site.add("stops", self.per_g2_g, self.per_g2_dps, variance)


NOISE_BANDWIDTH = math.pi / (2 * math.sqrt(2))
"""Equivalent noise bandwidth of a second-order Butterworth filter divided by its cut-off: 1.11."""
Step = tuple[float, float, float, float]
FAR_S = 0.2
"""Longest interval between evaluations in normal polling, in s. A longer one contains the set-up of a chip; changes are
then assumed to be instantaneous.
"""


@dataclass(frozen=True)
class OutputFilter(SensorMechanism):
    """The bandwidth of the output filter is lower than the configured one: a second-order low-pass acts before the
    converter.

    Butterworth of second order at `cutoff_hz`: x'' + sqrt(2) w x' + w^2 x = w^2 u, w = 2 pi cutoff.

    White noise of density D gives x an rms of D sqrt(1.11 cutoff) and the autocorrelation exp(-a t) (cos a t + sin a
    t), a = w / sqrt(2); between two evaluations the state is propagated exactly. The stimulus is also filtered, exactly
    if it is linear between evaluations. After a longer time without evaluations, for example when a change of the range
    shifts the offset, it is assumed to have kept its last value. Reference: 20 Hz, narrower as severity grows.
    """

    cutoff_hz: float = 20.0

    resembles: ClassVar[tuple[str, ...]] = ("bandwidth",)
    inverse: ClassVar[tuple[str, ...]] = ("cutoff_hz",)

    @property
    def decay(self) -> float:
        """Return the magnitude of both the real and the imaginary part of the poles, per second."""
        return 2 * math.pi * self.cutoff_hz / math.sqrt(2)

    @property
    def delay_s(self) -> float:
        """Return the delay of a slow signal: sqrt(2) / w."""
        return 1 / self.decay

    def step(self, seconds: float) -> Step:
        """Return the transition matrix of (x, x') over this time, row by row, for an input of 0."""
        a = self.decay
        fade, cosine, sine = math.exp(-a * seconds), math.cos(a * seconds), math.sin(a * seconds)
        return fade * (cosine + sine), fade * sine / a, -2 * a * fade * sine, fade * (cosine - sine)

    def correlation(self, seconds: float) -> float:
        """Return the autocorrelation of the filtered noise."""
        return self.step(seconds)[0]

    def put_on(self, site: Site) -> None:
        """Filter signal and noise separately, which is equivalent to filtering their sum."""
        random = site.run_random("filter")
        site.chain.sensed.append(self._signal())
        # First in the list, because the noise of other mechanisms is added after the filter.
        site.chain.noise.insert(0, self._noise(lambda: float(random.standard_normal())))

    def _signal(self) -> Callable[[int, Triple, WorldStimulus], Triple]:
        elapsed = Stopwatch()
        state: list[tuple[float, float]] = []
        before: Triple = (0.0, 0.0, 0.0)

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
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
                lag = slope * self.delay_s  # the settled response to a ramp
                transient, faster = x - (old - lag), speed - slope
                state[axis] = new - lag + a * transient + b * faster, slope + c * transient + d * faster
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
        """Return the Cholesky factor (11, 21, 22) of the covariance that noise adds to (x, x') in `seconds`: it is P -
        F P F^T with P = diag(1, 2 a^2).
        """
        a, b, c, d = self.step(seconds)
        power = 2 * self.decay**2
        xx = max(0.0, 1 - a * a - b * b * power)
        xv = -a * c - b * d * power
        vv = max(0.0, power - c * c - d * d * power)
        first = math.sqrt(xx)
        across = xv / first if first > 0 else 0.0
        return first, across, math.sqrt(max(0.0, vv - across * across))


@dataclass(frozen=True)
class PipelineDelay(SensorMechanism):
    """A decimation filter with a long pipeline: the output is delayed.

    The output is that of the stimulus `delay_s` earlier: a group delay that the data sheet does not state.

    Reference: 20 ms.
    """

    delay_s: float = 0.02

    resembles: ClassVar[tuple[str, ...]] = ("skew",)
    scaled: ClassVar[tuple[str, ...]] = ("delay_s",)

    def put_on(self, site: Site) -> None:
        """Delay the stimulus except for the temperature, which is not filtered."""
        delay_ns, world = round(self.delay_s * 1e9), site.world

        def changed_stimulus(at_ns: int, stimulus: WorldStimulus) -> WorldStimulus:
            delayed = world(max(0, at_ns - delay_ns))
            if delayed is stimulus:
                return stimulus
            return delayed._replace(temperature_degc=stimulus.temperature_degc)

        site.chain.stimulus.append(changed_stimulus)
