"""`dropped_samples` is recognised by gaps between rows, and by flags that say so."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.inference.when import NUMBERS, SINGLE, stretches
from imuarray.simulate.effects.dropped_samples import DroppedSamples

_PROBES = ("gaps", "lost", "longest_interval", "irregularity", "interval")


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the share of rows lost, and how many at a time; and where they are few, just those that are missing,
    since chance takes others, from other phases.
    """
    yield from with_removal(evidence, DroppedSamples.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_PROBES):
        return
    yield from _one_by_one(evidence)
    summaries = [phase.raw for phase in evidence.phases if phase.raw.rows]
    interval_s = _interval_s(evidence)
    bursts = sum(max(summary.intervals.gaps, summary.flags["lost_before"]) for summary in summaries)
    if not bursts:
        return
    rows = sum(summary.rows for summary in summaries)
    due = sum((summary.phase.end_ns - summary.phase.start_ns) * 1e-9 / interval_s for summary in summaries)
    longest = float(np.nan_to_num([summary.intervals.longest_s for summary in summaries]).max()) / interval_s - 1
    burst_rows = float(np.clip((due - rows) / bursts, 1.0, max(longest, 1.0)))
    lost = bursts * burst_rows
    probability = min(lost / (rows + lost), 0.9 * burst_rows / (burst_rows + 1))
    yield Hypothesis((DroppedSamples(probability, burst_rows),), ("probability", "burst_rows")[: 1 + (longest > 1.5)])


def _one_by_one(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest rows that the log reports as lost."""
    holes = evidence.holes
    if not 0 < len(holes) <= SINGLE:
        return
    yield Hypothesis((DroppedSamples(**stretches(holes)),), whole=True, rarity=NUMBERS * len(holes))


def _interval_s(evidence: Evidence) -> float:
    """Between rows of which none is lost: as the model has it, or else as most are."""
    rows = evidence.expected.get("interval", np.zeros((0, 1)))
    known = rows[np.isfinite(rows)]
    return float(np.exp(np.median(known))) if len(known) else 1 / evidence.rows_per_s


DROPPED_SAMPLES = Candidate(DroppedSamples.name, guesses, dict.fromkeys(get_args(Kind), "10000 readings or more"))
