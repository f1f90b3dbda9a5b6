"""The errors of one specimen, drawn within its data sheet: normal, with half a printed limit as standard deviation.

Units are those of the sensor: g or dps, and K.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.bench_world.chips import ADXL345_CODES_PER_G, Array, Sensor
from tests.bench_world.rotation import RADIANS, cross_matrix

BMA180_NOISE = {1: 150e-6, 1.5: 160e-6, 2: 170e-6, 3: 200e-6, 4: 250e-6, 8: 7e-4, 16: 1.3e-3}
"""g/sqrt(Hz) by range: 150e-6 at the finest (BMA-110), up to what a code of the coarse ranges has (PAP-05)."""
L3G4200D_BIAS = {250: 3, 500: 5, 2000: 12}
"""dps by range, a third or less of the typical zero-rate levels (L3G-70)."""
L3G4200D_NOISE = 0.03
"""dps/sqrt(Hz): L3G-74."""
ADXL345_NOISE = np.array([0.75, 0.75, 1.1]) / ADXL345_CODES_PER_G
"""g at 100 Hz: ADX-67; sqrt(2) more for each octave above (ADX-68)."""
ADXL345_BIAS_AT_3V3, ADXL345_SCALE_AT_3V3 = (0.025, 0.025, -0.02), (0.035, 0.035, 0)
"""Shift of zero in g and of scale at a supply of 3.3 V: ADX-71."""
MPU6050_NOISE = {"mpu6050_acc": 400e-6, "mpu6050_gyro": 0.005}
"""g/sqrt(Hz) and dps/sqrt(Hz): product specification, sections 6.2 and 6.1."""
POSITION_ERROR_MM = 0.4
"""Of the sensing element, from where the configuration says."""


@dataclass(frozen=True)
class Errors:
    """What the data sheet of a chip limits, (3,) each: `bias`, `scale` (share), `bias_slope` (per K), `noise` (standard
    deviation of a sample before the filter), `scale_slope` (share per K); and `alignment_deg`, a standard deviation.
    """

    bias: Array
    scale: Array
    bias_slope: Array
    noise: Array
    scale_slope: Array
    alignment_deg: float


@dataclass(frozen=True)
class Part:
    """One specimen. `matrix` (3, 3) holds scale, alignment and cross-axis errors; `force_sensitivity` (3, 3) is in dps
    per g; `quadratic` (3,) per unit; the chip follows the air with `time_constant_s` and is heated by `heat_share`
    more than the box; its thermometer reads `thermometer_offset_k` too much, or `thermometer_code` at 22 degC;
    `turn_on` is the standard deviation of its bias from one switching on to the next.
    """

    bias: Array
    bias_slope: Array
    scale_slope: Array
    noise: Array
    matrix: Array
    clock_error: float
    position_mm: Array
    force_sensitivity: Array
    quadratic: Array
    time_constant_s: float
    heat_share: float
    thermometer_offset_k: float
    thermometer_noise_k: float
    thermometer_code: float
    turn_on: float


def draw_part(sensor: Sensor, stream: np.random.Generator, supply_v: float) -> Part:
    """Return a specimen of this sensor's chip."""
    errors = _DRAWS[sensor.chip](sensor, stream)
    bias, scale = errors.bias, errors.scale
    if sensor.chip == "adxl345" and supply_v > 3:
        bias, scale = bias + ADXL345_BIAS_AT_3V3, scale + ADXL345_SCALE_AT_3V3
    is_gyroscope = sensor.is_gyroscope
    return Part(
        bias=bias,
        bias_slope=errors.bias_slope,
        scale_slope=errors.scale_slope,
        noise=errors.noise,
        clock_error=stream.normal(0, 0.02 if sensor.chip == "bma180" else 0.008),
        matrix=_draw_matrix(scale, errors.alignment_deg, stream),
        position_mm=np.array(sensor.position_mm) + stream.normal(0, POSITION_ERROR_MM, 3),
        force_sensitivity=stream.normal(0, 0.004, (3, 3)) if is_gyroscope else np.zeros((3, 3)),
        quadratic=stream.normal(0, 0.0005, 3) / (sensor.range if is_gyroscope else 2),
        time_constant_s=stream.uniform(2, 6),
        heat_share=stream.normal(0, 0.03),
        thermometer_offset_k=stream.uniform(-3, 3),
        thermometer_noise_k=stream.uniform(0.1, 0.3),
        thermometer_code=stream.uniform(18, 30),
        turn_on=_draw_turn_on(sensor, stream),
    )


