"""`calibrate tumble`: every inertial sensor of a log from static poses, named faces if the log has them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.faces import fit_faces
from imuarray.calibrate.gravity import fit_gravity
from imuarray.calibrate.model import Calibration, SensorCalibration, nominal
from imuarray.calibrate.poses import Pose, find_poses, named_faces, read_pose
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tumble:
    """The calibration, how it was made and how well it fits.

    `method` is "faces" or "gravity"; `drift_lsb` (3,) by sensor for a face read twice; `residual_g` rms over the
    poses by accelerometer (distance of the specific force from one g).
    """

    calibration: Calibration
    method: str
    poses: int
    drift_lsb: dict[str, Floats]
    residual_g: dict[str, float]


def calibrate_tumble(*logs: Log) -> Tumble:
    """Bias and response of the accelerometers, bias and g-sensitivity of the gyroscopes, from one log or from several
    of the same array (a log a face, say).

    With named faces by Appendix B; without, from at least nine static poses that are found in the logs.
    CalibrationError says what is missing or which face does not fit.
    """
    first = logs[0]
    accelerometers, gyroscopes = first.of("specific_force"), first.of("angular_rate")
    if not accelerometers:
        raise CalibrationError(f"{first.path}: no accelerometer in it; tumble needs gravity")
    faces = [pose for log in logs for pose in named_faces(log)]
    if faces:
        fits = {sensor.name: fit_faces(sensor, faces) for sensor in (*accelerometers, *gyroscopes)}
        fitted = {name: calibration for name, (calibration, _) in fits.items()}
        drift = {name: drift for name, (_, drift) in fits.items()}
        poses, method = faces, "faces"
    else:
        poses, method, drift = [pose for log in logs for pose in find_poses(log)], "gravity", {}
        joint, _ = fit_gravity(accelerometers, poses)
        fitted = {calibration.name: calibration for calibration in joint}
        fitted.update({sensor.name: _still_bias(sensor, poses) for sensor in gyroscopes})
    temperature = _temperature(first, poses)
    fitted = {name: replace(calibration, temperature_degc=temperature) for name, calibration in fitted.items()}
    return Tumble(
        Calibration(fitted, tuple(str(log.path) for log in logs)),
        method,
        len(poses),
        drift,
        {sensor.name: _residual_g(sensor, poses, fitted[sensor.name]) for sensor in accelerometers},
    )


def _still_bias(sensor: SensorLog, poses: list[Pose]) -> SensorCalibration:
    """A gyroscope's bias: the mean over all poses, each as heavy as the next."""
    readings = [read_pose(sensor, pose) for pose in poses]
    mean = np.mean([reading.mean_lsb for reading in readings], axis=0)
    sem = np.sqrt(np.sum([reading.sem_lsb**2 for reading in readings], axis=0)) / len(readings)
    return replace(nominal(sensor), bias_lsb=mean, bias_sem_lsb=sem)


def _residual_g(sensor: SensorLog, poses: list[Pose], calibration: SensorCalibration) -> float:
    """Rms over the poses of (length of the calibrated specific force minus one g), in g."""
    means = np.array([read_pose(sensor, pose).mean_lsb for pose in poses if not pose.is_check])
    force_g = (means - calibration.bias_lsb) @ np.linalg.inv(calibration.response_lsb_per_unit).T
    return float(np.sqrt(np.mean((np.linalg.norm(force_g, axis=1) - 1) ** 2)))


def _temperature(log: Log, poses: list[Pose]) -> float | None:
    """Mean temperature over the poses in degC, from an independent thermometer if the log has one."""
    for sensor in log.of("pressure"):
        parts = []
        for pose in poses:
            here, rows = pose.rows_of(sensor)
            parts.append(np.asarray(here.compensated("temperature")[rows]))
        values = np.concatenate(parts) if parts else np.array([])
        if len(values):
            return float(values.mean())
    return None
