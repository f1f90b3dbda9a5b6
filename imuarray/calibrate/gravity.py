"""Joint calibration of accelerometers and directions of gravity from static poses, by the known length of gravity.

Any static poses are suitable, without a levelled table and without labels: in each of them the specific force is one g
long, and all accelerometers measure the same vector.

The fit starts with each accelerometer alone. ``|shape @ (mean - bias)| = 1 g`` over all poses gives its bias (3) and a
triangular shape matrix (6), an ellipsoid (Skog & Handel, Proc. XVII IMEKO World Congress, 2006). The length does not
determine the rotation of each sensor. It follows from the other sensors: all measured the same vector, so their
directions are aligned with each other.

From this start all sensors and all directions are fitted together by maximum likelihood (`solve`), including the drift
of biases while the box is tumbled. Every axis of every sensor is a linear function of the direction of gravity, which
all sensors share and which is unknown::

    reading = row @ up + bias (+ drift terms) + noise,      |up| = 1

This is a bundle adjustment, as used in photogrammetry for cameras and points (Triggs et al., Vision Algorithms, LNCS
1883, 2000): Gauss-Newton iterations on the directions, with the axes eliminated by their Schur complement. A common
rotation of all directions and all rows changes nothing; the box frame is defined as the one in which the mean response
of all sensors, each turned by its configured axes, is symmetric: on average they point where the configuration says.

Poses that no calibration explains are excluded. Readings are weighted by the noise within poses. If the readings of an
axis scatter more from pose to pose, a variance estimated from its residuals is added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from imuarray.arrays import Floats
from imuarray.calibrate.faces import accelerometer_of
from imuarray.calibrate.fits import (
    DRIFTS,
    Outlier,
    TriadFit,
    beyond_noise,
    find_outlier,
    misfit_probability,
    moving_poses,
    outlier_of,
    separated_poses,
)
from imuarray.calibrate.model import SensorCalibration
from imuarray.calibrate.pose_readings import Pose, PoseReadings, read_poses
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

_ITERATIONS = 30
_CONVERGED = 1e-9
"""Radians; a pose is known to a thousandth of a degree at best."""
_FREE = 3
"""Degrees of freedom of a common rotation of all directions and rows."""


@dataclass(frozen=True)
class Bundle:
    """The fit of a axes in k poses with q terms in addition to the response (the first is the bias).

    `coefficients` (a, 3 + q), `up_box` (k, 3), `residual` and `weight` (a, k), `design` (k, 3 + q). Of the normal
    equations: the inverse blocks `own` (a, p, p) of the axes, `shared` (a, p, 2k), the change of the axes with the
    directions, and `direction_covariance` (2k, 2k) along `tangents` (k, 3, 2). `stiffness` is the smallest over the
    largest eigenvalue of the directions' information matrix, without the common rotation.
    """

    coefficients: Floats
    up_box: Floats
    residual: Floats
    weight: Floats
    design: Floats
    own: Floats
    shared: Floats
    direction_covariance: Floats
    tangents: Floats
    stiffness: float

    @property
    def chi_squared(self) -> float:
        """Sum of the weighted squares."""
        return float((self.weight * self.residual**2).sum())

    @property
    def freedom(self) -> int:
        """Readings less unknowns."""
        return self.residual.size - self.coefficients.size - 2 * len(self.up_box) + _FREE

    @property
    def is_linear(self) -> bool:
        """Return whether the errors of directions are small enough for a linear fit: squared they are below a quarter
        of the noise of a reading (radians, and readings in units of gravity).
        """
        return float(np.diag(self.direction_covariance).max()) < 0.25 * float(np.mean(self.weight) ** -0.5)

    def axis_freedom(self) -> Floats:
        """Return the degrees of freedom (a,) of each axis: the number of poses less the trace of its leverages."""
        reach = np.einsum("apm,kp->akm", self.shared, self.design)
        slopes = np.einsum("ap,kpi->aki", self.coefficients[:, :3], self.tangents)
        for pose in range(len(self.up_box)):
            reach[:, pose, 2 * pose : 2 * pose + 2] -= slopes[:, pose]
        variance = np.einsum("kp,apq,kq->ak", self.design, self.own, self.design)
        variance += np.einsum("akm,mn,akn->ak", reach, self.direction_covariance, reach)
        return np.asarray((1 - self.weight * variance).sum(axis=1))

    def covariance(self) -> Floats:
        """Return the covariance (a p, a p) of all coefficients in the frame of `solve`, before the rotation into the
        box frame.
        """
        axes, p, _ = self.own.shape
        shared = self.shared.reshape(axes * p, -1)
        full = shared @ self.direction_covariance @ shared.T
        for axis in range(axes):
            place = slice(axis * p, (axis + 1) * p)
            full[place, place] += self.own[axis]
        return np.asarray(full)


def solve(readings: Floats, weight: Floats, terms: Floats, up_box: Floats, iterations: int = _ITERATIONS) -> Bundle:
    """Fit readings (a, k) with weights (a, k) and `terms` (k, q) in addition to the response, starting from directions
    (k, 3) near the truth. If one pose of a converged fit is omitted, two `iterations` are enough.
    """
    for _ in range(iterations):
        design = np.column_stack([up_box, terms])
        of_axes = np.linalg.pinv(np.einsum("kp,ak,kq->apq", design, weight, design), hermitian=True)
        coefficients = np.einsum("apq,kq,ak->ap", of_axes, design, weight * readings)
        residual = readings - coefficients @ design.T
        tangents = _tangents(up_box)
        slopes = np.einsum("ap,kpi->aki", coefficients[:, :3], tangents)
        shared, reduced = _reduce_axes(design, weight, slopes, of_axes)
        values, vectors = np.linalg.eigh(reduced)
        inverse = (vectors[:, _FREE:] / np.maximum(values[_FREE:], 1e-300)) @ vectors[:, _FREE:].T
        step = inverse @ np.einsum("aki,ak->ki", slopes, weight * residual).ravel()
        stiffness = float(values[_FREE] / values[-1])
        if np.abs(step).max() < _CONVERGED:
            break
        up_box = up_box + np.einsum("kpi,ki->kp", tangents, np.clip(step, -0.2, 0.2).reshape(-1, 2))
        up_box = up_box / np.linalg.norm(up_box, axis=1, keepdims=True)
    return Bundle(coefficients, up_box, residual, weight, design, of_axes, shared, inverse, tangents, stiffness)


def _tangents(up: Floats) -> Floats:
    """Return two unit vectors (k, 3, 2) perpendicular to each direction."""
    first = np.cross(up, np.eye(3)[np.abs(up).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(up, first)], axis=2)


def _reduce_axes(design: Floats, weight: Floats, slopes: Floats, own: Floats) -> tuple[Floats, Floats]:
    """Return the change (a, p, 2k) of the axes with the directions, and the directions' information matrix (2k, 2k)
    after elimination of the axes.
    """
    axes, poses, _ = slopes.shape
    mixed = np.einsum("kp,ak,aki->apki", design, weight, slopes).reshape(axes, -1, 2 * poses)
    shared = own @ mixed
    reduced: Floats = -mixed.reshape(-1, 2 * poses).T @ shared.reshape(-1, 2 * poses)
    blocks = np.einsum("aki,ak,akj->kij", slopes, weight, slopes)
    for pose in range(poses):
        place = slice(2 * pose, 2 * pose + 2)
        reduced[place, place] += blocks[pose]
    return shared, reduced


@dataclass(frozen=True)
class BoxFrameFit:
    """A bundle rotated into the box frame: coefficients (a, p) with covariance (a p, a p), directions (k, 3) with
    covariance (3 k, 3 k).
    """

    coefficients: Floats
    covariance: Floats
    up_box: Floats
    up_covariance: Floats


def turn_into_box_frame(bundle: Bundle, orientations: Floats) -> BoxFrameFit:
    """Turn a fit into the box frame, in which the mean over the sensors of ``orientation @ rows`` is symmetric;
    `orientations` (s, 3, 3) are the configured ones.

    Errors of the rows turn that frame, which completes the covariance of the directions: the common rotation is not
    part of `Bundle.direction_covariance`.
    """
    axes, p = bundle.coefficients.shape
    stacked = np.concatenate(orientations, axis=1) / len(orientations)  # (3, a): the mean is stacked @ rows
    left_vectors, _, right = np.linalg.svd(stacked @ bundle.coefficients[:, :3])
    turn = right.T @ left_vectors.T
    rows = bundle.coefficients[:, :3] @ turn
    rotate = np.eye(p)
    rotate[:3, :3] = turn.T
    free, turned_by = _rotation_derivative(rows, stacked, p)
    into = np.kron(np.eye(axes), rotate)
    held = (np.eye(axes * p) + free @ turned_by) @ into
    covariance = bundle.covariance()
    # Errors of the directions: those along their tangents, and the rotation of the frame by errors of the rows.
    up_box = bundle.up_box @ turn
    count = len(up_box)
    along = np.zeros((3 * count, 2 * count))
    for pose in range(count):
        along[3 * pose : 3 * pose + 3, 2 * pose : 2 * pose + 2] = turn.T @ bundle.tangents[pose]
    swung = np.cross(np.eye(3)[None], up_box[:, None, :]).transpose(0, 2, 1).reshape(-1, 3) @ turned_by @ into
    mixed = bundle.shared.reshape(axes * p, -1) @ bundle.direction_covariance
    crossed = swung @ mixed @ along.T
    up_covariance = along @ bundle.direction_covariance @ along.T + swung @ covariance @ swung.T - crossed - crossed.T
    return BoxFrameFit(
        np.column_stack([rows, bundle.coefficients[:, 3:]]), held @ covariance @ held.T, up_box, up_covariance
    )


def _rotation_derivative(rows: Floats, stacked: Floats, p: int) -> tuple[Floats, Floats]:
    """Return the derivative (a p, 3) of the coefficients by a common rotation, and the rotation (3, a p) that keeps the
    mean response symmetric if the coefficients change.
    """
    axes = len(rows)
    free = np.zeros((axes, p, 3))
    free[:, :3] = np.cross(np.eye(3)[None], rows[:, None, :]).transpose(0, 2, 1)  # column j: e_j x row
    skew = np.zeros((3, axes, p))
    for j, (m, n) in enumerate(((2, 1), (0, 2), (1, 0))):  # entry (m, n) of the mean less entry (n, m)
        skew[j, :, n] += stacked[m]
        skew[j, :, m] -= stacked[n]
    flat, gauge = free.reshape(axes * p, 3), skew.reshape(3, axes * p)
    return flat, -np.asarray(np.linalg.solve(gauge @ flat, gauge), float)


_TRIANGLE = np.triu_indices(3)


def directions_of(readings: PoseReadings) -> Floats:
    """Return approximate directions (k, 3) of gravity's reaction in the box frame.

    CalibrationError if the poses do not separate bias from scale.
    """
    means = readings.mean_lsb / readings.sensitivity[:, None, None]
    directions = []
    for sensor, mean in zip(readings.sensors, means, strict=True):
        gravity = _ellipsoid(sensor, mean)
        directions.append(sensor.orientation @ gravity / np.linalg.norm(gravity, axis=0))
    return _common(directions).T


def _ellipsoid(sensor: SensorLog, means: Floats) -> Floats:
    """Return the specific force (3, k) in g, sensor frame, of readings (k, 3) in g; CalibrationError if the poses do
    not separate bias from scale.
    """

    def gravity(parameters: Floats) -> Floats:
        shape = np.zeros((3, 3))
        shape[_TRIANGLE] = parameters[3:]
        return np.asarray(shape @ (means - parameters[:3]).T)

    start = np.concatenate([np.zeros(3), np.eye(3)[_TRIANGLE]])
    fit = least_squares(lambda parameters: np.linalg.norm(gravity(parameters), axis=0) - 1, start)
    if not fit.success or np.linalg.cond(fit.jac.T @ fit.jac) > 1e8:
        raise CalibrationError(insufficient_poses(sensor, means))
    return gravity(fit.x)


FACE_COSINE = 0.97
"""Cosine of the angle (14 degrees) within which a pose lies on a face: a table is level, and a box has right angles."""


def faces_of(means_g: Floats) -> list[tuple[int, bool]]:
    """Return for each pose (k, 3) the axis (0, 1, 2) along which gravity points, and whether it is positive; [] if a
    pose is not on a face.
    """
    directions = means_g / np.linalg.norm(means_g, axis=1, keepdims=True)
    axis = np.argmax(np.abs(directions), axis=1)
    component = np.take_along_axis(directions, axis[:, None], axis=1)[:, 0]
    if (np.abs(component) < FACE_COSINE).any():
        return []
    return list(zip(axis.tolist(), (component > 0).tolist(), strict=True))


def insufficient_poses(sensor: SensorLog, means_g: Floats | None = None) -> str:
    """Describe the parameters that the poses do not determine; `means_g` (k, 3) are their readings."""
    if means_g is not None and len(set(faces_of(means_g))) == 6:
        return (
            f"{sensor.where}: all poses lie on the six faces, which leaves the angles between the axes open; add"
            " poses on edges and corners, or name the faces (imuarray log --phase z_up, [[phase]] in an import's"
            " map), so that each is known to point up"
        )
    return f"{sensor.where}: the poses do not separate bias from scale; add poses on other sides"


def _common(directions: Sequence[Floats]) -> Floats:
    """Return the mean (3, k) of the sensors' directions (3, k), each aligned with it (Kabsch, Acta Cryst. A32, 1976, p.
    922).
    """
    from scipy.spatial.transform import Rotation  # slow to import

    common = np.asarray(directions[0])
    for _ in range(3):
        aligned = [Rotation.align_vectors(common.T, direction.T)[0].as_matrix() @ direction for direction in directions]
        common = np.mean(aligned, axis=0)
        common /= np.linalg.norm(common, axis=0)
    return common


MIN_POSES = 9
"""Nine unknowns per sensor."""

LARGEST_ERROR_G = 0.001
"""Largest deviation from one g, median over the accelerometers, of a pose at rest, by the calibration from the other
poses. A box on a table stays below it; a box held by hand does not."""

_SOFTEST = 1e-5
"""Lower limit of `Bundle.stiffness`: below it, some rotation of the directions is practically unknown."""

_MOST_DRIFT = 2
"""Highest power of time in the drift of a bias: warm-up is fast at first."""


@dataclass(frozen=True)
class GravityFit:
    """Accelerometers calibrated together from `poses` (k), in the order of the sensors (s).

    `up_box` (k, 3) are the directions of gravity's reaction. `force_g` (s, k) is the length of the calibrated specific
    force with the drift corrected, and `held_out_force_g` the same by a calibration from all other poses (nan where
    those are too few). `drift_lsb` (s, 3) is the bias in the first pose less that in the last, and `drift_terms` the
    number of powers of time in it. `covariance` (12 s, 12 s) is that of bias and response of all sensors: the rows of
    `fits`' coefficients without the drift, in the order of the sensors. `up_covariance` (3 k, 3 k) is that of the
    directions.
    """

    calibrations: tuple[SensorCalibration, ...]
    fits: tuple[TriadFit, ...]
    covariance: Floats
    poses: tuple[Pose, ...]
    up_box: Floats
    up_covariance: Floats
    force_g: Floats
    held_out_force_g: Floats
    drift_lsb: Floats
    drift_terms: int
    left_out: tuple[Outlier, ...]

    @property
    def residual_g(self) -> Floats:
        """Rms (s,) over the poses of the specific force's length less one g."""
        return np.asarray(np.sqrt(np.mean((self.force_g - 1) ** 2, axis=1)))

    @property
    def held_out_residual_g(self) -> Floats:
        """The same (s,) with each pose calibrated from the other poses."""
        return np.asarray(np.sqrt(np.mean((self.held_out_force_g - 1) ** 2, axis=1)))


