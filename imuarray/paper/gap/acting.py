"""What an effect of the simulator does to the printed numbers, in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from imuarray.chips import CHIPS
from imuarray.paper.gap.sensor import CONTINUOUS, HEATING, RUNS, Array, Floats, Sensor, printed
from imuarray.paper.model_units import runs_of
from imuarray.paper.noise import HIGH_RATE_HZ
from imuarray.paper.room import DEGC, FACES_DEGC
from imuarray.paper.startup import boot_faults
from imuarray.simulate.converters import adxl345_bandwidth_hz, even_step
from imuarray.simulate.effect import Effect

FACES_MEAN_DEGC = float(np.mean(FACES_DEGC[:6]))

Effects = Mapping[str, tuple[Effect, ...]]
"""By sensor."""


def with_effects(array: Array, effects: Effects) -> Array:
    """The array with these effects as well, one after the other; KeyError for an effect that `ACTS` has not."""
    return {name: _all(sensor, effects.get(name, ())) for name, sensor in array.items()}


def _all(sensor: Sensor, effects: Iterable[Effect]) -> Sensor:
    for effect in effects:
        sensor = ACTS[effect.name](sensor, effect)
    return sensor


def _white_noise(sensor: Sensor, effect: Any) -> Sensor:
    return replace(sensor, noise=np.array(effect.rms) / sensor.lsb)


def _odr_error(sensor: Sensor, effect: Any) -> Sensor:
    """More bandwidth makes more noise; a slower chip repeats itself where it is asked 350 times a second."""
    header = sensor.header
    rate_hz = header.rate_hz if math.isnan(effect.rate_hz) else effect.rate_hz
    ratio = 1.0
    if header.chip == "adxl345":
        ratio = adxl345_bandwidth_hz(rate_hz) / adxl345_bandwidth_hz(header.rate_hz)
    if not math.isnan(effect.bandwidth_hz):
        ratio = effect.bandwidth_hz / (header.bandwidth_hz or header.rate_hz / 2)
    repeated = max(0.0, 1 - rate_hz / HIGH_RATE_HZ)
    return replace(
        sensor,
        header=replace(header, rate_hz=rate_hz),
        noise=sensor.noise * math.sqrt(ratio),
        step=math.lcm(sensor.step, even_step(header.chip, rate_hz)),
        neighbours=np.maximum(sensor.neighbours, repeated),
    )


def _quantisation(sensor: Sensor, effect: Any) -> Sensor:
    return replace(sensor, step=math.lcm(sensor.step, int(effect.step_lsb)))


def _thermal_bias(sensor: Sensor, effect: Any) -> Sensor:
    return replace(sensor, slope=np.array(effect.slope) / sensor.lsb, slope_sd=np.zeros(3))


def _thermal_scale(sensor: Sensor, effect: Any) -> Sensor:
    """Seen with +Z up, where all but Table 10 was taken."""
    return replace(sensor, slope=sensor.slope + np.array(effect.slope) * sensor.response[:, 2])


def _misalignment(sensor: Sensor, effect: Any) -> Sensor:
    turn = np.array(sensor.header.orientation).T
    sizes = np.linalg.norm(sensor.response, axis=1)
    return replace(
        sensor,
        response=sizes[:, None] * effect.directions @ turn,
        response_sd=sensor.response_sd * (np.abs(turn) > 0.5),
    )


def _scale(sensor: Sensor, effect: Any) -> Sensor:
    turn = np.array(sensor.header.orientation).T
    stretched = sensor.response * (1 + np.array(effect.error))[:, None]
    return replace(sensor, response=stretched, response_sd=sensor.response_sd * (np.abs(turn) < 0.5))


def _g_sensitivity(sensor: Sensor, effect: Any) -> Sensor:
    turn = np.array(sensor.header.orientation).T
    return replace(sensor, response=np.reshape(effect.response, (3, 3)) @ turn / sensor.lsb)


def _turn_on_bias(sensor: Sensor, effect: Any) -> Sensor:
    return replace(sensor, turn_on=np.array(effect.rms) / sensor.lsb)


def _bias_instability(sensor: Sensor, effect: Any) -> Sensor:
    return replace(sensor, in_run=np.array(effect.rms) / sensor.lsb)


def _random_walk(sensor: Sensor, effect: Any) -> Sensor:
    return replace(sensor, walk=np.array(effect.density) / sensor.lsb)


def _bistable_bias(sensor: Sensor, effect: Any) -> Sensor:
    """Each switch-on stands in the nearer of the two states; Table 10's is the one with the offset."""
    offset = -np.array(effect.offset) / sensor.lsb
    levels = {RUNS: runs_of(sensor.name)} if sensor.name in ("BMA1", "Gyro3") else {}
    levels |= {CONTINUOUS: _level(sensor, 11, "cont_mean"), HEATING: _heated_level(sensor)}
    upright = sensor.level + sensor.response[:, 2]
    nearer = {
        at: ((level - upright) @ offset > offset @ offset / 2)[..., None] * offset for at, level in levels.items()
    }
    return replace(sensor, shift={**sensor.shift, **nearer})


