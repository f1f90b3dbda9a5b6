"""Joint calibration of accelerometers and directions of gravity from static poses, by the known length of gravity.

Any static poses will do, without a levelled table and without labels: in each of them the specific force is one g long,
and all accelerometers sense the same vector.

The fit starts with each accelerometer alone. ``|shape @ (mean - bias)| = 1 g`` over all poses gives its bias (3) and a
triangular shape matrix (6), an ellipsoid (Skog & Handel, Proc. XVII IMEKO World Congress, 2006). The rotation of each
sensor, which the length leaves open, follows from the others: all sensed the same, so their directions are turned onto
each other.

From this start all sensors and all directions are fitted together by maximum likelihood (`solve`), including the drift
of biases while the box is tumbled. Every axis of every sensor is a linear function of the direction of gravity, which
all sensors share and which is unknown::

    reading = row @ up + bias (+ drift terms) + noise,      |up| = 1

This is a bundle adjustment, as photogrammetry has it with cameras and points (Triggs et al., Vision Algorithms, LNCS
1883, 2000): Gauss-Newton on the directions, the axes eliminated by their Schur complement. A common rotation of all
directions and all rows changes nothing; the box frame is defined as the one in which the mean response of all sensors,
each turned by its configured axes, is symmetric: on average they point where the configuration says.

Poses that no calibration explains are left out. Weights are those of the noise within poses; an axis whose readings
scatter more from pose to pose gets a variance of its own, as large as its residuals require.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from imuarray.arrays import Floats
from imuarray.calibrate.disturbed import Exclusion, another_go, chance_of_misfit, exclusion_of, moved_within, worst
from imuarray.calibrate.faces import accelerometer_of
from imuarray.calibrate.fits import DRIFTS, TriadFit, beyond_noise
from imuarray.calibrate.model import SensorCalibration
from imuarray.calibrate.pose_readings import Pose, PoseReadings, read_poses
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog

_ITERATIONS = 30
_CONVERGED = 1e-9
"""Radians; a pose is known to a thousandth of a degree at best."""
_FREE = 3
"""Turns of everything together."""


@dataclass(frozen=True)
class Bundle:
    """The fit of a axes in k poses with q terms beside the response (the first is the bias).

    `coefficients` (a, 3 + q), `up_box` (k, 3), `residual` and `weight` (a, k), `design` (k, 3 + q); of the normal
    equations the inverse blocks `own` (a, p, p), `shared` (a, p, 2k), the axes' answer to the directions, and
    `direction_covariance` (2k, 2k) along `tangents` (k, 3, 2). `stiffness`: smallest over largest eigenvalue of what
    the readings say of the directions, the free turns left aside.
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
        """Return whether directions are known so well that their errors matter to first order only: squared they must
        stay below a quarter of the noise of a reading (radians, and readings in units of gravity).
        """
        return float(np.diag(self.direction_covariance).max()) < 0.25 * float(np.mean(self.weight) ** -0.5)

    def axis_freedom(self) -> Floats:
        """(a,) readings of each axis less the unknowns that it pays for: k less the trace of its leverages."""
        reach = np.einsum("apm,kp->akm", self.shared, self.design)
        slopes = np.einsum("ap,kpi->aki", self.coefficients[:, :3], self.tangents)
        for pose in range(len(self.up_box)):
            reach[:, pose, 2 * pose : 2 * pose + 2] -= slopes[:, pose]
        variance = np.einsum("kp,apq,kq->ak", self.design, self.own, self.design)
        variance += np.einsum("akm,mn,akn->ak", reach, self.direction_covariance, reach)
        return np.asarray((1 - self.weight * variance).sum(axis=1))

    def covariance(self) -> Floats:
        """(a p, a p) of all coefficients in the frame of `solve`, before they are turned into the box frame."""
        axes, p, _ = self.own.shape
        shared = self.shared.reshape(axes * p, -1)
        full = shared @ self.direction_covariance @ shared.T
        for axis in range(axes):
            place = slice(axis * p, (axis + 1) * p)
            full[place, place] += self.own[axis]
        return np.asarray(full)


