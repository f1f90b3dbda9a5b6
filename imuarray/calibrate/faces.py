"""Six faces of a box on a table (the paper's Appendix B): bias, response and g-sensitivity from known directions.

Every axis is a linear function of the direction of gravity: ``mean counts = response_row @ up + bias``. With one
reading of each of the six faces the least-squares solution is the appendix's: half differences and the mean of six. A
repeated face measures the drift and is not part of the fit, except in a gyroscope's bias, which the paper takes over
all readings (Table 4).

Readings may be off by more than noise, because a table leans or a bias wanders. That shows in the two degrees of
freedom that six faces leave per axis; where it is significant it is part of the standard errors, equally in every
reading of a sensor. A leaning table affects all sensors, so their errors are then correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.disturbed import Exclusion, chance_of_misfit, exclusion_of, moved_within, worst
from imuarray.calibrate.fits import TriadFit, straight_lines
from imuarray.calibrate.labels import axes_text, check_labels
from imuarray.calibrate.model import SensorCalibration, nominal
from imuarray.calibrate.pose_readings import Pose, PoseReadings, read_poses
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

_WANTED = "z_up, x_up, y_up, x_down, y_down, z_down are required"

LEANS_G = 0.01
"""A face this far from the straight line through the others did not stand as its label says: 0.6 degrees."""

_HALFWAY = 0.8
"""Cosine of 37 degrees: an axis further from where it should be points elsewhere."""


@dataclass(frozen=True)
class Faces:
    """Named faces that were found sound: those of the fit, those that were read again, and those left out."""

    fitted: tuple[Pose, ...]
    checks: tuple[Pose, ...]
    left_out: tuple[Exclusion, ...]

    @property
    def up_box(self) -> Floats:
        """(k, 3) what the labels of the fitted ones say."""
        return np.array([pose.up_box for pose in self.fitted], float).reshape(-1, 3)


def sound_faces(accelerometers: Sequence[SensorLog], poses: Sequence[Pose]) -> Faces:
    """The named faces without those in which the box moved or stood otherwise than the label says.

    CalibrationError for labels that accelerometers contradict, and if too few faces remain: it names what was wrong.
    """
    first = accelerometers[0]
    _refuse_too_few(first, [pose for pose in poses if not pose.is_check], ())
    readings = read_poses(accelerometers, poses)
    up_box = np.array([pose.up_box for pose in poses], float)
    check_labels(readings, up_box)
    bad = moved_within(readings)
    place = _leaning(readings, up_box, bad)
    if place is not None:
        bad[place[0]] = place[1]
    left_out = tuple(exclusion_of(poses[place], reason) for place, reason in sorted(bad.items()))
    kept = [pose for place, pose in enumerate(poses) if place not in bad]
    fitted = tuple(pose for pose in kept if not pose.is_check)
    _refuse_too_few(first, fitted, left_out)
    return Faces(fitted, tuple(pose for pose in kept if pose.is_check), left_out)


def _refuse_too_few(sensor: SensorLog, faces: Sequence[Pose], left_out: Sequence[Exclusion]) -> None:
    """Faces that don't tell a bias and three columns apart."""
    if not tell_all(faces):
        names = ", ".join(pose.label for pose in faces) or "none"
        why = "".join(f"; phase {each.phase!r}: {each.reason}" for each in left_out)
        logs = list(dict.fromkeys(str(pose.log.path) for pose in faces if pose.log is not None))
        where = sensor.where if len(logs) < 2 else f"{', '.join(logs)}: sensor {sensor.name}"
        raise CalibrationError(f"{where}: faces {names}: too few; {_WANTED}{why}")


def tell_all(faces: Sequence[Pose]) -> bool:
    """Return whether faces tell a bias and the three columns of a response."""
    ups = np.array([pose.up_box for pose in faces if not pose.is_check], float).reshape(-1, 3)
    return len(ups) >= 4 and int(np.linalg.matrix_rank(np.column_stack([ups, np.ones(len(ups))]))) == 4


