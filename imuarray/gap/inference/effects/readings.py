"""Effects on single readings: steps there and back, and runs of equal rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Integers
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.timing import mean_of, odd_lags, repeated_rows
from imuarray.gap.inference.evidence import (
    NATS_PER_NUMBER,
    SINGLE,
    Evidence,
    PhaseEvidence,
    Repetition,
    Span,
    rarity_of_events,
    stretches,
)
from imuarray.gap.statistics.probes.probe import noise_lsb
from imuarray.gap.statistics.summary import Summary
from imuarray.simulate.effect import FOREVER_S
from imuarray.simulate.effects.readings import Glitches, Stuck, high_byte

_STEPS = ("tail", "extreme", "kurtosis", "noise_excess", "noise_uneven")
_IN_MOTION = "motion_residual"
_SPIKE = "spike"
_BEYOND_NOISE = 4.0
"""Least size of a step, in standard deviations."""

_GAUSSIAN = 6.33e-5
"""Share of the steps of Gaussian noise that are larger."""

_LOW_BYTES = (64, 256)
"""Counts per unit of the high byte: the low byte of a BMA180 carries six bits (BMA-60), that of other chips eight."""

_NEAR = 0.25

_FAR, _FEWEST_LSB = 6.0, 4.0
"""Least deviation of a single reading from the middle of its neighbours, in standard deviations and in counts."""

_AMONG = 2.5
"""A reading in motion is a spike if it deviates by more than this multiple of the smallest deviation that is kept of
its axis.
"""

_AGAIN_TORN = 3
"""Fewest torn readings that determine a frequency."""


class _Tail(NamedTuple):
    """Sizes of the steps of one axis in one phase, in counts, and how often each occurs; rows of the phase; and, for
    high bytes of 64 and of 256 counts, the probability that two independent readings differ in it.
    """

    sizes: Integers
    counts: Integers
    rows: int
    crossing: tuple[float, float]


def guess_glitches(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest spikes, torn words and words that read -1, each with its frequency."""
    if evidence.is_odd("words"):
        yield from _words([phase.raw for phase in evidence.phases])
    if evidence.is_odd(*_STEPS):
        yield from _spikes_again(evidence)
    if evidence.is_odd(*_STEPS, _IN_MOTION, _SPIKE):
        yield from _torn_again(evidence)
        yield from _glitches_alone(evidence)
    if evidence.is_odd(_IN_MOTION):
        yield from _torn_by_lag(evidence)


