"""Six faces of a box on a table (the paper's Appendix B): bias, response and g-sensitivity from known directions.

Every axis is a linear function of the direction of gravity: ``mean counts = response_row @ up + bias``. With one
reading of each of the six faces the least-squares solution is the appendix's: half differences and the mean of six. A
repeated face measures the drift and is not part of the fit, except in a gyroscope's bias, which the paper takes over
all readings (Table 4).

Readings may deviate by more than noise, because a table leans or a bias wanders. Six faces have two degrees of freedom
per axis from which this is estimated; if it is significant, it is included in the standard errors, equally for every
reading of a sensor. A leaning table affects all sensors, so that their errors are correlated.

Face labels are verified: the box axis that pointed up according to the accelerometers is compared with the one that the
phase states. If most accelerometers contradict a face, its label is wrong; if a single sensor does, its axes differ
from those in the log. Where a single rotation or reflection of the box explains all faces, either may be the cause, and
the error states both.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, up_vector
from imuarray.calibrate.fits import (
    Outlier,
    TriadFit,
    find_outlier,
    misfit_probability,
    moving_poses,
    outlier_of,
    straight_lines,
)
from imuarray.calibrate.model import SensorCalibration, nominal
from imuarray.calibrate.pose_readings import Pose, PoseReadings, read_poses
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

Indices = npt.NDArray[np.int64]

_UPS = np.array([up_vector(up) for up in UP_AXES])


def check_labels(readings: PoseReadings, up_box: Floats) -> None:
    """Raise CalibrationError for faces with wrong labels, and for accelerometers with axes that differ from those in
    the log; the message states the faces or the axes.

    `up_box` (k, 3) are the directions according to the labels.
    """
    force = readings.force_box_g()
    measured = (force @ _UPS.T).argmax(axis=2)
    labels = (up_box @ _UPS.T).argmax(axis=1)
    majority = np.array([Counter(column.tolist()).most_common(1)[0][0] for column in measured.T])
    wrong = np.flatnonzero((measured != labels).mean(axis=0) > 0.5)
    if len(wrong):
        turn = _common_rotation(labels, majority)
        if turn is None:
            raise CalibrationError(_label_error(readings, force, up_box, wrong, majority))
        raise CalibrationError(_axes_error(readings.sensors[0], turn) + _exchanged_labels(readings, wrong, turn))
    for sensor, face_labels in zip(readings.sensors, measured, strict=True):
        for face in np.flatnonzero(face_labels != labels):
            turn = _common_rotation(labels, face_labels)
            if turn is not None:
                raise CalibrationError(_axes_error(sensor, turn))
            raise CalibrationError(
                f"{readings.poses[face].where(sensor)}: phase {readings.poses[face].label!r}: it measured"
                f" {UP_AXES[face_labels[face]]} up, most accelerometers {UP_AXES[majority[face]]}"
            )


def axes_text(rows: Floats) -> str:
    """Return the signed box axes nearest to the rows (3, 3) of a response: "-Y+X+Z"."""
    return "".join(f"{'+' if row[np.abs(row).argmax()] > 0 else '-'}{'XYZ'[int(np.abs(row).argmax())]}" for row in rows)


def _common_rotation(labels: Indices, measured: Indices) -> Floats | None:
    """Return the signed permutation (3, 3) that maps the labelled direction of every face to the measured one; None if
    no such permutation exists, or if fewer than six faces do not determine it.
    """
    if len(np.unique(labels)) < len(UP_AXES):
        return None
    turn = np.array([_UPS[measured[np.flatnonzero(labels == up)[0]]] for up in (0, 2, 4)]).T
    is_permutation = np.abs(turn).sum(axis=1).max() == 1
    return turn if is_permutation and (_UPS[measured] == _UPS[labels] @ turn.T).all() else None


def _label_error(readings: PoseReadings, force: Floats, up_box: Floats, wrong: Indices, majority: Indices) -> str:
    error_g = np.median(np.linalg.norm(force - up_box, axis=2), axis=0)
    first = readings.sensors[0]
    wheres = [readings.poses[face].where(first) for face in wrong]
    names = [
        f"{'' if where == wheres[0] else where + ': '}phase {readings.poses[face].label!r} is {error_g[face]:.2f} g off"
        f" the other faces: {UP_AXES[majority[face]]} points up in it"
        for where, face in zip(wheres, wrong, strict=True)
    ]
    return f"{wheres[0]}: {'; '.join(names)}; mislabelled"


def _axes_error(sensor: SensorLog, turn: Floats) -> str:
    rows = sensor.orientation.T @ turn
    axis = "xyz"[int(np.abs(rows - sensor.orientation.T).max(axis=1).argmax())]
    return (
        f"{sensor.where}: axis {axis} does not point along axes {sensor.axes!r}; the faces indicate {axes_text(rows)!r}"
    )


def _exchanged_labels(readings: PoseReadings, wrong: Sequence[int] | Indices, turn: Floats) -> str:
    """Return the other explanation: exchanged labels."""
    faces = " and ".join(repr(readings.poses[face].label) for face in wrong)
    of_all = f", as do all {len(readings.sensors)} accelerometers" if len(readings.sensors) > 1 else ""
    chip = ", and no chip is mirrored" if np.linalg.det(turn) < 0 else ""
    return f"{of_all}; or the labels of {faces} are exchanged{chip}"


_ALL_FACES = "z_up, x_up, y_up, x_down, y_down, z_down are required"

LEANS_G = 0.01
"""Least distance, in g, of a face's mean force from the straight line through the other faces at which the box leaned:
0.6 degrees.
"""

_HALFWAY = 0.8
"""Cosine of 37 degrees: largest angle between a measured axis and the configured one."""


@dataclass(frozen=True)
class Faces:
    """Named faces: those of the fit, repeated ones (`checks`), and excluded ones (`left_out`)."""

    fitted: tuple[Pose, ...]
    checks: tuple[Pose, ...]
    left_out: tuple[Outlier, ...]


def select_faces(accelerometers: Sequence[SensorLog], poses: Sequence[Pose]) -> Faces:
    """Return the named faces, with those excluded in which the box moved or leaned.

    CalibrationError for labels that the accelerometers contradict, and if too few faces remain; it states the reason.
    """
    first = accelerometers[0]
    _refuse_too_few(first, [pose for pose in poses if not pose.is_check], ())
    readings = read_poses(accelerometers, poses)
    up_box = np.array([pose.up_box for pose in poses], float)
    check_labels(readings, up_box)
    bad = moving_poses(readings)
    place = _leaning(readings, up_box, bad)
    if place is not None:
        bad[place[0]] = place[1]
    left_out = tuple(outlier_of(poses[place], reason) for place, reason in sorted(bad.items()))
    sound = [pose for place, pose in enumerate(poses) if place not in bad]
    fitted = tuple(pose for pose in sound if not pose.is_check)
    _refuse_too_few(first, fitted, left_out)
    return Faces(fitted, tuple(pose for pose in sound if pose.is_check), left_out)


def _refuse_too_few(sensor: SensorLog, faces: Sequence[Pose], left_out: Sequence[Outlier]) -> None:
    """Raise CalibrationError for faces that do not determine a bias and a response."""
    if not determine_response(faces):
        names = ", ".join(pose.label for pose in faces) or "none"
        reasons = "".join(f"; phase {each.phase!r}: {each.reason}" for each in left_out)
        logs = list(dict.fromkeys(str(pose.log.path) for pose in faces if pose.log is not None))
        where = sensor.where if len(logs) < 2 else f"{', '.join(logs)}: sensor {sensor.name}"
        raise CalibrationError(f"{where}: faces {names}: too few; {_ALL_FACES}{reasons}")


def determine_response(faces: Sequence[Pose]) -> bool:
    """Return whether faces determine a bias and the three columns of a response."""
    ups = np.array([pose.up_box for pose in faces if not pose.is_check], float).reshape(-1, 3)
    return len(ups) >= 4 and int(np.linalg.matrix_rank(np.column_stack([ups, np.ones(len(ups))]))) == 4


def _leaning(readings: PoseReadings, up_box: Floats, bad: dict[int, str]) -> tuple[int, str] | None:
    """Return the index of the face that leaned, and the lean in words; None if no face leaned.

    The mean of all accelerometers is treated as one triad. The error of a face is its distance from the straight line
    through the other faces. With six faces, the two opposite faces of a pair have the same distance; then the face that
    is farther from the direction that the configured axes predict is chosen. CalibrationError if both are about equally
    far.
    """
    used = [place for place in range(len(readings.poses)) if place not in bad]
    design = np.column_stack([up_box[used], np.ones(len(used))])
    force = readings.force_box_g()[:, used].mean(axis=0)
    hat = design @ np.linalg.pinv(design)
    residual = force - hat @ force
    free = np.maximum(1 - np.diag(hat), 1e-9)  # a face that the others do not determine has no residual
    squares = (residual**2).sum(axis=1)
    whole = float(squares.sum())
    freedom = 3 * (len(used) - round(np.trace(hat)) - 1)
    chances = [
        misfit_probability(whole, whole - float(each / share), 3, freedom) if share > 1e-6 else 1.0
        for each, share in zip(squares, free, strict=True)
    ]
    off_g = np.sqrt(squares) / free
    result = find_outlier(chances, off_g, LEANS_G)
    if result is None:
        return None
    similar = np.flatnonzero(off_g > 0.9 * off_g[result])
    predicted = np.linalg.norm(force - up_box[used] - np.median(force - up_box[used], axis=0), axis=1)
    order = similar[np.argsort(predicted[similar])[::-1]]
    poses = [readings.poses[used[place]] for place in order]
    names = [pose.label for pose in poses]
    words = f"{1e3 * off_g[result]:.0f} mg off the straight line through the other faces"
    if len(order) > 1 and predicted[order[0]] < 2 * predicted[order[1]]:
        either = " or ".join(f"phase {name!r}" for name in sorted(names))
        raise CalibrationError(
            f"{poses[0].where(readings.sensors[0])}: {either} is {words}: moved or disturbed; record these faces again"
        )
    return used[int(order[0])], words


def fit_faces(sensor: SensorLog, poses: Sequence[Pose]) -> tuple[SensorCalibration, TriadFit, Floats]:
    """Calibrate one inertial triad from named faces. Returns also the straight lines through its readings, and the
    drift (3,) in counts: the first reading of a face less the repeated one.

    CalibrationError if faces are missing, or if the axes differ from those in the log.
    """
    faces = [pose for pose in poses if not pose.is_check]
    _refuse_too_few(sensor, faces, ())
    readings = read_poses([sensor], faces)
    design = np.column_stack([np.array([pose.up_box for pose in faces], float), np.ones(len(faces))])
    fit, _ = straight_lines(readings.mean_lsb[0], readings.variance_lsb2[0], design)
    checks = [pose for pose in poses if pose.is_check]
    drift = face_drift(sensor, faces, checks)
    if sensor.quantity == "specific_force":
        _check_axes(sensor, fit.coefficients[:, :3])
        return accelerometer_of(sensor, fit), fit, drift
    return gyroscope_of(sensor, fit, [*faces, *checks]), fit, drift


def accelerometer_of(sensor: SensorLog, fit: TriadFit) -> SensorCalibration:
    """Return an accelerometer's calibration: bias and response of the fit."""
    return replace(
        nominal(sensor),
        bias_lsb=fit.coefficients[:, 3],
        bias_sem_lsb=fit.bias_sem_lsb,
        bias_covariance_lsb2=fit.bias_covariance_lsb2,
        response_lsb_per_unit=fit.coefficients[:, :3],
        response_sem_lsb_per_unit=fit.response_sem.max(axis=1),
        response_covariance_lsb2_per_unit2=fit.response_covariance,
    )


