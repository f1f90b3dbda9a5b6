"""Accelerometers calibrated from a box that is tumbled slowly by hand and never rests: gravity's length along the path.

A hand that turns a box slowly adds tens of mg to gravity, as often with its sign as against it. The path is cut into
stretches of half a second. In each, the reading of every axis in the middle is taken from a parabola through its
readings (a mean would be too short, by the turn within it), and all sensors are fitted to one g as static poses are
(`imuarray.calibrate.gravity`).

The weight of a stretch depends on its motion q: the scatter of its readings about the parabola beyond the noise, and
the acceleration of a turn about a wrist, ``r w^2``. The length of the force is off by ``a q`` (one sigma), where a is
estimated from the lengths themselves. The error is the same in all sensors, so more of them don't make the lengths
better known.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate.disturbed import Exclusion, exclusion_of
from imuarray.calibrate.gravity import GravityFit, fit_weighted
from imuarray.calibrate.pose_readings import Pose, PoseReadings
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.log.format import SATURATED, SUSPECT, Phase
from imuarray.robust import MEDIAN_SQUARE
from imuarray.units import STANDARD_GRAVITY

STRETCH_S = 0.5
"""Long beside a reading, short beside a turn: at 60 degrees a second a parabola errs by a ten-thousandth in it."""

ARM_M = 0.3
"""Distance from the wrist to the box: a turn about the wrist adds ARM_M w^2 to gravity."""

FEWEST_STRETCHES = 30
"""Three times the unknowns of a sensor, and one more is asked of the motion."""

MOST_STRETCHES = 100
"""Stretches that are fitted at once; if there are more, the calmest of every direction."""

WORTHLESS_G = 0.05
"""The standard error of a bias from which a path gives no information: a data sheet promises as much (BMA-113)."""

_ROUNDS = 3
"""Fit and motion in turn; they settle in two."""

_PARABOLA = 9 / 4
"""Variance of a parabola's value in the middle of evenly spaced readings over that of their mean."""

_LEAST_ROWS = 5
_FAST = 0.15
"""In g: a stretch that scatters by more about its parabola is shaken, not turned slowly."""

_LEAST_MOTION_G = 1e-3
"""The least motion of a box that is held by hand."""

_CELLS = 3
"""The number of cells along each box axis by which directions are distinguished."""

_STRANGE = 4.0
"""Standard deviations by which the length of a stretch may be off before it is left out."""


def fit_path(sensors: Sequence[SensorLog], logs: Sequence[Log]) -> GravityFit:
    """Calibrate accelerometers jointly from the path of the box in `logs`; CalibrationError if it tells too little."""
    readings, motion_g = _stretches(sensors, logs)
    if len(readings.poses) < FEWEST_STRETCHES:
        raise CalibrationError(
            f"{sensors[0].where}: {len(readings.poses)} slow stretches of {STRETCH_S:g} s, at least {FEWEST_STRETCHES}"
            " are required"
        )
    kept = _spread(readings, motion_g)
    readings, motion_g = readings.only(kept), motion_g[kept]
    scale = readings.sensitivity[:, None, None]
    noise = (readings.variance_lsb2 / scale**2).transpose(0, 2, 1).reshape(-1, len(readings.poses))
    left_out: list[Exclusion] = []
    factor = 1.0
    for _ in range(_ROUNDS):
        fit = fit_weighted(readings, noise + len(sensors) * (factor * motion_g) ** 2, left_out)
        off = fit.force_g.mean(axis=0) - 1
        free = len(off) / (len(off) - 9)
        factor = float(np.sqrt(free * np.median((off / motion_g) ** 2) / MEDIAN_SQUARE))
        sound = np.abs(off) < _STRANGE * np.hypot(factor * motion_g, np.sqrt(noise.mean(axis=0)))
        if not sound.all() and sound.sum() >= FEWEST_STRETCHES:
            left_out += [
                exclusion_of(pose, f"{1e3 * each:+.0f} mg from one g: moved")
                for pose, each, good in zip(readings.poses, off, sound, strict=True)
                if not good
            ]
            readings, motion_g, noise = readings.only(np.flatnonzero(sound)), motion_g[sound], noise[:, sound]
    fit = fit_weighted(readings, noise + len(sensors) * (factor * motion_g) ** 2, left_out)
    worst_g = max(float(f.bias_sem_lsb.max() / s.sensitivity) for f, s in zip(fit.fits, sensors, strict=True))
    if not worst_g < WORTHLESS_G:
        raise CalibrationError(
            f"{sensors[0].where}: the path determines biases to {1e3 * worst_g:.0f} mg only: turn the box"
            f" slower, and to all"
            " sides"
        )
    return fit


