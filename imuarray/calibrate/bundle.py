"""Joint fit of all triads in all poses: maximum likelihood for responses, biases and the directions of gravity.

Every axis of every sensor is a linear function of the direction of gravity, which all sensors share and which is
unknown::

    reading = row @ up + bias (+ drift terms) + noise,      |up| = 1

This is a bundle adjustment, as photogrammetry has it with cameras and points (Triggs et al., Vision Algorithms, LNCS
1883, 2000): Gauss-Newton on the directions, the axes eliminated by their Schur complement. A common rotation of all
directions and all rows changes nothing; the box frame is defined as the one in which the mean response of all sensors,
each turned by its configured axes, is symmetric: on average they point where the configuration says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats

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
