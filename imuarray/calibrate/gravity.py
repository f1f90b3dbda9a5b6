"""Any static poses, no table, no labels: in every one of them the specific force is one g long.

Per accelerometer, ``|shape @ (mean - bias)| = 1 g`` over all poses gives the bias (3) and a triangular shape matrix
(6): scale factors and the angles between its own axes (an ellipsoid; Skog & Handel, Proc. XVII IMEKO World Congress,
2006). What is left, a rotation per sensor, comes from the other sensors: all of them saw the same gravity, so their
directions are turned onto each other, and the array as a whole keeps the orientation that its configuration says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imuarray.calibrate.model import SensorCalibration, nominal
from imuarray.calibrate.poses import Pose, Reading, read_pose
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

Floats = npt.NDArray[np.float64]

MIN_POSES = 9
"""Nine unknowns per sensor."""

_TRIANGLE = np.triu_indices(3)


def fit_gravity(sensors: Sequence[SensorLog], poses: Sequence[Pose]) -> tuple[list[SensorCalibration], Floats]:
    """Calibrate accelerometers jointly from static poses; also the residual of each sensor, rms over the poses, in g.

    CalibrationError if there are fewer than nine poses or they do not spread enough.
    """
    if len(poses) < MIN_POSES:
        raise CalibrationError(f"{sensors[0].where}: {len(poses)} static poses, at least {MIN_POSES} are wanted")
    ellipsoids = [_ellipsoid(sensor, [read_pose(sensor, pose) for pose in poses]) for sensor in sensors]
    turns = _common_frame([orient @ gravity for orient, gravity in _nominal_directions(sensors, ellipsoids)])
    fitted, residuals = [], []
    for sensor, ellipsoid, turn in zip(sensors, ellipsoids, turns, strict=True):
        # gravity_sensor = shape @ (counts - bias); gravity_box = turn @ orientation @ gravity_sensor
        response = np.asarray(np.linalg.inv(turn @ sensor.orientation @ ellipsoid.shape), float)
        fitted.append(
            replace(
                nominal(sensor),
                bias_lsb=ellipsoid.bias_lsb,
                bias_sem_lsb=ellipsoid.bias_sem_lsb,
                response_lsb_per_unit=response,
                response_sem_lsb_per_unit=ellipsoid.response_sem,
            )
        )
        residuals.append(float(np.sqrt(np.mean((np.linalg.norm(ellipsoid.gravity_g, axis=0) - 1) ** 2))))
    return fitted, np.array(residuals)


class _Ellipsoid(NamedTuple):
    """One sensor's fit.

    Bias (3,) in counts and its standard error, shape (3, 3) in g per count, the standard error of the response (3,) in
    counts per g (the largest entry of each row), gravity (3, k) in g in the sensor frame.
    """

    bias_lsb: Floats
    bias_sem_lsb: Floats
    shape: Floats
    response_sem: Floats
    gravity_g: Floats


def _shape_of(parameters: Floats) -> Floats:
    """The upper triangle (3, 3) from the nine parameters."""
    shape = np.zeros((3, 3))
    shape[_TRIANGLE] = parameters[3:]
    return shape


def _ellipsoid(sensor: SensorLog, readings: Sequence[Reading]) -> _Ellipsoid:
    """Fit one sensor; CalibrationError if the poses do not tell bias from scale."""
    means = np.array([reading.mean_lsb for reading in readings]) / sensor.sensitivity

    def gravity(parameters: Floats) -> Floats:
        return np.asarray(_shape_of(parameters) @ (means - parameters[:3]).T)

    start = np.concatenate([np.zeros(3), np.eye(3)[_TRIANGLE]])
    fit = least_squares(lambda parameters: np.linalg.norm(gravity(parameters), axis=0) - 1, start)
    information = fit.jac.T @ fit.jac
    if not fit.success or np.linalg.cond(information) > 1e8:
        raise CalibrationError(
            f"{sensor.where}: the poses do not tell bias from scale; put the box on more different sides"
        )
    covariance = np.linalg.inv(information) * _variance(sensor, readings, 2 * fit.cost)
    changes = np.array([_response_change(fit.x, index) for index in range(len(fit.x))])
    response_variance = np.einsum("pij,pq,qij->ij", changes, covariance, changes)
    return _Ellipsoid(
        bias_lsb=fit.x[:3] * sensor.sensitivity,
        bias_sem_lsb=np.sqrt(np.diag(covariance)[:3]) * sensor.sensitivity,
        shape=_shape_of(fit.x) / sensor.sensitivity,
        response_sem=np.sqrt(response_variance).max(axis=1) * sensor.sensitivity,
        gravity_g=gravity(fit.x),
    )


def _variance(sensor: SensorLog, readings: Sequence[Reading], squares: float) -> float:
    """Variance of one pose's specific force in g^2: from the residuals, but never far below what the readings' scatter
    says: with nine poses there are no residuals, and with few of them they can be small by luck.
    """
    freedom = len(readings) - MIN_POSES
    scatter = float(np.mean([np.mean(reading.sem_lsb**2) for reading in readings])) / sensor.sensitivity**2
    return scatter if freedom == 0 else max(squares / freedom, scatter / 4)


def _response_change(parameters: Floats, index: int) -> Floats:
    """Derivative (3, 3) of the response, in the sensor's own frame, by one parameter: -inverse @ change @ inverse."""
    if index < 3:
        return np.zeros((3, 3))
    change = np.zeros(9)
    change[index] = 1.0
    inverse = np.linalg.inv(_shape_of(parameters))
    return np.asarray(-inverse @ _shape_of(change) @ inverse)


def _nominal_directions(sensors: Sequence[SensorLog], ellipsoids: Sequence[_Ellipsoid]) -> list[tuple[Floats, Floats]]:
    """Each sensor's orientation and its gravity directions (3, k), unit length, in its own frame."""
    return [
        (sensor.orientation, ellipsoid.gravity_g / np.linalg.norm(ellipsoid.gravity_g, axis=0))
        for sensor, ellipsoid in zip(sensors, ellipsoids, strict=True)
    ]


def _common_frame(directions: Sequence[Floats]) -> list[Floats]:
    """A small rotation (3, 3) for each sensor that brings its directions (3, k) onto the array's common ones.

    The common directions are the normalised mean; the rotations are those of Kabsch (1976), their mean turned to
    identity.
    """
    turned = list(directions)
    turns = [np.eye(3) for _ in directions]
    for _ in range(3):
        common = np.mean(turned, axis=0)
        common /= np.linalg.norm(common, axis=0)
        turns = [Rotation.align_vectors(common.T, own.T)[0].as_matrix() for own in directions]
        mean = Rotation.from_matrix(np.array(turns)).mean().as_matrix()
        turns = [mean.T @ turn for turn in turns]
        turned = [turn @ own for turn, own in zip(turns, directions, strict=True)]
    return turns