def fit_gravity(
    sensors: Sequence[SensorLog], poses: Sequence[Pose], progress: Callable[[int], None] = lambda done: None
) -> GravityFit:
    """Calibrate accelerometers jointly from static poses; `progress` is called with the number of poses tested.

    CalibrationError if there are fewer than nine poses, if they do not spread enough, or if too few are undisturbed.
    """
    _refuse_few(sensors[0], len(poses), [])
    return fit_readings(read_poses(sensors, poses), progress)


def fit_readings(all_readings: PoseReadings, progress: Callable[[int], None] = lambda done: None) -> GravityFit:
    """Calibrate as `fit_gravity` does, from readings instead of logs."""
    sensors, poses = all_readings.sensors, all_readings.poses
    separated = separated_poses(poses) if all_readings.one_run else {}
    reasons = {**(separated if len(poses) - len(separated) >= MIN_POSES else {}), **moving_poses(all_readings)}
    bad = {place: outlier_of(poses[place], reason) for place, reason in reasons.items()}
    while True:
        sound = [place for place in range(len(poses)) if place not in bad]
        left_out = [bad[place] for place in sorted(bad)]
        _refuse_few(sensors[0], len(sound), left_out)
        joint = _fit_jointly(all_readings.only(sound))
        held_out, chances = _leave_one_out(joint, progress)
        off_g = np.median(np.abs(held_out - 1), axis=0)
        outlier = find_outlier(chances, np.nan_to_num(off_g), LARGEST_ERROR_G)
        if outlier is None:
            return _result(joint, held_out, left_out)
        reason = f"{1e3 * off_g[outlier]:.1f} mg from one g by the calibration of the other poses: not at rest"
        bad[sound[outlier]] = outlier_of(poses[sound[outlier]], reason)


