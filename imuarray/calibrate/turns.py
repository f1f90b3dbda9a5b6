"""Scale factors and axes of gyroscopes from the turns between poses, with the accelerometers as reference.

A gyroscope's rates, integrated from one pose to the next, must rotate gravity's direction before the turn into that
after it. Each turn gives two equations (gravity does not show a turn about the vertical) for the nine elements of the
response's inverse::

    rate_box = inverse @ (counts - bias - g_sensitivity @ force)

The bias over a turn is interpolated between the poses before and after it, so that drift has no effect. Rates are
linear between readings; their rotation is that of the mean rate with the coning term ``dt^2 / 12 (w0 x w1)`` (Bortz,
IEEE Trans. AES 7, 1971; Savage, J. Guidance 21, 1998). The fit is nonlinear least squares, weighted by the noise at
rest, integrated over the turn; the covariance is enlarged if the residuals require it. The prior response with its
covariance is one more measurement: the one measured before, or the data sheet's with its tolerance. Columns that the
turns do not determine, because they are about too few axes, are then known to the data sheet's tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.fits import Outlier, beyond_noise, find_outlier, misfit_probability
from imuarray.calibrate.model import SensorCalibration, uncertain_columns
from imuarray.calibrate.pose_readings import Pose, read_pose
from imuarray.log import SensorLog
from imuarray.log.format import SATURATED, SUSPECT
from imuarray.units import SI_PER_UNIT, STANDARD_GRAVITY

FEWEST_TURNS = 6
"""Twelve equations for nine unknowns."""

FEWEST_MORE_TURNS = 3
"""Fewest turns of a gyroscope with an already measured response: six equations for the three unknowns of a column."""

LONGEST_S = 20.0
"""Longest turn; the integrated noise and bias of a longer one exceed its information."""

_GAP = 3.0
"""Longest pause between readings within a turn, as a multiple of the usual interval."""

_FAR_DEG = 0.3
"""Smallest error of a turn that is excluded."""

TOLERANCE = 0.02
"""Standard deviation of each entry of a gyroscope's response about the data sheet's and the configured axes, as a share
of the sensitivity: L3G-72 allows the scale factor 2 % (over temperature), and a misalignment of one degree adds as much
of another axis. If turns determine a column to 0.03 %, this prior changes it by less than a thousandth of that."""

_ITERATIONS = 10


@dataclass(frozen=True)
class TurnFit:
    """One gyroscope's response from turns.

    `response` (3, 3) in counts per dps, with standard errors `sem` and `covariance` (9, 9) row by row, includes the
    data sheet's tolerance or an earlier measurement. `uncertain_axes` are the box axes with few turns about them, whose
    columns are not known to one per cent. `turns` is the number used, `residual_deg` the rms error of the directions
    after them, `chi_squared` that by the noise at rest with `freedom` degrees; `left_out` are the excluded turns.
    """

    response: Floats
    sem: Floats
    covariance: Floats
    uncertain_axes: str
    turns: int
    residual_deg: float
    chi_squared: float
    freedom: float
    left_out: tuple[Outlier, ...]

    def complete(self, calibration: SensorCalibration) -> SensorCalibration:
        """Return a gyroscope's calibration with this response."""
        return replace(
            calibration,
            response_lsb_per_unit=self.response,
            response_sem_lsb_per_unit=self.sem.max(axis=1),
            response_covariance_lsb2_per_unit2=self.covariance,
        )


@dataclass(frozen=True)
class _Turn:
    """A turn from one pose to the next: its name and log, the index of the pose before it (`place`), steps between
    readings (n - 1,) in s, counts less bias (n, 3), the upward directions `before` and `after` (3,), and the variance
    of its end in rad^2 by the gyroscope's noise.
    """

    name: str
    log: str
    place: int
    steps_s: Floats
    counts: Floats
    before: Floats
    after: Floats
    variance: float


def fit_turns(
    sensor: SensorLog,
    calibration: SensorCalibration,
    poses: Sequence[Pose],
    up_box: Floats,
    up_covariance: Floats,
    accelerometers: Sequence[tuple[SensorLog, SensorCalibration]] = (),
) -> TurnFit | None:
    """Measure a gyroscope's response from the turns between neighbouring `poses`, in which `up_box` (k, 3) pointed up,
    with covariance (3 k, 3 k). None if fewer than `FEWEST_TURNS` are usable (`FEWEST_MORE_TURNS` if `calibration` has a
    measured response, which the turns then improve).

    `calibration` contains the g-sensitivity; the calibrated `accelerometers` measure the specific force during a turn.
    """
    prior = _response_before(sensor, calibration)
    fewest = FEWEST_TURNS if calibration.response_sem_lsb_per_unit is None else FEWEST_MORE_TURNS
    good: list[_Turn] = []
    left_out: list[Outlier] = []
    for place, (first, second) in enumerate(pairwise(poses)):
        if first.log is not second.log:
            continue
        turn = _turn(sensor, calibration, (first, second), place, up_box, accelerometers)
        if isinstance(turn, Outlier):
            left_out.append(turn)
        else:
            good.append(turn)
    while len(good) >= fewest:
        fit, chances, shifts = _fit(sensor, prior, good, up_covariance, left_out)
        outlier = find_outlier(chances, shifts, np.radians(_FAR_DEG))
        if outlier is None:
            return fit
        reason = f"ends {np.degrees(shifts[outlier]):.2f} degrees from where the other turns predict its end"
        left_out.append(Outlier(good[outlier].name, good[outlier].log, reason))
        good.pop(outlier)
    return None


