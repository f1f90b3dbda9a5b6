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
    yield from with_removal(evidence, GSensitivity.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.header.quantity != "angular_rate":
        return
    found = _from_faces(evidence) if evidence.is_odd(*_AT_REST, beyond=_BEYOND) else None
    if found is None and evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):
        found = _from_motion(evidence)
    if found is not None and found.any():
        fitted = float(np.count_nonzero(found))  # numbers, whose cost none of them being refined doesn't save
        yield Hypothesis((GSensitivity(tuple(found.ravel().tolist())),), rarity=fitted)


def _from_faces(evidence: Evidence) -> Floats | None:
    """(3, 3); None unless faces differ. Directions that were not felt get 0."""
    found = levels(evidence)
    known = np.isfinite(found.felt_g).all(axis=1)
    if not known.any():
        return None
    felt = found.felt_g[known] - found.felt_g[known].mean(axis=0)
    if not felt.any():
        return None
    beyond = np.linalg.lstsq(felt, found.mean[known], rcond=1e-6)[0].T
    return np.asarray(beyond + np.where(beyond != 0, evidence.fitted.response, 0.0))


def _from_motion(evidence: Evidence) -> Floats | None:
    found = moments(evidence)
    if found is None:
        return None
    force, shared, _ = found.beside(FORCE)
    return np.asarray((np.linalg.pinv(force, rcond=1e-6, hermitian=True) @ shared).T)


G_SENSITIVITY = Candidate(
    GSensitivity.name,
    guesses,
    {"tumble": "all six faces, 1 minute each", "motion": "strokes of 1 g and more along every axis, 1 minute"},
)