def _draw_adxl345(sensor: Sensor, stream: np.random.Generator) -> Errors:
    octaves = np.sqrt(max(sensor.update_rate_hz, 100) / 100)
    return Errors(
        bias=np.clip(stream.normal(0, [0.035, 0.035, 0.04]), -0.12, 0.12),  # ADX-60, ADX-61
        scale=stream.normal(0, 0.01, 3),  # ADX-63
        bias_slope=stream.normal(0, [0.0002, 0.0002, 0.0006]),  # half of ADX-62
        noise=ADXL345_NOISE * octaves * stream.uniform(0.9, 1.15, 3),
        scale_slope=stream.normal(0, 5e-5, 3),  # half of ADX-64
        alignment_deg=0.25,
    )


def _draw_bma180(sensor: Sensor, stream: np.random.Generator) -> Errors:
    return Errors(
        bias=_within(0.03 if sensor.range < 8 else 0.15, stream),  # BMA-113, BMA-79
        scale=_within(0.015 if sensor.range <= 4 else 0.025, stream),  # BMA-70 to BMA-76
        bias_slope=_within(0.0005, stream),  # BMA-115
        noise=BMA180_NOISE[sensor.range] * stream.uniform(0.9, 1.2, 3) * np.sqrt(1200),
        scale_slope=_within(1e-4, stream),  # BMA-116
        alignment_deg=0.5,  # half of BMA-119
    )


def _draw_l3g4200d(sensor: Sensor, stream: np.random.Generator) -> Errors:
    return Errors(
        bias=_within(L3G4200D_BIAS[int(sensor.range)], stream),
        scale=stream.normal(0, 0.01, 3),
        bias_slope=_within(0.03 if sensor.range < 2000 else 0.04, stream),  # L3G-71
        noise=L3G4200D_NOISE * stream.uniform(0.85, 1.15, 3) * np.sqrt(sensor.update_rate_hz / 2),
        scale_slope=stream.normal(0, 8e-5, 3),  # L3G-72
        alignment_deg=0.5,
    )


def _draw_mpu6050(sensor: Sensor, stream: np.random.Generator) -> Errors:
    is_gyroscope = sensor.is_gyroscope
    spread = (0.9, 1.2) if is_gyroscope else (0.7, 1.0)
    return Errors(
        bias=_within(6 if is_gyroscope else 0.05, stream),
        scale=_within(0.02, stream),
        bias_slope=_within(0.02 if is_gyroscope else 0.0004, stream),
        noise=MPU6050_NOISE[sensor.chip] * stream.uniform(*spread, 3) * np.sqrt(sensor.update_rate_hz / 2),
        scale_slope=_within(1e-4, stream),
        alignment_deg=0.4,
    )


_DRAWS: dict[str, Callable[[Sensor, np.random.Generator], Errors]] = {
    "adxl345": _draw_adxl345,
    "bma180": _draw_bma180,
    "l3g4200d": _draw_l3g4200d,
    "mpu6050_acc": _draw_mpu6050,
    "mpu6050_gyro": _draw_mpu6050,
}


def _within(limit: float, stream: np.random.Generator) -> Array:
    return np.clip(stream.normal(0, limit / 2, 3), -limit, limit)


def _draw_matrix(scale: Array, alignment_deg: float, stream: np.random.Generator) -> Array:
    turn = cross_matrix(stream.normal(0, alignment_deg * RADIANS, 3))
    cross_axis = stream.normal(0, 0.001, (3, 3)) * (1 - np.eye(3))
    return np.eye(3) + turn + np.diag(scale) + cross_axis


def _draw_turn_on(sensor: Sensor, stream: np.random.Generator) -> float:
    if sensor.chip == "l3g4200d":
        return float(np.clip(stream.normal(0.06, 0.02), 0.02, 0.12))
    return 0.03 if sensor.is_gyroscope else 0.001
