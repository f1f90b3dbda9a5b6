"""From the motion of the box to the rows of one sensor: the chip's clock, its temperature, its response, its noise, its
filter, its codes, and the recorder that polls it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tests.bench_world.chips import Array, Sensor
from tests.bench_world.faults import Fault
from tests.bench_world.filters import lag, low_pass
from tests.bench_world.motion import STANDARD_GRAVITY, STEP_S, Motion, lever_arm_force
from tests.bench_world.noise import PowerLaw, draw_noise
from tests.bench_world.parts import Part
from tests.bench_world.recorder import Frames
from tests.bench_world.rotation import RADIANS
from tests.bench_world.samples import AFTER_LOSS, SATURATED, STALE, Readings, Rows, Samples, Session

SETTLED_S = 2
"""How long a chip has run before a log begins: its filter has settled."""
REFERENCE_C = 25.0
"""Where biases and scale factors are given."""
WARM_UP_S = 20
"""Time constant of a chip's own heat."""
THERMAL_STEPS = 8
"""Of the grid, between two temperatures of a chip."""
FLICKER_CORNER, WALK_CORNER = 0.25, 0.2
"""Where the 1/f and the 1/f² noise of every part equal its white noise, over the length of the log: they are just not
seen.
"""


@dataclass(frozen=True)
class Unit:
    """A sensor, its specimen, and what is wrong with it."""

    sensor: Sensor
    part: Part
    faults: tuple[Fault, ...]


@dataclass(frozen=True)
class Temperature:
    """The temperature of a chip (m,) degC at times (m,) s."""

    time_s: Array
    chip_c: Array


def record(unit: Unit, session: Session, slot_s: float, stream: np.random.Generator) -> Rows:
    """Return the rows of a unit in a log; it is polled `slot_s` after the beginning of each frame."""
    bias = stream.normal(0, unit.part.turn_on, 3)
    for fault in unit.faults:
        bias = fault.start(bias, session.number)
    time_s, rate_hz = _draw_clock(unit, session.motion.duration_s, stream)
    temperature = _temperature(unit.part, session)
    samples = _sample(unit, session.motion, temperature, time_s, rate_hz)
    values = _response(unit, samples) + unit.part.bias + bias + _thermal_bias(unit, temperature, time_s)
    values = values + _draw_noise(unit, samples, stream)
    values = low_pass(values, rate_hz, _cutoff_hz(unit))
    for fault in unit.faults:
        values = values + fault.ripple(samples, stream)
    readings = _poll(_encode(unit, values, samples), samples, session.frames, slot_s)
    for fault in unit.faults:
        readings = fault.read(readings, samples, stream)
    return Rows(
        time_ns=np.rint(readings.time_s * 1e9).astype(np.int64),
        counts=readings.codes.astype(np.int16),
        status=readings.status,
        temperature_counts=_read_thermometer(unit, readings, samples, stream),
    )


def _draw_clock(unit: Unit, duration_s: float, stream: np.random.Generator) -> tuple[Array, float]:
    """The times (n,) s of the samples, and their rate."""
    nominal_hz = unit.sensor.update_rate_hz
    for fault in unit.faults:
        nominal_hz = fault.clock_hz(nominal_hz)
    rate_hz = nominal_hz * (1 + unit.part.clock_error)
    count = int((duration_s + SETTLED_S) * rate_hz) + 2
    return stream.uniform(0, 1) / rate_hz + np.arange(count) / rate_hz - SETTLED_S, rate_hz


def _temperature(part: Part, session: Session) -> Temperature:
    motion = session.motion
    time_s, box_c = motion.time_s[::THERMAL_STEPS], motion.temperature_c
    place_c = (box_c[0] + (box_c - box_c[0]) * (1 + part.heat_share))[::THERMAL_STEPS]
    own_k = session.self_heating_k * (1 - np.exp(-time_s / WARM_UP_S))
    return Temperature(time_s, lag(place_c, THERMAL_STEPS * STEP_S, part.time_constant_s) + own_k)


def _sample(unit: Unit, motion: Motion, temperature: Temperature, time_s: Array, rate_hz: float) -> Samples:
    sensor, part = unit.sensor, unit.part
    felt_s, position_m = time_s, part.position_mm / 1000
    for fault in unit.faults:
        felt_s, position_m = fault.sampled_at(felt_s), fault.place(position_m)
    rate_box, acceleration_box, force_box = (
        _interpolate(felt_s, motion.time_s, values)
        for values in (motion.rate_box, motion.angular_acceleration_box, motion.force_box)
    )
    force_box = force_box + lever_arm_force(rate_box, acceleration_box, position_m)
    force_g = force_box / STANDARD_GRAVITY @ sensor.orientation
    slower = rate_hz / sensor.update_rate_hz
    return Samples(
        sensor=sensor,
        duration_s=motion.duration_s,
        rate_hz=rate_hz,
        time_s=time_s,
        warmth_k=np.interp(time_s, temperature.time_s, temperature.chip_c) - REFERENCE_C,
        value=rate_box / RADIANS @ sensor.orientation if sensor.is_gyroscope else force_g,
        force_g=force_g,
        noise=part.noise if sensor.chip == "adxl345" else part.noise * np.sqrt(slower),
    )