def fit_weighted(readings: PoseReadings, variance_g2: Floats, left_out: Sequence[Outlier] = ()) -> GravityFit:
    """Calibrate from readings with given variances (3 s, k) in g squared, without a drift.

    CalibrationError if the poses do not spread enough.
    """
    scale = readings.sensitivity[:, None, None]
    values = _flatten_axes(readings.mean_lsb / scale)
    terms = np.ones((len(readings.poses), 1))
    bundle = solve(values, 1 / variance_g2, terms, directions_of(readings))
    if bundle.stiffness < _SOFTEST:
        raise CalibrationError(insufficient_poses(readings.sensors[0]))
    chi_squared, freedom = _chi_squared(bundle)
    joint = _JointFit(readings, values, bundle, np.zeros(len(values)), chi_squared, freedom)
    return _result(joint, np.full((len(readings.sensors), len(readings.poses)), np.nan), left_out)


def _refuse_few(sensor: SensorLog, count: int, left_out: Sequence[Outlier]) -> None:
    if count < MIN_POSES:
        reasons = "".join(f"; {pose.phase}: {pose.reason}" for pose in left_out)
        sound = "static" if not left_out else "undisturbed"
        raise CalibrationError(f"{sensor.where}: {count} {sound} poses, at least {MIN_POSES} are required{reasons}")


