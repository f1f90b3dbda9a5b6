"""`misalignment` is recognised by axes that show a share of what acts along another one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.response import DOUBTFUL, ODD, response, size_of_score
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.response import Misalignment

_LARGEST_DEG = 45.0
"""What leans further is nearer to another axis."""

_AXES = np.arange(3)


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the angles beside the diagonal of the response's error, where they stray beyond the population."""
    yield from with_removal(evidence, Misalignment.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    score, measured_response = np.zeros((3, 3)), response(evidence)
    for step, way in enumerate(("next", "after"), start=1):
        score[_AXES, (_AXES + step) % 3] = size_of_score(evidence, f"force_{way}", f"motion_{way}", "motion_across")
    if measured_response is None or not (score > ODD).any():
        return
    gain = 1 + np.diag(measured_response.error)
    tangents = np.divide(measured_response.error, gain[:, None], out=np.zeros((3, 3)), where=gain[:, None] > 0)
    angles = np.degrees(np.arctan(np.where(score > DOUBTFUL, tangents, 0.0)))
    angles[np.abs(angles) > _LARGEST_DEG] = 0.0
    if angles.any():
        yield Hypothesis((Misalignment(tuple(angles[~np.eye(3, dtype=bool)].tolist())),), ("angles_deg",))


MISALIGNMENT = Candidate(
    Misalignment.name,
    guesses,
    {"tumble": "all six faces, 1 minute each", "motion": "turns and strokes along every axis, 1 minute"},
)