def _turn(
    sensor: SensorLog,
    calibration: SensorCalibration,
    ends: tuple[Pose, Pose],
    place: int,
    up_box: Floats,
    accelerometers: Sequence[tuple[SensorLog, SensorCalibration]],
) -> _Turn | Outlier:
    """Return the turn between two poses, the first of index `place`, or the reason why it can't be integrated."""
    (first, second), before, after = ends, up_box[place], up_box[place + 1]
    source, _ = first.rows_of(sensor)
    name, log = f"{first.phase.name} to {second.phase.name}", "" if first.log is None else str(first.log.path)
    inside = source.between(first.phase.end_ns, second.phase.start_ns)
    rows = slice(max(inside.start - 1, 0), inside.stop + 1)
    time = np.asarray(source.time[rows]) * 1e-9
    seconds = float(time[-1] - time[0])
    readings = [read_pose(sensor, pose) for pose in (first, second)]
    rests_s = [(pose.phase.end_ns - pose.phase.start_ns) * 1e-9 for pose in (first, second)]
    usual_s = rests_s[0] / readings[0].rows
    clipped = int(np.count_nonzero(np.asarray(source.status[rows]) & (SATURATED | SUSPECT)))
    if clipped:
        return Outlier(name, log, f"{clipped} readings clip or are suspect")
    if seconds > LONGEST_S:
        return Outlier(name, log, f"took {seconds:.0f} s")
    if len(time) < 4 or np.diff(time).max() > _GAP * usual_s:
        return Outlier(name, log, "readings are missing")
    share = ((time - time[0]) / seconds)[:, None]
    means = [reading.mean_lsb for reading in readings]
    counts = np.asarray(source.counts[rows], float) - means[0] - share * (means[1] - means[0])
    if accelerometers and calibration.g_sensitivity_lsb_per_g is not None:
        change_g = _force_g(accelerometers, first, time) - before - share * (after - before)
        counts = counts - change_g @ calibration.g_sensitivity_lsb_per_g.T
    rad_per_lsb = SI_PER_UNIT[sensor.unit] / sensor.sensitivity
    mean_variance = np.array([np.mean(reading.sem_lsb**2) for reading in readings]) * rad_per_lsb**2
    white = float(np.mean(mean_variance * rests_s))  # rad^2/s: a mean's variance times its averaging time
    variance = white * seconds + float(mean_variance.sum()) * seconds**2 / 4
    return _Turn(name, log, place, np.diff(time), counts, before, after, max(variance, 1e-12))


def _force_g(accelerometers: Sequence[tuple[SensorLog, SensorCalibration]], pose: Pose, time_s: Floats) -> Floats:
    """Return the specific force (n, 3) in g in the box frame at these times: the mean of all accelerometers."""
    forces = []
    for sensor, calibration in accelerometers:
        source, _ = pose.rows_of(sensor)
        rows = source.between(round(time_s[0] * 1e9) - 10**8, round(time_s[-1] * 1e9) + 10**8)
        own = np.asarray(source.time[rows]) * 1e-9
        force = calibration.stimulus_box(np.asarray(source.counts[rows])) / STANDARD_GRAVITY
        forces.append(np.stack([np.interp(time_s, own, column) for column in force.T], axis=1))
    return np.asarray(np.mean(forces, axis=0))


def _response_before(sensor: SensorLog, calibration: SensorCalibration) -> tuple[Floats, Floats]:
    """Return the prior inverse response (3, 3) in rad/s per count and its information matrix (9, 9), row by row: as
    measured before, or the data sheet's with its tolerance.
    """
    si = SI_PER_UNIT[sensor.unit]
    covariance = calibration.response_covariance()
    if covariance is None:
        return np.asarray(sensor.orientation) * si / sensor.sensitivity, (
            TOLERANCE * si / sensor.sensitivity
        ) ** -2 * np.eye(9)
    inverse = np.asarray(np.linalg.inv(calibration.response_lsb_per_unit) * si, float)
    change = -np.einsum("ia,bj->ijab", inverse, inverse).reshape(9, 9) / si
    return inverse, np.asarray(np.linalg.inv(change @ covariance @ change.T), float)