@dataclass(frozen=True)
class _JointFit:
    """Joint fit of all axes (a = 3 s) in all poses (k): `bundle` is fitted to `values` (a, k) in g; `beyond` (a,) is
    the scatter beyond the noise, `chi_squared` and `freedom` (a,) are those with the noise alone.
    """

    readings: PoseReadings
    values: Floats
    bundle: Bundle
    beyond: Floats
    chi_squared: Floats
    freedom: Floats

    @property
    def terms(self) -> Floats:
        """The terms (k, q) of the fit in addition to the response."""
        return self.bundle.design[:, 3:]


def _fit_jointly(readings: PoseReadings) -> _JointFit:
    """Fit all sensors and directions, including the drift and the scatter estimated from the readings."""
    scale = readings.sensitivity[:, None, None]
    values = _flatten_axes(readings.mean_lsb / scale)
    noise = _flatten_axes(readings.variance_lsb2 / scale**2)
    terms, bundle = _fit_drift(readings, values, noise, directions_of(readings))
    if bundle.stiffness < _SOFTEST:
        raise CalibrationError(insufficient_poses(readings.sensors[0]))
    beyond = np.zeros(len(values))
    chi_squared, freedom = _chi_squared(bundle)
    for _ in range(10):
        squares, freedoms = _chi_squared(bundle)
        fits = np.abs(squares - freedoms) < 0.05 * freedoms
        factors = [beyond_noise(square, free, len(freedoms)) for square, free in zip(squares, freedoms, strict=True)]
        change = (np.array(factors) | (beyond > 0)) & ~fits & (freedoms > 0.5)
        if not change.any():
            break
        total = (1 / bundle.weight).mean(axis=1) * squares / np.maximum(freedoms, 0.5)
        beyond = np.where(change, np.maximum(total - noise.mean(axis=1), 0.0), beyond)
        bundle = solve(values, 1 / (noise + beyond[:, None]), terms, bundle.up_box)
    return _JointFit(readings, values, bundle, np.sqrt(beyond), chi_squared, freedom)


