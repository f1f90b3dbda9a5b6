"""Effects that show in motion: how readings depend on the reference motion, on rotation and on force."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices, triple
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.levels import levels
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.statistics.cross import CUBES, KINEMATIC, SQUARES, Cross
from imuarray.simulate.effects.response import GSensitivity, Nonlinearity, SizeEffect
from imuarray.units import SI_PER_UNIT

OWN, REFERENCE, ROTATION = slice(0, 3), slice(3, 6), slice(6, 6 + KINEMATIC)
FORCE = slice(6 + KINEMATIC, 9 + KINEMATIC)
CUBED = slice(9 + KINEMATIC, 9 + KINEMATIC + CUBES)
CHANGE = slice(CUBED.stop, CUBED.stop + 3)


@dataclass(frozen=True)
class Moments:
    """Mean products (24, 24) of window means in motion, less the means of their segments, over `windows` windows. The
    columns are the sensor's readings (`OWN`), those of its reference along its nominal axes (`REFERENCE`;
    `Cross.reference`), products of angular rates and angular accelerations in the box (`ROTATION`, rad^2/s^2), the mean
    force along the sensor's nominal axes in g (`FORCE`), cubes of angular rates in the box (`CUBED`, rad^3/s^3), and
    the reference's change per second (`CHANGE`).
    """

    products: Floats
    windows: int

    def beyond_reference(self, columns: slice | Indices) -> tuple[Floats, Floats, Floats]:
        """Return the products that the reference does not explain: (c, c) of these columns, (c, 3) of these columns
        with the sensor's readings, and (3,) squares of the readings.
        """
        reference_products = self.products[REFERENCE, REFERENCE]
        solved = np.linalg.pinv(reference_products, rcond=1e-9, hermitian=True) @ self.products[REFERENCE]
        remaining = self.products - self.products[:, REFERENCE] @ solved
        return remaining[columns][:, columns], remaining[columns, OWN], np.diag(remaining[OWN, OWN])


def moments(evidence: Evidence) -> Moments | None:
    """Return the moments over all phases in motion; None without a motion or without a reference."""
    total, windows = np.zeros((CHANGE.stop, CHANGE.stop)), 0
    for phase in evidence.phases:
        if phase.is_still or phase.cross is None or not phase.cross.windows or not takes_part(evidence, phase.cross):
            continue
        weights = _weights(phase.cross, evidence.header.name)
        if weights is None:
            return None
        total += phase.cross.windows * _products(phase.cross, weights)
        windows += phase.cross.windows
    return Moments(total / windows, windows) if windows else None


def _products(cross: Cross, weights: Floats) -> Floats:
    """Return the mean products (24, 24) of the columns `weights` (21, p) and of the reference's change per second. The
    changes are normalised by the length of the windows; they are nan if no window has a neighbour.
    """
    products = np.zeros((CHANGE.stop, CHANGE.stop))
    products[: CHANGE.start, : CHANGE.start] = weights @ cross.fast @ weights.T
    if np.isfinite(cross.changes).all():
        products[: CHANGE.start, CHANGE] = weights @ cross.turning @ weights[REFERENCE].T / cross.window_s
        products[CHANGE, : CHANGE.start] = products[: CHANGE.start, CHANGE].T
        products[CHANGE, CHANGE] = weights[REFERENCE] @ cross.changes @ weights[REFERENCE].T / cross.window_s**2
    return products


def takes_part(evidence: Evidence, cross: Cross) -> bool:
    """Return whether the sensor is among those whose readings are compared: inertial sensors that have readings."""
    return any(item.name == evidence.header.name for item in cross.sensors)


def _weights(cross: Cross, sensor: str) -> Floats | None:
    """Return (21, p) the weights of the columns of `Moments`, without the change; None without a reference."""
    reference = cross.reference(sensor)
    if reference is None:
        return None
    weights = np.zeros((CUBED.stop, cross.fast.shape[0]))
    weights[OWN, cross.columns(sensor)] = np.eye(3)
    turn = np.array(cross.header(sensor).orientation).T
    weights[REFERENCE] = reference
    weights[ROTATION, cross.kinematic] = np.eye(KINEMATIC)
    feel = tuple(item.name for item in cross.sensors if item.quantity == "specific_force")
    weights[FORCE] = turn @ cross.mean_box(feel)
    weights[CUBED, cross.cubes] = np.eye(CUBES)
    return weights


_BENT_MOTION = ("motion_residual", "motion_coupling", "motion_gain", "motion_square", "motion_cube")
_SQUARE, _CUBE = "motion_square", "motion_cube"
_BEYOND = 2.7
"""Scores above which a motion shows one of these effects."""

_LARGEST_BEND = 0.5
"""Largest deviation from a straight line at the end of the range, as a share of the range."""

_SMALL_BEND = 1e-3
"""Least deviation of a cubic term that is suggested, as a share of the motion."""


def guess_nonlinearity(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest quadratic terms by the even part on faces; for a gyroscope, by the squares of rates in motion. Suggest
    cubic terms of a gyroscope by the cubes of rates, and of any sensor by the residual in motion, as for a sine.
    """
    quadratic = np.zeros(3)
    if evidence.header.quantity != "angular_rate":
        quadratic = np.where(np.abs(evidence.score("force_square")) > _BEYOND, evidence.shift("force_square"), 0.0)
    elif evidence.is_odd(*_BENT_MOTION, beyond=_BEYOND):  # no rate acts on a face
        quadratic = _quadratic_from_rates(evidence)
    quadratic = np.clip(quadratic, -_LARGEST_BEND / evidence.header.range, _LARGEST_BEND / evidence.header.range)
    if quadratic.any():
        yield Hypothesis((Nonlinearity(quadratic=triple(quadratic)),), ("quadratic",))
    if evidence.header.quantity == "angular_rate" and evidence.is_odd(_CUBE, beyond=_BEYOND):
        yield from _of_cubic(_cubic(evidence))
    if evidence.is_odd(*_BENT_MOTION, beyond=_BEYOND):
        yield from _cubic_from_motion(evidence)


