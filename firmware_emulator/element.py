"""The sensing element, which turns the world into the converter's input, with the imperfections of one unit.

For a sensor with axes s, in the data sheet's unit and at temperature T:

    input = (1 + k (T - 25)) R s  +  G f  +  b + d (T - 25)  +  white noise

R (3x3) is scale and misalignment, k the change of scale, G f the effect of specific force on a gyroscope, b the bias
and d its slope. The position of the sensor in the box has no effect: every sensor is at the box's origin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from zlib import crc32

import numpy as np

from firmware_emulator.chip import Triple
from firmware_emulator.chips import BAROMETERS, HALVES
from firmware_emulator.six_axis import ACCELEROMETER
from firmware_emulator.world import ROOM_DEGC, STANDARD_GRAVITY, World, WorldStimulus, scaled

Matrix = tuple[Triple, Triple, Triple]
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO: Triple = (0.0, 0.0, 0.0)
NOTHING: Matrix = (ZERO, ZERO, ZERO)
BLOCK = 3 * 1365

SENSED: dict[str, tuple[str, float]] = {
    "adxl345": ("force_box", 1 / STANDARD_GRAVITY),
    "bma180": ("force_box", 1 / STANDARD_GRAVITY),
    "l3g4200d": ("rate_box", 180 / math.pi),
    **{
        chip: ("force_box", 1 / STANDARD_GRAVITY) if half.name == ACCELEROMETER else ("rate_box", 180 / math.pi)
        for chip, half in HALVES.items()
    },
    **dict.fromkeys(BAROMETERS, ("force_box", 0.0)),
    "hmc5883": ("field_box", 1.0),
    "hmc5883l": ("field_box", 1.0),
    "lis3mdl": ("field_box", 1.0),
    "mmc5983": ("field_box", 1.0),
    "ak8963": ("field_box", 1.0),
    "ak8975": ("field_box", 1.0),
}
"""Keyed by chip: the field of `WorldStimulus` that it measures, and the factor from its unit to g, dps or gauss."""


@dataclass(frozen=True)
class UnitDeviations:
    """The deviations of one part from the ideal one; the data sheet's unit is g, dps or gauss, axes are the sensor's
    own.

    White noise is `noise` rms at `noise_full_scale` and `noise_bandwidth_hz`; it grows with the square root of the
    bandwidth and with the full scale to the power `noise_exponent`. From the full scale `shift_from` on, `shift` is
    added to the bias (BMA-79).
    """

    bias: Triple = ZERO
    response: Matrix = IDENTITY
    slope_per_degc: Triple = ZERO
    scale_slope_per_degc: float = 0.0
    noise: Triple = ZERO
    noise_full_scale: float = 1.0
    noise_bandwidth_hz: float = 1.0
    noise_exponent: float = 0.0
    shift: Triple = ZERO
    shift_from: float = math.inf
    g_sensitivity: Matrix = NOTHING
    thermometer_offset_degc: float = 0.0
    pressure_offset_pa: float = 0.0


def product(a: Matrix, b: Matrix) -> Matrix:
    """Return a @ b."""
    columns = transposed(b)
    x, y, z = (applied(columns, row) for row in a)
    return x, y, z


def times(matrix: Matrix, factor: float) -> Matrix:
    """Return `factor` times `matrix`."""
    x, y, z = (scaled(row, factor) for row in matrix)
    return x, y, z


def transposed(matrix: Matrix) -> Matrix:
    """Return the transpose."""
    x, y, z = zip(*matrix, strict=True)
    return x, y, z


def applied(matrix: Matrix, vector: Triple) -> Triple:
    """Return matrix @ vector."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    x, y, z = vector
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def stream(seed: int, key: str) -> np.random.Generator:
    """Return a separate random generator for each `key`; the numbers of one do not depend on the use of the others."""
    return np.random.default_rng([seed, crc32(key.encode())])


class SensingElement:
    """The element of the sensor called `name`, a `chip` mounted so that box = `orientation` @ sensor."""

    def __init__(
        self, world: World, chip: str, name: str, orientation: Matrix, unit: UnitDeviations, seed: int = 0
    ) -> None:
        self.unit = unit
        self._world = world
        self._constant: WorldStimulus | None = getattr(world, "constant", None)
        self._random = stream(seed, f"noise of {name}")
        self._noise: list[float] = []
        self._used = 0
        field, factor = SENSED[chip]
        self._sensed: Callable[[WorldStimulus], Triple] = attrgetter(field)
        from_box = transposed(orientation)
        self._response = times(product(unit.response, from_box), factor)
        self._feels_force = any(any(row) for row in unit.g_sensitivity)
        self._g_sensitivity = times(product(unit.g_sensitivity, from_box), 1 / STANDARD_GRAVITY)
        self._setting = (math.nan, math.nan)
        self._deviation = self._bias = ZERO
        self._stimulus: WorldStimulus | None = None
        self._ideal = ZERO

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        """Return the input of the converter along the sensor's x, y, z, in the data sheet's unit, including noise."""
        if (full_scale, bandwidth_hz) != self._setting:
            self._set(full_scale, bandwidth_hz)
        stimulus = self._constant or self._world(at_ns)
        if stimulus is not self._stimulus:  # the stimulus of a box at rest is the same object for a long time
            self._stimulus, self._ideal = stimulus, self._ideal_output(stimulus)
        used = self._used
        if used >= len(self._noise):
            self._noise, used = self._random.standard_normal(BLOCK).tolist(), 0
        self._used = used + 3
        noise, (x, y, z), (dx, dy, dz) = self._noise, self._ideal, self._deviation
        return x + dx * noise[used], y + dy * noise[used + 1], z + dz * noise[used + 2]

    def temperature(self, at_ns: int) -> float:
        """Return the temperature of the chip's own thermometer in degC, including its offset."""
        stimulus = self._constant or self._world(at_ns)
        return stimulus.temperature_degc + self.unit.thermometer_offset_degc

    def pressure(self, at_ns: int) -> float:
        """Return the air pressure in Pa, including the part's offset."""
        return self._world(at_ns).pressure_pa + self.unit.pressure_offset_pa

    def _set(self, full_scale: float, bandwidth_hz: float) -> None:
        unit = self.unit
        share = math.sqrt(bandwidth_hz / unit.noise_bandwidth_hz)
        share *= (full_scale / unit.noise_full_scale) ** unit.noise_exponent
        shifted = full_scale >= unit.shift_from
        self._deviation = unit.noise[0] * share, unit.noise[1] * share, unit.noise[2] * share
        x, y, z = (bias + shifted * shift for bias, shift in zip(unit.bias, unit.shift, strict=True))
        self._bias = x, y, z
        self._setting = full_scale, bandwidth_hz
        self._stimulus = None

    def _ideal_output(self, stimulus: WorldStimulus) -> Triple:
        unit, bias = self.unit, self._bias
        warmer = stimulus.temperature_degc - ROOM_DEGC
        scale = 1.0 + unit.scale_slope_per_degc * warmer
        x, y, z = applied(self._response, self._sensed(stimulus))
        slope = unit.slope_per_degc
        x = x * scale + bias[0] + slope[0] * warmer
        y = y * scale + bias[1] + slope[1] * warmer
        z = z * scale + bias[2] + slope[2] * warmer
        if not self._feels_force:
            return x, y, z
        gx, gy, gz = applied(self._g_sensitivity, stimulus.force_box)
        return x + gx, y + gy, z + gz
