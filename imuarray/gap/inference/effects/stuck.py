"""`stuck` is recognised by runs of equal rows that are longer than holding and chance make them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple, get_args

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence, Repetition
from imuarray.gap.inference.when import NUMBERS, SINGLE, Span, stretches
from imuarray.simulate.effect import FOREVER_S
from imuarray.simulate.effects.readings import Stuck

_PROBES = ("longest_repeat", "repeats", "stale", "noise_uneven")
_SPREAD = ("noise", "noise_uneven", "noise_excess", "kurtosis")
"""Probes that an axis without noise moves."""

_FLAT_SEGMENTS, _NOISE_LSB = 3, 0.4
"""Segments without any change in which an axis is stuck whose noise is at least so many LSB elsewhere."""

_LEAST_ROWS = 8
_HOLDS = 4.0
"""So many times longer than readings are held on average."""

_MOST = 2
_AGAIN = 3
"""Phases with such a run; fewer are single events."""

_FEWEST = 2
"""Stretches that are told one by one."""

_BEYOND = 1.5
"""So many times longer than the longest run that the model makes in any phase."""


class _Run(NamedTuple):
    """Seconds since the epoch of log `log` in which every reading is the one before; `open` until the phase's end."""

    log: int
    onset_s: float
    end_s: float
    open: bool


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the longest runs, runs over several phases in one piece; one that lasts to the log's end lasts for ever.
    Where many phases have one: again and again, as much time in all as rows are held; and where they are few enough,
    each of them, since chance puts them into other phases.
    """
    yield from with_removal(evidence, Stuck.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.is_odd(*_SPREAD):
        yield from _single_axes(evidence)
    if not evidence.is_odd(*_PROBES):
        return
    runs = sorted(_runs(evidence), key=lambda run: run.onset_s - run.end_s)
    if len(runs) >= _AGAIN:
        yield from _again(evidence, runs)
    yield from _one_by_one(evidence)
    for run in runs[:_MOST]:
        for_ever = run.open and run.end_s >= _end_s(evidence, run.log)
        duration_s = math.inf if for_ever else run.end_s - run.onset_s
        yield Hypothesis((Stuck(run.onset_s, duration_s, kind=_kind(evidence)),))


def _single_axes(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest axes that keep one code from one segment at rest to another while the others have noise, until the log
    ends or the first segment that changes.
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
            yield Hypothesis((stuck,), whole=True, rarity=NUMBERS)


def _again(evidence: Evidence, runs: Sequence[_Run]) -> Iterator[Hypothesis]:
    """Suggest stretches as long as these `runs`, as often as explains all repeated rows."""
    length_s = float(np.median([run.end_s - run.onset_s for run in runs]))
    held_rows = sum(float(np.nan_to_num(phase.raw.repeats.repeat_share)) * phase.raw.rows for phase in evidence.phases)
    rows = sum(phase.raw.rows for phase in evidence.phases)
    every_s = length_s * (rows / max(held_rows, length_s * evidence.rows_per_s) - 1)
    if every_s > 0:
        stuck = Stuck(duration_s=length_s, every_s=every_s, kind=_kind(evidence))
        yield Hypothesis((stuck,), ("duration_s", "every_s"))


def _one_by_one(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest all stretches that are longer than the model makes them, in two forms: with the recorded readings, and
    with whatever reading the simulation holds. Recorded readings fit only if the simulated bias varies little.
    """
    longest = evidence.expected.get("longest_repeat", np.zeros((0, 1)))  # rows, the first one too
    least = _BEYOND * float(np.nanmax(longest, initial=1.0)) - 1
    repeated = [repetition for repetition in evidence.repeated if repetition.rows >= least]
    if not _FEWEST <= len(repeated) <= SINGLE:
        return
    readings = tuple(count / evidence.header.sensitivity for repetition in repeated for count in repetition.counts)
    kind, rarity = _kind(evidence), NUMBERS * len(repeated)
    alone = stretches([repetition.span for repetition in repeated])
    yield Hypothesis((Stuck(kind=kind, **alone),), whole=True, rarity=rarity)
    with_first = stretches([_with_first_reading(repetition) for repetition in repeated])
    yield Hypothesis((Stuck(kind=kind, **with_first, readings=readings),), whole=True, rarity=rarity)


def _with_first_reading(repetition: Repetition) -> Span:
    """Return the stretch with the reading that is repeated, which may be the first of the log."""
    log, moment_s, length_s = repetition.span
    begin_s = max(moment_s - length_s / repetition.rows, 0.0)
    return Span(log, begin_s, moment_s + length_s - begin_s)


def _kind(evidence: Evidence) -> str:
    """Return "stale" if the chip marks more than half of the repeated rows as stale, else "new"."""
    repeated = sum(float(np.nan_to_num(phase.raw.repeats.repeat_share)) * phase.raw.rows for phase in evidence.phases)
    return "stale" if sum(phase.raw.flags["stale"] for phase in evidence.phases) > repeated / 2 else "new"


def _runs(evidence: Evidence) -> list[_Run]:
    """Return the longest of each phase, joined where one goes on in the next phase of the log."""
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
    first = repeats.longest_row + (repeats.longest_row > 0)  # the reading that is repeated is not one of them
    ends = (first, repeats.longest_row + repeats.longest)
    onset_s, end_s = np.interp(ends, upto, edges_s).tolist()
    half_s = 0.5 / rows_per_s  # between two rows
    return _Run(phase.log, max(onset_s - half_s, 0.0), end_s - half_s, ends[1] >= phase.raw.rows)


def _end_s(evidence: Evidence, log: int) -> float:
    """Return the time at which the log's last phase ends, less one row."""
    end_ns = max(phase.raw.phase.end_ns for phase in evidence.phases if phase.log == log)
    return end_ns * 1e-9 - 1 / evidence.rows_per_s


STUCK = Candidate(Stuck.name, guesses, dict.fromkeys(get_args(Kind), "the same again, for as long as possible"))
