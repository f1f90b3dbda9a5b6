"""`g_sensitivity`: levels of a gyroscope or magnetometer that differ from face to face, or follow the force."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.in_motion import FORCE, moments
from imuarray.gap.inference.effects.levels import levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.g_sensitivity import GSensitivity

_AT_REST = ("force_own", "force_next", "force_after", "mean")
_IN_MOTION = ("motion_coupling", "motion_residual")
_BEYOND = 2.7

_CLEAR, _SMALL = 4.0, 0.2
"""Standard errors from which on a response is clear, and its least share of the largest one."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Least squares of the levels over the force on each face, with all responses and with those alone that are clear;
    where there are no faces, of what the other sensors don't explain in motion over the accelerometers' mean.
    """
    yield from with_removal(evidence, GSensitivity.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.header.quantity != "angular_rate":
        return
    responses_g = _from_faces(evidence) if evidence.is_odd(*_AT_REST, beyond=_BEYOND) else []
    if not responses_g and evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):
        responses_g = _from_motion(evidence)
    for response_g in responses_g:
        if response_g.any():
            fitted = float(np.count_nonzero(response_g))  # numbers, whose cost none of them being refined doesn't save
            yield Hypothesis((GSensitivity(tuple(response_g.ravel().tolist())),), rarity=fitted)


def _from_faces(evidence: Evidence) -> list[Floats]:
    """(3, 3) each; none unless faces differ. Directions that were not felt get 0."""
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
    return [response_g] if is_clear[beyond != 0].all() else [response_g, clear_g]


def _from_motion(evidence: Evidence) -> list[Floats]:
    table = moments(evidence)
    if table is None:
        return []
    force, shared, _ = table.beside(FORCE)
    return [np.asarray((np.linalg.pinv(force, rcond=1e-6, hermitian=True) @ shared).T)]


G_SENSITIVITY = Candidate(
    GSensitivity.name,
    guesses,
    {"tumble": "all six faces, 1 minute each", "motion": "strokes of 1 g and more along every axis, 1 minute"},
    quantity="angular_rate",
)
