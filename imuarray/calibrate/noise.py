"""`calibrate noise`: how much single readings scatter while the box stands still, per sensor axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.model import Calibration, SensorCalibration, nominal
from imuarray.calibrate.poses import Pose, find_poses
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.log.format import SATURATED, STALE, SUSPECT
from imuarray.units import INERTIAL

_STILL_PHASES = ("static", "room")

SEGMENT_ROWS = 256
"""The scatter is taken about the mean of so many rows, so that slow drift is not called noise."""


def calibrate_noise(*logs: Log) -> Calibration:
    """Standard deviation of single readings (3,) in counts for every inertial sensor, pooled over all still stretches
    of one log or of several.

    Still stretches are the phases that name a face, `static` or `room`; in a log without such phases they are found
    by the accelerometers. CalibrationError if there are none.
    """
    poses = [pose for log in logs for pose in _still_stretches(log)]
    first = logs[0]
    if not poses:
        raise CalibrationError(f"{first.path}: no stretch in which the box stood still")
    sensors = [sensor for sensor in first.sensors.values() if sensor.quantity in INERTIAL]
    if not sensors:
        raise CalibrationError(f"{first.path}: no inertial sensor in it")
    return Calibration({sensor.name: _noise(sensor, poses) for sensor in sensors}, tuple(str(log.path) for log in logs))


def _still_stretches(log: Log) -> list[Pose]:
    named = [Pose(phase, None, log) for phase in log.phases if phase.up or phase.name in _STILL_PHASES]
    return named or find_poses(log)


def _noise(sensor: SensorLog, poses: list[Pose]) -> SensorCalibration:
    """Pooled variance within segments of one sensor's still stretches; stale, saturated and suspect rows are left
    out.
    """
    squares, freedom = np.zeros(3), 0
    for pose in poses:
        here, rows = pose.rows_of(sensor)
        for start in range(rows.start, rows.stop, SEGMENT_ROWS):
            part = slice(start, min(start + SEGMENT_ROWS, rows.stop))
            counts = _sound(here, part)
            if len(counts) > 1:
                squares += ((counts - counts.mean(axis=0)) ** 2).sum(axis=0)
                freedom += len(counts) - 1
    if freedom == 0:
        raise CalibrationError(f"{sensor.where}: no sound readings while the box stood still")
    return replace(nominal(sensor), noise_lsb=np.sqrt(squares / freedom))


def _sound(sensor: SensorLog, rows: slice) -> npt.NDArray[np.float64]:
    status = np.asarray(sensor.status[rows])
    sound = (status & (STALE | SATURATED | SUSPECT)) == 0
    return np.asarray(np.asarray(sensor.counts[rows], float)[sound])
