"""The analogue chain of one sensor: element, noise, filter, converter, data register, poll by the host.

Everything up to the register runs on the chip's own clock, the poll on the host's. Stages are named in `STAGES`; an
effect is a function that changes the signal at its stage.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from tests.foreign_world.parts import SI, Array, Part, Sensor, noise_bandwidth, stream, white_rms
from tests.foreign_world.world import Experiment, World

STAGES = ("input", "element", "noise", "filter", "code", "clock", "poll")
"""Where an effect can act: on the true motion in the sensor's axes; on what the element gives; together with the noise;
after the chip's filter; on whole codes; on the moments of polling; on the rows of the log.
"""
MARGIN_S = 2.0
"""The chip runs before the log begins and after it ends."""
SELF_HEATING_S = 40.0
"""Time constant of a chip that warms itself."""

Integers = npt.NDArray[np.int64]


@dataclass
class Signal:
    """What is known of one sensor in one log at a stage.

    On the chip's clock (m samples): `time` s of the log, `temperature` of the element, `force` and `rate` (m, 3) SI in
    the sensor's axes, `value` (m, 3) SI, `chip_codes` (m, 3), and `hold`, the samples for which the register stays
    as it is. On rows (n): `stamp` times to be logged s, `poll` true moments s, `sample` index of the chip's sample,
    `analogue` (n, 3) counts before rounding, `codes` (n, 3), `keep` (n,).
    """

    world: World
    sensor: Sensor
    part: Part
    experiment: Experiment
    log: int
    time: Array
    temperature: Array
    force: Array
    rate: Array
    magnetic: Array
    value: Array = field(default_factory=lambda: np.zeros((0, 3)))
    chip_codes: Array = field(default_factory=lambda: np.zeros((0, 3)))
    poll: Array = field(default_factory=lambda: np.zeros(0))
    stamp: Array = field(default_factory=lambda: np.zeros(0))
    sample: Integers = field(default_factory=lambda: np.zeros(0, np.int64))
    analogue: Array = field(default_factory=lambda: np.zeros((0, 3)))
    codes: Array = field(default_factory=lambda: np.zeros((0, 3)))
    keep: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    thermometer: Array = field(default_factory=lambda: np.zeros(0))
    stale: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    hold: int = 1

    @property
    def felt(self) -> Array:
        """What this kind of sensor measures (m, 3), SI."""
        quantity = self.sensor.facts.quantity
        return {"specific_force": self.force, "angular_rate": self.rate}.get(quantity, self.magnetic)

    @felt.setter
    def felt(self, value: Array) -> None:
        if self.sensor.facts.quantity == "specific_force":
            self.force = value
        elif self.sensor.facts.quantity == "angular_rate":
            self.rate = value
        else:
            self.magnetic = value

    @property
    def rms(self) -> Array:
        """Typical noise of the output (3,), SI: what sizes are measured by."""
        return white_rms(self.sensor)

    @property
    def chip_rate_hz(self) -> float:
        return 1 / float(self.time[1] - self.time[0])

    @property
    def random_key(self) -> tuple[object, ...]:
        return self.world.key, self.sensor.name, self.experiment.name


Act = tuple[str, Callable[[Signal], None]]
"""A stage, and what happens there."""


def record(world: World, sensor: Sensor, log: int, acts: Iterable[Act] = (), *, noise: bool = True) -> Signal:
    """One sensor's rows of one log. `noise=False` leaves out the element's noise, for detection limits."""
    acts = tuple(acts)
    signal = begin(world, sensor, log)
    perform("input", acts, signal)
    element(signal)
    perform("element", acts, signal)
    if noise:
        add_noise(signal)
    perform("noise", acts, signal)
    if sensor.is_filtered:
        signal.value = low_passed(signal.value, signal.chip_rate_hz, sensor.bandwidth_hz, signal.part.filter_order)
    perform("filter", acts, signal)
    convert(signal)
    perform("code", acts, signal)
    schedule(signal)
    perform("clock", acts, signal)
    read_register(signal)
    perform("poll", acts, signal)
    return signal


def perform(stage: str, acts: tuple[Act, ...], signal: Signal) -> None:
    """Let all effects of a stage act."""
    for at, act in acts:
        if at == stage:
            act(signal)


def begin(world: World, sensor: Sensor, log: int) -> Signal:
    """The true motion at the chip's own moments, in the sensor's axes, at the sensor's place in the box."""
    experiment, part = world.experiments[log], world.parts[sensor.name]
    stimulus = experiment.stimulus
    step = 1 / (sensor.rate_hz * (1 + part.clock_error))
    phase = stream(world.key, sensor.name, experiment.name, "phase").uniform(0, step)
    time = np.arange(-MARGIN_S + phase, stimulus.duration_s + MARGIN_S, step)
    orientation = sensor.orientation
    place = np.array(sensor.position_mm) * 1e-3
    force = (
        stimulus.force
        + np.cross(stimulus.acceleration, place)
        + np.cross(stimulus.rate, np.cross(stimulus.rate, place))
    )

    def at_chip(columns: Array) -> Array:
        turned = columns @ orientation
        return np.stack([np.interp(time, stimulus.time_s, column) for column in turned.T], axis=1)

    age = np.maximum(time + experiment.warm_up_s, 0)
    box = np.interp(time, stimulus.time_s, stimulus.temperature)
    box = lagged(box, step, part.lag_s)
    temperature = box + part.self_heating_k * (1 - np.exp(-age / SELF_HEATING_S))
    zero = np.zeros((1, 3))
    is_gyro, is_mag = sensor.facts.quantity == "angular_rate", sensor.facts.quantity == "magnetic_field"
    return Signal(
        world,
        sensor,
        part,
        experiment,
        log,
        time,
        temperature,
        force=at_chip(force),
        rate=at_chip(stimulus.rate) if is_gyro else zero,
        magnetic=at_chip(stimulus.field) if is_mag else zero,
    )