def _interpolate(at_s: Array, time_s: Array, values: Array) -> Array:
    return np.stack([np.interp(at_s, time_s, column) for column in values.T], 1)


def _response(unit: Unit, samples: Samples) -> Array:
    part, value = unit.part, samples.value
    matrix = part.matrix
    for fault in unit.faults:
        matrix = fault.distort(matrix)
    response = value @ matrix.T + value * (part.scale_slope * samples.warmth_k[:, None]) + part.quadratic * value**2
    if unit.sensor.is_gyroscope:
        response = response + samples.force_g @ part.force_sensitivity.T
    for fault in unit.faults:
        response = response + fault.respond(samples)
    return response


def _thermal_bias(unit: Unit, temperature: Temperature, time_s: Array) -> Array:
    followed_c = temperature.chip_c
    for fault in unit.faults:
        followed_c = fault.warm(followed_c, THERMAL_STEPS * STEP_S)
    warmth_k = np.interp(time_s, temperature.time_s, followed_c) - REFERENCE_C
    return np.asarray(unit.part.bias_slope * warmth_k[:, None])


def _draw_noise(unit: Unit, samples: Samples, stream: np.random.Generator) -> Array:
    rows, rate_hz, duration_s = len(samples.time_s), samples.rate_hz, samples.duration_s
    noise = stream.normal(0, 1, (rows, 3)) * samples.noise
    for fault in unit.faults:
        noise = fault.modulate(noise, samples, stream)
    density = samples.noise**2 * 2 / rate_hz
    for axis in range(3):
        flicker = PowerLaw(1, density[axis], FLICKER_CORNER / duration_s)
        walk = PowerLaw(2, density[axis], WALK_CORNER / duration_s)
        for law in (flicker, walk):
            noise[:, axis] += draw_noise(law, rows, rate_hz, stream)
    for fault in unit.faults:
        noise = noise + fault.disturb(samples, stream)
    return noise


def _cutoff_hz(unit: Unit) -> float | None:
    """The BMA180's filter moves with half the error of its clock."""
    cutoff_hz = unit.sensor.bandwidth_hz
    if cutoff_hz is None or unit.sensor.chip != "bma180":
        return cutoff_hz
    return cutoff_hz * (1 + 0.5 * unit.part.clock_error)


def _encode(unit: Unit, values: Array, samples: Samples) -> Array:
    codes = np.rint(values * unit.sensor.sensitivity)
    for fault in unit.faults:
        codes = fault.encode(codes, values, samples)
    return np.clip(codes, *unit.sensor.code_span)


def _poll(codes: Array, samples: Samples, frames: Frames, slot_s: float) -> Readings:
    """The newest sample at the time of each frame."""
    time_s = frames.time_s + slot_s
    sample = np.maximum(np.searchsorted(samples.time_s, time_s, side="right") - 1, 0)
    lowest, highest = samples.sensor.code_span
    read = codes[sample]
    status = np.zeros(len(time_s), np.uint16)
    status[1:][sample[1:] == sample[:-1]] |= STALE
    status[frames.follows_loss] |= AFTER_LOSS
    status[((read <= lowest) | (read >= highest)).any(1)] |= SATURATED
    return Readings(time_s, sample, read, status)


def _read_thermometer(
    unit: Unit, readings: Readings, samples: Samples, stream: np.random.Generator
) -> npt.NDArray[np.int16] | None:
    sensor, part, count = unit.sensor, unit.part, len(readings.time_s)
    if not sensor.has_thermometer:
        return None
    chip_c = samples.warmth_k + REFERENCE_C
    if sensor.chip == "bma180":  # 2 codes a K, 0 at 24 degC
        read_c = chip_c[readings.sample] + part.thermometer_offset_k
        codes = (read_c + stream.normal(0, part.thermometer_noise_k, count) - 24) / 0.5
    elif sensor.chip == "l3g4200d":  # -1 code a K, once a second, no absolute meaning: L3G-60
        second_s = np.floor(readings.time_s)
        codes = part.thermometer_code - (np.interp(second_s, samples.time_s, chip_c) - 22)
    else:  # MPU-6050, register map: 340 codes a K, 0 at 36.53 degC
        read_c = chip_c[readings.sample] + part.thermometer_offset_k / 3
        codes = (read_c - 36.53) * 340 + stream.normal(0, 20, count)
    return np.clip(np.rint(codes), -32768, 32767).astype(np.int16)
