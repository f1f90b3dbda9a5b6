"""`bias` is recognised by a step of the levels from one log to the next; a constant one is in every fit, unless that is
of an earlier recording.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import levels, log_levels
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias import Bias

_TRACES = ("mean", "level", "run_spread", "run_scatter", "run_outlier")
_CLEAR = 8.0
"""By so many nats two levels have to fit better than one."""

_FEWEST = 3
"""Of two logs nobody can say which one is odd: that is a turn-on bias."""

_SMALL = 0.1

_ODD = 3.0
"""Standard deviations from which on the level of an axis may have changed since an earlier recording."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """The step that divides the logs best, in the order in which they were recorded; or the level of all of them, where
    the base model's is of an earlier recording.
    """
    if not evidence.is_odd(*_TRACES):
        return
    if not evidence.is_refitted:
        yield from _since(evidence)
    logs, means, errors = log_levels(levels(evidence))
    if len(means) < _FEWEST:
        return
    gains = [_gain(means, errors, at) for at in range(1, len(means))]
    at = int(np.argmax(gains)) + 1
    if gains[at - 1] > _CLEAR:
        step = means[at:].mean(axis=0) - means[:at].mean(axis=0)
        x, y, z = np.where(np.abs(step) > _SMALL * np.abs(step).max(), step, 0.0).tolist()
        yield Hypothesis((Bias((x, y, z), float(logs[at])),), ("offset",))


def _since(evidence: Evidence) -> Iterator[Hypothesis]:
    """A bias that has changed since the earlier recording."""
    shift = evidence.typical("mean")
    size = np.abs(evidence.score("mean", "level"))
    x, y, z = np.where((size > _ODD) & np.isfinite(shift), shift, 0.0).tolist()
    if any((x, y, z)):
        yield Hypothesis((Bias((x, y, z)),), ("offset",))


def _gain(means: Floats, errors: Floats, at: int) -> float:
    """Nats by which a level of the first `at` logs and one of the rest explain means (l, 3) better than one of all."""
    whole = ((means - means.mean(axis=0)) ** 2 + errors).sum(axis=0)
    parts = sum(
        ((part - part.mean(axis=0)) ** 2 + error).sum(axis=0)
        for part, error in ((means[:at], errors[:at]), (means[at:], errors[at:]))
    )
    return float(len(means) / 2 * np.log(whole / parts).sum())


BIAS = Candidate(
    Bias.name, guesses, {"turn-on": "a dozen boots of 1 minute before what may have happened, and as many after it"}
)
