"""`axis_error` is recognised by faces or a motion that come out along another axis, or with the other sign."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import permutations, product

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.response import response
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.response import AxisError

_PROBES = (
    *("mean", "force_own", "force_next", "force_after"),
    *("motion_gain", "motion_along", "motion_next", "motion_after", "motion_across"),
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
    measured = response(evidence) if evidence.is_odd(*_PROBES) else None
    if measured is None:
        return
    nominal = measured.misfit(np.eye(3))
    misfits = {
        axes: measured.misfit(matrix) + _CHANGE * nominal * np.count_nonzero(np.diag(matrix) != 1)
        for axes, matrix in exchanges().items()
    }
    for axes in sorted(misfits, key=misfits.__getitem__)[:_MOST]:
        if misfits[axes] < _BETTER * nominal:
            yield Hypothesis((AxisError(axes),))


@cache
def exchanges() -> dict[str, Floats]:
    """Return the 47 exchanges of axes and signs by name, "+Y+X-Z", as matrices (3, 3); right-handed ones first, since
    no chip is left-handed.
    """
    matrices = {}
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.array(signs)[:, None] * np.eye(3)[list(order)]
        name = "".join("+-"[sign < 0] + "XYZ"[axis] for sign, axis in zip(signs, order, strict=True))
        matrices[name] = matrix
    del matrices["+X+Y+Z"]
    return dict(sorted(matrices.items(), key=lambda item: -np.linalg.det(item[1])))


AXIS_ERROR = Candidate(
    AxisError.name,
    guesses,
    {"tumble": "all six faces, 10 s each", "motion": "turns and strokes along every axis, 20 s"},
)
