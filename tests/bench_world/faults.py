"""What can be wrong with a sensor, each as a frozen dataclass that overrides the place of the chain where it acts.

The places, in the order of the chain (`tests.bench_world.chain`): `start`, `clock_hz`, `sampled_at`, `place`, `warm`,
`distort`, `respond`, `modulate`, `disturb`, `ripple`, `encode`, `read`. Parameters are in the unit of the sensor: g or
dps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tests.bench_world.chips import Array
from tests.bench_world.filters import lag
from tests.bench_world.noise import PowerLaw, draw_noise
from tests.bench_world.rotation import RADIANS, matrix_of
from tests.bench_world.samples import AFTER_LOSS, Readings, Samples

Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of one sensor: the axes that have it ("" if it is none of one axis), from when it acts, its size in
    words.
    """

    effect: ClassVar[str]
    sensor: str
    axes: str = "xyz"
    since: str = "always"
    size: str

    @property
    def axis(self) -> int:
        """The number of its axis."""
        return "xyz".index(self.axes)

    def start(self, bias: Array, log: int) -> Array:
        """Return the bias (3,) that this log begins with."""
        return bias

    def clock_hz(self, rate_hz: float) -> float:
        """Return the nominal rate of the chip's samples."""
        return rate_hz

    def sampled_at(self, time_s: Array) -> Array:
        """Return the times (n,) s whose motion the samples have."""
        return time_s

    def place(self, position_m: Array) -> Array:
        """Return where (3,) the sensing element is, in m."""
        return position_m

    def warm(self, temperature_c: Array, step_s: float) -> Array:
        """Return the temperature (m,) that the bias follows, of that of the chip."""
        return temperature_c

    def distort(self, matrix: Array) -> Array:
        """Return the matrix (3, 3) of scale and axes."""
        return matrix

    def respond(self, samples: Samples) -> Array | float:
        """Return what it adds (n, 3) to the response to motion."""
        return 0.0

    def modulate(self, noise: Array, samples: Samples, stream: np.random.Generator) -> Array:
        """Return the white noise (n, 3)."""
        return noise

    def disturb(self, samples: Samples, stream: np.random.Generator) -> Array | float:
        """Return what it adds (n, 3) in front of the filter."""
        return 0.0

    def ripple(self, samples: Samples, stream: np.random.Generator) -> Array | float:
        """Return what it adds (n, 3) behind the filter."""
        return 0.0

    def encode(self, codes: Array, values: Array, samples: Samples) -> Array:
        """Return the codes (n, 3), before they are limited to the span of the chip."""
        return codes

    def read(self, readings: Readings, samples: Samples, stream: np.random.Generator) -> Readings:
        """Return what the recorder gets."""
        return readings

    def _on_axis(self, values: Array) -> Array:
        added = np.zeros((len(values), 3))
        added[:, self.axis] = values
        return added


@dataclass(frozen=True, kw_only=True)
class BistableBias(Fault):
    """The bias has one of two states from one switching on to the next; `states` are those of the logs."""

    effect = "bistable_bias"
    jump: Vector
    states: tuple[int, ...]

    def start(self, bias: Array, log: int) -> Array:
        return bias + np.array(self.jump) if self.states[log] else bias


@dataclass(frozen=True, kw_only=True)
class RateError(Fault):
    """The chip samples at another rate than it is configured for."""

    effect = "odr_error"
    rate_hz: float

    def clock_hz(self, rate_hz: float) -> float:
        return self.rate_hz


@dataclass(frozen=True, kw_only=True)
class Skew(Fault):
    """The samples are late."""

    effect = "skew"
    delay_s: float

    def sampled_at(self, time_s: Array) -> Array:
        return time_s - self.delay_s


@dataclass(frozen=True, kw_only=True)
class SizeEffect(Fault):
    """The sensor is not where the configuration says."""

    effect = "size_effect"
    shift_mm: Vector

    def place(self, position_m: Array) -> Array:
        return position_m + np.array(self.shift_mm) / 1000


@dataclass(frozen=True, kw_only=True)
class ThermalLag(Fault):
    """The bias follows the temperature of the chip late."""

    effect = "thermal_lag"
    lag_s: float

    def warm(self, temperature_c: Array, step_s: float) -> Array:
        return lag(temperature_c, step_s, self.lag_s)


