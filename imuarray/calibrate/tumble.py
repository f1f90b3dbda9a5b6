"""`calibrate tumble`: every inertial sensor of a log from static poses, named faces if the log has them.

Bias and g-sensitivity of gyroscopes follow from any static poses (the method of the paper's Table 4, the whole matrix):
``mean counts = g_sensitivity @ up + bias (+ drift)``, with the directions of gravity from the accelerometers. The
paper's caveat holds: a change of the bias from pose to pose, by temperature above all, looks like g-sensitivity. A
steady drift is part of the fit where it is significant, and the residuals raise the standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, face_up
from imuarray.calibrate.disturbed import Exclusion, chance_of_misfit
from imuarray.calibrate.faces import Faces, face_fit, faces_apart, fit_faces, sound_faces, tell_all
from imuarray.calibrate.fits import DRIFTS, TriadFit, straight_lines
from imuarray.calibrate.gravity import MIN_POSES, fit_gravity
from imuarray.calibrate.model import Calibration, SensorCalibration, nominal
from imuarray.calibrate.pose_readings import Pose, PoseReadings, find_poses, noted_faces, read_poses
from imuarray.calibrate.quasi_static import fit_path
from imuarray.calibrate.segments import TemperatureSeries, thermometer_of
from imuarray.calibrate.thermal import SEGMENT_S
from imuarray.calibrate.turns import TurnFit, fit_turns
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.printable import counted
from imuarray.units import STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_DRIFT = 2


def fit_g_sensitivity(
    sensor: SensorLog, poses: tuple[Pose, ...], up_box: Floats
) -> tuple[SensorCalibration, TriadFit, Floats]:
    """One gyroscope from its readings in `poses` (k), in which `up_box` (k, 3) pointed up: its calibration with the
    mean bias over the poses, the fit, and the drift (3,) in counts, first pose less last.
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
    """Straight lines with as many powers of time as fit better beyond chance, and those terms (k, q)."""
    powers = readings.powers_of_time(_MOST_DRIFT)
    fits = [_line(readings, up_box, powers[:, :count]) for count in range(1, powers.shape[1] + 1)]
    used = 0
    for (_, squares), (better, fewer) in pairwise(fits):
        if chance_of_misfit(squares, fewer, 3, int(better.freedom)) > DRIFTS:
            break
        used += 1
    return fits[used][0], powers[:, : used + 1]


def _line(readings: PoseReadings, up_box: Floats, terms: Floats) -> tuple[TriadFit, float]:
    """One fit and its weighted squares."""
    fit, residual = straight_lines(readings.mean_lsb[0], readings.variance_lsb2[0], np.column_stack([up_box, terms]))
    return fit, float((residual**2 / readings.variance_lsb2[0]).sum())


PATH = "path"
"""The method where the box never rested (`quasi_static.py`)."""

UNSURE_G = 0.01
"""A bias whose standard error is larger is warned of: a table tells it ten times better."""


@dataclass(frozen=True, repr=False)
class Tumble:
    """The calibration, how it was made and how well it fits.

    `method` is "faces", "gravity" or "path" (a box that never rested), `poses` how many readings were used. By sensor:
    `drift_lsb` (3,), first reading less last of the same bias, as a face read twice or a fitted drift says; `fits`;
    `turns` of gyroscopes that had enough of them. By accelerometer, over the poses named `pose_names` (k):
    `pose_residual_g` (k,) length of the calibrated specific force less one g, a fitted drift allowed for, and
    `residual_g` its rms; `residual_apart_g` the rms in poses that the calibration had not seen (nan where those that
    remain are too few); `residual_steady_g` the rms by the mean bias alone, which is what the calibration keeps.
    `left_out` names what was not used, and why.
    """

    calibration: Calibration
    method: str
    poses: int
    drift_lsb: Mapping[str, Floats]
    residual_g: Mapping[str, float]
    residual_apart_g: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    residual_steady_g: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    pose_names: tuple[str, ...] = ()
    pose_residual_g: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    fits: Mapping[str, TriadFit] = field(default_factory=lambda: MappingProxyType({}))
    turns: Mapping[str, TurnFit] = field(default_factory=lambda: MappingProxyType({}))
    left_out: tuple[Exclusion, ...] = ()
    warnings: tuple[str, ...] = ()
    """Sentences on what the poses tell badly."""

    def plot(self) -> Figure:
        """The residual of every accelerometer in every pose, in mg; MissingExtraError without matplotlib."""
        from imuarray.calibrate.plots import residual_figure

        names = list(self.pose_residual_g)
        residual_mg = 1e3 * np.array([self.pose_residual_g[name] for name in names]).reshape(len(names), -1)
        return residual_figure(names, self.pose_names, residual_mg)

    def __repr__(self) -> str:
        worst = f", residual at most {1e3 * max(self.residual_g.values()):.2f} mg rms" if self.residual_g else ""
        return f"<Tumble by {self.method}: {self.poses} poses{worst}, {len(self.calibration.sensors)} sensors>"

    def _repr_html_(self) -> str:
        """Residuals by accelerometer, for notebooks."""
        from imuarray.html_table import html_table, number

        rows = [
            (name, number(1e3 * rms), number(1e3 * self.residual_apart_g.get(name, math.nan)))
            for name, rms in self.residual_g.items()
        ]
        return html_table(repr(self), ("accelerometer", "residual, mg rms", "in poses not fitted, mg rms"), rows)