def _torn_by_lag(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest high bytes that are a row old. Such a byte is wrong by 256 counts with a probability of the change over
    256, so the mean reading is late by a row. If torn readings are too frequent to be isolated, the sensor is late by
    their share of a row. One axis of three is torn.
    """
    lags_seen = odd_lags(evidence)
    share = 3 * mean_of(lags_seen, "lag_s") * evidence.rows_per_s if lags_seen else 0.0
    if 0 < share <= 1:
        yield Hypothesis((Glitches(share, kind="torn"),), ("probability",), limits={"probability": (0.0, 1.0)})


def _spikes_again(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest spikes and torn readings that recur."""
    tails = [tail for phase in evidence.still for tail in _tails(phase.raw)]
    rows = sum(tail.rows for tail in tails) / 3
    count, usual = sum(int(tail.counts.sum()) for tail in tails), _GAUSSIAN * 3 * rows
    if count >= usual + 3 * math.sqrt(usual) + 2:
        hits = (count - usual) / 2  # each makes a step there and a step back
        size = _median_step(tails)
        spike = Glitches(min(hits / rows, 1.0), size / evidence.header.sensitivity)
        yield Hypothesis((spike,), ("probability", "amplitude"))
        yield from _torn(tails, size, hits)


class _Hit(NamedTuple):
    """A reading of an axis in a log, and its deviation in counts (`jump`)."""

    log: int
    moment_s: float
    axis: int
    jump: float


def _glitches_alone(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the readings themselves that were hit, if they are so few that most phases have none."""
    hits = [hit for phase in evidence.still for hit in _hits(phase)]
    spikes, torn = _spikes_in_motion(evidence), _torn_in_motion(evidence)
    hits += spikes if evidence.is_odd(_SPIKE) and len(torn) < len(spikes) else torn
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
    yield Hypothesis((effect,), whole=True, rarity=rarity_of_events(len(hits)))


def _hits(phase: PhaseEvidence) -> Iterator[_Hit]:
    """Yield isolated readings that deviate more than noise does, each dated half a row before its time."""
    limits = np.fmax(_FAR * np.sqrt(1.5) * noise_lsb(phase.raw), _FEWEST_LSB)
    half_s = phase.raw.intervals.mean_s / 2
    lone = phase.raw.outliers
    for axis, time_ns, apart in zip(lone.axis.tolist(), lone.time_ns.tolist(), lone.deviation.tolist(), strict=True):
        if abs(apart) > limits[axis]:
            yield _Hit(phase.log, time_ns * 1e-9 - half_s, axis, apart)


def _torn_again(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest torn readings with their frequency in motion, among the readings whose high byte has changed."""
    hits, weight = len(_torn_in_motion(evidence)), high_byte(evidence.header.chip)
    moving = [(phase.raw.rows, steps) for phase in evidence.phases if not phase.is_still for steps in phase.raw.steps]
    shares = [np.minimum(steps.codes / weight, 1.0) @ steps.counts / max(steps.counts.sum(), 1) for _, steps in moving]
    changes = sum(rows * float(share) for (rows, _), share in zip(moving, shares, strict=True)) / 3
    if hits >= _AGAIN_TORN and changes > 0:
        yield Hypothesis((Glitches(min(hits / changes, 1.0), kind="torn"),), ("probability",))


def _torn_in_motion(evidence: Evidence) -> list[_Hit]:
    """Return the spikes in motion that deviate by whole high bytes. A reading that deviates by another amount may be a
    late one.
    """
    weight = high_byte(evidence.header.chip)
    spikes = ((hit, round(hit.jump / weight)) for hit in _spikes_in_motion(evidence))
    return [
        hit._replace(jump=bytes_off * weight)
        for hit, bytes_off in spikes
        if bytes_off and abs(hit.jump / weight - bytes_off) < _NEAR
    ]


def _spikes_in_motion(evidence: Evidence) -> list[_Hit]:
    """Return the readings of the phases in motion that deviate far more than the motion explains."""
    half_s = 0.5 / evidence.rows_per_s
    phases = [(moving.log, moving.raw.phase) for moving in evidence.phases if not moving.is_still]
    spikes = []
    for log, lone in evidence.outliers:
        nearest = [float(np.abs(lone.deviation[lone.axis == axis]).min(initial=np.inf)) for axis in range(3)]
        for axis, time_ns, apart in zip(
            lone.axis.tolist(), lone.time_ns.tolist(), lone.deviation.tolist(), strict=True
        ):
            if abs(apart) > _AMONG * nearest[axis] and any(
                log == log_of_phase and phase.start_ns <= time_ns < phase.end_ns for log_of_phase, phase in phases
            ):
                spikes.append(_Hit(log, time_ns * 1e-9 - half_s, axis, apart))
    return spikes


def _torn(tails: Sequence[_Tail], size: float, hits: float) -> Iterator[Hypothesis]:
    """Suggest torn readings. A reading with the high byte of the reading before is wrong only if that byte changed, on
    one axis of three.
    """
    for place, weight in enumerate(_LOW_BYTES):
        changes = sum(tail.rows * tail.crossing[place] for tail in tails) / 3
        if abs(size / weight - 1) < _NEAR and changes >= 1:
            yield Hypothesis((Glitches(min(hits / changes, 1.0), kind="torn"),), ("probability",))


def _words(summaries: Sequence[Summary]) -> Iterator[Hypothesis]:
    words, rows = (sum(getattr(summary, name) for summary in summaries) for name in ("words", "rows"))
    if words:
        yield Hypothesis((Glitches(words / rows, kind="word"),), ("probability",))


def _tails(summary: Summary) -> Iterator[_Tail]:
    limits = np.fmax(_BEYOND_NOISE * np.sqrt(2) * noise_lsb(summary), 1.5)
    for steps, codes, limit in zip(summary.steps, summary.codes, limits.tolist(), strict=True):
        beyond = steps.codes > limit
        low, high = (_crossing(codes.codes // weight, codes.counts) for weight in _LOW_BYTES)
        yield _Tail(steps.codes[beyond], steps.counts[beyond], summary.rows, (low, high))


def _crossing(high: Integers, counts: Integers) -> float:
    """Return the probability that two readings differ in the high byte."""
    if len(high) == 0:
        return 0.0
    shares = np.bincount(high - high.min(), weights=counts) / counts.sum()
    return float(1 - (shares**2).sum())


def _median_step(tails: Sequence[_Tail]) -> float:
    """Return the median size of the steps in counts."""
    sizes, counts = (np.concatenate(parts) for parts in list(zip(*tails, strict=True))[:2])
    order = np.argsort(sizes)
    upto = np.cumsum(counts[order])
    return float(sizes[order][np.searchsorted(upto, upto[-1] / 2)])


_REPEAT_PROBES = ("longest_repeat", "repeats", "stale", "noise_uneven")
_FLAT_PROBES = ("noise", "noise_uneven", "noise_excess", "kurtosis")
"""Probes that change if an axis has no noise."""

_FLAT_SEGMENTS, _NOISE_LSB = 3, 0.4
"""Fewest segments without a change in which an axis is stuck, and its least noise elsewhere, in LSB."""

_LEAST_ROWS = 8
_HOLDS = 4.0
"""Least length of a run, as a multiple of the mean number of rows for which readings are held."""

_MOST_RUNS = 2
_AGAIN_STUCK = 3
"""Fewest runs that are suggested to recur; fewer are single events."""

_FEWEST_STRETCHES = 2
"""Fewest stretches that are suggested one by one."""

_BEYOND_MODEL = 1.5
"""Least length of a stretch, as a multiple of the longest run that the model makes in any phase."""


class _Run(NamedTuple):
    """Seconds since the epoch of log `log` in which each reading repeats the one before; `open`: until the phase
    ends.
    """

    log: int
    onset_s: float
    end_s: float
    open: bool


def guess_stuck(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the longest runs, each in one piece over several phases; a run that lasts to the log's end lasts for
    ever. If many phases have a run, suggest recurring runs that explain all repeated rows. If the runs are few enough,
    suggest each of them with its time, because a random process puts them into other phases.
    """
    if evidence.is_odd(*_FLAT_PROBES):
        yield from _single_axes(evidence)
    if not evidence.is_odd(*_REPEAT_PROBES):
        return
    runs = sorted(_runs(evidence), key=lambda run: run.onset_s - run.end_s)
    if len(runs) >= _AGAIN_STUCK:
        yield from _stuck_again(evidence, runs)
    yield from _stuck_alone(evidence)
    for run in runs[:_MOST_RUNS]:
        for_ever = run.open and run.end_s >= _end_s(evidence, run.log)
        duration_s = math.inf if for_ever else run.end_s - run.onset_s
        yield Hypothesis((Stuck(run.onset_s, duration_s, kind=_kind_of_rows(evidence)),))


def _single_axes(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest axes that keep one code over several segments at rest while the others have noise, until the log ends or
    the first segment that changes.
    """
    for log in sorted({phase.log for phase in evidence.still}):
        phases = [phase.raw for phase in evidence.still if phase.log == log]
        rows = np.concatenate([phase.segments.rows for phase in phases])
        variance = np.concatenate([phase.segments.variance for phase in phases])
        begin_s = np.concatenate([phase.segments.time_s - phase.segments.width_s / 2 for phase in phases])
        mean = np.concatenate([phase.segments.mean for phase in phases])
        is_flat = (variance == 0) & (rows > 2)[:, None]
        if is_flat.all(axis=1).any():  # the whole sensor repeats its readings
            continue
        for axis in np.flatnonzero(is_flat.any(axis=0)).tolist():
            flat = np.flatnonzero(is_flat[:, axis])
            noise_lsb = np.sqrt(np.median(variance[~is_flat[:, axis], axis])) if len(flat) < len(rows) else 0.0
            is_single_stretch = len(np.unique(mean[flat, axis])) == 1 and len(flat) == np.ptp(flat) + 1
            if len(flat) < _FLAT_SEGMENTS or not is_single_stretch or noise_lsb < _NOISE_LSB:
                continue
            onset_s, after = float(begin_s[flat[0]]), flat[-1] + 1
            length_s = float(begin_s[after]) - onset_s if after < len(rows) else FOREVER_S
            reading = np.zeros(3)
            reading[axis] = mean[flat[0], axis] / evidence.header.sensitivity
            stuck = Stuck(
                kind="new",
                **stretches([Span(log, onset_s, length_s)]),
                readings=tuple(reading.tolist()),
                stuck_axes=(float(axis),),
            )
            yield Hypothesis((stuck,), whole=True, rarity=NATS_PER_NUMBER)


def _stuck_again(evidence: Evidence, runs: Sequence[_Run]) -> Iterator[Hypothesis]:
    """Suggest stretches of the median length of these `runs`, at the frequency that explains all repeated rows."""
    length_s = float(np.median([run.end_s - run.onset_s for run in runs]))
    held_rows = repeated_rows(phase.raw for phase in evidence.phases)
    rows = sum(phase.raw.rows for phase in evidence.phases)
    every_s = length_s * (rows / max(held_rows, length_s * evidence.rows_per_s) - 1)
    if every_s > 0:
        stuck = Stuck(duration_s=length_s, every_s=every_s, kind=_kind_of_rows(evidence))
        yield Hypothesis((stuck,), ("duration_s", "every_s"))


def _stuck_alone(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest all stretches that are longer than those of the model, in two forms: with the recorded readings, and with
    whatever reading the simulation holds. Recorded readings fit only if the simulated bias varies little.
    """
    longest = evidence.expected.get("longest_repeat", np.zeros((0, 1)))  # rows, including the first one
    least = _BEYOND_MODEL * float(np.nanmax(longest, initial=1.0)) - 1
    repeated = [repetition for repetition in evidence.repeated if repetition.rows >= least]
    if not _FEWEST_STRETCHES <= len(repeated) <= SINGLE:
        return
    readings = tuple(count / evidence.header.sensitivity for repetition in repeated for count in repetition.counts)
    kind, rarity = _kind_of_rows(evidence), rarity_of_events(len(repeated))
    alone = stretches([repetition.span for repetition in repeated])
    yield Hypothesis((Stuck(kind=kind, **alone),), whole=True, rarity=rarity)
    with_first = stretches([_with_first_reading(repetition) for repetition in repeated])
    yield Hypothesis((Stuck(kind=kind, **with_first, readings=readings),), whole=True, rarity=rarity)


def _with_first_reading(repetition: Repetition) -> Span:
    """Return the stretch including the reading that is repeated, which may be the first of the log."""
    log, moment_s, length_s = repetition.span
    begin_s = max(moment_s - length_s / repetition.rows, 0.0)
    return Span(log, begin_s, moment_s + length_s - begin_s)


def _kind_of_rows(evidence: Evidence) -> str:
    """Return "stale" if the chip marks more than half of the repeated rows as stale, else "new"."""
    repeated = sum(float(np.nan_to_num(phase.raw.repeats.repeat_share)) * phase.raw.rows for phase in evidence.phases)
    return "stale" if sum(phase.raw.flags["stale"] for phase in evidence.phases) > repeated / 2 else "new"


def _runs(evidence: Evidence) -> list[_Run]:
    """Return the longest run of each phase; runs that continue in the next phase of the log are joined."""
    joined: list[_Run] = []
    order = sorted(evidence.phases, key=lambda phase: (phase.log, phase.raw.phase.start_ns))
    for phase in order:
        run = _longest(phase, evidence.rows_per_s)
        if run is None:
            continue
        last = joined[-1] if joined else None
        if last is not None and last.open and last.log == phase.log and phase.raw.repeats.longest_row == 0:
            joined[-1] = last._replace(end_s=run.end_s, open=run.open)
        else:
            joined.append(run)
    return joined


def _longest(phase: PhaseEvidence, rows_per_s: float) -> _Run | None:
    """Return the longest run of repeated rows in a phase; None if the chip's hold and chance explain it."""
    repeats, span = phase.raw.repeats, phase.raw.phase
    hold = _HOLDS / repeats.new_share if repeats.new_share > 0 else 0.0
    if repeats.longest < max(_LEAST_ROWS, hold):
        return None
    rows = phase.raw.segments.rows
    edges_s = span.start_ns * 1e-9 + phase.raw.segments.width_s * np.arange(len(rows) + 1)
    upto = np.concatenate([[0], np.cumsum(rows)])
    first = repeats.longest_row + (repeats.longest_row > 0)  # the repeated reading itself is not part of the run
    ends = (first, repeats.longest_row + repeats.longest)
    onset_s, end_s = np.interp(ends, upto, edges_s).tolist()
    half_s = 0.5 / rows_per_s  # between two rows
    return _Run(phase.log, max(onset_s - half_s, 0.0), end_s - half_s, ends[1] >= phase.raw.rows)


def _end_s(evidence: Evidence, log: int) -> float:
    """Return the time at which the log's last phase ends, less one row."""
    end_ns = max(phase.raw.phase.end_ns for phase in evidence.phases if phase.log == log)
    return end_ns * 1e-9 - 1 / evidence.rows_per_s