def _quadratic_from_rates(evidence: Evidence) -> Floats:
    """Return (3,) coefficients of the square of each axis's rate, by the nearest axis of the box. If the squares show
    on some axes, only these have a coefficient.
    """
    table = moments(evidence)
    if table is None:
        return np.zeros(3)
    shows = np.abs(evidence.score(_SQUARE)) > _BEYOND
    slope = _slope_beyond_reference(table, ROTATION, np.array(SQUARES)[_nearest(evidence)]) * (math.pi / 180) ** 2
    return np.where(shows, slope, 0.0) if shows.any() else slope


def _cubic(evidence: Evidence) -> Floats:
    """Return (3,) coefficients of the cube of the rate of each axis on which it shows."""
    table = moments(evidence)
    if table is None:
        return np.zeros(3)
    nearest = _nearest(evidence)
    sign = np.sign(np.array(evidence.header.orientation)[nearest, range(3)])
    slope = sign * _slope_beyond_reference(table, CUBED, nearest) * (math.pi / 180) ** 3
    most = _LARGEST_BEND / evidence.header.range**2
    return np.where(np.abs(evidence.score(_CUBE)) > _BEYOND, np.clip(slope, -most, most), 0.0)


def _nearest(evidence: Evidence) -> Indices:
    """Return (3,) the axis of the box that is nearest to each axis of the sensor."""
    return np.asarray(np.abs(np.array(evidence.header.orientation)).argmax(axis=0))


def _slope_beyond_reference(table: Moments, columns: slice, at: Indices) -> Floats:
    """Return (3,) slopes of each axis's readings over its column, after the reference's part of both is subtracted."""
    products, shared, _ = table.beyond_reference(columns)
    size = products[at, at]
    return np.divide(shared[at, range(3)], size, out=np.zeros(3), where=size > 0)


