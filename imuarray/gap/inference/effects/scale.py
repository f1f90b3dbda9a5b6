"""`scale` is recognised by opposite faces that differ by more or less than they should, or by a share of motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.response import DOUBTFUL, ODD, response, size_of_score
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.scale import Scale

_LARGEST = 0.9
"""More than that isn't an error of scale."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """The diagonal of the response's error, on axes that stray beyond the population."""
    yield from with_removal(evidence, Scale.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    score, measured_response = size_of_score(evidence, "force_own", "motion_gain"), response(evidence)
    if measured_response is None or not (score > ODD).any():
        return
    axis_error, doubtful = np.diag(measured_response.error), score > DOUBTFUL
    error = np.where(doubtful & (np.abs(axis_error) < _LARGEST), axis_error, 0.0)
    if error.any():
        x, y, z = error.tolist()
        yield Hypothesis((Scale((x, y, z)),), ("error",))


SCALE = Candidate(
    Scale.name,
    guesses,
    {"tumble": "all six faces, 1 minute each", "motion": "turns and strokes along every axis, 1 minute"},
)
