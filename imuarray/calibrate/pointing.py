"""Orientation of every sensor as signed axes, from a few poses held by hand, and its entry in the text of a
configuration.

The axes that a log states are ignored. Of the 24 proper rotations of a sensor in the box (no chip is a mirror image)
the one that explains the data best is chosen

* for an accelerometer: by gravity in the poses, of which it is known which box axis was up;
* for a gyroscope: by how it turned from one pose to the next, carrying gravity with it;
* for a magnetometer: by a field that is fixed in the world while the box turns as the gyroscopes state, and an offset.

The second-best rotation must explain the data clearly worse; otherwise the sensor's orientation is not reported.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise, permutations, product
from math import nan
from typing import Any

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, orientation_of, up_vector
from imuarray.calibrate.faces import axes_text
from imuarray.calibrate.pose_readings import Pose, find_poses, named_faces
from imuarray.errors import CalibrationError, ConfigError
from imuarray.log import Log, SensorLog
from imuarray.printable import counted, printable
from imuarray.units import INERTIAL, SI_PER_UNIT

DEFAULT_POSES = ("+Z", "+X", "+Y")
"""Box axis that is up in each of the poses that the user is asked for by default: a set that no reflection maps to
itself."""

_CLEARLY = 2.0
"""Least ratio of the rms residual of the second-best rotation to that of the best."""

_MOST = 0.5
"""Largest rms residual of the best rotation, as a share of one g or in radians; above it no rotation explains the
poses."""

_LONGEST_S = 30.0
"""Longest time between two poses over which a gyroscope is integrated."""


@dataclass(frozen=True)
class Pointing:
    """Orientation of one sensor: its `axes` as text ("" if the poses do not determine them, with the `reason`), and the
    rms `residual` of its readings (in g, in radians, or relative to the field) with these axes and with the next best;
    nan without residuals.
    """

    sensor: str
    chip: str
    axes: str = ""
    residual: float = nan
    next_best: float = nan
    reason: str = ""


def _turns() -> Floats:
    """Return the (24, 3, 3) rotation matrices whose entries are 0, 1 and -1."""
    signs = [np.diag(sign) for sign in product((1.0, -1.0), repeat=3)]
    matrices = [np.eye(3)[list(order)] @ sign for order in permutations(range(3)) for sign in signs]
    return np.array([matrix for matrix in matrices if np.linalg.det(matrix) > 0])


TURNS = _turns()
"""All orientations of a chip along the box axes: ``vector_sensor = turn @ vector_box``."""


def upright_poses(log: Log, ups: Sequence[str] = ()) -> list[Pose]:
    """Return the log's poses with the box axis that was up in each: `ups` in order of time, or those that its phases
    state, or `DEFAULT_POSES`.

    CalibrationError if the number of poses in the log differs from the number of axes.
    """
    faces = [] if ups else named_faces(log)
    if faces:
        return faces
    poses = find_poses(log, [sensor.name for quantity in INERTIAL for sensor in log.of(quantity)[:1]])
    expected = list(ups) or list(DEFAULT_POSES)
    for up in expected:
        if up not in UP_AXES:
            raise CalibrationError(f"pose {up!r}: allowed are {', '.join(UP_AXES)}")
    if len(poses) != len(expected):
        places = ", ".join(f"{pose.phase.start_ns * 1e-9:.1f} to {pose.phase.end_ns * 1e-9:.1f} s" for pose in poses)
        raise CalibrationError(
            f"{log.path}: {counted(len(poses), 'pose')} detected ({places or 'none'}), {len(expected)} expected"
            f" ({', '.join(expected)}): hold each pose still for three seconds, or state the poses that were held"
        )
    return [Pose(pose.phase, up_vector(up), log) for pose, up in zip(poses, expected, strict=True)]


def find_pointing(log: Log, poses: Sequence[Pose]) -> list[Pointing]:
    """Determine the axes of every triad of a log, in its order, from poses whose `up_box` is known.

    CalibrationError if the poses do not determine any axes, or if no orientation explains the readings of most
    accelerometers: then the stated poses are wrong.
    """
    ups = np.array([pose.up_box for pose in poses], float)
    if np.linalg.matrix_rank(ups) < 2:
        raise CalibrationError(
            f"{log.path}: poses with one box axis up do not determine the axes: hold the box in three orientations"
        )
    results = {sensor.name: _accelerometer(sensor, poses, ups) for sensor in log.of("specific_force")}
    unexplained = [pointing for pointing in results.values() if pointing.residual > _MOST]
    if unexplained and 2 * len(unexplained) > len(results):
        raise CalibrationError(
            f"{log.path}: no orientation of {unexplained[0].sensor} explains its readings: the poses were not"
            f" {', '.join(_name(up) for up in ups)} up, in this order"
        )
    rotations = {
        sensor.name: [_rotation(sensor, first, second) for first, second in pairwise(poses)]
        for sensor in log.of("angular_rate")
    }
    for sensor in log.of("angular_rate"):
        results[sensor.name] = _gyroscope(sensor, rotations[sensor.name], ups)
    box_rotations = _box_rotations(rotations, results)
    for sensor in log.of("magnetic_field"):
        results[sensor.name] = _magnetometer(sensor, poses, box_rotations)
    return [results[name] for name in log.sensors if name in results]


def _name(up: Floats) -> str:
    return next(name for name in UP_AXES if np.allclose(up_vector(name), up))


def _mean(sensor: SensorLog, pose: Pose) -> Floats:
    """Return the mean reading (3,) of a sensor in its unit along its own axes; nan if there is none."""
    log, rows = pose.rows_of(sensor)
    counts = np.asarray(log.counts[rows], float)
    return counts.mean(axis=0) / sensor.sensitivity if len(counts) else np.full(3, np.nan)


def _accelerometer(sensor: SensorLog, poses: Sequence[Pose], ups: Floats) -> Pointing:
    """Determine the axes of an accelerometer by gravity; biases are too small to hide it."""
    mean_g = np.array([_mean(sensor, pose) for pose in poses])
    if not np.isfinite(mean_g).all():
        return Pointing(sensor.name, sensor.chip, reason="it has no readings in one of the poses")
    residuals = np.sqrt(np.mean((mean_g - ups @ TURNS.transpose(0, 2, 1)) ** 2 * 3, axis=(1, 2)))
    return _best(sensor, residuals)


def _rotation(sensor: SensorLog, first: Pose, second: Pose) -> Floats | None:
    """Return the rotation (3, 3) in the sensor's frame of a vector that is fixed in the world, from one pose to the
    next; None if the rates can't be integrated.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    if first.log is not second.log:
        return None
    log, _ = first.rows_of(sensor)
    rows = log.between(first.phase.end_ns, second.phase.start_ns)
    time_s = np.asarray(log.time[rows]) * 1e-9
    biases = np.array([_mean(sensor, first), _mean(sensor, second)])
    if len(time_s) < 4 or not 0 < time_s[-1] - time_s[0] < _LONGEST_S or not np.isfinite(biases).all():
        return None
    rates = (np.asarray(log.counts[rows], float) / sensor.sensitivity - biases.mean(axis=0)) * SI_PER_UNIT[sensor.unit]
    angles = np.diff(time_s)[:, None] * (rates[1:] + rates[:-1]) / 2
    steps = Rotation.from_rotvec(angles).inv().as_matrix()
    return reduce(lambda so_far, step: np.asarray(step @ so_far), steps, np.eye(3))


