"""`calibrate tumble`: every inertial sensor from static poses, from named faces, or from a slow tumble by hand.

Bias and g-sensitivity of gyroscopes follow from any static poses (the method of the paper's Table 4, the whole matrix):
``mean counts = g_sensitivity @ up + bias (+ drift)``, with the directions of gravity from the accelerometers. The
paper's caveat holds: a change of the bias from pose to pose, mainly by temperature, looks like g-sensitivity. The fit
includes a steady drift if that is significant, and residuals increase the standard errors.

Quasi-static calibration: a hand that turns a box slowly adds accelerations of tens of mg to gravity, with either sign.
The path is divided into stretches of half a second. In each, the reading of every axis in the middle is taken from a
parabola through its readings (a mean would be too short, because of the turn within it), and all sensors are fitted to
one g like static poses (`imuarray.calibrate.gravity`).

The weight of a stretch depends on its motion q: the scatter of its readings about the parabola beyond the noise, and
the acceleration of a turn about a wrist, ``r w^2``. The error of the length of the force is ``a q`` (one sigma), where
a is estimated from the lengths themselves. All sensors have the same error, so more sensors do not reduce it.

Six faces (`fit_six_faces`) give bias and scale factor of accelerometers without knowing which pose is which. Gravity is
one g long in every pose. Of the nine parameters of ``|shape @ (mean - bias)| = 1 g``, poses on the six faces determine
the bias and the scale of each axis, but not the angles between the axes. Those have the data sheet's value here, zero
within `ANGLES_RAD`, as a prior. A face that leans by a few degrees changes bias and scale only in second order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, face_up
from imuarray.calibrate.faces import (
    Faces,
    accelerometer_of,
    determine_response,
    fit_faces,
    leave_one_out_residual,
    select_faces,
)
from imuarray.calibrate.fits import DRIFTS, Outlier, TriadFit, misfit_probability, outlier_of, straight_lines
from imuarray.calibrate.gravity import MIN_POSES, GravityFit, faces_of, fit_gravity, fit_weighted
from imuarray.calibrate.model import Calibration, SensorCalibration, nominal
from imuarray.calibrate.pose_readings import Pose, PoseReadings, find_poses, labelled_faces, read_poses
from imuarray.calibrate.segments import TemperatureSeries, thermometer_of
from imuarray.calibrate.thermal import SEGMENT_S
from imuarray.calibrate.turns import TurnFit, fit_turns
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog, require_logs
from imuarray.log.format import SATURATED, SUSPECT, Phase
from imuarray.printable import counted
from imuarray.robust import MEDIAN_SQUARE
from imuarray.units import STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANGLES_RAD = np.radians(0.5)
"""Standard deviation in rad of the direction of an axis in its chip, and of a chip's mounting, as in the gap tool's
populations.
"""

_FACES = 6
_UPPER = np.triu_indices(3, 1)
_STEP = 1e-6


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
        fit, force = _fit_sensor(sensor, means[number], float(noise))
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
    """Return the axes of the first sensor ("+x") along which no pose has gravity; None if a pose is not on a face."""
    faces = faces_of(readings.mean_lsb[0] / readings.sensitivity[0])
    if not faces:
        return None
    present = set(faces)
    return [
        f"{'+' if up else '-'}{'xyz'[axis]}" for axis in range(3) for up in (True, False) if (axis, up) not in present
    ]


def _fit_sensor(sensor: SensorLog, means_g: Floats, noise_g: float) -> tuple[TriadFit, Floats]:
    """Return the fit of one sensor, and the specific force (k, 3) in g along its axes."""
    weight = 1 / max(noise_g, 1e-9)

    def force(parameters: Floats) -> Floats:
        return np.asarray((means_g - parameters[:3]) @ _shape(parameters).T)

    def residuals(parameters: Floats) -> Floats:
        errors = (np.linalg.norm(force(parameters), axis=1) - 1) * weight
        return np.concatenate([errors, parameters[6:] / (np.sqrt(2) * ANGLES_RAD)])

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
    turned = _rotate_mounting(coefficients)
    total += ANGLES_RAD**2 * turned @ turned.T
    return TriadFit(coefficients, total, squares, max(freedom, 0.0), np.zeros(3)), force(best.x)


def _shape(parameters: Floats) -> Floats:
    """Return the matrix (3, 3) from readings less bias to specific force: scale factors, and angles between the axes
    without a common rotation.
    """
    shape = np.diag(parameters[3:6])
    shape[_UPPER] = parameters[6:] / 2
    shape.T[_UPPER] = parameters[6:] / 2
    return shape


def _coefficients(sensor: SensorLog, parameters: Floats) -> Floats:
    """Return the response to box axes and the bias (3, 4) in counts."""
    response = np.linalg.inv(_shape(parameters)) @ sensor.orientation.T
    return np.asarray(np.column_stack([response, parameters[:3]]) * sensor.sensitivity)


def _rotate_mounting(coefficients: Floats) -> Floats:
    """Return the change (12, 3) of coefficients by a rotation of the mounting about each box axis."""
    change = np.zeros((3, 4, 3))
    for axis in range(3):
        change[:, :3, axis] = np.cross(np.eye(3)[axis], coefficients[:, :3])
    return change.reshape(12, 3)


STRETCH_S = 0.5
"""Length of a stretch: long compared with the interval of readings, short compared with a turn (at 60 degrees per
second the error of a parabola is one ten-thousandth)."""

ARM_M = 0.3
"""Distance from the wrist to the box: a turn about the wrist adds ARM_M w^2 to gravity."""

FEWEST_STRETCHES = 30
"""Three times the unknowns of a sensor, and the factor of the motion."""

MOST_STRETCHES = 100
"""Largest number of stretches in the fit; the calmest of every direction are selected."""

WORTHLESS_G = 0.05
"""Largest standard error of a bias from a path: a data sheet's tolerance is as small (BMA-113)."""

