"""`scale` is recognised by opposite faces that differ by more or less than they should, by a share of motion (about a
single axis too), or by a level that changes along the axes that feel gravity.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.bias import LevelStep, level_steps
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.response import DOUBTFUL, ODD, response, size_of_score
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.inference.when import Span, When
from imuarray.gap.statistics.probes.level import mean
from imuarray.simulate.effects.response import Scale

_LARGEST = 0.9
"""More than that isn't an error of scale."""

_ALONG, _TURNS = "motion_along", "turn_factor"

_LEAST_FACTOR = 0.3
"""A smaller factor of the readings of turns is no error of scale."""

_SMALLER = 0.8
"""Largest error of the first part of a motion, as a share of that of the second, if it begins within the motion."""

_FELT = 0.3
"""Least share of the force along an axis whose level tells a scale."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the diagonal of the response's error, on axes that stray beyond the population; and of an accelerometer
    the error that makes a level's step within a log, on the axes that show it or on all. If the box always lies alike,
    such a step is that of a bias: a scale has to show in motion or on several faces.
    """
    yield from with_removal(evidence, Scale.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.header.quantity == "specific_force":
        for step in level_steps(evidence):
            yield from _of_step(evidence, step)
    yield from _of_rotation(evidence)
    yield from _of_turns(evidence)
    yield from _within_motion(evidence)
    score, measured_response = size_of_score(evidence, "force_own", "motion_gain"), response(evidence)
    if measured_response is None or not (score > ODD).any():
        return
    axis_error, doubtful = np.diag(measured_response.error), score > DOUBTFUL
    error = np.where(doubtful & (np.abs(axis_error) < _LARGEST), axis_error, 0.0)
    if error.any():
        x, y, z = error.tolist()
        yield Hypothesis((Scale((x, y, z)),), ("error",))


def _of_rotation(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the share of motion that is lacking along each axis that strays, and along all axes alike, where the axes
    cannot be told apart: in a rotation about a single axis.
    """
    score = size_of_score(evidence, _ALONG)
    if evidence.is_odd("motion_gain", beyond=ODD) or not (score > ODD).any():
        return
    shift = evidence.shift(_ALONG)
    error = np.where((score > DOUBTFUL) & (np.abs(shift) < _LARGEST), shift, 0.0)
    largest = float(error[score.argmax()])
    for x, y, z in dict.fromkeys([(largest,) * 3, tuple(error.tolist())]):
        if any((x, y, z)):
            yield Hypothesis((Scale((x, y, z)),), ("error",))


def _of_turns(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest what the turns from one rest to the next show, of the only gyroscope."""
    score = np.abs(evidence.score(_TURNS))
    if evidence.others or not (score > ODD).any():
        return
    error = np.zeros(3)
    for axis in np.flatnonzero(score > DOUBTFUL):
        factor, expected = (table[_TURNS][:, axis] for table in (evidence.values, evidence.expected))
        known = np.isfinite(factor) & (np.abs(factor) > _LEAST_FACTOR)
        error[axis] = (expected[known] / factor[known]).mean() - 1 if known.any() else 0.0
    error = np.where(np.abs(error) < _LARGEST, error, 0.0)
    largest = float(error[score.argmax()])
    for x, y, z in dict.fromkeys([tuple(error.tolist()), (largest,) * 3]):
        if any((x, y, z)):
            yield Hypothesis((Scale((x, y, z)),), ("error",))


def _within_motion(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the error of the second part of a motion from some moment on, where the first part
    shows a smaller one.
    """
    if _ALONG not in evidence.scores or _ALONG not in evidence.rows_of:
        return
    logs = np.array(evidence.rows_of[_ALONG])
    shift, score = evidence.values[_ALONG] - evidence.expected[_ALONG], np.nan_to_num(np.abs(evidence.scores[_ALONG]))
    for log in np.unique(logs[logs >= 0]).tolist():
        parts = np.flatnonzero(logs == log)
        moving = [phase.raw.phase for phase in evidence.phases if phase.log == log and not phase.is_still]
        if len(parts) != 2 or not moving:
            continue
        (first, second), second_score = np.nan_to_num(shift[parts]), score[parts[1]]
        changes = (second_score > DOUBTFUL) & (np.abs(second) < _LARGEST) & (np.abs(first) < _SMALLER * np.abs(second))
        error = np.where(changes, second, 0.0)
        if not (changes & (second_score > ODD)).any():
            continue
        begin_s, end_s = min(phase.start_ns for phase in moving) * 1e-9, max(phase.end_ns for phase in moving) * 1e-9
        when = When((Span(log, (begin_s + end_s) / 2, math.inf),))
        largest = float(error[second_score.argmax()])
        for x, y, z in dict.fromkeys([(largest,) * 3, tuple(error.tolist())]):
            if any((x, y, z)):
                scale = Hypothesis((Scale((x, y, z)),), ("error",)).at(when)
                yield replace(scale, begin_bounds_s=(begin_s, end_s))


def _of_step(evidence: Evidence, step: LevelStep) -> Iterator[Hypothesis]:
    phases = [phase for phase in evidence.phases if phase.log == step.when.spans[-1].log]
    if all(phase.is_still for phase in phases) and len({phase.raw.phase.up for phase in phases}) < 2:
        return
    felt = _felt(evidence, step)
    size = np.abs(felt).max(initial=0.0)
    along = np.abs(felt) > _FELT * size
    if not size or np.abs(step.size).argmax() not in np.flatnonzero(along):
        return
    error = np.divide(step.size, felt, out=np.zeros(3), where=along)
    largest = float(error[np.abs(error).argmax()])
    if abs(largest) < _LARGEST:
        for x, y, z in dict.fromkeys([tuple(error.tolist()), (largest,) * 3]):
            scale = Hypothesis((Scale((x, y, z)),), ("error",)).at(step.when)
            yield replace(scale, begin_bounds_s=step.begin_bounds_s)


def _felt(evidence: Evidence, step: LevelStep) -> Floats:
    """Return (3,) what the axes should read, without bias, in the phases at rest that reach into the step's last
    stretch.
    """
    span = step.when.spans[-1]
    felt = [
        evidence.fitted.by_response(evidence.fitted.unbiased(phase.raw) - mean(phase.residual))
        for phase in evidence.still
        if phase.log == span.log and span.moment_s < phase.raw.phase.end_ns * 1e-9 and phase.raw.rows
    ]
    return np.mean(felt, axis=0) if felt else np.zeros(3)


SCALE = Candidate(
    Scale.name,
    guesses,
    {"tumble": "all six faces, 1 minute each", "motion": "turns and strokes along every axis, 1 minute"},
)