def _gyroscope(sensor: SensorLog, rotations: Sequence[Floats | None], ups: Floats) -> Pointing:
    """Determine the axes of a gyroscope by gravity before and after each turn."""
    rotated = [(index, rotation) for index, rotation in enumerate(rotations) if rotation is not None]
    if not rotated:
        reason = "no turn from one pose to the next in one log, of less than 30 s"
        return Pointing(sensor.name, sensor.chip, reason=reason)
    errors = [rotation @ (TURNS @ ups[i])[..., None] - (TURNS @ ups[i + 1])[..., None] for i, rotation in rotated]
    residuals = np.sqrt(np.mean([np.sum(error**2, axis=(1, 2)) for error in errors], axis=0))
    return _best(sensor, residuals)


def _box_rotations(
    rotations: Mapping[str, Sequence[Floats | None]], pointings: Mapping[str, Pointing]
) -> list[Floats | None]:
    """Return the rotations between poses in the box frame, by the gyroscope with the least residual."""
    by_residual = sorted((pointings[name].residual, name) for name in rotations if pointings[name].axes)
    if not by_residual:
        return []
    name = by_residual[0][1]
    orientation = np.array(orientation_of(pointings[name].axes))
    return [None if rotation is None else orientation @ rotation @ orientation.T for rotation in rotations[name]]