@dataclass(frozen=True)
class _Reference:
    """Reference that the accelerometers give: their calibrations, fits and drifts by name; the length of the calibrated
    specific force less one g in each pose, and the same by a calibration from the others; directions (k, 3) in all
    `poses`, and their covariance (3 k, 3 k).
    """

    method: str
    poses: tuple[Pose, ...]
    up_box: Floats
    up_covariance: Floats
    known: dict[str, SensorCalibration]
    fits: dict[str, TriadFit]
    drift_lsb: dict[str, Floats]
    names: tuple[str, ...]
    residual_g: dict[str, Floats]
    apart_g: dict[str, Floats]
    left_out: tuple[Exclusion, ...]


def calibrate_tumble(*logs: Log, progress: Callable[[str, int, int], None] = lambda what, done, of: None) -> Tumble:
    """Bias and response of the accelerometers, bias, g-sensitivity and (from turns) response of the gyroscopes: from
    one log or from several of the same array (a log a face, say).

    With faces that phases name, or of which they say what was up, by Appendix B; without, from at least nine static
    poses that are found in the logs. `progress` is called with the step and how much of it is done. CalibrationError
    says what is missing or which face does not fit.
    """
    first = logs[0]
    accelerometers, gyroscopes = first.of("specific_force"), first.of("angular_rate")
    if not accelerometers:
        raise CalibrationError(f"{first.path}: it has no accelerometer; tumble needs gravity")
    noted = noted_faces(logs)
    if noted and not face_up(noted[0].phase.name) and not tell_all(noted):
        noted = []  # a few phases that say what was up, in logs of any poses
    faces = sound_faces(accelerometers, noted) if noted else None
    reference = _by_gravity(accelerometers, logs, progress) if faces is None else _by_faces(accelerometers, faces)
    known, fits, drift = dict(reference.known), dict(reference.fits), dict(reference.drift_lsb)
    turns: dict[str, TurnFit] = {}
    felt = [(sensor, known[sensor.name]) for sensor in accelerometers]
    for done, sensor in enumerate(() if reference.method == PATH else gyroscopes, start=1):
        at_rest = _at_rest(sensor, reference, faces)
        known[sensor.name], fits[sensor.name], drift[sensor.name] = at_rest
        turned = fit_turns(sensor, known[sensor.name], reference.poses, reference.up_box, reference.up_covariance, felt)
        if turned is not None:
            turns[sensor.name] = turned
            known[sensor.name] = turned.complete(known[sensor.name])
        progress("gyroscopes", done, len(gyroscopes))
    temperature = _temperature(first, reference.poses)
    calibrated = {name: replace(calibration, temperature_degc=temperature) for name, calibration in known.items()}
    return Tumble(
        Calibration(calibrated, tuple(str(log.path) for log in logs)).stamped(logs),
        reference.method,
        len(reference.poses),
        drift,
        {name: _rms(residual) for name, residual in reference.residual_g.items()},
        {name: _rms(residual) for name, residual in reference.apart_g.items()},
        {name: _rms(residual) for name, residual in _steady_g(felt, reference).items()},
        reference.names,
        reference.residual_g,
        fits,
        turns,
        reference.left_out,
        tuple(_warnings([*accelerometers, *gyroscopes], known, reference, faces)),
    )


def _warnings(
    sensors: Sequence[SensorLog],
    known: Mapping[str, SensorCalibration],
    reference: _Reference,
    faces: Faces | None,
) -> Iterator[str]:
    """List the warnings about a calibration."""
    if faces is not None:
        ups = {pose.phase.up for pose in faces.fitted}
        if missing := [up for up in UP_AXES if up not in ups]:
            yield (
                f"no face with {', '.join(missing)} up: the opposite one is not checked, and its error"
                " enters bias and scale factor; record all six"
            )
    apart = [sensor.name for sensor in sensors if sensor.name not in known]
    if apart:
        yield f"{', '.join(apart)} not calibrated: the bias of a gyroscope needs a box at rest"
    for sensor in sensors:
        sem = known[sensor.name].bias_sem_lsb if sensor.quantity == "specific_force" else None
        worst = None if sem is None else int((sem / sensor.sensitivity).argmax())
        if sem is not None and worst is not None and sem[worst] > UNSURE_G * sensor.sensitivity:
            yield (
                f"{sensor.name} {'xyz'[worst]}: bias within +- {1e3 * sem[worst] / sensor.sensitivity:.3g} mg only:"
                " the poses disagree; check that the box was still and the labels are right"
            )