def solve(readings: Floats, weight: Floats, terms: Floats, up_box: Floats, iterations: int = _ITERATIONS) -> Bundle:
    """Fit readings (a, k) with weights (a, k), `terms` (k, q) beside the response, from directions (k, 3) near the
    truth; from directions that fit all but one pose, two `iterations` are enough.
    """
    for _ in range(iterations):
        design = np.column_stack([up_box, terms])
        own = np.linalg.pinv(np.einsum("kp,ak,kq->apq", design, weight, design), hermitian=True)
        coefficients = np.einsum("apq,kq,ak->ap", own, design, weight * readings)
        residual = readings - coefficients @ design.T
        tangents = _tangents(up_box)
        slopes = np.einsum("ap,kpi->aki", coefficients[:, :3], tangents)
        shared, reduced = _reduced(design, weight, slopes, own)
        values, vectors = np.linalg.eigh(reduced)
        inverse = (vectors[:, _FREE:] / np.maximum(values[_FREE:], 1e-300)) @ vectors[:, _FREE:].T
        step = inverse @ np.einsum("aki,ak->ki", slopes, weight * residual).ravel()
        stiffness = float(values[_FREE] / values[-1])
        if np.abs(step).max() < _CONVERGED:
            break
        up_box = up_box + np.einsum("kpi,ki->kp", tangents, np.clip(step, -0.2, 0.2).reshape(-1, 2))
        up_box = up_box / np.linalg.norm(up_box, axis=1, keepdims=True)
    return Bundle(coefficients, up_box, residual, weight, design, own, shared, inverse, tangents, stiffness)


def _tangents(up: Floats) -> Floats:
    """(k, 3, 2) two unit vectors across each direction."""
    first = np.cross(up, np.eye(3)[np.abs(up).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(up, first)], axis=2)


def _reduced(design: Floats, weight: Floats, slopes: Floats, own: Floats) -> tuple[Floats, Floats]:
    """The axes' answer (a, p, 2k) to the directions, with its sign, and the directions' information (2k, 2k) once the
    axes are eliminated.
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
class InBoxFrame:
    """A bundle turned into the box frame: coefficients (a, p) with covariance (a p, a p), directions (k, 3) with
    covariance (3 k, 3 k).
    """

    coefficients: Floats
    covariance: Floats
    up_box: Floats
    up_covariance: Floats


def in_box_frame(bundle: Bundle, orientations: Floats) -> InBoxFrame:
    """The frame in which the mean over the sensors of ``orientation @ rows`` is symmetric; `orientations` (s, 3, 3) are
    the configured ones.

    An error of the rows turns the frame, so that directions, whose covariance the free turns leave open, get theirs.
    """
    axes, p = bundle.coefficients.shape
    stacked = np.concatenate(orientations, axis=1) / len(orientations)  # (3, a): the mean is stacked @ rows
    left_vectors, _, right = np.linalg.svd(stacked @ bundle.coefficients[:, :3])
    turn = right.T @ left_vectors.T
    rows = bundle.coefficients[:, :3] @ turn
    rotate = np.eye(p)
    rotate[:3, :3] = turn.T
    free, turned_by = _turned_by(rows, stacked, p)
    into = np.kron(np.eye(axes), rotate)
    held = (np.eye(axes * p) + free @ turned_by) @ into
    covariance = bundle.covariance()
    # Directions answer to the tangents' unknowns and to the frame's turn, which the rows' errors make.
    up_box = bundle.up_box @ turn
    count = len(up_box)
    along = np.zeros((3 * count, 2 * count))
    for pose in range(count):
        along[3 * pose : 3 * pose + 3, 2 * pose : 2 * pose + 2] = turn.T @ bundle.tangents[pose]
    swung = np.cross(np.eye(3)[None], up_box[:, None, :]).transpose(0, 2, 1).reshape(-1, 3) @ turned_by @ into
    mixed = bundle.shared.reshape(axes * p, -1) @ bundle.direction_covariance
    crossed = swung @ mixed @ along.T
    up_covariance = along @ bundle.direction_covariance @ along.T + swung @ covariance @ swung.T - crossed - crossed.T
    return InBoxFrame(
        np.column_stack([rows, bundle.coefficients[:, 3:]]), held @ covariance @ held.T, up_box, up_covariance
    )


def _turned_by(rows: Floats, stacked: Floats, p: int) -> tuple[Floats, Floats]:
    """Return what a turn of everything does to the coefficients (a p, 3), and the turn (3, a p) that keeps the mean
    response symmetric when the coefficients change.
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
    """(k, 3) directions of gravity's reaction in the box frame, near the truth.

    CalibrationError if the poses do not tell bias from scale.
    """
    means = readings.mean_lsb / readings.sensitivity[:, None, None]
    directions = []
    for sensor, mean in zip(readings.sensors, means, strict=True):
        gravity = _ellipsoid(sensor, mean)
        directions.append(sensor.orientation @ gravity / np.linalg.norm(gravity, axis=0))
    return _common(directions).T


