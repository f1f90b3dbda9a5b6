"""`adaptive_range` is recognised by readings that repeat where the rates of an ICM-42688-P are high."""

from __future__ import annotations

from collections.abc import Iterator

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.conversion import AdaptiveRange

_CHIP = "icm42688_gyro"
_THRESHOLD_DPS, _HOLD_S = 100.0, 0.0015
"""Rate near which the chip changes its range, and the time for which it then delivers no new reading (TDK-18)."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the rate and the time of the erratum, if rows repeat in motion."""
    yield from with_removal(evidence, AdaptiveRange.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    moves = any(not phase.is_still for phase in evidence.phases)
    if evidence.header.chip == _CHIP and moves and evidence.is_odd("repeats", "longest_repeat"):
        yield Hypothesis((AdaptiveRange(_THRESHOLD_DPS, _HOLD_S),), ("hold_s",))


ADAPTIVE_RANGE = Candidate(
    AdaptiveRange.name,
    guesses,
    {"motion": "turns that pass 100 dps a hundred times, at the chip's full rate"},
    chip=_CHIP,
)
