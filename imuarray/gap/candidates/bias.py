"""`bias` is fitted in every model, so that nothing of a constant level is left to see: there is no guess."""

from __future__ import annotations

from collections.abc import Iterator

from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.evidence import Evidence
from imuarray.simulate.effects.bias import Bias


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """None: a level that isn't the same in all phases is the matter of other effects."""
    yield from ()


BIAS = Candidate(Bias.name, guesses)