@dataclass(frozen=True, kw_only=True)
class Misalignment(Fault):
    """The chip is turned about its own axes."""

    effect = "misalignment"
    rotation_deg: Vector

    def distort(self, matrix: Array) -> Array:
        return matrix @ matrix_of(np.array(self.rotation_deg) * RADIANS)


@dataclass(frozen=True, kw_only=True)
class Scale(Fault):
    """The scale factors are wrong by a share."""

    effect = "scale"
    share: Vector

    def distort(self, matrix: Array) -> Array:
        return np.asarray(matrix * (1 + np.array(self.share))[:, None])


@dataclass(frozen=True, kw_only=True)
class ThermalScale(Fault):
    """The scale factors change with the temperature."""

    effect = "thermal_scale"
    per_k: Vector

    def respond(self, samples: Samples) -> Array:
        return samples.value * (np.array(self.per_k) * samples.warmth_k[:, None])


@dataclass(frozen=True, kw_only=True)
class Nonlinearity(Fault):
    """The response has a cubic term, per unit²."""

    effect = "nonlinearity"
    cubic: float

    def respond(self, samples: Samples) -> Array:
        return self._on_axis(self.cubic * samples.value[:, self.axis] ** 3)


@dataclass(frozen=True, kw_only=True)
class ForceSensitivity(Fault):
    """A gyroscope responds to force, in dps per g."""

    effect = "g_sensitivity"
    matrix: tuple[Vector, Vector, Vector]

    def respond(self, samples: Samples) -> Array:
        return np.asarray(samples.force_g @ np.array(self.matrix).T)


@dataclass(frozen=True, kw_only=True)
class PackageRelaxation(Fault):
    """The bias creeps after a change of force, as if the package relaxed. No library of causes has it."""

    effect = "package_relaxation"
    g_per_g: float
    time_constant_s: float

    def respond(self, samples: Samples) -> Array:
        force_g = samples.force_g[:, self.axis]
        step = max(1, int(samples.rate_hz / 50))
        slow = lag(force_g[::step], step / samples.rate_hz, self.time_constant_s)
        return self._on_axis(self.g_per_g * (np.interp(samples.time_s, samples.time_s[::step], slow) - force_g))


@dataclass(frozen=True, kw_only=True)
class BurstNoise(Fault):
    """The noise is louder in bursts. No library of causes has it."""

    effect = "burst_noise"
    factor: float
    length_s: float
    every_s: float

    def modulate(self, noise: Array, samples: Samples, stream: np.random.Generator) -> Array:
        loud = np.zeros(len(noise), bool)
        start_s = stream.uniform(2, self.every_s)
        while start_s < samples.duration_s:
            loud |= (samples.time_s >= start_s) & (samples.time_s < start_s + self.length_s)
            start_s += stream.uniform(0.6, 1.4) * self.every_s
        return noise + self._on_axis(np.where(loud, (self.factor - 1) * noise[:, self.axis], 0))


@dataclass(frozen=True, kw_only=True)
class BiasInstability(Fault):
    """Noise with a 1/f spectrum that equals the white noise at the corner."""

    effect = "bias_instability"
    corner_hz: float

    def disturb(self, samples: Samples, stream: np.random.Generator) -> Array:
        density = samples.noise[self.axis] ** 2 * 2 / samples.rate_hz
        law = PowerLaw(1, density, self.corner_hz)
        return self._on_axis(draw_noise(law, len(samples.time_s), samples.rate_hz, stream))


@dataclass(frozen=True, kw_only=True)
class RandomWalk(Fault):
    """The bias walks at random, in units per sqrt(s)."""

    effect = "random_walk"
    per_sqrt_s: float

    def disturb(self, samples: Samples, stream: np.random.Generator) -> Array:
        steps = stream.normal(0, self.per_sqrt_s / np.sqrt(samples.rate_hz), len(samples.time_s))
        return self._on_axis(np.cumsum(steps))


@dataclass(frozen=True, kw_only=True)
class PopcornNoise(Fault):
    """The bias jumps between two states, and stays in each for an exponential time."""

    effect = "popcorn_noise"
    step: float
    dwell_s: float

    def disturb(self, samples: Samples, stream: np.random.Generator) -> Array:
        state, start_s, states = 0, 0.0, np.zeros(len(samples.time_s))
        while start_s < samples.duration_s:
            end_s = start_s + stream.exponential(self.dwell_s)
            states[(samples.time_s >= start_s) & (samples.time_s < end_s)] = state
            state, start_s = 1 - state, end_s
        return self._on_axis(self.step * states)


