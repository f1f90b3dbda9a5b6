"""`g_sensitivity`: levels of a gyroscope or magnetometer that differ from face to face, or follow the force."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.in_motion import CHANGE, FORCE, Moments, moments
from imuarray.gap.inference.effects.levels import levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.response import GSensitivity

_AT_REST = ("force_own", "force_next", "force_after", "mean")
_DELAY = "motion_delay"
_IN_MOTION = ("motion_coupling", "motion_residual", _DELAY)
_BEYOND = 2.7

_CLEAR, _SMALL = 4.0, 0.2
"""Standard errors from which on a response is clear, and its least share of the largest one."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the least-squares fit of the levels over the force on each face, with all responses and with those alone
    that are clear; where there are no faces, of what the other sensors don't explain in motion over the accelerometers'
    mean.
    """
    yield from with_removal(evidence, GSensitivity.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest hypotheses with the cost of each number, since they are not refined."""
    if evidence.header.quantity != "angular_rate":
        return
    responses = _from_faces(evidence) if evidence.is_odd(*_AT_REST, beyond=_BEYOND) else []
    if not responses and evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):
        responses = _from_motion(evidence)
    for response in responses:
        if response.per_g.any():
            yield Hypothesis((GSensitivity(tuple(response.per_g.ravel().tolist())),), rarity=float(response.numbers))


class _Response(NamedTuple):
    """Response `per_g` (3, 3) to specific force, which so many `numbers` determine."""

    per_g: Floats
    numbers: int


def _from_faces(evidence: Evidence) -> list[_Response]:
    """Return the least-squares fit of the levels on faces, 0 along directions that were not felt; [] unless faces
    differ.
    """
    table = levels(evidence)
    known = np.isfinite(table.felt_g).all(axis=1)
    if not known.any():
        return []
    felt, mean = table.felt_g[known] - table.felt_g[known].mean(axis=0), table.mean[known]
    if not felt.any():
        return []
    beyond = np.linalg.lstsq(felt, mean, rcond=1e-6)[0].T
    variance = (mean - mean.mean(axis=0) - felt @ beyond.T).var(axis=0)
    inverse = np.diag(np.linalg.pinv(felt.T @ felt, rcond=1e-6, hermitian=True))
    size = np.abs(beyond)
    is_clear = (size > _CLEAR * np.sqrt(variance[:, None] * inverse)) & (size > _SMALL * size.max())
    response_g = beyond + np.where(beyond != 0, evidence.fitted.response, 0.0)
    clear_g = np.where(is_clear, response_g, 0.0)
    responses_g = [response_g] if is_clear[beyond != 0].all() else [response_g, clear_g]
    return [_Response(per_g, int(np.count_nonzero(per_g))) for per_g in responses_g]


def _from_motion(evidence: Evidence) -> list[_Response]:
    """Return the least-squares fit of what the reference does not explain; and the mass unbalance that makes the delays
    of axes.
    """
    table = moments(evidence)
    if table is None:
        return []
    force, shared, _ = table.beyond_reference(FORCE)
    response_g = np.asarray((np.linalg.pinv(force, rcond=1e-6, hermitian=True) @ shared).T)
    return [_Response(response_g, int(np.count_nonzero(response_g))), _Response(_unbalance(evidence, table), 3)]


def _unbalance(evidence: Evidence, table: Moments) -> Floats:
    """Return the (3, 3) response to the force f of a mass unbalance m, m x f (IEEE Std 1431), that delays the axes as
    they are delayed beyond the model, as far as delays tell it; directions that they do not tell are near 0.

    A box that rocks feels gravity turn in step with the change c of its rate: an axis is late by -<c, m x f> / <c, c>.
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
"""Scatter of the mass unbalance in dps/g, which limits what weak evidence says."""


G_SENSITIVITY = Candidate(
    GSensitivity.name,
    guesses,
    {"tumble": "all six faces, 1 minute each", "motion": "strokes of 1 g and more along every axis, 1 minute"},
    quantity="angular_rate",
)
