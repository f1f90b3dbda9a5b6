"""`stale_samples` is recognised by rows that equal the one before on all axes, all through the log."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.repetition import repeated_share
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.readings import StaleSamples

_PROBES = ("repeats", "stale", "longest_repeat", "lag_1")
_LEAST, _MOST = 1e-4, 0.95


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the share of repetitions beyond what the model makes."""
    yield from with_removal(evidence, StaleSamples.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    probability = repeated_share(evidence) if evidence.is_odd(*_PROBES) else 0.0
    if probability > _LEAST:
        yield Hypothesis((StaleSamples(min(probability, _MOST)),), ("probability",))


STALE_SAMPLES = Candidate(StaleSamples.name, guesses, dict.fromkeys(get_args(Kind), "1000 readings or more"))
