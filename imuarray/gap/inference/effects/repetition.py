"""Rows that repeat the one before them on all axes: their number in the recording and in the model."""

from __future__ import annotations

import numpy as np

from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.statistics.summary import Summary


def repeated_share(evidence: Evidence) -> float:
    """Return probability that a row that would be new is a repetition, beyond what the model makes: the median over
    phases; negative where repetitions are missing.
    """
    shares = [_share(phase.raw) for phase in evidence.phases if phase.raw.rows > phase.raw.repeats.longest]
    usual = np.sin(evidence.expected.get("repeats", np.zeros((0, 1)))) ** 2
    known = usual[np.isfinite(usual)]
    chance = float(np.median(known)) if len(known) else 0.0
    return (float(np.median(shares)) - chance) / (1 - chance) if shares and chance < 1 else 0.0


def _share(summary: Summary) -> float:
    """Return the share of rows that repeat the one before, without the longest run, which may be of
    a chip that hung.
    """
    repeats = summary.repeats
    longest = repeats.longest - 1
    return (repeats.repeat_share * (summary.rows - 1) - longest) / max(summary.rows - 1 - longest, 1)
