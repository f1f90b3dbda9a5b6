"""What effects do to a signal of the chain, and where and when: waveforms that are added, and what is no sum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.foreign_world.chain import Signal, code_span, lagged, low_passed, record
from tests.foreign_world.parts import DPS, Array, G, Generator, rotation, stream

FORCE, RATE = "specific_force", "angular_rate"
REFERENCE = {FORCE: G, RATE: 100 * DPS}
"""The value at which a deviation that depends on the value is stated: 1 g, 100 dps."""
KELVIN = 10.0
"""The warming at which a deviation that depends on temperature is stated."""


@dataclass(frozen=True)
class When:
    """When an effect acts: `always`, `from` a moment of a log on, in some `logs`, during `stretches` or at `moments`
    (pairs of log and seconds; of a stretch two, its start and end).
    """

    kind: str
    logs: tuple[int, ...] = ()
    stretches: tuple[tuple[int, float, float], ...] = ()

    def weight(self, log: int, time: Array) -> Array:
        """1 where the effect acts, else 0."""
        if self.kind in ("always", "moments"):  # what acts at moments looks them up itself
            return np.ones(len(time))
        if self.kind == "logs":
            return np.full(len(time), float(log in self.logs))
        result = np.zeros(len(time))
        for at, start, end in self.stretches:
            if at == log:
                result[(time >= start) & (time < end)] = 1
            elif self.kind == "from" and log > at:
                result[:] = 1
        return result


@dataclass(frozen=True)
class Placement:
    """Where and when an effect acts. `key` is that of its random stream."""

    sensors: tuple[str, ...]
    axes: tuple[int, ...]
    when: When
    key: str

    def rng(self, *more: object) -> Generator:
        return stream(self.key, *more)

    def on_chip(self, signal: Signal) -> Array:
        """Where it acts (m, 3), on the chip's samples."""
        return self._columns(signal, signal.time)

    def on_rows(self, signal: Signal) -> Array:
        """Where it acts (n, 3), on the rows of the log."""
        return self._columns(signal, signal.poll)

    def _columns(self, signal: Signal, time: Array) -> Array:
        columns = np.zeros((len(time), 3))
        columns[:, list(self.axes)] = self.when.weight(signal.log, time)[:, None]
        return columns


Deed = Callable[[Signal, Placement, float], None]


def column(values: Array) -> Array:
    return values[:, None]


# Additive signals of the element: `waveform` gives (m,) or (m, 3) for size 1.
def additive(waveform: Callable[[Signal, Placement], Array]) -> Deed:
    def act(signal: Signal, place: Placement, size: float) -> None:
        shape = waveform(signal, place)
        signal.value = signal.value + size * (column(shape) if shape.ndim == 1 else shape) * place.on_chip(signal)

    return act


def on_rows(waveform: Callable[[Signal, Placement], Array]) -> Deed:
    """Additive after the register, in SI: the codes move as the converter's would have."""

    def act(signal: Signal, place: Placement, size: float) -> None:
        shape = waveform(signal, place)
        counts = size * signal.sensor.counts_per_si
        shift = counts * (column(shape) if shape.ndim == 1 else shape) * place.on_rows(signal)
        moved = signal.codes + np.rint(signal.analogue + shift) - np.rint(signal.analogue)
        signal.analogue = signal.analogue + shift
        signal.codes = np.clip(moved, *code_span(signal.sensor))

    return act


def vibration(signal: Signal, place: Placement) -> Array:
    rng = place.rng("line")
    rate = signal.world.recorder.frame_rate_hz / signal.sensor.divider
    return np.sin(2 * np.pi * rng.uniform(0.06, 0.45) * rate * signal.time + rng.uniform(0, 6))


def mains(signal: Signal, place: Placement) -> Array:
    rng = place.rng("line")
    hertz = float(rng.choice([50, 60, 100, 120])) * (1 + rng.uniform(-2e-4, 2e-4))
    return np.sin(2 * np.pi * hertz * signal.time + rng.uniform(0, 6))


def chirp(signal: Signal, place: Placement) -> Array:
    rng = place.rng("chirp")
    rate = signal.world.recorder.frame_rate_hz / signal.sensor.divider
    start, end, period = rng.uniform(0.02, 0.08) * rate, rng.uniform(0.25, 0.45) * rate, rng.uniform(15, 40)
    age = signal.time % period
    wave: Array = np.sin(2 * np.pi * (start * age + (end - start) * age**2 / (2 * period)))
    return wave