def _by_gravity(
    accelerometers: Sequence[SensorLog], logs: Sequence[Log], progress: Callable[[str, int, int], None]
) -> _Reference:
    """Any poses."""
    poses = [pose for log in logs for pose in find_poses(log)]
    method = "gravity" if len(poses) >= MIN_POSES else PATH
    if method == PATH:
        try:
            fit = fit_path(accelerometers, logs)
        except CalibrationError as error:
            raise CalibrationError(
                f"{accelerometers[0].where}: {counted(len(poses), 'static pose')}, at least {MIN_POSES} are required;"
                " the path between them does not determine the parameters either"
                f" ({str(error).removeprefix(f'{accelerometers[0].where}: ')})"
            ) from None
    else:
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
        tuple(pose.label for pose in fit.poses),
        dict(zip(names, fit.force_g - 1, strict=True)),
        dict(zip(names, fit.force_apart_g - 1, strict=True)),
        fit.left_out,
    )


def _by_faces(accelerometers: Sequence[SensorLog], faces: Faces) -> _Reference:
    """Appendix B. Directions are those that the calibrated accelerometers felt: a table leans, and turns tell more."""
    everything = sorted((*faces.fitted, *faces.checks), key=_place_and_time)
    result = {sensor.name: fit_faces(sensor, everything) for sensor in accelerometers}
    known = {name: calibration for name, (calibration, _) in result.items()}
    readings = read_poses(accelerometers, everything)
    forces = np.array(
        [_force_g(known[s.name], mean) for s, mean in zip(accelerometers, readings.mean_lsb, strict=True)]
    )
    up_box = forces.mean(axis=0)
    fits = {sensor.name: face_fit(sensor, faces.fitted) for sensor in accelerometers}
    spread = [np.mean(fits[s.name].repeatability_lsb ** 2) / s.sensitivity**2 for s in accelerometers]
    noise = (readings.variance_lsb2 / readings.sensitivity[:, None, None] ** 2).mean(axis=(1, 2))
    fitted = [place for place, pose in enumerate(everything) if not pose.is_check]
    return _Reference(
        "faces",
        tuple(everything),
        up_box / np.linalg.norm(up_box, axis=1, keepdims=True),
        float(np.mean(spread) + np.sum(noise) / len(noise) ** 2) * np.eye(up_box.size),
        known,
        fits,
        {name: drift for name, (_, drift) in result.items()},
        tuple(everything[place].label for place in fitted),
        {s.name: np.linalg.norm(force[fitted], axis=1) - 1 for s, force in zip(accelerometers, forces, strict=True)},
        {sensor.name: faces_apart(sensor, faces.fitted) for sensor in accelerometers},
        faces.left_out,
    )


def _place_and_time(pose: Pose) -> tuple[str, int]:
    """Poses of one log one after the other."""
    return "" if pose.log is None else str(pose.log.path), pose.phase.start_ns


def _at_rest(
    sensor: SensorLog, reference: _Reference, faces: Faces | None
) -> tuple[SensorCalibration, TriadFit, Floats]:
    """A gyroscope from its readings at rest: bias and g-sensitivity, the fit, the drift."""
    if faces is None:
        return fit_g_sensitivity(sensor, reference.poses, reference.up_box)
    known, drift = fit_faces(sensor, [*faces.fitted, *faces.checks])
    return known, face_fit(sensor, faces.fitted), drift


def _force_g(known: SensorCalibration, mean_lsb: Floats) -> Floats:
    """(k, 3) specific force in g in the box frame."""
    return np.asarray(known.stimulus_box(mean_lsb) / STANDARD_GRAVITY)


def _steady_g(
    accelerometers: Sequence[tuple[SensorLog, SensorCalibration]], reference: _Reference
) -> dict[str, Floats]:
    """(k,) length of the specific force less one g in the fitted poses, by the bias as it is kept."""
    poses = [pose for pose in reference.poses if not pose.is_check]
    return {
        sensor.name: np.linalg.norm(_force_g(known, read_poses([sensor], poses).mean_lsb[0]), axis=1) - 1
        for sensor, known in accelerometers
    }


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _temperature(log: Log, poses: Sequence[Pose]) -> float | None:
    """Mean temperature over the poses in degC, by the best thermometer of the logs that has a zero."""
    parts = []
    logs = [log if pose.log is None else pose.log for pose in poses]
    for own in {id(each): each for each in logs}.values():
        thermometer = next(
            (result for sensor in own.of("specific_force") if (result := _thermometer(own, sensor))), None
        )
        if thermometer is None:
            return None
        here = [pose.phase for pose, each in zip(poses, logs, strict=True) if each is own]
        parts.append(thermometer.at(np.array([(phase.start_ns + phase.end_ns) * 0.5e-9 for phase in here])))
    return float(np.concatenate(parts).mean()) if parts else None


def _thermometer(log: Log, sensor: SensorLog) -> TemperatureSeries | None:
    result = thermometer_of(log, sensor, SEGMENT_S) if len(sensor) else None
    return None if result is None or result.kind == "relative" else result
