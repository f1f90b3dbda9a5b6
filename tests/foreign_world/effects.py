"""What can be wrong with an array beyond its data sheets, each a small function of the chain's signal.

`EFFECTS` tells of each effect: the name that the project's vocabulary has for it (None: it has none), at which stage of
the chain it acts, which experiments can show it, when it can act, and by which kind of limit its size is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from tests.foreign_world.chain import Act, Signal, code_span, lagged, low_passed, record
from tests.foreign_world.parts import DPS, SI, Array, G, Generator, rotation, stream
from tests.foreign_world.stimulus import GRID_HZ

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
    return np.sin(2 * np.pi * (start * age + (end - start) * age**2 / (2 * period)))


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
        return (np.cumsum(rng.random(rows) < step / dwell) + rng.integers(2)) % 2.0

    return coarse(signal, make, place, signal.sensor.name)


def supply(signal: Signal, place: Placement) -> Array:
    """The same ripple of the supply for every sensor, in units of each one's noise."""
    tau = place.rng("tau").uniform(0.05, 0.5)

    def make(rng: Generator, rows: int, step: float) -> Array:
        kernel = np.exp(-np.arange(0, 5 * tau, step) / tau)
        return np.convolve(rng.normal(size=rows + len(kernel) - 1), kernel / np.linalg.norm(kernel), "valid")

    return coarse(signal, make, place) * signal.rms[0]


def constant(signal: Signal, place: Placement) -> Array:
    return np.ones(len(signal.time))


def creep(signal: Signal, place: Placement) -> Array:
    return np.log1p(np.maximum(signal.time, 0) / place.rng("creep").uniform(2, 8))


def warmth(signal: Signal) -> Array:
    """Temperature over that of the log's beginning, in units of `KELVIN`."""
    return (signal.temperature - signal.temperature[0]) / KELVIN


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
    return white(signal, place) * np.abs(share(signal))