def lagged(values: Array, step: float, constant: float) -> Array:
    """First-order lag, on a coarse grid: temperatures are slow."""
    stride = max(1, int(0.1 / step))
    coarse = values[::stride]
    share = 1 - np.exp(-stride * step / constant)
    result = np.empty_like(coarse)
    state = coarse[0]
    for index, value in enumerate(coarse):
        state += share * (value - state)
        result[index] = state
    return np.interp(np.arange(len(values)), np.arange(len(coarse)) * stride, result)


def element(signal: Signal) -> None:
    """Scale factor, misalignment, nonlinearity, bias, slopes with temperature, and the scatter between turn-ons."""
    part, full_scale = signal.part, signal.part.extra["full_scale"]
    warmth = (signal.temperature - 25.0)[:, None]
    value = signal.felt @ part.matrix.T
    share = value / full_scale
    value = value * (1 + part.scale + part.scale_slope * warmth)
    if part.quadratic.any():
        value = value + full_scale * (part.quadratic * share**2 + part.cubic * share**3)
    turn_on = stream(signal.world.key, signal.sensor.name, "turn-on", signal.experiment.power_cycle)
    signal.value = value + part.bias + part.bias_slope * warmth + turn_on.normal(0, 1, 3) * part.turn_on_sigma


def add_noise(signal: Signal) -> None:
    """White noise of the part's density at the chip's rate."""
    rng = stream(*signal.random_key, "noise")
    sigma = signal.part.noise_density * np.sqrt(signal.sensor.rate_hz / 2)
    signal.value = signal.value + rng.standard_normal(signal.value.shape) * sigma


def low_passed(value: Array, rate_hz: float, cutoff_hz: float, order: int) -> Array:
    """Butterworth low-pass of order 1 or 2, by its frequency response; the end runs smoothly into the start."""
    rows = len(value)
    ramp = max(64, int(2 * rate_hz / cutoff_hz))
    length = smooth_length(rows + ramp)
    share = np.linspace(0, 1, length - rows + 2)[1:-1, None]
    padded = np.vstack([value, value[-1] * (1 - share) + value[0] * share])
    s = 1j * np.fft.rfftfreq(length, 1 / rate_hz) / cutoff_hz
    response = 1 / (1 + s) if order == 1 else 1 / (1 + np.sqrt(2) * s + s * s)
    filtered: Array = np.fft.irfft(np.fft.rfft(padded, axis=0) * response[:, None], length, axis=0)[:rows]
    return filtered