def _magnetometer(sensor: SensorLog, poses: Sequence[Pose], rotations: Sequence[Floats | None]) -> Pointing:
    """Determine the axes of a magnetometer by a field that is fixed in the world and an offset of the sensor, over the
    longest run of poses with known rotations between them.
    """
    runs: list[list[tuple[int, Floats]]] = [[(0, np.eye(3))]]
    for index, rotation in enumerate(rotations, start=1):
        if rotation is None:
            runs.append([(index, np.eye(3))])
        else:
            runs[-1].append((index, np.asarray(rotation @ runs[-1][-1][1])))
    run = max(runs, key=len)
    if len(run) < 3:
        return Pointing(sensor.name, sensor.chip, reason="no gyroscope measured the turns between three poses")
    means = np.concatenate([_mean(sensor, poses[index]) for index, _ in run])
    if not np.isfinite(means).all():
        return Pointing(sensor.name, sensor.chip, reason="it has no readings in one of the poses")
    residuals = []
    for turn in TURNS:
        design = np.concatenate([np.hstack([turn @ attitude, np.eye(3)]) for _, attitude in run])
        solution = np.linalg.lstsq(design, means, rcond=None)[0]
        rms = np.sqrt(np.mean((means - design @ solution) ** 2) * 3)
        residuals.append(rms / max(float(np.linalg.norm(solution[:3])), 1e-9))
    return _best(sensor, np.array(residuals))


def _best(sensor: SensorLog, residuals: Floats) -> Pointing:
    """Return the orientation with the least residual, if it is clearly the least."""
    order = np.argsort(residuals)
    best, second = float(residuals[order[0]]), float(residuals[order[1]])
    axes, reason = axes_text(TURNS[order[0]]), ""
    if best > _MOST:
        reason = "no orientation explains its readings"
    elif second < _CLEARLY * best or second - best < 1e-6:
        reason = f"{axes_text(TURNS[order[1]])} is as good as {axes}"
    return Pointing(sensor.name, sensor.chip, "" if reason else axes, best, second, reason)


_LONGEST = 1 << 20
"""Largest number of characters in a configuration; one with a hundred sensors has thirty thousand."""


def with_axes(text: str, pointings: Sequence[Pointing], where: str) -> str:
    """Return the text of a configuration with the axes that were determined; everything else, including comments, is
    unchanged.

    ConfigError, beginning with the source of the text (`where`), if that is not a configuration.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    if len(text) > _LONGEST:
        raise ConfigError(f"{where}: its configuration has {len(text)} characters; at most {_LONGEST}")
    axes = {pointing.sensor: pointing.axes for pointing in pointings if pointing.axes}
    try:
        file: Any = tomlkit.parse(text)
        for sensor in _sensors(file, where):
            if str(sensor.get("name")) in axes:
                sensor["axes"] = axes[str(sensor["name"])]
        return tomlkit.dumps(file)
    except (TOMLKitError, RecursionError) as error:
        raise ConfigError(f"{where}: its configuration is not TOML: {printable(str(error))[:200]}") from None


def _sensors(file: Any, where: str) -> list[Any]:
    """Return the [[sensor]] tables of a configuration; ConfigError if there are none."""
    sensors = file.get("sensor", [])
    if not isinstance(sensors, list) or not all(isinstance(sensor, MutableMapping) for sensor in sensors):
        raise ConfigError(f"{where}: its configuration has no list of [[sensor]] tables")
    return sensors