def _leaning(readings: PoseReadings, up_box: Floats, bad: dict[int, str]) -> tuple[int, str] | None:
    """The face that stood otherwise than its label says, by place, and how far in words; None if none did.

    The mean of all accelerometers is one triad, and what one face is off by shows in its distance from the line
    through the others. Six faces leave two of a pair alike; then it is the one that is further from where the
    configured axes promise it. CalibrationError where that does not tell either.
    """
    used = [place for place in range(len(readings.poses)) if place not in bad]
    design = np.column_stack([up_box[used], np.ones(len(used))])
    force = readings.force_box_g()[:, used].mean(axis=0)
    hat = design @ np.linalg.pinv(design)
    residual = force - hat @ force
    free = np.maximum(1 - np.diag(hat), 1e-9)  # a face that nothing else tells has none
    squares = (residual**2).sum(axis=1)
    whole = float(squares.sum())
    freedom = 3 * (len(used) - round(np.trace(hat)) - 1)
    chances = [
        chance_of_misfit(whole, whole - float(each / share), 3, freedom) if share > 1e-6 else 1.0
        for each, share in zip(squares, free, strict=True)
    ]
    off_g = np.sqrt(squares) / free
    result = worst(chances, off_g, LEANS_G)
    if result is None:
        return None
    similar = np.flatnonzero(off_g > 0.9 * off_g[result])
    promised = np.linalg.norm(force - up_box[used] - np.median(force - up_box[used], axis=0), axis=1)
    order = similar[np.argsort(promised[similar])[::-1]]
    poses = [readings.poses[used[place]] for place in order]
    names = [pose.label for pose in poses]
    words = f"{1e3 * off_g[result]:.0f} mg off the straight line through the other faces"
    if len(order) > 1 and promised[order[0]] < 2 * promised[order[1]]:
        either = " or ".join(f"phase {name!r}" for name in sorted(names))
        raise CalibrationError(
            f"{poses[0].where(readings.sensors[0])}: {either} is {words}: moved or disturbed; record these faces again"
        )
    return used[int(order[0])], words


def fit_faces(sensor: SensorLog, poses: Sequence[Pose]) -> tuple[SensorCalibration, Floats]:
    """Calibrate one inertial triad from named faces; also the drift (3,) in counts, first reading of a face minus its
    check.

    CalibrationError if faces are missing, or if the axes are not where the log says.
    """
    faces = [pose for pose in poses if not pose.is_check]
    _refuse_too_few(sensor, faces, ())
    fit = face_fit(sensor, faces)
    checks = [pose for pose in poses if pose.is_check]
    drift = face_drift(sensor, faces, checks)
    if sensor.quantity == "specific_force":
        _check_axes(sensor, fit.coefficients[:, :3])
        return accelerometer_of(sensor, fit), drift
    return gyroscope_of(sensor, fit, [*faces, *checks]), drift


def face_fit(sensor: SensorLog, faces: Sequence[Pose]) -> TriadFit:
    """The straight lines of one triad through its readings of `faces`."""
    readings = read_poses([sensor], faces)
    ups = np.array([pose.up_box for pose in faces], float)
    design = np.column_stack([ups, np.ones(len(ups))])
    return straight_lines(readings.mean_lsb[0], readings.variance_lsb2[0], design)[0]


def accelerometer_of(sensor: SensorLog, fit: TriadFit) -> SensorCalibration:
    """Bias and response."""
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
    """Bias, the mean over all readings as in Table 4, and g-sensitivity, half differences."""
    everything = read_poses([sensor], readings)
    variance = everything.variance_lsb2[0].sum(axis=0) / len(readings) ** 2
    variance = variance + fit.repeatability_lsb**2 / len(readings)
    return replace(
        nominal(sensor),
        bias_lsb=everything.mean_lsb[0].mean(axis=0),
        bias_sem_lsb=np.sqrt(variance),
        bias_covariance_lsb2=np.diag(variance),
        g_sensitivity_lsb_per_g=fit.coefficients[:, :3],
        g_sensitivity_sem_lsb_per_g=fit.response_sem,
    )


def faces_apart(sensor: SensorLog, faces: Sequence[Pose]) -> Floats:
    """(k,) length of an accelerometer's specific force less one g in each face, by the straight lines through the other
    faces; nan where these are too few.
    """
    mean = read_poses([sensor], faces).mean_lsb[0]
    design = np.column_stack([np.array([pose.up_box for pose in faces], float), np.ones(len(faces))])
    apart = np.full(len(faces), np.nan)
    for face in range(len(faces)):
        others = np.arange(len(faces)) != face
        if np.linalg.matrix_rank(design[others]) == design.shape[1]:
            line = np.linalg.lstsq(design[others], mean[others], rcond=None)[0]
            apart[face] = np.linalg.norm(np.linalg.solve(line[:3].T, mean[face] - line[3])) - 1
    return apart


def face_drift(sensor: SensorLog, faces: Sequence[Pose], checks: Sequence[Pose]) -> Floats:
    """(3,) first reading of a face minus its check in counts, zeros if none was read again."""
    for check in checks:
        first = next((pose for pose in faces if pose.up_box == check.up_box), None)
        if first is not None:
            both = read_poses([sensor], [first, check]).mean_lsb[0]
            return np.asarray(both[0] - both[1])
    return np.zeros(3)


def _check_axes(sensor: SensorLog, response: Floats) -> None:
    """Refuse axes that point elsewhere than the log says."""
    rows = response / np.linalg.norm(response, axis=1)[:, None]
    agreement = np.sum(rows * sensor.orientation.T, axis=1)
    if agreement.min() < _HALFWAY:
        axis = "xyz"[int(agreement.argmin())]
        raise CalibrationError(
            f"{sensor.where}: axis {axis} does not point as axes {sensor.axes!r} says; the faces say"
            f" {axes_text(rows)!r}"
        )
