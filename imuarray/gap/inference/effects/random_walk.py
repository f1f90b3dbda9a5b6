"""`random_walk`: Allan deviations that rise by +1/2, levels that never come back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.slow import BEYOND, TRACES, allan_of, size_of, sized
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias import RandomWalk

_ALIKE = 2.0
"""Levels that are farther apart by this factor than the Allan variances say make a guess of their own."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a density by the Allan variances, density^2 tau / 3, and by the differences of levels, density^2 t, if
    that differs.
    """
    yield from with_removal(evidence, RandomWalk.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    score = evidence.score(*TRACES)
    allan = allan_of(evidence)
    known = len(allan.time_s) > 3
    short = np.sqrt(size_of(allan, allan.time_s / 3, allan.length_s / 6)[0]) if known else np.zeros(3)
    far = _from_levels(evidence)
    for density in (short, far) if far.max() > _ALIKE * short.max() else (short,):
        for sizes in sized(density, score):
            yield Hypothesis((RandomWalk(sizes),), ("density",))


def _from_levels(evidence: Evidence) -> Floats:
    """Return (3,) density from the first and last quarter of the segments of each log and face."""
    table, squares, seconds = levels(evidence), np.zeros(3), 0.0
    for at in table.groups():
        quarter = len(at) // 4
        if quarter == 0:
            continue
        first, last = at[:quarter], at[-quarter:]
        step = table.mean[last].mean(axis=0) - table.mean[first].mean(axis=0)
        error = (table.square_error[first].sum(axis=0) + table.square_error[last].sum(axis=0)) / quarter**2
        squares += (step**2 - error).clip(0.0)
        seconds += float(table.time_s[last].mean() - table.time_s[first].mean())
    return np.asarray(np.sqrt(squares / seconds)) if seconds > 0 else np.zeros(3)


RANDOM_WALK = Candidate(
    RandomWalk.name,
    guesses,
    {"static": "still for an hour, several times", "tumble": "the first face again at the end"},
)