def _flatten_axes(triads: Floats) -> Floats:
    """Reorder (s, k, 3) to (3 s, k)."""
    return triads.transpose(0, 2, 1).reshape(-1, triads.shape[1])


def _chi_squared(bundle: Bundle) -> tuple[Floats, Floats]:
    """Return chi-squared (a,) of every axis and its degrees of freedom."""
    return (bundle.weight * bundle.residual**2).sum(axis=1), bundle.axis_freedom()


def _fit_drift(readings: PoseReadings, values: Floats, noise: Floats, up_box: Floats) -> tuple[Floats, Bundle]:
    """Return the terms of the fit in addition to the response, and the fit. The terms are powers of time, as long as
    each one improves the fit significantly.

    All terms but the bias have zero mean over the poses, so that the bias is the mean one. If the poses do not separate
    a drift from the other parameters, it remains part of the scatter.
    """
    powers = readings.powers_of_time(_MOST_DRIFT)
    terms = powers[:, :1]
    best = solve(values, 1 / noise, terms, up_box)
    for count in range(2, powers.shape[1] + 1):
        trial = solve(values, 1 / noise, powers[:, :count], best.up_box)
        chance = misfit_probability(best.chi_squared, trial.chi_squared, len(values), trial.freedom)
        if trial.freedom <= 0 or not trial.is_linear or chance > DRIFTS:
            break
        terms, best = powers[:, :count], trial
    return terms, best