def _fit(
    sensor: SensorLog,
    response_prior: tuple[Floats, Floats],
    turns: Sequence[_Turn],
    up_covariance: Floats,
    left_out: Sequence[Outlier],
) -> tuple[TurnFit, list[float], Floats]:
    """Fit the response to all `turns` and the prior. Return the fit; for each turn the probability of an error at least
    as large as its own; and the errors in radians with respect to the other turns.
    """
    nominal, prior = response_prior
    inverse = nominal.copy()
    for _ in range(_ITERATIONS):
        parts = [_integrate_turn(turn, inverse) for turn in turns]
        missed = np.concatenate([part.missed for part in parts])
        slopes = np.concatenate([part.slope for part in parts])
        weight = np.linalg.inv(_variance(turns, parts, up_covariance))
        information = slopes.T @ weight @ slopes
        posterior = np.linalg.inv(information + prior)
        step = posterior @ (slopes.T @ weight @ missed + prior @ (nominal - inverse).ravel())
        inverse = inverse + step.reshape(3, 3)
        if np.abs(step).max() < 1e-7 * np.abs(nominal).max():
            break
    chi_squared = float(missed @ weight @ missed)
    freedom = 2 * len(turns) - float(np.trace(posterior @ information))  # the prior has no degrees of freedom
    excess = chi_squared / freedom if beyond_noise(chi_squared, freedom) else 1.0
    chances, shifts = _shifts(missed, weight - weight @ slopes @ posterior @ slopes.T @ weight, chi_squared, freedom)
    response = np.asarray(np.linalg.inv(inverse), float) * SI_PER_UNIT[sensor.unit]
    change = -np.einsum("ia,bj->ijab", response, response).reshape(9, 9) / SI_PER_UNIT[sensor.unit]
    covariance = change @ np.linalg.inv(information / excess + prior) @ change.T
    sem = np.sqrt(np.diag(covariance)).reshape(3, 3)
    uncertain = uncertain_columns(response, covariance)
    residual_deg = float(np.degrees(np.sqrt((missed**2).sum() / len(turns))))
    fit = TurnFit(response, sem, covariance, uncertain, len(turns), residual_deg, chi_squared, freedom, tuple(left_out))
    return fit, chances, shifts


def _variance(turns: Sequence[_Turn], parts: Sequence[_GravityMisfit], up_covariance: Floats) -> Floats:
    """Return the covariance (2 t, 2 t) of the errors after turns: the gyroscope's noise, and the errors of the
    directions at both ends, which neighbouring turns share.
    """
    answer = np.zeros((2 * len(turns), len(up_covariance)))
    for row, (turn, part) in enumerate(zip(turns, parts, strict=True)):
        ends = slice(3 * turn.place, 3 * turn.place + 6)
        answer[2 * row : 2 * row + 2, ends] = part.across @ np.hstack([-part.onward, np.eye(3)])
    variances = np.repeat([turn.variance for turn in turns], 2)
    return np.asarray(answer @ up_covariance @ answer.T + np.diag(variances))


def _shifts(missed: Floats, projected: Floats, chi_squared: float, freedom: float) -> tuple[list[float], Floats]:
    """Return for each turn the probability of its error by the scatter of the others, and the error (t,): the mean
    shift that explains it under the projected weights (2 t, 2 t).
    """
    pulls = (projected @ missed).reshape(-1, 2)
    blocks = np.array([projected[row : row + 2, row : row + 2] for row in range(0, len(missed), 2)])
    alone = np.linalg.solve(blocks, pulls[:, :, None])[:, :, 0]
    gains = (pulls * alone).sum(axis=1)
    chances = [misfit_probability(chi_squared, chi_squared - float(gain), 2, freedom - 2) for gain in gains]
    return chances, np.linalg.norm(alone, axis=1)


@dataclass(frozen=True)
class _GravityMisfit:
    """Error (2,) of gravity's direction after a turn, in radians along two perpendicular directions `across` (2, 3);
    the derivative (2, 9) of the direction by the inverse response, row by row; and the rotation (3, 3) `onward`.
    """

    missed: Floats
    slope: Floats
    across: Floats
    onward: Floats


def _integrate_turn(turn: _Turn, inverse: Floats) -> _GravityMisfit:
    """Integrate the rates of a turn and compare the direction of gravity with the one after it."""
    from scipy.spatial.transform import Rotation  # slow to import

    rates = turn.counts @ inverse.T
    steps = turn.steps_s[:, None]
    angles = steps * (rates[1:] + rates[:-1]) / 2 + steps**2 / 12 * np.cross(rates[:-1], rates[1:])
    onward = _products(Rotation.from_rotvec(angles).as_matrix())
    carried = onward[0].T @ turn.before
    across = np.linalg.svd(turn.after[None])[2][1:]
    middle = steps * (turn.counts[1:] + turn.counts[:-1]) / 2
    turned = np.einsum("nji,nl->ijl", np.concatenate([onward[1:], np.eye(3)[None]]), middle).reshape(3, 9)
    slope = across @ np.cross(carried[None], turned.T).T
    return _GravityMisfit(across @ (turn.after - carried), slope, across, onward[0].T)


def _products(rotations: Floats) -> Floats:
    """Return the product (n, 3, 3) of each rotation and all that follow it, in log2 n steps."""
    products, reach = rotations.copy(), 1
    while reach < len(products):
        products[:-reach] = products[:-reach] @ products[reach:]
        reach *= 2
    return products