def _level(sensor: Sensor, number: int, column: str) -> Floats:
    return np.array([printed(number, f"{sensor.name} {axis}", column) for axis in "xyz"])


def _heated_level(sensor: Sensor) -> Floats:
    intercept, slope = (_level(sensor, 8, column) for column in ("intercept_lsb", "slope_lsb_per_degc"))
    return np.asarray(intercept + slope * FACES_MEAN_DEGC)


def _range_reset(sensor: Sensor, effect: Any) -> Sensor:
    """The one run of Table 6 whose gravity is of another range."""
    (fault,) = boot_faults()
    ratio = CHIPS[sensor.header.chip].sensitivity[effect.range] * sensor.lsb
    # from run to run BMA1 is steadier than from day to day: the other runs are the level that the reset multiplies
    runs = runs_of(sensor.name)
    usual = np.delete(runs, fault.run - 1, axis=0).mean(axis=0)
    foretold = sensor.level + sensor.response[:, 2] + sensor.slope * (DEGC[11, "runs_mean"] - FACES_MEAN_DEGC)
    shift = np.zeros((len(runs), 3))
    shift[fault.run - 1] = (usual + np.array(effect.offset) / sensor.lsb) * ratio - foretold
    spread = np.zeros_like(shift)
    spread[fault.run - 1] = ratio * sensor.turn_on
    return replace(sensor, shift={**sensor.shift, RUNS: shift}, shift_sd={**sensor.shift_sd, RUNS: spread})


def _bandwidth(sensor: Sensor, effect: Any) -> Sensor:
    left = math.exp(-2 * math.pi * effect.cutoff_hz / HIGH_RATE_HZ)
    return replace(sensor, neighbours=np.full(3, left))


def _stale_samples(sensor: Sensor, effect: Any) -> Sensor:
    return replace(sensor, neighbours=np.full(3, effect.probability))


def _tone(sensor: Sensor, effect: Any) -> Sensor:
    power = np.square(effect.amplitude) / 2 / sensor.lsb**2
    lined = np.where(power > 0, effect.frequency_hz, np.nan)
    return replace(sensor, noise=np.sqrt(sensor.noise**2 + power), line_hz=lined)


ACTS: Mapping[str, Callable[[Sensor, Any], Sensor]] = MappingProxyType(
    {
        "white_noise": _white_noise,
        "odr_error": _odr_error,
        "quantisation": _quantisation,
        "thermal_bias": _thermal_bias,
        "thermal_scale": _thermal_scale,
        "misalignment": _misalignment,
        "scale": _scale,
        "g_sensitivity": _g_sensitivity,
        "turn_on_bias": _turn_on_bias,
        "bias_instability": _bias_instability,
        "random_walk": _random_walk,
        "bistable_bias": _bistable_bias,
        "range_reset": _range_reset,
        "bandwidth": _bandwidth,
        "stale_samples": _stale_samples,
        "tone": _tone,
    }
)
"""By the effect's name: (sensor, effect) to the sensor that has it."""