def _ellipsoid(sensor: SensorLog, means: Floats) -> Floats:
    """Specific force (3, k) in g, sensor frame, of readings (k, 3) in g; CalibrationError if the poses do not tell bias
    from scale.
    """

    def gravity(parameters: Floats) -> Floats:
        shape = np.zeros((3, 3))
        shape[_TRIANGLE] = parameters[3:]
        return np.asarray(shape @ (means - parameters[:3]).T)

    start = np.concatenate([np.zeros(3), np.eye(3)[_TRIANGLE]])
    fit = least_squares(lambda parameters: np.linalg.norm(gravity(parameters), axis=0) - 1, start)
    if not fit.success or np.linalg.cond(fit.jac.T @ fit.jac) > 1e8:
        raise CalibrationError(same_sides(sensor, means))
    return gravity(fit.x)


FACE_COSINE = 0.97
"""Cosine of the angle (14 degrees) within which a pose lies on a face: a table is level, and a box has right angles."""


def same_sides(sensor: SensorLog, means: Floats | None = None) -> str:
    """Describe what poses leave open; `means` (k, 3) are their readings in g."""
    if means is not None:
        directions = means / np.linalg.norm(means, axis=1, keepdims=True)
        face = np.argmax(np.abs(directions), axis=1)
        along = np.take_along_axis(directions, face[:, None], axis=1)[:, 0]
        if (np.abs(along) > FACE_COSINE).all() and len(set(zip(face.tolist(), (along > 0).tolist(), strict=True))) == 6:
            return (
                f"{sensor.where}: all poses lie on the six faces, which leaves the angles between the axes open; add"
                " poses on edges and corners, or name the faces (imuarray log --phase z_up, [[phase]] in an import's"
                " map), so that each is known to point up"
            )
    return f"{sensor.where}: the poses do not separate bias from scale; add poses on other sides"


def _common(directions: Sequence[Floats]) -> Floats:
    """(3, k) mean of the sensors' directions (3, k), each turned onto it (Kabsch, Acta Cryst. A32, 1976, p. 922)."""
    from scipy.spatial.transform import Rotation  # its weight is for those who turn anything

    common = np.asarray(directions[0])
    for _ in range(3):
        turned = [Rotation.align_vectors(common.T, own.T)[0].as_matrix() @ own for own in directions]
        common = np.mean(turned, axis=0)
        common /= np.linalg.norm(common, axis=0)
    return common


MIN_POSES = 9
"""Nine unknowns per sensor."""

STRANGE_G = 0.001
"""A pose in which most accelerometers feel so much more or less than one g by the calibration that the other poses give
was not at rest; a hand that holds a box does that, a table does not."""

_SOFTEST = 1e-5
"""Lower limit of `Bundle.stiffness`: below it, some rotation of the directions is as good as unknown."""

_MOST_DRIFT = 2
"""A bias drifts along a parabola in time at most: warming up, it goes fast at first."""


@dataclass(frozen=True)
class GravityFit:
    """Accelerometers calibrated together from `poses` (k), in the order of the sensors (s).

    `up_box` (k, 3) directions of gravity's reaction; `force_g` (s, k) lengths of the calibrated specific force, drift
    allowed for, and `force_apart_g` the same by a calibration from all other poses (nan where those are too few);
    `drift_lsb` (s, 3) bias in the first pose less that in the last, and `drift_terms` how many powers of time it took.
    `covariance` is that of all sensors' bias and response (12 s, 12 s): rows of `fits`' coefficients without the drift,
    one sensor after the other. `up_covariance` (3 k, 3 k) is that of the directions.
    """

    calibrations: tuple[SensorCalibration, ...]
    fits: tuple[TriadFit, ...]
    covariance: Floats
    poses: tuple[Pose, ...]
    up_box: Floats
    up_covariance: Floats
    force_g: Floats
    force_apart_g: Floats
    drift_lsb: Floats
    drift_terms: int
    left_out: tuple[Exclusion, ...]

    @property
    def residual_g(self) -> Floats:
        """(s,) rms over the poses of the specific force's length less one g."""
        return np.asarray(np.sqrt(np.mean((self.force_g - 1) ** 2, axis=1)))

    @property
    def residual_apart_g(self) -> Floats:
        """(s,) the same in poses that the calibration has not seen."""
        return np.asarray(np.sqrt(np.mean((self.force_apart_g - 1) ** 2, axis=1)))