def coarse(signal: Signal, make: Callable[[Generator, int, float], Array], place: Placement, *keys: object) -> Array:
    """A slow random process, made at 50 Hz from the log's beginning and interpolated."""
    step = 0.02
    rows = int((signal.time[-1] - signal.time[0]) / step) + 2
    columns = make(place.rng(signal.experiment.name, *keys), rows, step)
    grid = signal.time[0] + step * np.arange(rows)
    if columns.ndim == 1:
        return np.interp(signal.time, grid, columns)
    return np.stack([np.interp(signal.time, grid, c) for c in columns.T], axis=1)


def walk(signal: Signal, place: Placement) -> Array:
    return coarse(
        signal, lambda rng, n, h: np.cumsum(rng.normal(0, np.sqrt(h), (n, 3)), axis=0), place, signal.sensor.name
    )


def flicker(signal: Signal, place: Placement) -> Array:
    def make(rng: Generator, rows: int, step: float) -> Array:
        frequency = np.fft.rfftfreq(2 * rows, step)[1:, None]
        spectrum = rng.normal(size=(rows, 3)) + 1j * rng.normal(size=(rows, 3))
        waves = np.fft.irfft(np.vstack([np.zeros((1, 3)), spectrum / np.sqrt(frequency)]), 2 * rows, axis=0)[:rows]
        result: Array = waves * np.sqrt(rows / step)
        return result / 2

    return coarse(signal, make, place, signal.sensor.name)


def telegraph(signal: Signal, place: Placement) -> Array:
    dwell = place.rng("dwell").uniform(2, 12)

    def make(rng: Generator, rows: int, step: float) -> Array:
        changes = np.cumsum(rng.random(rows) < step / dwell)
        return np.asarray((changes + rng.integers(2)) % 2, float)

    return coarse(signal, make, place, signal.sensor.name)


def supply(signal: Signal, place: Placement) -> Array:
    """The same ripple of the supply for every sensor, in units of each one's noise."""
    tau = place.rng("tau").uniform(0.05, 0.5)

    def make(rng: Generator, rows: int, step: float) -> Array:
        kernel = np.exp(-np.arange(0, 5 * tau, step) / tau)
        kernel /= np.sqrt(np.sum(kernel**2))
        return np.asarray(np.convolve(rng.normal(size=rows + len(kernel) - 1), kernel, "valid"), float)

    return np.asarray(coarse(signal, make, place) * signal.rms[0], float)


def constant(signal: Signal, place: Placement) -> Array:
    return np.ones(len(signal.time))


def creep(signal: Signal, place: Placement) -> Array:
    return np.asarray(np.log1p(np.maximum(signal.time, 0) / place.rng("creep").uniform(2, 8)), float)


def warmth(signal: Signal) -> Array:
    """Temperature over that of the log's beginning, in units of `KELVIN`."""
    return np.asarray((signal.temperature - signal.temperature[0]) / KELVIN, float)


def thermal_quadratic(signal: Signal, place: Placement) -> Array:
    return np.square(warmth(signal))


def thermal_lag(signal: Signal, place: Placement) -> Array:
    step = float(signal.time[1] - signal.time[0])
    behind = lagged(signal.temperature, step, float(place.rng("lag").uniform(30, 90)))
    return (behind - signal.temperature) / KELVIN


def share(signal: Signal) -> Array:
    """What is felt, in units of the quantity's reference value."""
    return signal.felt / REFERENCE[signal.sensor.facts.quantity]


def thermal_scale(signal: Signal, place: Placement) -> Array:
    return share(signal) * column((signal.temperature - 25) / KELVIN)


def quadratic(signal: Signal, place: Placement) -> Array:
    return np.square(share(signal))


def cubic(signal: Signal, place: Placement) -> Array:
    return share(signal) ** 3


def force_seen(signal: Signal, place: Placement) -> Array:
    """Specific force in g along an axis that the effect chooses, for a gyroscope."""
    return signal.force[:, int(place.rng("axis").integers(3))] / G