def _cubic_from_motion(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest cubic terms: y = x + c x^3 of a sine x of variance s^2 has a gain of 1 + 3/2 c s^2 and a residual
    variance of c^2 s^6 / 4.
    """
    table = moments(evidence)
    if table is None:
        return
    square = np.diag(table.products[REFERENCE, REFERENCE])
    gain = table.products[OWN, REFERENCE].diagonal() / np.where(square > 0, square, np.inf) - 1
    remaining = table.beyond_reference(ROTATION)[2]
    size = 2 * np.sqrt(np.maximum(remaining, 0.0)) / np.where(square > 0, square**1.5, np.inf)
    most = _LARGEST_BEND / evidence.header.range**2
    cubic = np.sign(gain) * np.minimum(np.minimum(size, np.abs(gain) / (1.5 * square + 1e-30)), most)
    cubic = np.where(np.abs(cubic) * square > _SMALL_BEND, cubic, 0.0)
    yield from _of_cubic(cubic)


def _of_cubic(cubic: Floats) -> Iterator[Hypothesis]:
    """Yield the hypothesis of cubic terms (3,), unless all are 0."""
    if cubic.any():
        yield Hypothesis((Nonlinearity(cubic=triple(cubic)),), ("cubic",))


_AT_REST = ("force_own", "force_next", "force_after", "mean")
_DELAY = "motion_delay"
_FORCE_IN_MOTION = ("motion_coupling", "motion_residual", _DELAY)

_CLEAR_RESPONSE, _SMALL_RESPONSE = 4.0, 0.2
"""Standard errors from which on a response is clear, and its least share of the largest response."""


def guess_g_sensitivity(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the least-squares fit of the levels over the force on each face, with all responses, and with the clear
    ones only. Without several faces, suggest the fit of the residual of a motion, which the other sensors do not
    explain, over the accelerometers' mean.
    """
    responses = _response_on_faces(evidence) if evidence.is_odd(*_AT_REST, beyond=_BEYOND) else []
    if not responses and evidence.is_odd(*_FORCE_IN_MOTION, beyond=_BEYOND):
        responses = _response_in_motion(evidence)
    for response in responses:
        if response.per_g.any():
            yield Hypothesis((GSensitivity(tuple(response.per_g.ravel().tolist())),), rarity=float(response.numbers))


class _ForceResponse(NamedTuple):
    """Response `per_g` (3, 3) to specific force, and the `numbers` of parameters that determine it."""

    per_g: Floats
    numbers: int


def _response_on_faces(evidence: Evidence) -> list[_ForceResponse]:
    """Return the least-squares fit of the levels on faces, 0 along directions in which the force did not change; [] if
    all faces are the same.
    """
    table = levels(evidence)
    known = np.isfinite(table.applied_g).all(axis=1)
    if not known.any():
        return []
    applied, mean = table.applied_g[known] - table.applied_g[known].mean(axis=0), table.mean[known]
    if not applied.any():
        return []
    beyond = np.linalg.lstsq(applied, mean, rcond=1e-6)[0].T
    variance = (mean - mean.mean(axis=0) - applied @ beyond.T).var(axis=0)
    inverse = np.diag(np.linalg.pinv(applied.T @ applied, rcond=1e-6, hermitian=True))
    size = np.abs(beyond)
    is_clear = (size > _CLEAR_RESPONSE * np.sqrt(variance[:, None] * inverse)) & (size > _SMALL_RESPONSE * size.max())
    response_g = beyond + np.where(beyond != 0, evidence.fitted.response, 0.0)
    clear_g = np.where(is_clear, response_g, 0.0)
    responses_g = [response_g] if is_clear[beyond != 0].all() else [response_g, clear_g]
    return [_ForceResponse(per_g, int(np.count_nonzero(per_g))) for per_g in responses_g]


def _response_in_motion(evidence: Evidence) -> list[_ForceResponse]:
    """Return the least-squares fit of what the reference does not explain, and the mass unbalance that explains the
    delays of the axes.
    """
    table = moments(evidence)
    if table is None:
        return []
    force, shared, _ = table.beyond_reference(FORCE)
    response_g = np.asarray((np.linalg.pinv(force, rcond=1e-6, hermitian=True) @ shared).T)
    return [
        _ForceResponse(response_g, int(np.count_nonzero(response_g))),
        _ForceResponse(_unbalance(evidence, table), 3),
    ]


def _unbalance(evidence: Evidence, table: Moments) -> Floats:
    """Return the (3, 3) response to the force f of a mass unbalance m, m x f (IEEE Std 1431), that explains the delays
    of the axes beyond the model. Directions that the delays do not determine are near 0.

    In a box that rocks, gravity turns in step with the change c of the rate: an axis is late by -<c, m x f> / <c, c>.
    """
    products, _, _ = table.beyond_reference(_CHANGE_AND_FORCE)
    changes, force = np.diag(products[:3, :3]), products[:3, 3:]
    delay_s, score = evidence.typical(_DELAY), evidence.score(_DELAY)
    known = np.isfinite(delay_s) & (score != 0) & (delay_s != 0) & (changes > 0)
    if not known.any():
        return np.zeros((3, 3))
    delays_s = np.cross(np.eye(3), force)[known] / changes[known, None]
    error_s = np.abs(delay_s[known] / score[known])
    normal = (delays_s / error_s[:, None] ** 2).T @ delays_s + np.eye(3) / _USUAL_UNBALANCE**2
    unbalance = np.linalg.solve(normal, delays_s.T @ (delay_s[known] / error_s**2))
    return np.cross(unbalance, np.eye(3)).T


_CHANGE_AND_FORCE = np.r_[CHANGE, FORCE]

_USUAL_UNBALANCE = 10.0
"""Standard deviation of the prior of a mass unbalance in dps/g. It limits the estimate if the evidence is weak."""


_LARGEST_MM = 5000.0
_CROSS_PRODUCTS = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(0, 2, 1)
"""(3, 3, 3): matrix k multiplied by r is e_k x r."""


def guess_size_effect(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the displacement, by a least-squares fit of what the mean of the other accelerometers does not
    explain.
    """
    if not evidence.is_odd("motion_coupling", "motion_residual", "motion_gain", "motion_next", "motion_after"):
        return
    table = moments(evidence)
    if table is None:
        return
    place = _displacement_m(evidence, *table.beyond_reference(ROTATION)[:2]) * 1e3
    if place.any() and np.linalg.norm(place) < _LARGEST_MM:
        yield Hypothesis((SizeEffect(triple(place)),), ("position_mm",))


def _displacement_m(evidence: Evidence, rotation: Floats, shared: Floats) -> Floats:
    """Return (3,) displacement from the configured position in metres, in the box's frame. The force is the sum of
    column k of `rotation` times B_k r, with B_k (3, 3) along the sensor's axes and r from the mean position of the
    others.
    """
    turn = np.array(evidence.header.orientation).T / SI_PER_UNIT[evidence.header.unit]
    columns = turn @ rotation_columns()
    normal = np.einsum("kl,kij,lim->jm", rotation, columns, columns)
    moved = np.einsum("kij,ki->j", columns, shared) - normal @ _configured_m(evidence)
    return np.asarray(np.linalg.pinv(normal, rcond=1e-6) @ moved)


def _configured_m(evidence: Evidence) -> Floats:
    """Return (3,) the configured position in metres, in the box's frame, relative to the mean position of what the
    sensor is compared with in motion. A track is that of the origin.
    """
    sensor = evidence.header.name
    crosses = [phase.cross for phase in evidence.phases if not phase.is_still and phase.cross is not None]
    cross = next(cross for cross in crosses if takes_part(evidence, cross))
    others_mm = [cross.header(name).position_mm for name in cross.others(sensor, family=False)]
    others_mm += [(0.0, 0.0, 0.0)] * (sensor in cross.tracked)
    return np.asarray(np.subtract(cross.header(sensor).position_mm, np.mean(others_mm, axis=0)) * 1e-3)


def rotation_columns() -> Floats:
    """Return (9, 3, 3) the matrices B of the columns: rate x (rate x r) = (rate rate^T - rate^2) r by the products xx,
    xy, xz, yy, yz, zz, and angular acceleration x r.
    """
    products = []
    for first, second in zip(*np.triu_indices(3), strict=True):
        outer = np.zeros((3, 3))
        outer[first, second] = outer[second, first] = 1.0
        products.append(outer - np.eye(3) * (first == second))
    return np.concatenate([products, _CROSS_PRODUCTS])