def gyroscope_of(sensor: SensorLog, fit: TriadFit, readings: Sequence[Pose]) -> SensorCalibration:
    """Return a gyroscope's calibration: the bias is the mean over all readings, as in the paper's Table 4; the
    g-sensitivity is that of `fit`.
    """
    all_readings = read_poses([sensor], readings)
    variance = all_readings.variance_lsb2[0].sum(axis=0) / len(readings) ** 2
    variance = variance + fit.repeatability_lsb**2 / len(readings)
    return replace(
        nominal(sensor),
        bias_lsb=all_readings.mean_lsb[0].mean(axis=0),
        bias_sem_lsb=np.sqrt(variance),
        bias_covariance_lsb2=np.diag(variance),
        g_sensitivity_lsb_per_g=fit.coefficients[:, :3],
        g_sensitivity_sem_lsb_per_g=fit.response_sem,
    )


def leave_one_out_residual(sensor: SensorLog, faces: Sequence[Pose]) -> Floats:
    """Return the length (k,) in g of an accelerometer's specific force on each face, less 1 g, calibrated on the other
    faces; nan where these are too few.
    """
    mean = read_poses([sensor], faces).mean_lsb[0]
    design = np.column_stack([np.array([pose.up_box for pose in faces], float), np.ones(len(faces))])
    residual = np.full(len(faces), np.nan)
    for face in range(len(faces)):
        is_other = np.arange(len(faces)) != face
        if np.linalg.matrix_rank(design[is_other]) == design.shape[1]:
            line = np.linalg.lstsq(design[is_other], mean[is_other], rcond=None)[0]
            residual[face] = np.linalg.norm(np.linalg.solve(line[:3].T, mean[face] - line[3])) - 1
    return residual


def face_drift(sensor: SensorLog, faces: Sequence[Pose], checks: Sequence[Pose]) -> Floats:
    """Return the first reading of a face less the repeated one (3,) in counts; zeros without a repeated face."""
    for check in checks:
        first = next((pose for pose in faces if pose.up_box == check.up_box), None)
        if first is not None:
            means = read_poses([sensor], [first, check]).mean_lsb[0]
            return np.asarray(means[0] - means[1])
    return np.zeros(3)


def _check_axes(sensor: SensorLog, response: Floats) -> None:
    """Raise CalibrationError if an axis does not point in its configured direction."""
    rows = response / np.linalg.norm(response, axis=1)[:, None]
    agreement = np.sum(rows * sensor.orientation.T, axis=1)
    if agreement.min() < _HALFWAY:
        axis = "xyz"[int(agreement.argmin())]
        raise CalibrationError(
            f"{sensor.where}: axis {axis} does not point along axes {sensor.axes!r}; the faces indicate"
            f" {axes_text(rows)!r}"
        )