def fit_gravity(
    sensors: Sequence[SensorLog], poses: Sequence[Pose], progress: Callable[[int], None] = lambda done: None
) -> GravityFit:
    """Calibrate accelerometers jointly from static poses; `progress` is called with the number of poses tested.

    CalibrationError if there are fewer than nine poses, if they do not spread enough, or if too few are undisturbed.
    """
    _refuse_few(sensors[0], len(poses), [])
    return fit_readings(read_poses(sensors, poses), progress)


def fit_readings(everything: PoseReadings, progress: Callable[[int], None] = lambda done: None) -> GravityFit:
    """`fit_gravity` of readings that are there already."""
    sensors, poses = everything.sensors, everything.poses
    others = another_go(poses) if everything.one_run else {}
    reasons = {**(others if len(poses) - len(others) >= MIN_POSES else {}), **moved_within(everything)}
    bad = {place: exclusion_of(poses[place], reason) for place, reason in reasons.items()}
    while True:
        kept = [place for place in range(len(poses)) if place not in bad]
        left_out = [bad[place] for place in sorted(bad)]
        _refuse_few(sensors[0], len(kept), left_out)
        joint = _joint(everything.only(kept))
        apart, chances = _one_left_out(joint, progress)
        off_g = np.median(np.abs(apart - 1), axis=0)
        strange = worst(chances, np.nan_to_num(off_g), STRANGE_G)
        if strange is None:
            return _told(joint, apart, left_out)
        reason = f"{1e3 * off_g[strange]:.1f} mg from one g by the calibration of the other poses: not at rest"
        bad[kept[strange]] = exclusion_of(poses[kept[strange]], reason)


def fit_weighted(readings: PoseReadings, variance_g2: Floats, left_out: Sequence[Exclusion] = ()) -> GravityFit:
    """Every axis in every pose by the variances (3 s, k) that are given, in g squared, without a drift.

    CalibrationError where the poses don't spread enough.
    """
    scale = readings.sensitivity[:, None, None]
    values = _by_axis(readings.mean_lsb / scale)
    terms = np.ones((len(readings.poses), 1))
    bundle = solve(values, 1 / variance_g2, terms, directions_of(readings))
    if bundle.stiffness < _SOFTEST:
        raise CalibrationError(same_sides(readings.sensors[0]))
    chi_squared, freedom = _by_noise(bundle)
    joint = _Joint(readings, values, bundle.weight, terms, bundle, np.zeros(len(values)), chi_squared, freedom)
    return _told(joint, np.full((len(readings.sensors), len(readings.poses)), np.nan), left_out)


def _refuse_few(sensor: SensorLog, count: int, left_out: Sequence[Exclusion]) -> None:
    if count < MIN_POSES:
        why = "".join(f"; {each.phase}: {each.reason}" for each in left_out)
        sound = "static" if not left_out else "undisturbed"
        raise CalibrationError(f"{sensor.where}: {count} {sound} poses, at least {MIN_POSES} are required{why}")


@dataclass(frozen=True)
class _Joint:
    """All axes (a = 3 s) in all poses (k) in g: readings, weights and terms (k, q) of the fit `bundle`; the scatter
    beyond noise (a,), chi-squared and freedom (a,) by noise alone.
    """

    readings: PoseReadings
    values: Floats
    weight: Floats
    terms: Floats
    bundle: Bundle
    beyond: Floats
    chi_squared: Floats
    freedom: Floats


def _joint(readings: PoseReadings) -> _Joint:
    """Everything at once, with as much drift and scatter as the readings show."""
    scale = readings.sensitivity[:, None, None]
    values = _by_axis(readings.mean_lsb / scale)
    noise = _by_axis(readings.variance_lsb2 / scale**2)
    terms, bundle = _drifting(readings, values, noise, directions_of(readings))
    if bundle.stiffness < _SOFTEST:
        raise CalibrationError(same_sides(readings.sensors[0]))
    beyond = np.zeros(len(values))
    chi_squared, freedom = _by_noise(bundle)
    for _ in range(10):
        squares, own = _by_noise(bundle)
        fits = np.abs(squares - own) < 0.05 * own
        more = [beyond_noise(each, free, len(own)) for each, free in zip(squares, own, strict=True)]
        change = (np.array(more) | (beyond > 0)) & ~fits & (own > 0.5)
        if not change.any():
            break
        total = (1 / bundle.weight).mean(axis=1) * squares / np.maximum(own, 0.5)
        beyond = np.where(change, np.maximum(total - noise.mean(axis=1), 0.0), beyond)
        bundle = solve(values, 1 / (noise + beyond[:, None]), terms, bundle.up_box)
    return _Joint(readings, values, bundle.weight, terms, bundle, np.sqrt(beyond), chi_squared, freedom)


