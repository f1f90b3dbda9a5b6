"""The axes of an array: where each points in the box frame, where it sits, how far it reaches and how it scatters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import Described
from imuarray.units import SI_PER_UNIT


@dataclass(frozen=True)
class CalibrationErrors:
    """Errors that a calibration leaves in the three axes of one sensor, constant in a log.

    `bias_si2` (3, 3): covariance of their biases, with what biases do from run to run and within a run, in the square
    of m/s2 or rad/s; `response` (3, 3, 3, 3): covariance of axis i's error along box axis a with axis j's along box
    axis b at [i, a, j, b], as shares of the axes' scale factors. What was not measured is zero: nobody knows it.
    """

    bias_si2: Floats
    response: Floats


@dataclass(frozen=True)
class Axis:
    """One sensor axis: where it points in the box frame (unit vector) and what it is.

    `range_si` is the end of the measuring range and `noise_si` the standard deviation of a reading (None: unknown), in
    m/s2 or rad/s; `position_m` where the sensor sits in the box frame; `bandwidth_hz` the -3 dB bandwidth to which it
    is set (None: unknown); `stability_si` the rms of its slow error, from run to run and within a run (None: unknown);
    `errors` what the calibration of its sensor leaves unknown (None: nothing was measured).
    """

    sensor: str
    chip: str
    index: int
    direction_box: tuple[float, float, float]
    range_si: float
    noise_si: float | None
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bandwidth_hz: float | None = None
    stability_si: float | None = None
    errors: CalibrationErrors | None = field(default=None, compare=False, repr=False)

    @property
    def in_plane(self) -> bool:
        """True for x and y, which lie in the plane of the silicon; z stands on it."""
        return self.index < 2

    @property
    def label(self) -> str:
        """Sensor and axis as people say it: "Gyro1 y"."""
        return f"{self.sensor} {'xyz'[self.index]}"


def axes_of(sensors: Sequence[Described], calibration: Calibration) -> list[Axis]:
    """Every axis of `sensors`, in order."""
    axes = []
    for sensor in sensors:
        known = calibration.or_nominal(sensor)
        x_m, y_m, z_m = (1e-3 * float(part) for part in sensor.position_mm)
        errors = _errors_of(known)
        for index, direction in enumerate(known.directions_box):
            noise = None if known.noise_lsb is None else float(known.noise_lsb[index] / known.lsb_per_si[index])
            x, y, z = (float(part) for part in direction)
            range_si = sensor.range * SI_PER_UNIT[sensor.unit]
            place = (x_m, y_m, z_m)
            bandwidth_hz, stability = sensor.bandwidth_hz or None, _stability_si(known, index)
            axes.append(
                Axis(
                    sensor.name, sensor.chip, index, (x, y, z), range_si, noise, place, bandwidth_hz, stability, errors
                )
            )
    return axes


def response_shares(known: SensorCalibration) -> Floats | None:
    """(9, 9) covariance of a sensor's response row by row, as shares of the axes' scale factors; None if it was not
    measured.
    """
    covariance = known.response_covariance()
    if covariance is None:
        return None
    scale = np.repeat(known.scale_lsb_per_unit, 3)
    return np.asarray(covariance / np.outer(scale, scale))


def _errors_of(known: SensorCalibration) -> CalibrationErrors | None:
    """Return a calibration's own errors as they were measured; None without a measurement."""
    bias = np.zeros((3, 3))
    if known.bias_covariance_lsb2 is not None:
        bias = known.bias_covariance_lsb2 / np.outer(known.lsb_per_si, known.lsb_per_si)
    elif known.bias_sem_lsb is not None:
        bias = np.diag((known.bias_sem_lsb / known.lsb_per_si) ** 2)
    slow = [_stability_si(known, index) or 0.0 for index in range(3)]
    bias = bias + np.diag(np.square(slow))
    shares = response_shares(known)
    if shares is None and not bias.any():
        return None
    return CalibrationErrors(bias, (np.zeros((9, 9)) if shares is None else shares).reshape(3, 3, 3, 3))


def _stability_si(known: SensorCalibration, index: int) -> float | None:
    """Rms of what the bias of an axis does from run to run and within a run, as far as either was measured."""
    parts = [group.rms_lsb[index] for group in (known.turn_on, known.drift) if group is not None]
    finite = [float(part / known.lsb_per_si[index]) for part in parts if np.isfinite(part)]
    return math.hypot(*finite) if finite else None


def directions(axes: Sequence[Axis]) -> Floats:
    """(m, 3) unit vectors of the axes in the box frame: values = directions @ truth_box + errors."""
    return np.array([axis.direction_box for axis in axes])
