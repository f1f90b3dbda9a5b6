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


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Least squares of the levels over the force on each face; where there are no faces, of what the other sensors
    don't explain in motion over the accelerometers' mean.
    """
    yield from with_removal(evidence, GSensitivity.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.header.quantity != "angular_rate":
        return
    response_g = _from_faces(evidence) if evidence.is_odd(*_AT_REST, beyond=_BEYOND) else None
    if response_g is None and evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):
        response_g = _from_motion(evidence)
    if response_g is not None and response_g.any():
        fitted = float(np.count_nonzero(response_g))  # numbers, whose cost none of them being refined doesn't save
        yield Hypothesis((GSensitivity(tuple(response_g.ravel().tolist())),), rarity=fitted)


def _from_faces(evidence: Evidence) -> Floats | None:
    """(3, 3); None unless faces differ. Directions that were not felt get 0."""
    table = levels(evidence)
    known = np.isfinite(table.felt_g).all(axis=1)
    if not known.any():
        return None
    felt = table.felt_g[known] - table.felt_g[known].mean(axis=0)
    if not felt.any():
        return None
    beyond = np.linalg.lstsq(felt, table.mean[known], rcond=1e-6)[0].T
    return np.asarray(beyond + np.where(beyond != 0, evidence.fitted.response, 0.0))


def _from_motion(evidence: Evidence) -> Floats | None:
    table = moments(evidence)
    if table is None:
        return None
    force, shared, _ = table.beside(FORCE)
    return np.asarray((np.linalg.pinv(force, rcond=1e-6, hermitian=True) @ shared).T)


G_SENSITIVITY = Candidate(
    GSensitivity.name,
    guesses,
    {"tumble": "all six faces, 1 minute each", "motion": "strokes of 1 g and more along every axis, 1 minute"},
)
