"""Bias and scale factor of accelerometers from the six faces, without knowing which pose is which.

Gravity is one g long in every pose. Of the nine parameters of ``|shape @ (mean - bias)| = 1 g``, poses on the six faces
determine the bias and the scale of each axis, but not the angles between the axes. Those have the data sheet's value
here, zero within `ANGLES_RAD`, as a prior. That a face leans by a few degrees changes bias and scale only in the second
order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from imuarray.arrays import Floats
from imuarray.calibrate.faces import accelerometer_of
from imuarray.calibrate.fits import TriadFit
from imuarray.calibrate.gravity import FACE_COSINE, GravityFit
from imuarray.calibrate.pose_readings import Pose, PoseReadings, read_poses
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

ANGLES_RAD = np.radians(0.5)
"""Standard deviation of the direction of an axis in its chip, and of a chip's mounting, as in the gap tool's
populations.
"""

_FACES = 6
_UPPER = np.triu_indices(3, 1)
_STEP = 1e-6


def faces_of(means_g: Floats) -> list[tuple[int, bool]]:
    """Return the axis (0, 1, 2) that gravity is along in each pose (k, 3), and whether it is positive; [] if a pose is
    on no face.
    """
    directions = means_g / np.linalg.norm(means_g, axis=1, keepdims=True)
    axis = np.argmax(np.abs(directions), axis=1)
    along = np.take_along_axis(directions, axis[:, None], axis=1)[:, 0]
    if (np.abs(along) < FACE_COSINE).any():
        return []
    return list(zip(axis.tolist(), (along > 0).tolist(), strict=True))


def fit_six_faces(sensors: Sequence[SensorLog], poses: Sequence[Pose]) -> GravityFit:
    """Calibrate accelerometers from static poses on the six faces, in any order; CalibrationError if they are not on
    all six.
    """
    readings = read_poses(sensors, poses)
    means = readings.mean_lsb / readings.sensitivity[:, None, None]
    missing = missing_faces(readings)
    if missing is None or missing:
        raise CalibrationError(f"{sensors[0].where}: the poses are not on the six faces")
    count = len(sensors)
    fits, forces = [], []
    for number, sensor in enumerate(sensors):
        noise = np.sqrt(readings.variance_lsb2[number].mean()) / sensor.sensitivity
        fit, force = _fit(sensor, means[number], float(noise))
        fits.append(fit)
        forces.append(force @ sensor.orientation.T)
    up_box = np.mean(forces, axis=0)
    covariance = np.zeros((12 * count, 12 * count))
    for number, fit in enumerate(fits):
        place = slice(12 * number, 12 * number + 12)
        covariance[place, place] = fit.covariance
    lengths = np.array([np.linalg.norm(force, axis=1) for force in forces])
    return GravityFit(
        calibrations=tuple(accelerometer_of(sensor, fit) for sensor, fit in zip(sensors, fits, strict=True)),
        fits=tuple(fits),
        covariance=covariance,
        poses=readings.poses,
        up_box=up_box / np.linalg.norm(up_box, axis=1, keepdims=True),
        up_covariance=ANGLES_RAD**2 / count * np.eye(up_box.size),
        force_g=lengths,
        held_out_force_g=np.full(lengths.shape, np.nan),
        drift_lsb=np.zeros((count, 3)),
        drift_terms=0,
        left_out=(),
    )


def missing_faces(readings: PoseReadings) -> list[str] | None:
    """Return the axes of the first sensor ("+x") along which no pose has gravity; None if a pose is on no face."""
    faces = faces_of(readings.mean_lsb[0] / readings.sensitivity[0])
    if not faces:
        return None
    known = set(faces)
    return [
        f"{'+' if up else '-'}{'xyz'[axis]}" for axis in range(3) for up in (True, False) if (axis, up) not in known
    ]


def _fit(sensor: SensorLog, means_g: Floats, noise_g: float) -> tuple[TriadFit, Floats]:
    """Return the fit of one sensor, and the specific force (k, 3) in g along its axes."""
    weight = 1 / max(noise_g, 1e-9)

    def force(parameters: Floats) -> Floats:
        return np.asarray((means_g - parameters[:3]) @ _shape(parameters).T)

    def residuals(parameters: Floats) -> Floats:
        off = (np.linalg.norm(force(parameters), axis=1) - 1) * weight
        return np.concatenate([off, parameters[6:] / (np.sqrt(2) * ANGLES_RAD)])

    start = np.concatenate([np.zeros(3), np.ones(3), np.zeros(3)])
    best = least_squares(residuals, start)
    squares = float((best.fun[: len(means_g)] ** 2).sum())
    freedom = float(len(means_g) - _FACES)
    beyond = max(squares / freedom, 1.0) if freedom > 0 else 1.0
    covariance = np.linalg.inv(best.jac.T @ best.jac) * beyond
    slope = np.stack(
        [
            (_coefficients(sensor, best.x + step) - _coefficients(sensor, best.x - step)).ravel() / (2 * _STEP)
            for step in _STEP * np.eye(9)
        ],
        axis=1,
    )
    coefficients = _coefficients(sensor, best.x)
    total = slope @ covariance @ slope.T
    turned = _turned(coefficients)
    total += ANGLES_RAD**2 * turned @ turned.T
    return TriadFit(coefficients, total, squares, max(freedom, 0.0), np.zeros(3)), force(best.x)


def _shape(parameters: Floats) -> Floats:
    """Return the matrix (3, 3) from readings less bias to specific force: scales, and angles that turn nothing."""
    shape = np.diag(parameters[3:6])
    shape[_UPPER] = parameters[6:] / 2
    shape.T[_UPPER] = parameters[6:] / 2
    return shape


def _coefficients(sensor: SensorLog, parameters: Floats) -> Floats:
    """Return the response to box axes and the bias (3, 4) in counts."""
    response = np.linalg.inv(_shape(parameters)) @ sensor.orientation.T
    return np.asarray(np.column_stack([response, parameters[:3]]) * sensor.sensitivity)


def _turned(coefficients: Floats) -> Floats:
    """Return the change (12, 3) of coefficients by a rotation of the mounting about each box axis."""
    change = np.zeros((3, 4, 3))
    for axis in range(3):
        change[:, :3, axis] = np.cross(np.eye(3)[axis], coefficients[:, :3])
    return change.reshape(12, 3)
