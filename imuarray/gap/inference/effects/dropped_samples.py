"""`dropped_samples` is recognised by gaps between rows, and by flags that say so."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, get_args

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.inference.when import NUMBERS, SINGLE, Span, stretches
from imuarray.simulate.effects.timing import DroppedSamples

_PROBES = ("gaps", "skips", "lost", "longest_interval", "irregularity", "interval")


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the share of rows lost, and how many at a time; and where they are few, just those that are missing,
    since chance takes others, from other phases.
    """
    yield from with_removal(evidence, DroppedSamples.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_PROBES):
        return
    yield from _one_by_one(evidence)
    rows = sum(phase.raw.rows for phase in evidence.phases)
    holes = [hole for phase in evidence.phases for hole in evidence.holes if _is_within(hole, phase)]
    bursts, lost, longest = _known_losses(holes, evidence) if holes else _losses_by_intervals(evidence)
    if not bursts:
        return
    burst_rows = float(np.clip(lost / bursts, 1.0, max(longest, 1.0)))
    lost = bursts * burst_rows
    probability = min(lost / (rows + lost), 0.9 * burst_rows / (burst_rows + 1))
    yield Hypothesis((DroppedSamples(probability, burst_rows),), ("probability", "burst_rows")[: 1 + (longest > 1.5)])


class _Losses(NamedTuple):
    """The number of `bursts`, the rows lost in all of them and in the longest one."""

    bursts: int
    rows: float
    longest: float


def _is_within(hole: Span, phase: PhaseEvidence) -> bool:
    compared = phase.raw.phase
    return hole.log == phase.log and compared.start_ns <= 1e9 * hole.moment_s < compared.end_ns


def _known_losses(holes: Sequence[Span], evidence: Evidence) -> _Losses:
    """Losses in the holes: other long intervals, such as stalls of the recorder, are no losses."""
    lost = np.maximum(np.rint(np.array([hole.length_s for hole in holes]) / _interval_s(evidence)), 1.0)
    return _Losses(len(lost), float(lost.sum()), float(lost.max()))


def _losses_by_intervals(evidence: Evidence) -> _Losses:
    """Losses by long intervals, flagged or not, and by the rows that are fewer than due."""
    summaries = [phase.raw for phase in evidence.phases if phase.raw.rows]
    interval_s = _interval_s(evidence)
    bursts = sum(max(summary.intervals.gaps, summary.flags["lost_before"]) for summary in summaries)
    due = sum((summary.phase.end_ns - summary.phase.start_ns) * 1e-9 / interval_s for summary in summaries)
    longest = max((float(np.nan_to_num(summary.intervals.longest_s)) for summary in summaries), default=0.0)
    return _Losses(bursts, due - sum(summary.rows for summary in summaries), longest / interval_s - 1)


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