def smooth_length(least: int) -> int:
    """The next number with no prime factor above 5."""
    best = 1 << (least - 1).bit_length()
    for fives in range(8):
        for threes in range(8):
            odd = 5**fives * 3**threes
            if odd < best:
                best = min(best, odd << max(0, (-(-least // odd) - 1).bit_length()))
    return best


def convert(signal: Signal) -> None:
    """The converter: rounds to codes and saturates at the ends of its span."""
    counts = signal.value * signal.sensor.counts_per_si
    signal.analogue = counts
    signal.chip_codes = np.clip(np.rint(counts), *code_span(signal.sensor))


def code_span(sensor: Sensor) -> tuple[int, int]:
    """Lowest and highest code; the ADXL345 has fewer bits in its lower ranges (ADX-46)."""
    facts = sensor.facts
    if sensor.chip == "adxl345":
        return -int(sensor.range * 256), int(sensor.range * 256) - 1
    return facts.code_low, facts.code_high


def schedule(signal: Signal) -> None:
    """When the host reads: frames on its own clock, some microseconds late, on a busy board milliseconds at times.

    All sensors of a frame share its delay.
    """
    recorder, sensor = signal.world.recorder, signal.sensor
    duration = signal.experiment.stimulus.duration_s
    frames = np.arange(0, int(duration * recorder.frame_rate_hz))
    rng = stream(signal.world.key, signal.experiment.name, "frames")
    late = np.abs(rng.normal(0, recorder.jitter_s, len(frames)))
    period = 1 / recorder.frame_rate_hz
    delays = np.where(
        rng.random(len(frames)) < recorder.delay_chance, rng.exponential(recorder.delay_s, len(frames)), 0
    )
    late = np.minimum(late + delays, 0.7 * period)
    slot = signal.world.sensors.index(sensor) * min(recorder.slot_s, 0.25 * period / len(signal.world.sensors))
    chosen = frames % sensor.divider == 0
    signal.stamp = (frames * period + late + slot)[chosen]
    signal.poll = signal.stamp * (1 + recorder.clock_error)


def read_register(signal: Signal) -> None:
    """The register holds the chip's last sample; where there was no newer one, the row is a repetition."""
    signal.sample = np.clip(np.searchsorted(signal.time, signal.poll, side="right") - 1, 0, len(signal.time) - 1)
    signal.codes = signal.chip_codes[signal.sample]
    signal.analogue = signal.analogue[signal.sample]
    signal.keep = np.ones(len(signal.stamp), bool)
    signal.stale = np.append(False, np.diff(signal.sample // signal.hold) == 0)
    signal.thermometer = thermometer(signal)


def thermometer(signal: Signal) -> Array:
    """Codes of the chip's own thermometer at each row; empty if it has none or the recorder does not log it."""
    part, rng = signal.part, stream(*signal.random_key, "thermometer")
    kind = signal.sensor.facts.thermometer
    if not kind or not signal.world.recorder.has_thermometers:
        return np.zeros(0)
    warm = signal.temperature[signal.sample]
    if kind == "bma180":  # BMA-63: 0.5 K per code, code 0 at 24 degC; the part's zero is off by up to 5 K
        kelvin = (warm - 24.0) * (1 + part.thermometer_slope) + part.thermometer_zero_k
        kelvin = kelvin + rng.normal(0, part.thermometer_noise_k, len(warm))
        return np.asarray(np.clip(np.rint(kelvin / 0.5), -128, 127), float)
    second = np.floor(signal.poll + MARGIN_S).astype(int)  # L3G-60: falls by 1 per kelvin, refreshed once a second
    first = np.searchsorted(signal.poll, second - MARGIN_S)
    noise = rng.normal(0, part.thermometer_noise_k, int(second[-1]) + 1)
    falling = part.thermometer_zero_k - warm[np.minimum(first, len(warm) - 1)] * (1 + part.thermometer_slope)
    return np.asarray(np.clip(np.rint(falling + noise[second]), -128, 127), float)


def output_rms(sensor: Sensor, part: Part) -> Array:
    """Closed form of the noise of a row (3,) in counts: density, filter, rounding."""
    analogue = part.noise_density * np.sqrt(noise_bandwidth(sensor, part.filter_order)) * sensor.sensitivity
    rms: Array = np.sqrt((analogue / SI[sensor.facts.unit]) ** 2 + 1 / 12)
    return rms
