"""`bistable_bias`: levels of boots in two groups, the same ones on all axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import levels, log_levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.turn_on_bias import BEYOND, TRACES
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias import BistableBias

_WIDE = 2.0
"""A gap so many times the mean of the others parts two groups."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the logs on either side of the widest gap between their levels: how far apart, and how often the rarer
    ones.
    """
    yield from with_removal(evidence, BistableBias.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    _, means, errors = log_levels(levels(evidence))
    if len(means) < 2 or (rare := rarer(means, errors)) is None:
        return
    x, y, z = (means[rare].mean(axis=0) - means[~rare].mean(axis=0)).tolist()
    yield Hypothesis((BistableBias((x, y, z), float(rare.mean())),), ("offset", "probability"))


def rarer(means: Floats, errors: Floats) -> Booleans | None:
    """Return (l,) the smaller one of two groups of levels (l, 3), by the axis that parts them best;
    None for one group.
    """
    ordered = np.sort(means, axis=0)
    gaps = np.diff(ordered, axis=0)
    largest = gaps.max(axis=0)
    others = (gaps.sum(axis=0) - largest) / max(len(gaps) - 1, 1) + np.sqrt(errors.mean(axis=0)) + 1e-12
    axis = int((largest / others).argmax())
    if largest[axis] < _WIDE * others[axis]:
        return None
    at = int(gaps[:, axis].argmax())
    upper = means[:, axis] > (ordered[at, axis] + ordered[at + 1, axis]) / 2
    return np.asarray(upper if upper.sum() * 2 <= len(upper) else ~upper)


BISTABLE_BIAS = Candidate(
    BistableBias.name, guesses, {"turn-on": "20 boots of 1 minute, switched off for 10 s in between"}
)