def bursts(signal: Signal, place: Placement) -> Array:
    period = place.rng("period").uniform(0.7, 2)
    return white(signal, place) * column((signal.time % period < 0.07) * 1.0)


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
    return (np.arange(len(signal.poll)) % period < period // 8) * 1.0


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
    """Nothing beyond a share of the largest value that the log has without it, counted from the middle of its values."""
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


@dataclass(frozen=True)
class Effect:
    """What the generator knows of an effect.

    `design_name` is its name in the vocabulary, None for one that has none. `shows` maps a quantity to the sets of
    experiments of which one suffices to show it. `limit`: `matched`, `energy` and `spectrum` are explained in
    `severity`; `tolerance`: `start` is the tolerance; `count`: `start` events are the limit; `fixed`: it has no size but `start`.
    Where `limit` is of the noise, `start` is where the search begins, in rms of the noise if the unit is SI.
    """

    design_name: str | None
    stage: str
    act: Deed
    whens: tuple[str, ...]
    limit: str
    start: float
    shows: Mapping[str, tuple[frozenset[str], ...]]
    unit: str = "SI"
    span: str = "axis"
    chips: tuple[str, ...] = ("bma180", "adxl345", "l3g4200d")
    least: float = 0.0
    notes: tuple[str, ...] = field(default=())

    def acts(self, place: Placement, size: float) -> dict[str, list[Act]]:
        """The effect, at this place and size, for each sensor that it concerns."""
        return {name: [(self.stage, lambda signal: self.act(signal, place, size))] for name in place.sensors}


def _any(*sets: str) -> dict[str, tuple[frozenset[str], ...]]:
    """Each text names experiments that together show the effect: "heating tumble"."""
    alternatives = tuple(frozenset(text.split()) for text in sets)
    return {FORCE: alternatives, RATE: alternatives}


ALL = _any("static", "tumble", "heating", "turn_on", "motion")
STILL = _any("static", "heating")
LONG = ("always", "from", "logs", "stretches")
MOVED = {FORCE: (frozenset({"tumble"}),), RATE: (frozenset({"motion"}),)}
MOTION = _any("motion")
SENSOR, PAIR, ARRAY = "sensor", "pair", "array"

EFFECTS: dict[str, Effect] = {
    "low_passed_output": Effect(
        "bandwidth",
        "filter",
        low_pass,
        ("always", "logs", "from"),
        "spectrum",
        2.0,
        ALL,
        "half poll rate over cut-off",
        SENSOR,
    ),
    "vibration_line": Effect("tone", "element", additive(vibration), LONG, "matched", 0.1, STILL),
    "mains_alias": Effect("tone", "element", additive(mains), LONG, "matched", 0.1, STILL),
    "repeated_samples": Effect("stale_samples", "poll", repeat, ("always", "from"), "count", 3, ALL, "rows", SENSOR),
    "even_codes": Effect(
        "quantisation", "code", coarse_codes(2), ("always", "logs", "from"), "fixed", 2, ALL, "codes", SENSOR
    ),
    "codes_in_fours": Effect("quantisation", "code", coarse_codes(4), ("always", "logs"), "fixed", 4, ALL, "codes"),
    "missing_codes": Effect("quantisation", "code", missing_codes, ("always",), "fixed", 1, ALL, "codes", SENSOR),
    "supply_noise": Effect(
        "common_mode", "element", additive(supply), ("always", "from"), "energy", 0.1, STILL, "rms", PAIR
    ),
    "held_readings": Effect("stuck", "poll", hold, ("moments",), "count", 5, ALL, "s", SENSOR),
    "dropped_rows": Effect("dropped_samples", "poll", drop, ("always", "from"), "count", 3, ALL, "rows", SENSOR),
    "scale_beyond_tolerance": Effect(
        "scale", "input", felt_turned(more_scale), ("always",), "tolerance", 0.02, MOVED, "1"
    ),
    "scale_step": Effect("scale", "input", felt_turned(more_scale), ("from",), "tolerance", 0.02, MOTION, "1"),
    "leaning_axes": Effect(
        "misalignment", "input", felt_turned(lean), ("always",), "tolerance", 1.0 * DPS, MOVED, "rad", SENSOR
    ),
    "swapped_axes": Effect("axis_error", "input", felt_turned(swap), ("always",), "fixed", 1, MOVED, "1"),
    "flipped_axis": Effect("axis_error", "input", felt_turned(flip), ("always",), "fixed", 1, MOVED, "1"),
    "quadratic_response": Effect("nonlinearity", "element", additive(quadratic), ("always",), "matched", 0.1, MOVED),
    "cubic_response": Effect(
        "nonlinearity",
        "element",
        additive(cubic),
        ("always",),
        "matched",
        0.1,
        {RATE: (frozenset({"motion"}),)},
        chips=("l3g4200d",),
    ),
    "quadratic_thermal_bias": Effect(
        "thermal_bias", "element", additive(thermal_quadratic), ("always",), "matched", 0.1, _any("heating")
    ),
    "lagging_thermal_bias": Effect(
        "thermal_lag", "element", additive(thermal_lag), ("always",), "matched", 0.3, _any("heating")
    ),
    "random_walk": Effect(
        "random_walk", "element", additive(walk), ("always",), "energy", 0.02, STILL, "SI per sqrt(s)"
    ),
    "flicker": Effect("bias_instability", "element", additive(flicker), ("always",), "energy", 0.1, STILL),
    "telegraph": Effect("popcorn_noise", "element", additive(telegraph), ("always", "from"), "matched", 0.2, STILL),
    "bistable_turn_on": Effect(
        "bistable_bias", "element", additive(bistable), ("always",), "tolerance", 1.0, _any("turn_on"), "turn-on sigma"
    ),
    "scattered_turn_on": Effect(
        "turn_on_bias",
        "element",
        additive(turn_on),
        ("always",),
        "tolerance",
        1.0,
        _any("turn_on"),
        "turn-on sigma",
        SENSOR,
    ),
    "clipping": Effect(
        "saturation", "code", clip, ("always",), "fixed", 0.7, MOTION, "share of the largest value", chips=("l3g4200d",)
    ),
    "spikes": Effect("glitches", "poll", on_rows(spikes), ("moments",), "matched", 5, ALL),
    "delayed_sensor": Effect(
        "skew", "clock", delay, ("always", "logs"), "matched", 0.005, {RATE: MOTION[RATE]}, "s", SENSOR, ("l3g4200d",)
    ),
    "fast_host_clock": Effect(
        "clock_error",
        "clock",
        fast_clock,
        ("always",),
        "matched",
        3e-4,
        {RATE: MOTION[RATE]},
        "1",
        ARRAY,
        ("l3g4200d",),
        1e-4,
    ),
    "late_stamps": Effect(
        "jitter", "clock", jitter, ("always",), "energy", 0.003, {RATE: MOTION[RATE]}, "s", SENSOR, ("l3g4200d",)
    ),
    "other_range": Effect(
        "range_reset", "code", other_range, ("from", "logs"), "fixed", 1, ALL, "1", SENSOR, ("bma180", "l3g4200d")
    ),
    "half_data_rate": Effect(
        "odr_error", "code", half_rate, ("always",), "fixed", 2, ALL, "1", SENSOR, ("adxl345", "l3g4200d")
    ),
    "force_in_gyro": Effect(
        "g_sensitivity",
        "element",
        additive(force_seen),
        ("always",),
        "matched",
        0.1,
        {RATE: (frozenset({"tumble"}),)},
        chips=("l3g4200d",),
    ),
    "thermal_scale": Effect(
        "thermal_scale",
        "element",
        additive(thermal_scale),
        ("always",),
        "matched",
        0.1,
        {FORCE: (frozenset({"heating", "tumble"}),), RATE: (frozenset({"heating", "motion"}),)},
    ),
    "excess_noise": Effect(
        "white_noise", "element", additive(white), ("from", "logs", "stretches"), "energy", 0.5, ALL
    ),
    "bias_step": Effect("bias", "element", additive(constant), ("from", "stretches"), "matched", 0.2, STILL),
    "swapped_sensors": Effect("channel_swap", "poll", swap_sensors, ("from", "logs"), "fixed", 1, ALL, "1", "twins"),
    "displaced_sensor": Effect(
        "size_effect",
        "element",
        additive(lever),
        ("always",),
        "matched",
        1.0,
        {FORCE: MOTION[FORCE]},
        "m",
        SENSOR,
        ("bma180", "adxl345"),
    ),
    # Nobody's library is likely to name the following.
    "creep_after_power_on": Effect(None, "element", additive(creep), ("always",), "matched", 0.2, STILL),
    "noise_with_signal": Effect(
        None, "element", additive(white_by_signal), ("always",), "energy", 0.5, MOVED, span=SENSOR
    ),
    "interleaved_converters": Effect(
        None, "filter", additive(interleave), ("always", "from"), "matched", 0.1, ALL, span=SENSOR
    ),
    "chirp": Effect(None, "element", additive(chirp), ("always", "stretches"), "matched", 0.1, STILL),
    "skewed_noise": Effect(None, "noise", skewed, ("always", "from"), "fixed", 1, STILL, "1", SENSOR),
    "backlash": Effect(None, "element", additive(backlash), ("always",), "matched", 0.3, MOVED, span=SENSOR),
    "leak_of_last_reading": Effect(None, "poll", on_rows(leak), ("always", "from"), "matched", 0.01, MOVED, "1", PAIR),
    "read_after_conversion": Effect(
        None, "poll", on_rows(read_phase), ("always", "from"), "matched", 0.1, STILL, span=SENSOR
    ),
    "counter_offset": Effect(None, "poll", on_rows(counter), ("always", "from"), "matched", 0.1, STILL),
    "noise_bursts": Effect(None, "element", additive(bursts), ("always", "from"), "energy", 1.0, STILL, span=SENSOR),
    "noise_growing_in_log": Effect(
        None, "element", additive(growing_white), ("always",), "energy", 0.5, STILL, span=SENSOR
    ),
}

DESIGN_NAMES: dict[str, str] = {name: effect.design_name for name, effect in EFFECTS.items() if effect.design_name}
"""For scoring: the vocabulary's name of each known effect."""
UNKNOWN = tuple(name for name, effect in EFFECTS.items() if effect.design_name is None)

__all__ = ["DESIGN_NAMES", "EFFECTS", "GRID_HZ", "SI", "UNKNOWN", "Effect", "Placement", "When"]