_ROUNDS = 3
"""Number of iterations of fit and motion; two are enough to converge."""

_PARABOLA = 9 / 4
"""Variance of a parabola's value in the middle of evenly spaced readings over that of their mean."""

_LEAST_ROWS = 5
_FAST = 0.15
"""Largest scatter about its parabola, in g, of a stretch in which the box is turned slowly."""

_LEAST_MOTION_G = 1e-3
"""Least motion of a box that is held by hand."""

_CELLS = 3
"""Number of cells along each box axis by which directions are distinguished."""

_LARGEST_ERROR = 4.0
"""Largest error of the length of a stretch, in standard deviations; longer or shorter ones are excluded."""


def fit_path(sensors: Sequence[SensorLog], logs: Sequence[Log]) -> GravityFit:
    """Calibrate accelerometers jointly from the path of the box in `logs`; CalibrationError if that is insufficient."""
    readings, motion_g = _stretches(sensors, logs)
    if len(readings.poses) < FEWEST_STRETCHES:
        raise CalibrationError(
            f"{sensors[0].where}: {len(readings.poses)} slow stretches of {STRETCH_S:g} s, at least {FEWEST_STRETCHES}"
            " are required"
        )
    selected = _spread(readings, motion_g)
    readings, motion_g = readings.only(selected), motion_g[selected]
    scale = readings.sensitivity[:, None, None]
    noise = (readings.variance_lsb2 / scale**2).transpose(0, 2, 1).reshape(-1, len(readings.poses))
    left_out: list[Outlier] = []
    factor = 1.0
    for _ in range(_ROUNDS):
        fit = fit_weighted(readings, noise + len(sensors) * (factor * motion_g) ** 2, left_out)
        errors = fit.force_g.mean(axis=0) - 1
        free = len(errors) / (len(errors) - 9)
        factor = float(np.sqrt(free * np.median((errors / motion_g) ** 2) / MEDIAN_SQUARE))
        sound = np.abs(errors) < _LARGEST_ERROR * np.hypot(factor * motion_g, np.sqrt(noise.mean(axis=0)))
        if not sound.all() and sound.sum() >= FEWEST_STRETCHES:
            left_out += [
                outlier_of(pose, f"{1e3 * error:+.0f} mg from one g: moved")
                for pose, error, good in zip(readings.poses, errors, sound, strict=True)
                if not good
            ]
            readings, motion_g, noise = readings.only(np.flatnonzero(sound)), motion_g[sound], noise[:, sound]
    fit = fit_weighted(readings, noise + len(sensors) * (factor * motion_g) ** 2, left_out)
    worst_g = max(float(f.bias_sem_lsb.max() / s.sensitivity) for f, s in zip(fit.fits, sensors, strict=True))
    if not worst_g < WORTHLESS_G:
        raise CalibrationError(
            f"{sensors[0].where}: the path determines biases to {1e3 * worst_g:.0f} mg only: turn the box more"
            " slowly, and to all sides"
        )
    return fit


