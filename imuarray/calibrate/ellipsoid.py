"""Where gravity pointed, from nothing but its length: a start for the joint fit.

Per accelerometer, ``|shape @ (mean - bias)| = 1 g`` over all poses gives the bias (3) and a triangular shape matrix
(6): an ellipsoid (Skog & Handel, Proc. XVII IMEKO World Congress, 2006). What is left, a turn per sensor, comes from
the others: all felt the same, so their directions are turned onto each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from imuarray.calibrate.readings import PoseReadings
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

Floats = npt.NDArray[np.float64]

_TRIANGLE = np.triu_indices(3)


def directions_of(readings: PoseReadings) -> Floats:
    """(k, 3) directions of gravity's reaction in the box frame, near the truth.

    CalibrationError if the poses do not tell bias from scale.
    """
    means = readings.mean_lsb / readings.sensitivity[:, None, None]
    directions = []
    for sensor, mean in zip(readings.sensors, means, strict=True):
        gravity = _ellipsoid(sensor, mean)
        directions.append(sensor.orientation @ gravity / np.linalg.norm(gravity, axis=0))
    return _common(directions).T


def _ellipsoid(sensor: SensorLog, means: Floats) -> Floats:
    """Specific force (3, k) in g, sensor frame, of readings (k, 3) in g; CalibrationError if the poses do not tell bias
    from scale.
    """

    def gravity(parameters: Floats) -> Floats:
        shape = np.zeros((3, 3))
        shape[_TRIANGLE] = parameters[3:]
        return np.asarray(shape @ (means - parameters[:3]).T)

    start = np.concatenate([np.zeros(3), np.eye(3)[_TRIANGLE]])
    fit = least_squares(lambda parameters: np.linalg.norm(gravity(parameters), axis=0) - 1, start)
    if not fit.success or np.linalg.cond(fit.jac.T @ fit.jac) > 1e8:
        raise CalibrationError(same_sides(sensor))
    return gravity(fit.x)


def same_sides(sensor: SensorLog) -> str:
    """What is wrong with poses that leave something open."""
    return f"{sensor.where}: the poses do not tell bias from scale; put the box on more different sides"


def _common(directions: Sequence[Floats]) -> Floats:
    """(3, k) mean of the sensors' directions (3, k), each turned onto it (Kabsch, Acta Cryst. A32, 1976, p. 922)."""
    from scipy.spatial.transform import Rotation  # its weight is for those who turn anything

    common = np.asarray(directions[0])
    for _ in range(3):
        turned = [Rotation.align_vectors(common.T, own.T)[0].as_matrix() @ own for own in directions]
        common = np.mean(turned, axis=0)
        common /= np.linalg.norm(common, axis=0)
    return common