def _leave_one_out(joint: _JointFit, progress: Callable[[int], None]) -> tuple[Floats, list[float]]:
    """Return for each pose the length (s, k) of the specific force by a calibration from all other poses, and the
    probability of a misfit at least as large by chance: the larger of the probabilities by the scatter of the other
    poses and by the weights.
    """
    sensors, poses = len(joint.readings.sensors), len(joint.readings.poses)
    lengths, chances = np.full((sensors, poses), np.nan), [1.0] * poses
    number = 3 * sensors - 2
    if joint.bundle.freedom - number <= 0:
        return lengths, chances
    for pose in range(poses):
        others = np.delete(np.arange(poses), pose)
        fit = solve(
            joint.values[:, others], joint.bundle.weight[:, others], joint.terms[others], joint.bundle.up_box[others], 2
        )
        if fit.stiffness > _SOFTEST:
            lengths[:, pose] = _lengths(fit.coefficients, joint.values[:, [pose]], joint.terms[[pose]])[:, 0]
            squares, fewer = joint.bundle.chi_squared, fit.chi_squared
            by_scatter = misfit_probability(squares, fewer, number, joint.bundle.freedom - number)
            chances[pose] = max(by_scatter, float(chdtrc(number, max(squares - fewer, 0.0))))
        progress(pose + 1)
    return lengths, chances


def _lengths(coefficients: Floats, values: Floats, terms: Floats) -> Floats:
    """Return the length (s, k) of the specific force in g for readings (3 s, k)."""
    response = coefficients[:, :3].reshape(-1, 3, 3)
    unbiased = (values - coefficients[:, 3:] @ terms.T).reshape(len(response), 3, -1)
    return np.asarray(np.linalg.norm(np.linalg.solve(response, unbiased), axis=1))


def _result(joint: _JointFit, held_out: Floats, left_out: Sequence[Outlier]) -> GravityFit:
    """Convert a fit to counts and to the box frame."""
    readings, bundle = joint.readings, joint.bundle
    orientations = np.array([sensor.orientation for sensor in readings.sensors])
    boxed = turn_into_box_frame(bundle, orientations)
    axes, p = boxed.coefficients.shape
    counts = np.repeat(readings.sensitivity, 3)
    covariance = boxed.covariance * np.outer(np.repeat(counts, p), np.repeat(counts, p))
    rows = boxed.coefficients * counts[:, None]
    fits = [
        TriadFit(
            rows[3 * s : 3 * s + 3],
            covariance[3 * p * s : 3 * p * (s + 1), 3 * p * s : 3 * p * (s + 1)],
            float(joint.chi_squared[3 * s : 3 * s + 3].sum()),
            float(joint.freedom[3 * s : 3 * s + 3].sum()),
            (joint.beyond * counts)[3 * s : 3 * s + 3],
        )
        for s in range(len(readings.sensors))
    ]
    is_response = np.tile(np.arange(p) < 4, axes)
    change = joint.terms[0] - joint.terms[-1]
    return GravityFit(
        calibrations=tuple(accelerometer_of(sensor, fit) for sensor, fit in zip(readings.sensors, fits, strict=True)),
        fits=tuple(fits),
        covariance=covariance[np.ix_(is_response, is_response)],
        poses=readings.poses,
        up_box=boxed.up_box,
        up_covariance=boxed.up_covariance,
        force_g=_lengths(bundle.coefficients, joint.values, joint.terms),
        held_out_force_g=held_out,
        drift_lsb=(rows[:, 3:] @ change).reshape(-1, 3),
        drift_terms=joint.terms.shape[1] - 1,
        left_out=tuple(left_out),
    )
