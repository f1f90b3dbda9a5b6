"""`turn_on_bias`: levels of logs that differ by more than what is within them explains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import change_between_logs, levels, log_levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias import TurnOnBias

TRACES = ("run_spread", "run_scatter", "run_two_states", "run_outlier", "mean")
"""Probes that move where boots differ."""

BEYOND = 2.7
_SMALL = 0.2


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the spread of the logs' levels on the faces that they share; of two logs, what they differ by."""
    yield from with_removal(evidence, TurnOnBias.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    change = change_between_logs(evidence)
    if change.any():
        x, y, z = (np.abs(change) / np.sqrt(2)).tolist()
        yield Hypothesis((TurnOnBias((x, y, z)),), whole=True)
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    _, means, errors = log_levels(levels(evidence))
    if len(means) < 2:
        return
    rms = np.sqrt(np.maximum(means.var(axis=0, ddof=1) - errors.mean(axis=0), 0.0))
    if rms.any():
        x, y, z = np.where(rms < _SMALL * rms.max(), np.where(np.abs(evidence.score(*TRACES)) > BEYOND, rms, 0.0), rms)
        yield Hypothesis((TurnOnBias((float(x), float(y), float(z))),), ("rms",))


TURN_ON_BIAS = Candidate(
    TurnOnBias.name, guesses, {"turn-on": "a dozen boots of 1 minute, switched off for 10 s in between"}
)
