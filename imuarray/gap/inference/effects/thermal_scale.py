"""`thermal_scale`: slopes over temperature that are opposite on opposite faces, or a scale that is off in warmth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import Levels, levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.response import DOUBTFUL, ODD, response, size_of_score
from imuarray.gap.inference.effects.thermal import BEYOND, LEAST_DEGC, TRACES, fitted, warmth
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.temperature import ThermalScale

_CLEAR = 2.0


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest, for an accelerometer, the part of the slope that has the sign of the force; on one face alone it
    can't be distinguished from a slope of the bias, which is fitted, and there is no guess. The other guess is the
    slope that makes the error of the scale at the temperature of the faces: no other experiment distinguishes the two.
    """
    yield from with_removal(evidence, ThermalScale.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    table = levels(evidence)
    if evidence.header.quantity != "specific_force" or not len(table.degc) or np.ptp(table.degc) < LEAST_DEGC:
        return
    if not evidence.is_odd(*TRACES, "force_own", "motion_gain", beyond=BEYOND):
        return
    slope = [_slope(table, axis) for axis in range(3)]
    if any(slope):
        yield Hypothesis((ThermalScale((slope[0], slope[1], slope[2])),), ("slope",))
    x, y, z = _by_scale(evidence, table).tolist()
    if any((x, y, z)):
        yield Hypothesis((ThermalScale((x, y, z)),), ("slope",))


def _by_scale(evidence: Evidence, table: Levels) -> Floats:
    """Return (3,) error of the scale over how much warmer it was than at the reference; 0 where that says nothing."""
    measured_response, known = response(evidence), np.isfinite(table.felt_g).all(axis=1)
    if measured_response is None or not known.any():
        return np.zeros(3)
    faces, of_face = np.unique(table.felt_g[known], axis=0, return_inverse=True)
    warm = float(np.mean([warmth(table)[known][of_face.ravel() == at].mean() for at in range(len(faces))]))
    score = size_of_score(evidence, "force_own")
    if abs(warm) < LEAST_DEGC or not (score > ODD).any():
        return np.zeros(3)
    return np.asarray(np.where(score > DOUBTFUL, np.diag(measured_response.error) / warm, 0.0))


def _slope(table: Levels, axis: int) -> float:
    """Return the slope by slopes within logs, or else by their levels; 0 if neither determines it."""
    known = np.isfinite(table.felt_g[:, axis])
    felt, warm, mean = table.felt_g[known, axis], warmth(table)[known], table.mean[known, axis : axis + 1]
    if not known.any():
        return 0.0
    within = fitted(np.stack([warm, warm * felt], axis=1), mean, table.group[known])
    whole = fitted(np.stack([np.ones_like(warm), warm, felt, warm * felt], axis=1), mean, None)
    for fit in (within, whole):
        if np.abs(fit.coefficient[-1, 0]) > _CLEAR * fit.error[-1, 0]:
            return float(fit.coefficient[-1, 0])
    return 0.0


THERMAL_SCALE = Candidate(
    ThermalScale.name, guesses, {"heating": "heat by 20 degC on two opposite faces, 10 minutes each"}
)