def _stretches(sensors: Sequence[SensorLog], logs: Sequence[Log]) -> tuple[PoseReadings, Floats]:
    """Return the readings in the middle of every stretch that all of them read soundly, and its motion (k,) in g."""
    parts = [_of_log(sensors, log) for log in logs]
    poses = tuple(pose for each, _, _, _ in parts for pose in each)
    means = np.concatenate([mean for _, mean, _, _ in parts], axis=1)
    variances = np.concatenate([variance for _, _, variance, _ in parts], axis=1)
    nothing = np.zeros_like(means)
    readings = PoseReadings(tuple(sensors), poses, means, variances, nothing, nothing + 1.0)
    return readings, np.concatenate([motion for _, _, _, motion in parts])


def _of_log(sensors: Sequence[SensorLog], log: Log) -> tuple[list[Pose], Floats, Floats, Floats]:
    """Poses (k), readings in their middle and their variances by noise (s, k, 3), and motion (k,), of one log."""
    here = [log[sensor.name] for sensor in sensors]
    begin = max(int(sensor.time[0]) for sensor in here)
    end = min(int(sensor.time[len(sensor) - 1]) for sensor in here)
    width_ns = round(1e9 * STRETCH_S)
    count = max(0, (end - begin) // width_ns)
    means, scatters, rows = (np.full((len(here), count, 3), np.nan) for _ in range(3))
    for place, sensor in enumerate(here):
        for index in range(count):
            start_ns = begin + index * width_ns
            means[place, index], scatters[place, index], rows[place, index] = _middle(sensor, start_ns, width_ns)
    sound = np.flatnonzero(np.isfinite(means).all(axis=(0, 2)))
    means, scatters, rows = means[:, sound], scatters[:, sound], rows[:, sound]
    # The calmest tenth of the stretches shows the noise; what others scatter more is motion.
    noise = np.quantile(scatters, 0.1, axis=1, keepdims=True) if len(sound) else scatters
    variances = _PARABOLA * noise / rows if len(sound) else scatters
    counts = np.array([sensor.sensitivity for sensor in here])[:, None, None]
    shaken = np.sqrt(np.maximum(scatters - noise, 0.0) / counts**2).max(axis=2).mean(axis=0)
    turns = np.array([sensor.orientation / sensor.sensitivity for sensor in here])
    force = np.einsum("sij,skj->ki", turns, means) / len(here)
    swung = ARM_M * _rate(force, sound) ** 2 / STANDARD_GRAVITY
    slow = np.flatnonzero(shaken < _FAST)
    motion = np.sqrt(shaken**2 + swung**2 + _LEAST_MOTION_G**2)[slow]
    poses = [
        Pose(Phase(begin + int(i) * width_ns, begin + (int(i) + 1) * width_ns, f"{i * STRETCH_S:g} s"), None, log)
        for i in sound[slow]
    ]
    return poses, means[:, slow], variances[:, slow], motion


def _middle(sensor: SensorLog, start_ns: int, width_ns: int) -> tuple[Floats, Floats, Floats]:
    """Value (3,) in the middle of a parabola through the readings of a stretch, their variance (3,) about it, and how
    many there are (3,); nan where a reading is doubtful or too few are there.
    """
    part = sensor.between(start_ns, start_ns + width_ns)
    status = np.asarray(sensor.status[part])
    if len(status) < _LEAST_ROWS or (status & (SATURATED | SUSPECT)).any():
        nothing = np.full(3, np.nan)
        return nothing, nothing, nothing
    since = (np.asarray(sensor.time[part]) - start_ns - width_ns / 2) / (width_ns / 2)
    counts = np.asarray(sensor.counts[part], float)
    design = np.vander(since, 3)
    values, _, _, _ = np.linalg.lstsq(design, counts, rcond=None)
    variance = ((counts - design @ values) ** 2).sum(axis=0) / (len(counts) - 3)
    return values[2], variance, np.full(3, float(len(counts)))


def _rate(force: Floats, number: npt.NDArray[np.int64]) -> Floats:
    """(k,) rad/s by which the direction of a force (k, 3) turns in stretches of these numbers."""
    if len(force) < 2:
        return np.zeros(len(force))
    unit = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
    seconds = STRETCH_S * np.maximum(np.diff(number), 1)
    steps = np.arccos(np.clip((unit[1:] * unit[:-1]).sum(axis=1), -1, 1)) / seconds
    return np.asarray(np.maximum(np.append(steps, steps[-1]), np.append(steps[0], steps)))


def _spread(readings: PoseReadings, motion_g: Floats) -> npt.NDArray[np.int64]:
    """The stretches that are fitted: the calmest of every direction, in order of time."""
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
