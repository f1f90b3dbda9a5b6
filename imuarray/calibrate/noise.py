"""`calibrate noise`: what a sensor reads while the box stands still, per axis: how much single readings scatter and of
what colour that is, and how the bias wanders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from imuarray.calibrate.drift import LEAST_SEGMENTS, MOST_SEGMENTS, fit_drift
from imuarray.calibrate.model import Calibration, SensorCalibration, nominal
from imuarray.calibrate.motion import refuse_motion
from imuarray.calibrate.poses import Pose, find_poses
from imuarray.calibrate.scatter import scatter_of
from imuarray.calibrate.segments import Segments, segment_means, thermometer_of
from imuarray.calibrate.sound_readings import SEGMENT_ROWS
from imuarray.calibrate.stability import Drift, Thermal
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.units import INERTIAL

_STILL_PHASES = ("static", "room")

_FALSE_ALARM = 0.01
"""Chance that any axis of a log without lines is said to have one."""

_THERMOMETER_S = 5.0


def calibrate_noise(
    *logs: Log,
    known: Calibration | None = None,
    progress: Callable[[str, int, int], None] = lambda what, done, of: None,
) -> Calibration:
    """Scatter of single readings, its colour, and the drift, of every inertial sensor, pooled over all still stretches
    of one log or of several; from the drift, what follows temperature by the slopes of `known` is taken out.

    Still stretches are the phases that name a face, `static` or `room`; in a log without such phases they are found
    by the accelerometers. CalibrationError if there are none. `progress` hears what is done, how many sensors are, and
    of how many.
    """
    poses = [pose for log in logs for pose in _still_stretches(log)]
    first = logs[0]
    if not poses:
        raise CalibrationError(f"{first.path}: no stretch in which the box stood still")
    sensors = [sensor for sensor in first.sensors.values() if sensor.quantity in INERTIAL]
    if not sensors:
        raise CalibrationError(f"{first.path}: no inertial sensor in it")
    slopes = {} if known is None else {name: sensor.thermal for name, sensor in known.sensors.items()}
    found = {}
    for number, sensor in enumerate(sensors, start=1):
        found[sensor.name] = _noise(sensor, poses, slopes.get(sensor.name), _FALSE_ALARM / (3 * len(sensors)))
        progress("noise", number, len(sensors))
    return Calibration(found, tuple(str(log.path) for log in logs))


def with_noise_of(log: Log, calibration: Calibration, names: Sequence[str] = ()) -> Calibration:
    """The calibration, with the noise that the log itself shows at rest for the sensors (only `names`, if there are
    any) of which it knows none. CalibrationError if the log shows none.
    """
    known = {
        sensor.name: calibration.or_nominal(sensor) for sensor in log.sensors.values() if sensor.quantity in INERTIAL
    }
    lacking = [name for name, each in known.items() if each.noise_lsb is None and (not names or name in names)]
    if not lacking:
        return calibration
    measured = calibrate_noise(log, known=calibration)
    return calibration.merged(Calibration({name: measured.sensors[name] for name in lacking}, measured.sources))


def _still_stretches(log: Log) -> list[Pose]:
    named = [Pose(phase, None, log) for phase in log.phases if phase.up or phase.name in _STILL_PHASES]
    poses = named or find_poses(log)
    refuse_motion(
        log, [(f"phase {p.phase.name!r}" if named else p.phase.name, p.phase.start_ns, p.phase.end_ns) for p in poses]
    )
    return poses


def _noise(sensor: SensorLog, poses: Sequence[Pose], thermal: Thermal | None, false_alarm: float) -> SensorCalibration:
    """One sensor's figures; CalibrationError where it has no sound readings."""
    found = [(pose, *pose.rows_of(sensor)) for pose in poses]
    stretches = [(here, rows) for _, here, rows in found if rows.stop > rows.start]
    scatter = scatter_of(stretches, false_alarm) if stretches else None
    if scatter is None:
        raise CalibrationError(f"{sensor.where}: no sound readings while the box stood still")
    return replace(
        nominal(sensor),
        noise_lsb=scatter.rms_lsb,
        noise_sem_lsb=scatter.rms_sem_lsb,
        noise_correlation=scatter.correlation,
        noise_lines=scatter.lines,
        drift=_drift(found, thermal),
    )


def _drift(found: Sequence[tuple[Pose, SensorLog, slice]], thermal: Thermal | None) -> Drift | None:
    """The drift over the stretches; None where they are too short, or too many, to show any."""
    rows = sum(part.stop - part.start for _, _, part in found)
    segment = max(SEGMENT_ROWS // 2, -(-rows // MOST_SEGMENTS))  # time constants are two of them at least
    long = [(pose, here, part) for pose, here, part in found if part.stop - part.start >= LEAST_SEGMENTS * segment]
    if not long:
        return None
    _, here, part = max(long, key=lambda entry: entry[2].stop - entry[2].start)
    width_s = segment * _interval_s(here, part)
    return fit_drift([_means(pose, sensor, rows, width_s, thermal) for pose, sensor, rows in long], width_s)


def _interval_s(sensor: SensorLog, rows: slice) -> float:
    first, last = (int(sensor.time[row]) for row in (rows.start, rows.stop - 1))
    return float((last - first) / (rows.stop - rows.start - 1)) * 1e-9


def _means(pose: Pose, sensor: SensorLog, rows: slice, width_s: float, thermal: Thermal | None) -> Segments:
    """Means of a stretch, what follows its temperature taken out; none where it has no sound readings."""
    try:
        means = segment_means(sensor, width_s, within=rows)
    except CalibrationError:
        return Segments(np.zeros(0), np.zeros((0, 3)))
    warm = None if thermal is None or pose.log is None else thermometer_of(pose.log, sensor, _THERMOMETER_S)
    if thermal is None or warm is None or (warm.kind == "relative") != (thermal.thermometer == "relative"):
        return means
    degc = warm.lagged(means.time_s, [thermal.significant_lag_s])[:, 0]
    return replace(means, mean=means.mean - thermal.bias_change_lsb(degc, float(degc[0])))
