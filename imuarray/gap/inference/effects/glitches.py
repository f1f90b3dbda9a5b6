"""`glitches` are recognised by steps there and back that no noise makes, or by words that no sensor gives."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Integers
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.lag import mean_of, odd_lags
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.inference.when import NUMBERS, SINGLE
from imuarray.gap.statistics.probes.probe import noise_lsb
from imuarray.gap.statistics.summary import Summary
from imuarray.simulate.effects.readings import Glitches, high_byte

_STEPS = ("tail", "extreme", "kurtosis", "noise_excess", "noise_uneven")
_IN_MOTION = "motion_residual"
_BEYOND = 4.0
"""Standard deviations of a step."""

_GAUSSIAN = 6.33e-5
"""So many steps of Gaussian noise are larger."""

_LOW_BYTES = (64, 256)
"""What a high byte counts: six bits of a BMA180 travel in the low one (BMA-60), eight elsewhere."""

_NEAR = 0.25

_FAR, _FEWEST_LSB = 6.0, 4.0
"""By so many standard deviations, and counts, single readings are off the middle of their neighbours."""

_AMONG = 2.5
"""So many times further off than the nearest that is kept of an axis is a reading that no motion explains."""

_AGAIN = 3
"""Fewer readings tell no frequency."""


class _Tail(NamedTuple):
    """Sizes of steps in counts and how often each came, of one axis in one phase of so many rows; per high byte that
    weighs 64 and 256, how often neighbours differ in it if they are independent.
    """

    sizes: Integers
    counts: Integers
    rows: int
    crossing: tuple[float, float]


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Spikes, torn words, words that read -1; each with its frequency."""
    yield from with_removal(evidence, Glitches.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.is_odd("words"):
        yield from _words([phase.raw for phase in evidence.phases])
    if evidence.is_odd(*_STEPS):
        yield from _again(evidence)
    if evidence.is_odd(*_STEPS, _IN_MOTION):
        yield from _torn_again(evidence)
        yield from _few(evidence)
    if evidence.is_odd(_IN_MOTION):
        yield from _torn_by_lag(evidence)


def _torn_by_lag(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a high byte that is a row old. It is wrong by 256 counts as often as a change has the share of these: in
    the mean the reading is a row late. So many of them that they don't stand alone make the sensor late by as much of a
    row; one of three axes is hit.
    """
    lags_seen = odd_lags(evidence)
    share = 3 * mean_of(lags_seen, "lag_s") * evidence.rows_per_s if lags_seen else 0.0
    if 0 < share <= 1:
        yield Hypothesis((Glitches(share, kind="torn"),), ("probability",), limits={"probability": (0.0, 1.0)})


def _again(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest spikes and torn readings that recur."""
    tails = [tail for phase in evidence.still for tail in _tails(phase.raw)]
    rows = sum(tail.rows for tail in tails) / 3
    count, usual = sum(int(tail.counts.sum()) for tail in tails), _GAUSSIAN * 3 * rows
    if count >= usual + 3 * math.sqrt(usual) + 2:
        hits = (count - usual) / 2  # there and back
        size = _median(tails)
        spike = Glitches(min(hits / rows, 1.0), size / evidence.header.sensitivity)
        yield Hypothesis((spike,), ("probability", "amplitude"))
        yield from _torn(tails, size, hits)


class _Hit(NamedTuple):
    """A reading of an axis in a log, and by how many counts it is off."""

    log: int
    moment_s: float
    axis: int
    jump: float


def _few(evidence: Evidence) -> Iterator[Hypothesis]:
    """Guess the very readings that were hit, which are all known, if they are so few that most phases have none."""
    hits = [hit for phase in evidence.still for hit in _hits(phase)]
    hits += _torn_in_motion(evidence)
    if not 0 < len(hits) <= SINGLE:
        return
    rows = sum(phase.raw.rows for phase in evidence.phases)
    scale = evidence.header.sensitivity
    jumps = [hit.jump / scale if axis == hit.axis else 0.0 for hit in hits for axis in range(3)]
    effect = Glitches(
        len(hits) / rows,
        float(np.median([abs(hit.jump) for hit in hits])) / scale,
        runs=tuple(float(hit.log) for hit in hits),
        moments_s=tuple(hit.moment_s for hit in hits),
        jumps=tuple(jumps),
    )
    yield Hypothesis((effect,), whole=True, rarity=NUMBERS * len(hits))


def _hits(phase: PhaseEvidence) -> Iterator[_Hit]:
    """Lone readings beyond what noise makes, each due half a row before it came."""
    limits = np.fmax(_FAR * np.sqrt(1.5) * noise_lsb(phase.raw), _FEWEST_LSB)
    half_s = phase.raw.intervals.mean_s / 2
    lone = phase.raw.outliers
    for axis, time_ns, apart in zip(lone.axis.tolist(), lone.time_ns.tolist(), lone.deviation.tolist(), strict=True):
        if abs(apart) > limits[axis]:
            yield _Hit(phase.log, time_ns * 1e-9 - half_s, axis, apart)


def _torn_again(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest torn readings as often as they occur in motion, among readings whose high byte has changed."""
    hits, weight = len(_torn_in_motion(evidence)), high_byte(evidence.header.chip)
    moving = [(phase.raw.rows, steps) for phase in evidence.phases if not phase.is_still for steps in phase.raw.steps]
    shares = [np.minimum(steps.codes / weight, 1.0) @ steps.counts / max(steps.counts.sum(), 1) for _, steps in moving]
    changes = sum(rows * float(share) for (rows, _), share in zip(moving, shares, strict=True)) / 3
    if hits >= _AGAIN and changes > 0:
        yield Hypothesis((Glitches(min(hits / changes, 1.0), kind="torn"),), ("probability",))


def _torn_in_motion(evidence: Evidence) -> list[_Hit]:
    """Return readings of phases that are looked at which are off by high bytes, and far more than the motion leaves.
    One that is off by anything else may have come late.
    """
    weight, half_s = high_byte(evidence.header.chip), 0.5 / evidence.rows_per_s
    phases = [(moving.log, moving.raw.phase) for moving in evidence.phases if not moving.is_still]
    spikes = []
    for log, lone in evidence.outliers:
        nearest = [float(np.abs(lone.deviation[lone.axis == axis]).min(initial=np.inf)) for axis in range(3)]
        for axis, time_ns, apart in zip(
            lone.axis.tolist(), lone.time_ns.tolist(), lone.deviation.tolist(), strict=True
        ):
            bytes_off = round(apart / weight)
            is_torn = bytes_off and abs(apart / weight - bytes_off) < _NEAR and abs(apart) > _AMONG * nearest[axis]
            if is_torn and any(
                log == log_of_phase and phase.start_ns <= time_ns < phase.end_ns for log_of_phase, phase in phases
            ):
                spikes.append(_Hit(log, time_ns * 1e-9 - half_s, axis, bytes_off * weight))
    return spikes


def _torn(tails: Sequence[_Tail], size: float, hits: float) -> Iterator[Hypothesis]:
    """Suggest torn readings: one with the high byte of the reading before is wrong only where that changed, on one
    axis of three."""
    for place, weight in enumerate(_LOW_BYTES):
        changes = sum(tail.rows * tail.crossing[place] for tail in tails) / 3
        if abs(size / weight - 1) < _NEAR and changes >= 1:
            yield Hypothesis((Glitches(min(hits / changes, 1.0), kind="torn"),), ("probability",))


def _words(summaries: Sequence[Summary]) -> Iterator[Hypothesis]:
    words, rows = (sum(getattr(summary, name) for summary in summaries) for name in ("words", "rows"))
    if words:
        yield Hypothesis((Glitches(words / rows, kind="word"),), ("probability",))


def _tails(summary: Summary) -> Iterator[_Tail]:
    limits = np.fmax(_BEYOND * np.sqrt(2) * noise_lsb(summary), 1.5)
    for steps, codes, limit in zip(summary.steps, summary.codes, limits.tolist(), strict=True):
        beyond = steps.codes > limit
        low, high = (_crossing(codes.codes // weight, codes.counts) for weight in _LOW_BYTES)
        yield _Tail(steps.codes[beyond], steps.counts[beyond], summary.rows, (low, high))


def _crossing(high: Integers, counts: Integers) -> float:
    """Return the chance that two readings have another high byte."""
    if len(high) == 0:
        return 0.0
    shares = np.bincount(high - high.min(), weights=counts) / counts.sum()
    return float(1 - (shares**2).sum())


def _median(tails: Sequence[_Tail]) -> float:
    """Size of the steps."""
    sizes, counts = (np.concatenate(parts) for parts in list(zip(*tails, strict=True))[:2])
    order = np.argsort(sizes)
    upto = np.cumsum(counts[order])
    return float(sizes[order][np.searchsorted(upto, upto[-1] / 2)])


GLITCHES = Candidate(
    Glitches.name,
    guesses,
    dict.fromkeys(("static", "tumble", "heating", "turn-on"), "at rest, 10000 readings or more"),
)
