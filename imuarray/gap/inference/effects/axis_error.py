"""`axis_error` is recognised by faces or a motion that come out along another axis, or with the other sign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.response import response, turns_of
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.recording.turns import exchanges, misses
from imuarray.simulate.effects.response import AxisError

_PROBES = (
    *("mean", "force_own", "force_next", "force_after"),
    *("motion_gain", "motion_along", "motion_next", "motion_after", "motion_across", "turn_factor"),
)
_BETTER = 0.4
"""An exchange of axes leaves less than such a share of what the nominal axes leave: it is exact, or it is none."""

_CHANGE = 0.01
"""Cost of each axis that reads otherwise than nominal, as a share of what the nominal axes leave: an axis about which
the box does not turn may keep its place.
"""

_MOST = 3


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the signed permutations that fit best, left-handed ones too."""
    yield from with_removal(evidence, AxisError.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_PROBES):
        return
    matrices = np.array([np.eye(3), *exchanges().values()])
    if (measured := response(evidence)) is not None:
        nominal, *others = (measured.misfit(matrix) for matrix in matrices)
    elif turns := turns_of(evidence):  # a reading is what the matrix makes of the rate, which its transpose makes of it
        nominal, *others = misses(turns, matrices.swapaxes(1, 2)).tolist()
    else:
        return
    misfits = {
        axes: misfit + _CHANGE * nominal * np.count_nonzero(np.diag(matrix) != 1)
        for misfit, (axes, matrix) in zip(others, exchanges().items(), strict=True)
    }
    for axes in sorted(misfits, key=misfits.__getitem__)[:_MOST]:
        if misfits[axes] < _BETTER * nominal:
            yield Hypothesis((AxisError(axes),))


AXIS_ERROR = Candidate(
    AxisError.name,
    guesses,
    {"tumble": "all six faces, 10 s each", "motion": "turns and strokes along every axis, 20 s"},
)
