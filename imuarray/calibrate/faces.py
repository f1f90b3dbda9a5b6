"""Six faces of a box on a table (the paper's Appendix B): bias, response and g-sensitivity from known directions of
gravity.

Every axis is a straight line in the direction of gravity: ``mean counts = response_row @ up + bias``. With one
reading of each of the six faces the least-squares solution is the appendix's: half differences and the mean of six. A
face that was read again tells the drift and is not part of the fit, except in a gyroscope's bias, which the paper
takes over all readings (Table 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.model import SensorCalibration, nominal
from imuarray.calibrate.poses import Pose, Reading, read_pose
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

Floats = npt.NDArray[np.float64]

_WORST_RESIDUAL_G = 0.1
"""A face further than this from the fit was mislabelled, or moved while it was read."""


def fit_faces(sensor: SensorLog, poses: Sequence[Pose]) -> tuple[SensorCalibration, Floats]:
    """Calibrate one inertial triad from named faces; also the drift (3,) in counts, first reading of a face minus its
    check.

    CalibrationError if faces are missing, if a reading does not fit its face, or if the axes are not where the log
    says.
    """
    faces = [pose for pose in poses if not pose.is_check]
    ups = np.array([pose.up_box for pose in faces], float)
    if len(faces) < 4 or np.linalg.matrix_rank(np.column_stack([ups, np.ones(len(ups))])) < 4:
        names = ", ".join(pose.phase.name for pose in faces) or "none"
        raise CalibrationError(
            f"{sensor.where}: faces {names}: too few; z_up, x_up, y_up, x_down, y_down, z_down are wanted"
        )
    readings = [read_pose(sensor, pose) for pose in faces]
    response, bias, bias_sem, response_sem, residual = _straight_line(ups, readings)
    drift = _drift(sensor, poses)
    if sensor.quantity == "specific_force":
        _check_faces(sensor, faces, residual, response)
        fitted = replace(
            nominal(sensor),
            bias_lsb=bias,
            bias_sem_lsb=bias_sem,
            response_lsb_per_unit=response,
            response_sem_lsb_per_unit=response_sem,
        )
        return fitted, drift
    everything = [*readings, *(read_pose(sensor, pose) for pose in poses if pose.is_check)]
    mean = np.mean([reading.mean_lsb for reading in everything], axis=0)
    sem = np.sqrt(np.sum([reading.sem_lsb**2 for reading in everything], axis=0)) / len(everything)
    return replace(nominal(sensor), bias_lsb=mean, bias_sem_lsb=sem, g_sensitivity_lsb_per_g=response), drift


def _straight_line(ups: Floats, readings: Sequence[Reading]) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Least squares of the readings (k, 3) on up vectors (k, 3): response, bias, their standard errors, residuals (k,
    3).
    """
    design = np.column_stack([ups, np.ones(len(ups))])
    means = np.array([reading.mean_lsb for reading in readings])
    solver = np.linalg.pinv(design)
    solution = solver @ means
    variance = np.array([reading.sem_lsb**2 for reading in readings])
    errors = np.sqrt(solver**2 @ variance)
    return solution[:3].T, solution[3], errors[3], errors[:3].max(axis=0), means - design @ solution


def _drift(sensor: SensorLog, poses: Sequence[Pose]) -> Floats:
    """First reading of a face minus its check, zeros if none was read again."""
    for check in (pose for pose in poses if pose.is_check):
        first = next((pose for pose in poses if pose.up_box == check.up_box and not pose.is_check), None)
        if first is not None:
            return read_pose(sensor, first).mean_lsb - read_pose(sensor, check).mean_lsb
    return np.zeros(3)


def _misfit(sensor: SensorLog, faces: Sequence[Pose]) -> tuple[int, float]:
    """The face that fits its label least, and by how much (g): what the log's own axes say that each should have read.

    A least-squares residual would not tell: it spreads evenly over a face and its opposite.
    """
    means = np.array([read_pose(sensor, pose).mean_lsb for pose in faces])
    promised = np.array([pose.up_box for pose in faces]) @ sensor.orientation * sensor.sensitivity
    off = np.linalg.norm(means - promised - np.median(means - promised, axis=0), axis=1) / sensor.sensitivity
    return int(off.argmax()), float(off.max())


def _check_faces(sensor: SensorLog, faces: Sequence[Pose], residual: Floats, response: Floats) -> None:
    """Refuse a face that does not fit, and axes that point elsewhere than the log says."""
    error_g = np.linalg.norm(residual, axis=1) / sensor.sensitivity
    if error_g.max() > _WORST_RESIDUAL_G:
        wrong, off_g = _misfit(sensor, faces)
        raise CalibrationError(
            f"{sensor.where}: phase {faces[wrong].phase.name!r} is {off_g:.2f} g off the other faces:"
            " mislabelled, or moved while it was read"
        )
    rows = response / np.linalg.norm(response, axis=1)[:, None]
    agreement = np.sum(rows * sensor.orientation.T, axis=1)
    if agreement.min() < 0.8:
        axis = "xyz"[int(agreement.argmin())]
        seen = "".join(
            f"{'+' if row[np.abs(row).argmax()] > 0 else '-'}{'XYZ'[int(np.abs(row).argmax())]}" for row in rows
        )
        raise CalibrationError(
            f"{sensor.where}: axis {axis} does not point as axes {sensor.axes!r} says; the faces say {seen!r}"
        )