def bistable(signal: Signal, place: Placement) -> Array:
    cycle = signal.experiment.power_cycle
    cycles = sorted({e.power_cycle for e in signal.world.experiments})
    states = place.rng("states").random(len(cycles)) < 0.5
    if states.all() or not states.any():
        states[len(cycles) // 2] ^= True
    return np.full(len(signal.time), float(states[cycles.index(cycle)]) * signal.part.turn_on_sigma)


def turn_on(signal: Signal, place: Placement) -> Array:
    draw = place.rng("turn-on", signal.sensor.name, signal.experiment.power_cycle).normal(size=3)
    return np.broadcast_to(draw * signal.part.turn_on_sigma, (len(signal.time), 3))


def backlash(signal: Signal, place: Placement) -> Array:
    """What hangs behind when the input turns round: the play operator with a width of a quarter of the reference."""
    values, stride = share(signal), max(1, int(signal.chip_rate_hz / 20))
    inputs = values[::stride]
    state, held = inputs[0].copy(), np.empty_like(inputs)
    for index, value in enumerate(inputs):
        state = np.clip(state, value - 0.25, value + 0.25)
        held[index] = state
    grid = np.arange(len(inputs)) * stride
    at = np.arange(len(values))
    return np.stack([np.interp(at, grid, c) for c in (held - inputs).T], axis=1)


def interleave(signal: Signal, place: Placement) -> Array:
    return np.where(np.arange(len(signal.time)) % 2, 1.0, -1.0)


def white(signal: Signal, place: Placement) -> Array:
    return place.rng(*signal.random_key).standard_normal(signal.value.shape)


def growing_white(signal: Signal, place: Placement) -> Array:
    return white(signal, place) * column(np.clip(signal.time / signal.experiment.stimulus.duration_s, 0, 1))


def white_by_signal(signal: Signal, place: Placement) -> Array:
    strength: Array = np.abs(share(signal))
    return white(signal, place) * strength


def bursts(signal: Signal, place: Placement) -> Array:
    period = place.rng("period").uniform(0.7, 2)
    return white(signal, place) * column(np.where(signal.time % period < 0.07, 1.0, 0.0))


def lever(signal: Signal, place: Placement) -> Array:
    """Centripetal and tangential force for one metre along a direction across the axis of turning."""
    stimulus = signal.experiment.stimulus
    direction = place.rng("direction").normal(size=3)
    direction /= np.linalg.norm(direction)
    box = np.cross(stimulus.acceleration, direction) + np.cross(stimulus.rate, np.cross(stimulus.rate, direction))
    box = box @ signal.sensor.orientation
    return np.stack([np.interp(signal.time, stimulus.time_s, c) for c in box.T], axis=1)


def spikes(signal: Signal, place: Placement) -> Array:
    shape = np.zeros((len(signal.poll), 3))
    for log, start, _ in place.when.stretches:
        if log == signal.log:
            row = int(np.clip(np.searchsorted(signal.poll, start), 0, len(shape) - 1))
            shape[row] = place.rng("sign", start).choice([-1.0, 1.0], 3)
    return shape


def leak(signal: Signal, place: Placement) -> Array:
    """A share of what the sensor that is read before it has given, in SI of this one."""
    sensors = signal.world.inertial
    other = sensors[(sensors.index(signal.sensor) - 1) % len(sensors)]
    rows = record(signal.world, other, signal.log)
    values = np.stack([np.interp(signal.poll, rows.poll, c) for c in rows.codes.T], axis=1)
    return values / signal.sensor.counts_per_si


def read_phase(signal: Signal, place: Placement) -> Array:
    """A reading that follows a conversion closely is disturbed by it."""
    age = (signal.poll - signal.time[signal.sample]) * signal.chip_rate_hz
    return np.exp(-4 * np.clip(age, 0, 3))


def counter(signal: Signal, place: Placement) -> Array:
    period = int(place.rng("period").choice([64, 128, 256]))
    return np.where(np.arange(len(signal.poll)) % period < period // 8, 1.0, 0.0)


# What is no sum.
def low_pass(signal: Signal, place: Placement, size: float) -> None:
    cutoff = signal.world.recorder.frame_rate_hz / signal.sensor.divider / 2 / size
    filtered = low_passed(signal.value, signal.chip_rate_hz, cutoff, 1)
    signal.value = np.where(place.on_chip(signal) > 0, filtered, signal.value)


def coarse_codes(step: int) -> Deed:
    def act(signal: Signal, place: Placement, size: float) -> None:
        codes = np.floor(signal.chip_codes / step) * step
        signal.chip_codes = np.where(place.on_chip(signal) > 0, codes, signal.chip_codes)

    return act


def missing_codes(signal: Signal, place: Placement, size: float) -> None:
    hit = (signal.chip_codes % 8 == place.rng("code").integers(8)) & (place.on_chip(signal) > 0)
    signal.chip_codes = signal.chip_codes + hit


def clip(signal: Signal, place: Placement, size: float) -> None:
    """Nothing beyond a share of the largest value that the log has without it, counted from its median."""
    codes = signal.chip_codes
    middle = np.median(codes, axis=0)
    inside = (signal.time >= 0) & (signal.time <= signal.experiment.stimulus.duration_s)
    largest = size * np.abs(codes[inside] - middle).max(axis=0)
    clipped = np.clip(codes, middle - largest, middle + largest)
    signal.chip_codes = np.where(place.on_chip(signal) > 0, np.rint(clipped), codes)


def other_range(signal: Signal, place: Placement, size: float) -> None:
    sensor = signal.sensor
    ranges = [r for r in sensor.facts.sensitivity if r != sensor.range]
    factor = sensor.facts.sensitivity[ranges[int(place.rng("range").integers(len(ranges)))]] / sensor.sensitivity
    codes = np.clip(np.rint(signal.analogue * factor), *code_span(sensor))
    inside = column(place.when.weight(signal.log, signal.time)) > 0
    signal.chip_codes = np.where(inside, codes, signal.chip_codes)


def half_rate(signal: Signal, place: Placement, size: float) -> None:
    held = signal.chip_codes[: len(signal.chip_codes) // 2 * 2 : 2].repeat(2, axis=0)
    signal.chip_codes = np.vstack([held, signal.chip_codes[len(held) :]])
    signal.hold = 2


def felt_turned(matrix: Callable[[Placement, float], Array]) -> Deed:
    def act(signal: Signal, place: Placement, size: float) -> None:
        turned = signal.felt @ matrix(place, size).T
        inside = column(place.when.weight(signal.log, signal.time)) > 0
        signal.felt = np.where(inside, turned, signal.felt)

    return act


def swap(place: Placement, size: float) -> Array:
    order = [(0, 2, 1), (2, 1, 0), (1, 0, 2)][place.axes[0]]
    return np.eye(3)[list(order)]


def flip(place: Placement, size: float) -> Array:
    diagonal = np.ones(3)
    diagonal[list(place.axes)] = -1
    return np.diag(diagonal)


def more_scale(place: Placement, size: float) -> Array:
    diagonal = np.ones(3)
    diagonal[list(place.axes)] += size * float(place.rng("sign").choice([-1, 1]))
    return np.diag(diagonal)


def lean(place: Placement, size: float) -> Array:
    axis = place.rng("axis").normal(size=3)
    return rotation(axis / np.linalg.norm(axis), size)


def delay(signal: Signal, place: Placement, size: float) -> None:
    signal.poll = signal.poll - size * place.when.weight(signal.log, signal.poll)


def fast_clock(signal: Signal, place: Placement, size: float) -> None:
    signal.poll = signal.poll + size * signal.stamp * place.when.weight(signal.log, signal.poll)


def jitter(signal: Signal, place: Placement, size: float) -> None:
    late = np.abs(place.rng(signal.experiment.name).normal(0, size, len(signal.poll)))
    signal.poll = signal.poll - late * place.when.weight(signal.log, signal.poll)


def chosen_rows(signal: Signal, place: Placement, size: float) -> Array:
    """As many rows of the case as the size says, shared among the logs in which the effect acts."""
    weights = [place.when.weight(log, e.stimulus.time_s).sum() for log, e in enumerate(signal.world.experiments)]
    mean = size * weights[signal.log] / max(sum(weights), 1)
    rng = place.rng("rows", signal.experiment.name, signal.sensor.name)
    rows = np.flatnonzero(place.when.weight(signal.log, signal.poll)[1:]) + 1
    count = min(len(rows), int(mean) + int(rng.random() < mean % 1))
    return np.sort(rng.choice(rows, count, replace=False)) if count else np.zeros(0, int)


def drop(signal: Signal, place: Placement, size: float) -> None:
    signal.keep[chosen_rows(signal, place, size)] = False


def repeat(signal: Signal, place: Placement, size: float) -> None:
    for row in chosen_rows(signal, place, size):
        signal.codes[row], signal.analogue[row] = signal.codes[row - 1], signal.analogue[row - 1]


def hold(signal: Signal, place: Placement, size: float) -> None:
    for log, start, _ in place.when.stretches:
        if log == signal.log:
            first = int(np.searchsorted(signal.poll, start))
            last = int(np.searchsorted(signal.poll, start + size))
            axes = list(place.axes)
            signal.codes[first:last, axes] = signal.codes[first, axes]


def swap_sensors(signal: Signal, place: Placement, size: float) -> None:
    name = place.sensors[1 - place.sensors.index(signal.sensor.name)]
    other = next(sensor for sensor in signal.world.sensors if sensor.name == name)
    rows = record(signal.world, other, signal.log)
    inside = column(place.when.weight(signal.log, signal.poll)) > 0
    signal.codes = np.where(inside, rows.codes, signal.codes)


def skewed(signal: Signal, place: Placement, size: float) -> None:
    """The white noise is replaced by one of the same variance whose distribution has a tail to one side."""
    plain = stream(*signal.random_key, "noise").standard_normal(signal.value.shape)
    tailed = place.rng(*signal.random_key).exponential(1, signal.value.shape) - 1
    sigma = signal.part.noise_density * np.sqrt(signal.sensor.rate_hz / 2)
    signal.value = signal.value + sigma * (tailed - plain) * place.on_chip(signal)