def _by_axis(triads: Floats) -> Floats:
    """(3 s, k) from (s, k, 3)."""
    return triads.transpose(0, 2, 1).reshape(-1, triads.shape[1])


def _by_noise(bundle: Bundle) -> tuple[Floats, Floats]:
    """(a,) chi-squared of every axis and its freedom."""
    return (bundle.weight * bundle.residual**2).sum(axis=1), bundle.axis_freedom()


def _drifting(readings: PoseReadings, values: Floats, noise: Floats, up_box: Floats) -> tuple[Floats, Bundle]:
    """The terms beside the response, and the fit with them: powers of time as long as each fits better beyond chance.

    All terms but the bias have zero mean over the poses: it is the mean one. Poses that don't tell a drift from
    the rest leave it to what biases scatter.
    """
    powers = readings.powers_of_time(_MOST_DRIFT)
    terms = powers[:, :1]
    best = solve(values, 1 / noise, terms, up_box)
    for more in range(2, powers.shape[1] + 1):
        tried = solve(values, 1 / noise, powers[:, :more], best.up_box)
        chance = chance_of_misfit(best.chi_squared, tried.chi_squared, len(values), tried.freedom)
        if tried.freedom <= 0 or not tried.is_linear or chance > DRIFTS:
            break
        terms, best = powers[:, :more], tried
    return terms, best


def _one_left_out(joint: _Joint, progress: Callable[[int], None]) -> tuple[Floats, list[float]]:
    """Return for each pose the lengths (s, k) of the specific force by a calibration from all others, and the chance
    that it fits as badly as it does: by the scatter of the others, and by that which the weights stand for.
    """
    sensors, poses = len(joint.readings.sensors), len(joint.readings.poses)
    lengths, chances = np.full((sensors, poses), np.nan), [1.0] * poses
    number = 3 * sensors - 2
    if joint.bundle.freedom - number <= 0:
        return lengths, chances
    for pose in range(poses):
        others = np.delete(np.arange(poses), pose)
        without = solve(
            joint.values[:, others], joint.weight[:, others], joint.terms[others], joint.bundle.up_box[others], 2
        )
        if without.stiffness > _SOFTEST:
            lengths[:, pose] = _lengths(without.coefficients, joint.values[:, [pose]], joint.terms[[pose]])[:, 0]
            squares, fewer = joint.bundle.chi_squared, without.chi_squared
            by_the_rest = chance_of_misfit(squares, fewer, number, joint.bundle.freedom - number)
            chances[pose] = max(by_the_rest, float(chdtrc(number, max(squares - fewer, 0.0))))
        progress(pose + 1)
    return lengths, chances


def _lengths(coefficients: Floats, values: Floats, terms: Floats) -> Floats:
    """(s, k) lengths of the specific force in g that readings (3 s, k) mean."""
    response = coefficients[:, :3].reshape(-1, 3, 3)
    pulled = (values - coefficients[:, 3:] @ terms.T).reshape(len(response), 3, -1)
    return np.asarray(np.linalg.norm(np.linalg.solve(response, pulled), axis=1))


def _told(joint: _Joint, apart: Floats, left_out: Sequence[Exclusion]) -> GravityFit:
    """The result in counts and in the box frame."""
    readings, bundle = joint.readings, joint.bundle
    orientations = np.array([sensor.orientation for sensor in readings.sensors])
    boxed = in_box_frame(bundle, orientations)
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
    mine = np.tile(np.arange(p) < 4, axes)
    change = joint.terms[0] - joint.terms[-1]
    return GravityFit(
        calibrations=tuple(accelerometer_of(sensor, fit) for sensor, fit in zip(readings.sensors, fits, strict=True)),
        fits=tuple(fits),
        covariance=covariance[np.ix_(mine, mine)],
        poses=readings.poses,
        up_box=boxed.up_box,
        up_covariance=boxed.up_covariance,
        force_g=_lengths(bundle.coefficients, joint.values, joint.terms),
        force_apart_g=apart,
        drift_lsb=(rows[:, 3:] @ change).reshape(-1, 3),
        drift_terms=joint.terms.shape[1] - 1,
        left_out=tuple(left_out),
    )