def _stretches(sensors: Sequence[SensorLog], logs: Sequence[Log]) -> tuple[PoseReadings, Floats]:
    """Return the readings in the middle of every stretch in which all sensors have valid ones, and its motion (k,) in
    g.
    """
    parts = [_read_stretches(sensors, log) for log in logs]
    poses = tuple(pose for each, _, _, _ in parts for pose in each)
    means = np.concatenate([mean for _, mean, _, _ in parts], axis=1)
    variances = np.concatenate([variance for _, _, variance, _ in parts], axis=1)
    zeros = np.zeros_like(means)
    readings = PoseReadings(tuple(sensors), poses, means, variances, zeros, zeros + 1.0)
    return readings, np.concatenate([motion for _, _, _, motion in parts])


def _read_stretches(sensors: Sequence[SensorLog], log: Log) -> tuple[list[Pose], Floats, Floats, Floats]:
    """Return the poses (k), the readings in their middle and their variances by noise (s, k, 3), and the motion (k,) of
    one log.
    """
    sensors_of_log = [log[sensor.name] for sensor in sensors]
    begin = max(int(sensor.time[0]) for sensor in sensors_of_log)
    end = min(int(sensor.time[len(sensor) - 1]) for sensor in sensors_of_log)
    width_ns = round(1e9 * STRETCH_S)
    count = max(0, (end - begin) // width_ns)
    means, scatters, rows = (np.full((len(sensors_of_log), count, 3), np.nan) for _ in range(3))
    for place, sensor in enumerate(sensors_of_log):
        for index in range(count):
            start_ns = begin + index * width_ns
            means[place, index], scatters[place, index], rows[place, index] = _middle(sensor, start_ns, width_ns)
    sound = np.flatnonzero(np.isfinite(means).all(axis=(0, 2)))
    means, scatters, rows = means[:, sound], scatters[:, sound], rows[:, sound]
    # The noise is estimated from the calmest tenth of the stretches; additional scatter of the others is motion.
    noise = np.quantile(scatters, 0.1, axis=1, keepdims=True) if len(sound) else scatters
    variances = _PARABOLA * noise / rows if len(sound) else scatters
    counts = np.array([sensor.sensitivity for sensor in sensors_of_log])[:, None, None]
    shaken = np.sqrt(np.maximum(scatters - noise, 0.0) / counts**2).max(axis=2).mean(axis=0)
    turns = np.array([sensor.orientation / sensor.sensitivity for sensor in sensors_of_log])
    force = np.einsum("sij,skj->ki", turns, means) / len(sensors_of_log)
    swung = ARM_M * _rate(force, sound) ** 2 / STANDARD_GRAVITY
    slow = np.flatnonzero(shaken < _FAST)
    motion = np.sqrt(shaken**2 + swung**2 + _LEAST_MOTION_G**2)[slow]
    poses = [
        Pose(Phase(begin + int(i) * width_ns, begin + (int(i) + 1) * width_ns, f"{i * STRETCH_S:g} s"), None, log)
        for i in sound[slow]
    ]
    return poses, means[:, slow], variances[:, slow], motion


def _middle(sensor: SensorLog, start_ns: int, width_ns: int) -> tuple[Floats, Floats, Floats]:
    """Return the value (3,) in the middle of a parabola through the readings of a stretch, their variance (3,) about
    it, and their number (3,); nan if a reading is saturated or suspect, or if there are too few.
    """
    part = sensor.between(start_ns, start_ns + width_ns)
    status = np.asarray(sensor.status[part])
    if len(status) < _LEAST_ROWS or (status & (SATURATED | SUSPECT)).any():
        unknown = np.full(3, np.nan)
        return unknown, unknown, unknown
    since = (np.asarray(sensor.time[part]) - start_ns - width_ns / 2) / (width_ns / 2)
    counts = np.asarray(sensor.counts[part], float)
    design = np.vander(since, 3)
    values, _, _, _ = np.linalg.lstsq(design, counts, rcond=None)
    variance = ((counts - design @ values) ** 2).sum(axis=0) / (len(counts) - 3)
    return values[2], variance, np.full(3, float(len(counts)))


def _rate(force: Floats, number: npt.NDArray[np.int64]) -> Floats:
    """Return the rate (k,) in rad/s at which the direction of a force (k, 3) turns; `number` (k,) are the numbers of
    the stretches.
    """
    if len(force) < 2:
        return np.zeros(len(force))
    unit = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
    seconds = STRETCH_S * np.maximum(np.diff(number), 1)
    steps = np.arccos(np.clip((unit[1:] * unit[:-1]).sum(axis=1), -1, 1)) / seconds
    return np.asarray(np.maximum(np.append(steps, steps[-1]), np.append(steps[0], steps)))


def _spread(readings: PoseReadings, motion_g: Floats) -> npt.NDArray[np.int64]:
    """Return the stretches of the fit: the calmest of every direction, in order of time."""
    if len(motion_g) <= MOST_STRETCHES:
        return np.arange(len(motion_g))
    force = readings.force_box_g().mean(axis=0)
    unit = force / np.linalg.norm(force, axis=1, keepdims=True)
    cell = np.clip(((unit + 1) / 2 * _CELLS).astype(int), 0, _CELLS - 1) @ [_CELLS**2, _CELLS, 1]
    order = np.argsort(motion_g)
    rank = np.empty(len(order), int)  # of each stretch among those of its direction
    for each in np.unique(cell):
        members = order[cell[order] == each]
        rank[members] = np.arange(len(members))
    return np.sort(np.lexsort((motion_g, rank))[:MOST_STRETCHES])


_MOST_DRIFT = 2


def fit_g_sensitivity(
    sensor: SensorLog, poses: tuple[Pose, ...], up_box: Floats
) -> tuple[SensorCalibration, TriadFit, Floats]:
    """Calibrate one gyroscope from its readings in `poses` (k), in which `up_box` (k, 3) pointed up. Returns the
    calibration with the mean bias over the poses, the fit, and the drift (3,) in counts, first pose less last.
    """
    readings = read_poses([sensor], poses)
    fit, terms = _fit(readings, up_box)
    fitted = replace(
        nominal(sensor),
        bias_lsb=fit.coefficients[:, 3],
        bias_sem_lsb=fit.bias_sem_lsb,
        bias_covariance_lsb2=fit.bias_covariance_lsb2,
        g_sensitivity_lsb_per_g=fit.coefficients[:, :3],
        g_sensitivity_sem_lsb_per_g=fit.response_sem,
    )
    return fitted, fit, fit.coefficients[:, 3:] @ (terms[0] - terms[-1])


def _fit(readings: PoseReadings, up_box: Floats) -> tuple[TriadFit, Floats]:
    """Fit straight lines with as many powers of time as are significant. Returns the fit and these terms (k, q)."""
    powers = readings.powers_of_time(_MOST_DRIFT)
    fits = [_line(readings, up_box, powers[:, :count]) for count in range(1, powers.shape[1] + 1)]
    used = 0
    for (_, squares), (better, fewer) in pairwise(fits):
        if misfit_probability(squares, fewer, 3, int(better.freedom)) > DRIFTS:
            break
        used += 1
    return fits[used][0], powers[:, : used + 1]


def _line(readings: PoseReadings, up_box: Floats, terms: Floats) -> tuple[TriadFit, float]:
    """Return one fit and its weighted sum of squares."""
    fit, residual = straight_lines(readings.mean_lsb[0], readings.variance_lsb2[0], np.column_stack([up_box, terms]))
    return fit, float((residual**2 / readings.variance_lsb2[0]).sum())


SIX_FACES = "six faces"
"""The method if all poses lie on the six faces, whose names are unknown (`fit_six_faces`)."""

PATH = "path"
"""The method if the box never rested (`fit_path`)."""

UNSURE_G = 0.01
"""A larger standard error of a bias causes a warning: poses on a table reach a tenth of it."""


@dataclass(frozen=True, repr=False)
class TumbleResult:
    """Result of `calibrate_tumble`: the calibration, how it was made and how well it fits.

    `method` is "faces", "gravity", "six faces" (without names) or "path" (a box that never rested), `poses` the number
    of poses used. By sensor: `drift_lsb` (3,), the first reading less the last of the same bias, from a face read twice
    or a fitted drift; `fits`; `turns` of gyroscopes that were turned enough. By accelerometer, over the poses
    `pose_names` (k): `pose_residual_g` (k,) is the length of the calibrated specific force less one g, with a fitted
    drift corrected, and `residual_g` its rms; `held_out_residual_g` is the rms with each pose calibrated from the other
    poses (nan if those are too few); `residual_steady_g` is the rms with the mean bias, which the calibration contains.
    `left_out` are the excluded poses and turns, with reasons.
    """

    calibration: Calibration
    method: str
    poses: int
    drift_lsb: Mapping[str, Floats]
    residual_g: Mapping[str, float]
    held_out_residual_g: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    residual_steady_g: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    pose_names: tuple[str, ...] = ()
    pose_residual_g: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    fits: Mapping[str, TriadFit] = field(default_factory=lambda: MappingProxyType({}))
    turns: Mapping[str, TurnFit] = field(default_factory=lambda: MappingProxyType({}))
    left_out: tuple[Outlier, ...] = ()
    warnings: tuple[str, ...] = ()
    """Sentences on parameters that the poses determine poorly."""

    def plot(self) -> Figure:
        """Plot the residual of every accelerometer in every pose, in mg; MissingExtraError without matplotlib."""
        from imuarray.calibrate.plots import residual_figure

        names = list(self.pose_residual_g)
        residual_mg = 1e3 * np.array([self.pose_residual_g[name] for name in names]).reshape(len(names), -1)
        return residual_figure(names, self.pose_names, residual_mg)

    def __repr__(self) -> str:
        worst = f", residual at most {1e3 * max(self.residual_g.values()):.2f} mg rms" if self.residual_g else ""
        return f"<TumbleResult by {self.method}: {self.poses} poses{worst}, {len(self.calibration.sensors)} sensors>"

    def _repr_html_(self) -> str:
        """Return a table of residuals by accelerometer, for notebooks."""
        from imuarray.html_table import html_table, number

        rows = [
            (name, number(1e3 * rms), number(1e3 * self.held_out_residual_g.get(name, math.nan)))
            for name, rms in self.residual_g.items()
        ]
        return html_table(repr(self), ("accelerometer", "residual, mg rms", "in poses not fitted, mg rms"), rows)


@dataclass(frozen=True)
class _Reference:
    """Gravity as measured by the accelerometers: their calibrations, fits and drifts by name; the length of the
    calibrated specific force less one g in each fitted pose, and the same with each pose calibrated from the others
    (`held_out_g`); the upward directions (k, 3) in all `poses`, and their covariance (3 k, 3 k).
    """

    method: str
    poses: tuple[Pose, ...]
    up_box: Floats
    up_covariance: Floats
    known: dict[str, SensorCalibration]
    fits: dict[str, TriadFit]
    drift_lsb: dict[str, Floats]
    residual_g: dict[str, Floats]
    held_out_g: dict[str, Floats]
    left_out: tuple[Outlier, ...]

    @property
    def fitted(self) -> list[Pose]:
        """The poses of the fit, without those that were read again."""
        return [pose for pose in self.poses if not pose.is_check]


def calibrate_tumble(
    *logs: Log, progress: Callable[[str, int, int], None] = lambda what, done, of: None
) -> TumbleResult:
    """Measure bias and response of the accelerometers, and bias, g-sensitivity and (from turns) response of the
    gyroscopes, from one log or from several logs of the same array (one per face, for example).

    If the phases name the faces, or state which axis was up, the paper's Appendix B is used; otherwise at least nine
    static poses are detected in the logs. `progress` is called with the step, the number done and the total.
    CalibrationError states what is missing or which face does not fit.
    """
    require_logs(logs, "calibrate_tumble(*logs)")
    first = logs[0]
    accelerometers, gyroscopes = first.of("specific_force"), first.of("angular_rate")
    if not accelerometers:
        raise CalibrationError(f"{first.path}: it has no accelerometer; tumble needs gravity")
    labelled = labelled_faces(logs)
    if labelled and not face_up(labelled[0].phase.name) and not determine_response(labelled):
        labelled = []  # a few phases state which axis was up, in logs of any poses
    faces = select_faces(accelerometers, labelled) if labelled else None
    reference = (
        _calibrate_by_gravity(accelerometers, logs, progress)
        if faces is None
        else _calibrate_by_faces(accelerometers, faces)
    )
    calibrations, fits, drift = dict(reference.known), dict(reference.fits), dict(reference.drift_lsb)
    turns: dict[str, TurnFit] = {}
    calibrated = [(sensor, calibrations[sensor.name]) for sensor in accelerometers]
    for done, sensor in enumerate(() if reference.method == PATH else gyroscopes, start=1):
        calibrations[sensor.name], fits[sensor.name], drift[sensor.name] = (
            fit_g_sensitivity(sensor, reference.poses, reference.up_box)
            if faces is None
            else fit_faces(sensor, [*faces.fitted, *faces.checks])
        )
        fit = fit_turns(
            sensor, calibrations[sensor.name], reference.poses, reference.up_box, reference.up_covariance, calibrated
        )
        if fit is not None:
            turns[sensor.name] = fit
            calibrations[sensor.name] = fit.complete(calibrations[sensor.name])
        progress("gyroscopes", done, len(gyroscopes))
    temperature = _temperature(first, reference.poses)
    sensors = {name: replace(calibration, temperature_degc=temperature) for name, calibration in calibrations.items()}
    return TumbleResult(
        Calibration(sensors, tuple(str(log.path) for log in logs)).stamped(logs),
        reference.method,
        len(reference.poses),
        drift,
        {name: _rms(residual) for name, residual in reference.residual_g.items()},
        {name: _rms(residual) for name, residual in reference.held_out_g.items()},
        {name: _rms(residual) for name, residual in _steady_g(calibrated, reference).items()},
        tuple(pose.label for pose in reference.fitted),
        reference.residual_g,
        fits,
        turns,
        reference.left_out,
        tuple(_warnings([*accelerometers, *gyroscopes], calibrations, reference, faces)),
    )


def _warnings(
    sensors: Sequence[SensorLog],
    calibrations: Mapping[str, SensorCalibration],
    reference: _Reference,
    faces: Faces | None,
) -> Iterator[str]:
    """Yield the warnings about a calibration."""
    if faces is not None:
        ups = {pose.phase.up for pose in faces.fitted}
        if missing := [up for up in UP_AXES if up not in ups]:
            yield (
                f"no face with {', '.join(missing)} up: the opposite face is not checked, and its error"
                " affects bias and scale factor; record all six"
            )
    if reference.method == SIX_FACES:
        yield (
            "the poses lie on the six faces, whose names are unknown: the angles between the axes are the data sheet's"
            f" (+- {np.degrees(ANGLES_RAD):g} degrees); add poses on edges and corners, or name the faces if the box"
            " stood on them"
        )
    if uncalibrated := [sensor.name for sensor in sensors if sensor.name not in calibrations]:
        yield f"{', '.join(uncalibrated)} not calibrated: the bias of a gyroscope can only be measured at rest"
    for sensor in sensors:
        sem = calibrations[sensor.name].bias_sem_lsb if sensor.quantity == "specific_force" else None
        worst = None if sem is None else int((sem / sensor.sensitivity).argmax())
        if sem is not None and worst is not None and sem[worst] > UNSURE_G * sensor.sensitivity:
            yield (
                f"{sensor.name} {'xyz'[worst]}: bias known to +- {1e3 * sem[worst] / sensor.sensitivity:.3g} mg only:"
                " the poses disagree; check that the box was still and the labels are right"
            )


def _calibrate_by_gravity(
    accelerometers: Sequence[SensorLog], logs: Sequence[Log], progress: Callable[[str, int, int], None]
) -> _Reference:
    """Calibrate the accelerometers from any poses; from the six faces if there are no other poses; from the path if
    there are too few poses.
    """
    poses = [pose for log in logs for pose in find_poses(log)]
    missing = missing_faces(read_poses(accelerometers[:1], poses)) if poses else None
    method = "gravity" if len(poses) >= MIN_POSES and missing is None else PATH
    if missing == []:
        method = SIX_FACES
        fit = fit_six_faces(accelerometers, poses)
    elif method == PATH and len(poses) < MIN_POSES:
        try:
            fit = fit_path(accelerometers, logs)
        except CalibrationError as error:
            faces = f" (no pose with {', '.join(missing)} of the sensor up)" if missing else ""
            raise CalibrationError(
                f"{accelerometers[0].where}: {counted(len(poses), 'static pose')}{faces}, at least {MIN_POSES} are"
                " required, or the six faces;"
                " the path between them does not determine the parameters either"
                f" ({str(error).removeprefix(f'{accelerometers[0].where}: ')})"
            ) from None
    else:
        method = "gravity"
        fit = fit_gravity(accelerometers, poses, lambda done: progress("leaving out poses in turn", done, len(poses)))
    names = [sensor.name for sensor in accelerometers]
    return _Reference(
        method,
        fit.poses,
        fit.up_box,
        fit.up_covariance,
        dict(zip(names, fit.calibrations, strict=True)),
        dict(zip(names, fit.fits, strict=True)),
        dict(zip(names, fit.drift_lsb, strict=True)),
        dict(zip(names, fit.force_g - 1, strict=True)),
        dict(zip(names, fit.held_out_force_g - 1, strict=True)),
        fit.left_out,
    )


def _calibrate_by_faces(accelerometers: Sequence[SensorLog], faces: Faces) -> _Reference:
    """Calibrate the accelerometers by the paper's Appendix B. The directions are those of the calibrated
    accelerometers, because a table may lean.
    """
    all_poses = sorted(
        (*faces.fitted, *faces.checks),
        key=lambda pose: ("" if pose.log is None else str(pose.log.path), pose.phase.start_ns),
    )
    result = {sensor.name: fit_faces(sensor, all_poses) for sensor in accelerometers}
    calibrations = {name: calibration for name, (calibration, _, _) in result.items()}
    readings = read_poses(accelerometers, all_poses)
    forces = np.array(
        [_force_g(calibrations[s.name], mean) for s, mean in zip(accelerometers, readings.mean_lsb, strict=True)]
    )
    up_box = forces.mean(axis=0)
    fits = {name: fit for name, (_, fit, _) in result.items()}
    variances = [np.mean(fits[s.name].repeatability_lsb ** 2) / s.sensitivity**2 for s in accelerometers]
    noise = (readings.variance_lsb2 / readings.sensitivity[:, None, None] ** 2).mean(axis=(1, 2))
    fitted = [place for place, pose in enumerate(all_poses) if not pose.is_check]
    return _Reference(
        "faces",
        tuple(all_poses),
        up_box / np.linalg.norm(up_box, axis=1, keepdims=True),
        float(np.mean(variances) + np.sum(noise) / len(noise) ** 2) * np.eye(up_box.size),
        calibrations,
        fits,
        {name: drift for name, (_, _, drift) in result.items()},
        {s.name: np.linalg.norm(force[fitted], axis=1) - 1 for s, force in zip(accelerometers, forces, strict=True)},
        {sensor.name: leave_one_out_residual(sensor, faces.fitted) for sensor in accelerometers},
        faces.left_out,
    )


def _force_g(calibration: SensorCalibration, mean_lsb: Floats) -> Floats:
    """Return the specific force (k, 3) in g in the box frame."""
    return np.asarray(calibration.stimulus_box(mean_lsb) / STANDARD_GRAVITY)


def _steady_g(
    accelerometers: Sequence[tuple[SensorLog, SensorCalibration]], reference: _Reference
) -> dict[str, Floats]:
    """Return the length (k,) of the specific force less one g in the fitted poses with the mean bias, by sensor."""
    fitted = reference.fitted
    return {
        sensor.name: np.linalg.norm(_force_g(calibration, read_poses([sensor], fitted).mean_lsb[0]), axis=1) - 1
        for sensor, calibration in accelerometers
    }


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _temperature(log: Log, poses: Sequence[Pose]) -> float | None:
    """Return the mean temperature over the poses in degC, by the best thermometer with a zero; None without one."""
    parts = []
    logs = [log if pose.log is None else pose.log for pose in poses]
    for own in {id(each): each for each in logs}.values():
        thermometer = next(
            (result for sensor in own.of("specific_force") if (result := _thermometer(own, sensor))), None
        )
        if thermometer is None:
            return None
        phases = [pose.phase for pose, each in zip(poses, logs, strict=True) if each is own]
        parts.append(thermometer.at(np.array([(phase.start_ns + phase.end_ns) * 0.5e-9 for phase in phases])))
    return float(np.concatenate(parts).mean()) if parts else None


def _thermometer(log: Log, sensor: SensorLog) -> TemperatureSeries | None:
    result = thermometer_of(log, sensor, SEGMENT_S) if len(sensor) else None
    return None if result is None or result.kind == "relative" else result