@dataclass(frozen=True, kw_only=True)
class SweptTone(Fault):
    """A sine whose frequency rises over the log. No library of causes has it."""

    effect = "swept_tone"
    amplitude: float
    from_hz: float
    to_hz: float

    def disturb(self, samples: Samples, stream: np.random.Generator) -> Array:
        chirp_hz = (self.to_hz - self.from_hz) * samples.time_s / 2 / samples.duration_s
        return self._on_axis(self.amplitude * np.sin(2 * np.pi * (self.from_hz + chirp_hz) * samples.time_s))


@dataclass(frozen=True, kw_only=True)
class Tone(Fault):
    """A sine behind the filter, as a ripple of the supply makes it."""

    effect = "tone"
    frequency_hz: float
    amplitude: Vector

    def ripple(self, samples: Samples, stream: np.random.Generator) -> Array:
        phase = 2 * np.pi * self.frequency_hz * samples.time_s + stream.uniform(0, 6)
        return np.outer(np.sin(phase), self.amplitude)


@dataclass(frozen=True, kw_only=True)
class RangeReset(Fault):
    """From a moment on the chip has another range, `codes_per_g`, and another zero (BMA-79)."""

    effect = "range_reset"
    codes_per_g: float
    onset_s: float
    shift_g: Vector

    def encode(self, codes: Array, values: Array, samples: Samples) -> Array:
        reset = np.rint((values + np.array(self.shift_g)) * self.codes_per_g)
        return np.where((samples.time_s >= self.onset_s)[:, None], reset, codes)


@dataclass(frozen=True, kw_only=True)
class Saturation(Fault):
    """An axis clips before the end of its range."""

    effect = "saturation"
    limit: float

    def encode(self, codes: Array, values: Array, samples: Samples) -> Array:
        limit = self.limit * samples.sensor.sensitivity
        clipped = codes.copy()
        clipped[:, self.axis] = np.clip(codes[:, self.axis], -limit, limit)
        return clipped


@dataclass(frozen=True, kw_only=True)
class AxisError(Fault):
    """Axes are exchanged or have the wrong sign."""

    effect = "axis_error"
    order: tuple[int, int, int]
    sign: tuple[int, int, int]

    def encode(self, codes: Array, values: Array, samples: Samples) -> Array:
        return np.asarray(codes[:, list(self.order)] * np.array(self.sign))


@dataclass(frozen=True, kw_only=True)
class Quantisation(Fault):
    """Only multiples of a code are given."""

    effect = "quantisation"
    step: int

    def encode(self, codes: Array, values: Array, samples: Samples) -> Array:
        return np.asarray(np.floor(codes / self.step) * self.step)


@dataclass(frozen=True, kw_only=True)
class Glitches(Fault):
    """Single rows jump, by 0.7 to 1.3 times `jump_g` either way."""

    effect = "glitches"
    share: float
    jump_g: float

    def read(self, readings: Readings, samples: Samples, stream: np.random.Generator) -> Readings:
        count = len(readings.time_s)
        rows = stream.choice(count, max(1, int(self.share * count)), replace=False)
        jump = self.jump_g * samples.sensor.sensitivity * stream.choice([-1, 1], len(rows))
        codes = readings.codes.copy()
        codes[rows, self.axis] += np.rint(jump * stream.uniform(0.7, 1.3, len(rows)))
        return replace(readings, codes=np.clip(codes, *samples.sensor.code_span))


@dataclass(frozen=True, kw_only=True)
class Stuck(Fault):
    """An axis repeats one code from a moment on."""

    effect = "stuck"
    onset_s: float

    def read(self, readings: Readings, samples: Samples, stream: np.random.Generator) -> Readings:
        first = np.searchsorted(readings.time_s, self.onset_s)
        codes = readings.codes.copy()
        codes[first:, self.axis] = codes[first, self.axis]
        return replace(readings, codes=codes)


@dataclass(frozen=True, kw_only=True)
class DroppedSamples(Fault):
    """A share of the rows is missing; the row after each says so."""

    effect = "dropped_samples"
    share: float

    def read(self, readings: Readings, samples: Samples, stream: np.random.Generator) -> Readings:
        dropped = stream.random(len(readings.time_s)) < self.share
        dropped[0] = False
        status = readings.status.copy()
        status[1:][dropped[:-1]] |= AFTER_LOSS
        kept = ~dropped
        return Readings(readings.time_s[kept], readings.sample[kept], readings.codes[kept], status[kept])
