"""A sensor of the paper's array in closed form: what decides the numbers that its tables print, in counts.

The start is what the data sheets say (`configs/models/datasheet.toml`), its populations as standard deviations; only
the bias is fitted, as the mean of Table 10's six faces. The ADXL345 is set to the 400 Hz of appendix A.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from math import sqrt

import numpy as np
import numpy.typing as npt

from imuarray.array import load_array
from imuarray.log.format import SensorHeader
from imuarray.log.headers import header_of
from imuarray.paper.accelerometers import READINGS
from imuarray.paper.replica import spread
from imuarray.paper.tables import table
from imuarray.shipped import configs
from imuarray.simulate.converters import even_step
from imuarray.simulate.effects.white_noise import WhiteNoise
from imuarray.simulate.model import Model, load_model
from imuarray.simulate.population import Spread
from imuarray.simulate.streams import Streams

Floats = npt.NDArray[np.float64]

STATED_RATE_HZ = 400.0
"""Of the ADXL345, appendix A.2; `configs/martin2013.toml` already has what was found."""

RUNS, CONTINUOUS, HEATING = "runs", "continuous", "heating"
"""Experiments with +Z up on other switch-ons than Table 10's."""


@cache
def printed(number: int, channel: str, column: str) -> float:
    """A printed number of Table 3, 4, 8, 10 or 11."""
    return spread.printed(number, channel, column)


def _zeros() -> Floats:
    return np.zeros(3)


def _unlined() -> Floats:
    return np.full(3, np.nan)


@dataclass(frozen=True)
class Sensor:
    """Vectors (3,) are along the sensor's axes, matrices (3, 3) have a column for box X, Y and Z; all in counts.

    `level` without force at the six faces' mean temperature, `response` per g, `slope` per degC, each with the standard
    deviation that the population gives (`_sd`); `squared_sd` is what +-1 g along a box axis adds by nonlinearity.
    `noise` of single readings before rounding to multiples of `step`, in the array runs. `turn_on` and `in_run` are rms
    (time constant: `imuarray.paper.wander`), `walk` per root second. `shift` and `shift_sd` move the level, (15, 3) for
    `RUNS`. `neighbours` is the correlation of readings 1/350 s apart, `line_hz` nan without a line.
    """

    header: SensorHeader
    level: Floats
    response: Floats
    response_sd: Floats
    squared_sd: Floats
    slope: Floats
    slope_sd: Floats
    noise: Floats
    step: int
    turn_on: Floats = field(default_factory=_zeros)
    in_run: Floats = field(default_factory=_zeros)
    walk: Floats = field(default_factory=_zeros)
    shift: Mapping[str, Floats] = field(default_factory=dict)
    shift_sd: Mapping[str, Floats] = field(default_factory=dict)
    neighbours: Floats = field(default_factory=_zeros)
    line_hz: Floats = field(default_factory=_unlined)
    line_sd_hz: float = 0.0

    @property
    def name(self) -> str:
        """Of Table 1."""
        return self.header.name

    @property
    def lsb(self) -> float:
        """The unit (g, dps) of one count, typically."""
        return 1 / self.header.sensitivity

    @property
    def rounded_noise(self) -> Floats:
        """Standard deviation of codes."""
        return np.asarray(np.sqrt(self.noise**2 + self.step**2 / 12))

    def moved(self, experiment: str) -> Floats:
        """By how much the level stands elsewhere there."""
        return self.shift.get(experiment, np.zeros(3))

    def moved_sd(self, experiment: str) -> Floats:
        """Standard deviation of that."""
        return self.shift_sd.get(experiment, np.zeros(3))


Array = Mapping[str, Sensor]
"""The nine sensors by name."""


@cache
def data_sheet() -> Model:
    """The shipped model."""
    return load_model(configs() / "models" / "datasheet.toml")


@cache
def data_sheet_array() -> Array:
    """The nine sensors of Table 1 as the data sheets have them, biases fitted."""
    return {row["sensor"]: _of_data_sheet(header(row["sensor"])) for row in table(1)}


def header(name: str) -> SensorHeader:
    """How a sensor is set according to the paper and `configs/martin2013.toml`."""
    config = load_array(configs() / "martin2013.toml")[name]
    found = header_of(config, {})
    return replace(found, rate_hz=STATED_RATE_HZ) if found.chip == "adxl345" else found


def faces_of(name: str) -> Floats:
    """(3, 7) what Table 10 prints for the axes of a sensor, in the order of `READINGS`."""
    return np.array([[printed(10, f"{name} {axis}", face) for face in READINGS] for axis in "xyz"])


def sigma(sensor: SensorHeader, kind: str, key: str, count: int = 3) -> Floats:
    """(count,) standard deviation of a parameter of the data sheet's population, in the sensor's unit; 0 if it has
    none.
    """
    part = data_sheet().parts(sensor).get(kind)
    total = np.zeros(count)
    for recipe in part.effects[kind] if part else ():
        figure = recipe.get(key, 0.0)
        several = figure if isinstance(figure, tuple) else (figure,) * count
        total += np.array([one.sigma if isinstance(one, Spread) else 0.0 for one in several]) ** 2
    return np.asarray(np.sqrt(total))


def bias_sigma(sensor: SensorHeader) -> Floats:
    """(3,) of the zero-g or zero-rate level that the data sheet allows at this range, in the unit."""
    return sigma(sensor, "bias", f"offset_{sensor.unit}")


def _of_data_sheet(sensor: SensorHeader) -> Sensor:
    per_unit, turn = sensor.sensitivity, np.array(sensor.orientation).T
    is_force = sensor.unit == "g"
    unlike = np.diag(sigma(sensor, "scale", "error"))
    unlike[~np.eye(3, dtype=bool)] = np.radians(sigma(sensor, "misalignment", "angles_deg", 6))
    squared = np.diag(sigma(sensor, "nonlinearity", "quadratic_per_g"))
    noise = next(one for one in data_sheet().effects(sensor, Streams(0)) if isinstance(one, WhiteNoise))
    slope_sd = sigma(sensor, "thermal_bias", f"slope_{sensor.unit}_per_degc")
    return Sensor(
        sensor,
        level=np.asarray(faces_of(sensor.name)[:, :6].mean(axis=1)),
        response=turn * (per_unit if is_force else 0.0),
        response_sd=unlike @ np.abs(turn) * per_unit,
        squared_sd=squared @ np.abs(turn) * per_unit,
        slope=np.zeros(3),
        slope_sd=slope_sd * per_unit,
        noise=np.array(noise.rms) * per_unit,
        step=even_step(sensor.chip, sensor.rate_hz),
    )


def fast_noise(sensor: Sensor) -> Floats:
    """Noise of a gyroscope at the 110 Hz of appendix A.1, before rounding."""
    return np.asarray(sensor.noise * sqrt(110 / sensor.header.bandwidth_hz))
