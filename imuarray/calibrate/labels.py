"""Verification of face labels: the box axis that the accelerometers felt upwards against the one that the phase states.

A face that most accelerometers contradict has the wrong label; a sensor that contradicts the labels otherwise than the
rest is mounted otherwise than the log says. Where a single rotation, or mirroring, of the box explains all faces,
either may be the case, and the error says so.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, up_vector
from imuarray.calibrate.pose_readings import PoseReadings
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

Indices = npt.NDArray[np.int64]

_UPS = np.array([up_vector(up) for up in UP_AXES])


def check_labels(readings: PoseReadings, up_box: Floats) -> None:
    """CalibrationError for faces whose labels are wrong, and for accelerometers that are mounted otherwise than the log
    says: which they are and what was felt.

    `up_box` (k, 3) is what the labels say.
    """
    force = readings.force_box_g()
    felt = (force @ _UPS.T).argmax(axis=2)
    said = (up_box @ _UPS.T).argmax(axis=1)
    majority = np.array([Counter(column.tolist()).most_common(1)[0][0] for column in felt.T])
    wrong = np.flatnonzero((felt != said).mean(axis=0) > 0.5)
    if len(wrong):
        turn = _one_turn(said, majority)
        if turn is None:
            raise CalibrationError(_mislabelled(readings, force, up_box, wrong, majority))
        raise CalibrationError(_mounted(readings.sensors[0], turn) + _or_else(readings, wrong, turn))
    for sensor, own in zip(readings.sensors, felt, strict=True):
        for face in np.flatnonzero(own != said):
            turn = _one_turn(said, own)
            if turn is not None:
                raise CalibrationError(_mounted(sensor, turn))
            raise CalibrationError(
                f"{readings.poses[face].where(sensor)}: phase {readings.poses[face].label!r}: it felt"
                f" {UP_AXES[own[face]]} up, most accelerometers {UP_AXES[majority[face]]}"
            )


def axes_text(rows: Floats) -> str:
    """The signed box axes nearest to the rows (3, 3) of a response: "-Y+X+Z"."""
    return "".join(f"{'+' if row[np.abs(row).argmax()] > 0 else '-'}{'XYZ'[int(np.abs(row).argmax())]}" for row in rows)


def _one_turn(said: Indices, felt: Indices) -> Floats | None:
    """The signed permutation (3, 3) that takes every direction that was said to the one that was felt; None if there
    is none.
    """
    if len(np.unique(said)) < len(UP_AXES):
        return None  # fewer faces leave open what the others would have said
    turn = np.array([_UPS[felt[np.flatnonzero(said == up)[0]]] for up in (0, 2, 4)]).T
    is_one = bool(np.abs(turn).sum(axis=1).max() == 1 and (_UPS[felt] == _UPS[said] @ turn.T).all())
    return turn if is_one else None


def _mislabelled(readings: PoseReadings, force: Floats, up_box: Floats, wrong: Indices, majority: Indices) -> str:
    off = np.median(np.linalg.norm(force - up_box, axis=2), axis=0)
    first = readings.sensors[0]
    wheres = [readings.poses[face].where(first) for face in wrong]
    names = [
        f"{'' if where == wheres[0] else where + ': '}phase {readings.poses[face].label!r} is {off[face]:.2f} g off the"
        f" other faces: {UP_AXES[majority[face]]} points up in it"
        for where, face in zip(wheres, wrong, strict=True)
    ]
    return f"{wheres[0]}: {'; '.join(names)}; mislabelled"


def _mounted(sensor: SensorLog, turn: Floats) -> str:
    rows = sensor.orientation.T @ turn
    axis = "xyz"[int(np.abs(rows - sensor.orientation.T).max(axis=1).argmax())]
    return (
        f"{sensor.where}: axis {axis} does not point along axes {sensor.axes!r}; the faces indicate {axes_text(rows)!r}"
    )


def _or_else(readings: PoseReadings, wrong: Sequence[int] | Indices, turn: Floats) -> str:
    """The other explanation: labels that were exchanged."""
    faces = " and ".join(repr(readings.poses[face].label) for face in wrong)
    whose = f", as do all {len(readings.sensors)} accelerometers" if len(readings.sensors) > 1 else ""
    chip = ", and no chip is mirrored" if np.linalg.det(turn) < 0 else ""
    return f"{whose}; or the labels of {faces} are exchanged{chip}"
