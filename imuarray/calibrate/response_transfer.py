"""Columns of a gyroscope's response that no turn determined, from other gyroscopes of the box or from gravity.

All gyroscopes of a rigid box measure one angular rate. After turns about two box axes the third column of a response is
known only to the data sheet's tolerance (`imuarray.calibrate.turns`). If another gyroscope's response is known, its
rates in any log in which the box turns about that axis determine the column::

    counts = response @ (rate_box + delay * d rate_box / dt) + bias + noise

for means over windows of `WINDOW_S`. The fit is linear least squares of response, bias and delay of each axis, with the
calibration's response and covariance as prior (C. M. Bishop, Pattern Recognition and Machine Learning, 2006, section
2.3.3); bias and delay of this log are free. Residuals larger than noise widen the covariance, and the errors of the
reference's own response are added to it.

If no gyroscope's response is known, gravity is the reference: a log in which the box rests between turns about the
missing axis determines the column like the turns of a calibration (`imuarray.calibrate.turns`), again with the
calibration's response and covariance as prior. The directions at both ends of a turn are those of the calibrated
accelerometers; their error is estimated from the length of the mean force. Turns about the vertical contain no
information, and a turn needs rests of at least one and a half seconds at both ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.calibrate.model import Calibration, SensorCalibration
from imuarray.calibrate.pose_readings import Pose, find_poses, read_poses
from imuarray.calibrate.turns import fit_turns
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.log.format import SATURATED, SUSPECT
from imuarray.robust import MEDIAN_SQUARE
from imuarray.units import SI_PER_UNIT, STANDARD_GRAVITY

WINDOW_S = 0.1
"""Length in s of the compared windows: short compared with turns by hand, long compared with the times between the
readings of different sensors.
"""

_CHUNK = 4096
"""Number of windows in memory at a time."""

_FEWEST = 100
"""Fewest windows for a measurement."""

_IMPOSSIBLE = 1e-6
"""Probability of a change of the response below which the calibration or the gyroscope is considered wrong, so that
nothing is transferred."""

GRAVITY = "gravity"
"""Name of the reference if no gyroscope is one."""

_PARAMETERS = 15
"""Nine entries of the response row by row, three biases, three delays."""


Calibrated = tuple[SensorLog, SensorCalibration]
"""A sensor and its calibration."""


@dataclass(frozen=True)
class ResponseTransfer:
    """A calibration with newly determined columns: box `axes` by sensor, determined from the rates of `references` (or
    from "gravity"). `refused` are the sensors whose rates contradict their calibration.
    """

    calibration: Calibration
    axes: dict[str, str]
    references: tuple[str, ...]
    refused: tuple[str, ...]


def transfer_response(log: Log, calibration: Calibration, only: Sequence[str] = ()) -> ResponseTransfer:
    """Determine the uncertain columns of the gyroscopes of `log` (`only` these, unless that is empty) from the
    gyroscopes with a known response, or from gravity if there are none, as far as the box turned in `log`. Without
    uncertain columns the calibration is returned unchanged.
    """
    measured = _find_measured(log.of("angular_rate", only), calibration)
    accelerometers = _find_measured(log.of("specific_force", only), calibration)
    references = [(sensor, calibrated) for sensor, calibrated in measured if not calibrated.uncertain_axes()]
    sensors, axes, refused = dict(calibration.sensors), {}, []
    ends = None if references or not measured else _find_ends(log, accelerometers)
    for sensor, calibrated in measured if references or ends else ():
        uncertain = calibrated.uncertain_axes()
        updated: SensorCalibration | None = calibrated
        if uncertain and references:
            updated = _update_by_rates(sensor, calibrated, references, accelerometers)
        elif uncertain and ends:
            updated = _update_by_turns(sensor, calibrated, ends, accelerometers)
        if updated is None:
            refused.append(sensor.name)
            continue
        sensors[sensor.name] = updated
        if gained := "".join(axis for axis in uncertain if axis not in updated.uncertain_axes()):
            axes[sensor.name] = gained
    return ResponseTransfer(
        replace(calibration, sensors=sensors),
        axes,
        tuple(sensor.name for sensor, _ in references) or (GRAVITY,),
        tuple(refused),
    )


class _Ends(NamedTuple):
    """Rests between turns (k): the upward direction (k, 3) in each in the box frame, and the covariance (3 k, 3 k) of
    all directions.
    """

    poses: tuple[Pose, ...]
    up_box: Floats
    covariance: Floats


def _find_ends(log: Log, accelerometers: Sequence[Calibrated]) -> _Ends | None:
    """Return the rests of a log by its calibrated accelerometers; None without these or without two rests."""
    if not accelerometers:
        return None
    try:
        poses = tuple(find_poses(log, [sensor.name for sensor in (*log.of("angular_rate"), *_logs_of(accelerometers))]))
        readings = read_poses(_logs_of(accelerometers), poses) if len(poses) > 1 else None
    except CalibrationError:  # too short, or a sensor that clips at rest
        return None
    if readings is None:
        return None
    forces_g = np.array(
        [
            calibrated.stimulus_box(mean) / STANDARD_GRAVITY
            for (_, calibrated), mean in zip(accelerometers, readings.mean_lsb, strict=True)
        ]
    )
    force_g = forces_g.mean(axis=0)
    length = np.linalg.norm(force_g, axis=1)
    noise = (readings.variance_lsb2 / readings.sensitivity[:, None, None] ** 2).mean() / len(accelerometers)
    variance = max(float(noise), float(np.mean((length - 1) ** 2)))
    return _Ends(poses, force_g / length[:, None], variance * np.eye(force_g.size))


def _logs_of(calibrated: Sequence[Calibrated]) -> list[SensorLog]:
    return [sensor for sensor, _ in calibrated]


def _update_by_turns(
    sensor: SensorLog, calibrated: SensorCalibration, ends: _Ends, accelerometers: Sequence[Calibrated]
) -> SensorCalibration | None:
    """Return the calibration with the response updated by turns between rests, unchanged if they are too few; None if
    they contradict it.
    """
    try:
        fit = fit_turns(sensor, calibrated, ends.poses, ends.up_box, ends.covariance, accelerometers)
    except CalibrationError:  # no valid reading in a rest
        return calibrated
    if fit is None:
        return calibrated
    change = (fit.response - calibrated.response_lsb_per_unit).ravel()
    if _is_impossible(change, _covariance(calibrated)):
        return None
    return fit.complete(calibrated)


def _is_impossible(change: Floats, prior: Floats) -> bool:
    """Return whether a change (9,) of a response is improbable under its covariance (9, 9)."""
    from scipy.special import gammaincc  # the chi-squared distribution; scipy.stats is slow to import

    moved = float(change @ np.linalg.solve(prior, change))
    return bool(gammaincc(4.5, moved / 2) < _IMPOSSIBLE)  # nine degrees of freedom


def _find_measured(sensors: Sequence[SensorLog], calibration: Calibration) -> list[Calibrated]:
    """Return the sensors that have rows and a measured response."""
    calibrated_sensors = [
        (sensor, calibration.sensors[sensor.name]) for sensor in sensors if sensor.name in calibration.sensors
    ]
    return [
        (sensor, entry)
        for sensor, entry in calibrated_sensors
        if entry.response_sem_lsb_per_unit is not None and len(sensor)
    ]


def _update_by_rates(
    sensor: SensorLog,
    calibrated: SensorCalibration,
    references: Sequence[Calibrated],
    accelerometers: Sequence[Calibrated],
) -> SensorCalibration | None:
    """Return the calibration with the response updated by the rates of `references`, unchanged if there are too few;
    None if the rates contradict it.
    """
    prior = _covariance(calibrated)
    information, right, squares, windows = np.zeros((_PARAMETERS, _PARAMETERS)), np.zeros(_PARAMETERS), 0.0, 0
    response = calibrated.response_lsb_per_unit
    variance: Floats | None = None
    for counts, rate_dps, slope_dps in _windows((sensor, calibrated), references, accelerometers):
        design = np.zeros((len(counts), 3, _PARAMETERS))
        for axis in range(3):
            design[:, axis, 3 * axis : 3 * axis + 3] = rate_dps
            design[:, axis, 9 + axis] = 1.0
            design[:, axis, 12 + axis] = slope_dps @ response[axis]
        deviation = counts - rate_dps @ response.T  # from the prediction of the calibration: the fit is of changes
        if variance is None:
            variance = _noise(deviation)
        information += np.einsum("nip,i,niq->pq", design, 1 / variance, design)
        right += np.einsum("nip,i,ni->p", design, 1 / variance, deviation)
        squares += float((deviation**2 / variance).sum())
        windows += len(counts)
    if windows < _FEWEST:
        return calibrated
    weights = np.zeros((_PARAMETERS, _PARAMETERS))
    weights[:9, :9] = np.linalg.inv(prior)
    change = np.linalg.solve(information + weights, right)
    rest = squares - 2 * change @ right + change @ information @ change
    excess = max(1.0, float(rest) / (3 * windows - _PARAMETERS))
    covariance = np.linalg.inv(information / excess + weights)
    change = covariance @ right / excess
    if _is_impossible(change[:9], prior):
        return None
    total = covariance[:9, :9] + _reference_covariance(response, references)
    return replace(
        calibrated,
        response_lsb_per_unit=response + change[:9].reshape(3, 3),
        response_sem_lsb_per_unit=np.sqrt(np.diag(total)).reshape(3, 3).max(axis=1),
        response_covariance_lsb2_per_unit2=total,
    )


def _reference_covariance(response: Floats, references: Sequence[Calibrated]) -> Floats:
    """Return the covariance (9, 9) of a response by errors of the references' responses. The error of the rate, the
    references' mean, is E rate_box with E the mean of their relative errors, and that of the response is response @ E.
    """
    errors = np.zeros((9, 9))
    for _, calibrated in references:
        covariance = _covariance(calibrated)
        carried = np.kron(np.linalg.inv(calibrated.response_lsb_per_unit), np.eye(3))
        errors += carried @ covariance @ carried.T / len(references) ** 2
    carried = np.kron(response, np.eye(3))
    return np.asarray(carried @ errors @ carried.T)


def _covariance(calibrated: SensorCalibration) -> Floats:
    """Return the covariance (9, 9) of a measured response, row by row."""
    covariance = calibrated.response_covariance()
    return np.zeros((9, 9)) if covariance is None else covariance


def _noise(deviation: Floats) -> Floats:
    """Return the variance (3,) of a window's mean: a sixth of the mean square of second differences, which slow motion
    does not affect.
    """
    bends = np.diff(deviation, 2, axis=0)
    squares = np.median(bends**2, axis=0) / MEDIAN_SQUARE
    return np.asarray(np.maximum(squares / 6, 1e-6))


def _windows(
    gyroscope: Calibrated, references: Sequence[Calibrated], accelerometers: Sequence[Calibrated]
) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Yield, for windows with readings of all sensors: mean counts (n, 3) of a gyroscope less its g-sensitivity, the
    mean rate (n, 3) of the references in dps and its derivative (n, 3) in dps/s, in the box frame.
    """
    sensors = [sensor for sensor, _ in (gyroscope, *references, *accelerometers)]
    width_ns = round(WINDOW_S * 1e9)
    begin_ns = max(int(item.time[0]) for item in sensors)
    end_ns = min(int(item.time[-1]) for item in sensors)
    for first_ns in range(begin_ns, end_ns, _CHUNK * width_ns):
        count = min(_CHUNK, (end_ns - first_ns) // width_ns)
        if count < 3:
            continue
        means = {sensor.name: window_means(sensor, first_ns, width_ns, count) for sensor in sensors}
        complete = np.all([has for _, has in means.values()], axis=0)
        forces_g = [
            calibrated.stimulus_box(means[sensor.name][0]) / STANDARD_GRAVITY for sensor, calibrated in accelerometers
        ]

        force_g = np.mean(forces_g, axis=0) if forces_g else None
        counts, *others = [
            without_force(means[sensor.name][0], calibrated, force_g) for sensor, calibrated in (gyroscope, *references)
        ]
        rates = [
            calibrated.stimulus_box(other) / SI_PER_UNIT[calibrated.unit]
            for other, (_, calibrated) in zip(others, references, strict=True)
        ]
        rate = np.mean(rates, axis=0)
        slope = np.gradient(rate, WINDOW_S, axis=0)
        usable = complete & np.isfinite(slope).all(axis=1)
        if np.count_nonzero(usable) > 2:
            yield counts[usable], rate[usable], slope[usable]


def without_force(counts: Floats, calibrated: SensorCalibration, force_g: Floats | None) -> Floats:
    """Return counts (n, 3) of a gyroscope less its g-sensitivity times the specific force (n, 3) in g, if both are
    known.
    """
    if force_g is None or calibrated.g_sensitivity_lsb_per_g is None:
        return counts
    return np.asarray(counts - force_g @ calibrated.g_sensitivity_lsb_per_g.T)


def window_means(sensor: SensorLog, first_ns: int, width_ns: int, count: int) -> tuple[Floats, Booleans]:
    """Return the mean counts (count, 3) of consecutive windows, NaN for windows without rows, and whether a window has
    rows of which none is saturated or suspect.
    """
    rows = sensor.between(first_ns, first_ns + count * width_ns)
    place = (np.asarray(sensor.time[rows], np.int64) - first_ns) // width_ns
    inside = (place >= 0) & (place < count)
    flagged = np.asarray(sensor.status[rows]) & (SATURATED | SUSPECT) != 0
    values = np.asarray(sensor.counts[rows], float)[inside]
    place, flagged = place[inside], flagged[inside]
    number = np.bincount(place, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack([np.bincount(place, values[:, axis], count) / number for axis in range(3)], axis=1)
    return mean, (number > 0) & (np.bincount(place, flagged, count) == 0)
