"""Effects on the response of axes: to the faces that were up, and to the motion that the other sensors measure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imuarray.arrays import Floats, triple
from imuarray.gap.inference.effects.bias import LevelStep, level_steps
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.levels import centre
from imuarray.gap.inference.evidence import Evidence, Span, When
from imuarray.gap.recording.turns import Turn, exchanges, misses
from imuarray.gap.statistics.probes.force import applied_g
from imuarray.gap.statistics.probes.level import mean
from imuarray.gap.statistics.probes.motion import joint_gains
from imuarray.gap.statistics.probes.turns import turn_of
from imuarray.simulate.effects.response import AxisError, Misalignment, Scale

MOTION_WEIGHT = 0.1
"""Weight of a motion relative to a face: its reference is noisy and determines only what no face determines."""

_LEAST_SHARE = 0.1
"""Least share of the reference's motion that the model must predict along some axis, for a motion to be used."""

ODD, DOUBTFUL = 2.5, 1.5
"""Scores above which there is something to explain, and above which an axis may be part of it."""

_AXES = np.arange(3)


@dataclass(frozen=True)
class Response:
    """`applied` and `reading` (p, 3): expected and actual readings along the axes, less their means; unit vectors
    if only the attitude or the motion changed.
    """

    applied: Floats
    reading: Floats

    @property
    def error(self) -> Floats:
        """(3, 3) E of reading = (1 + E) applied, row i for axis i; 0 along directions without any force or motion."""
        return np.asarray(np.linalg.lstsq(self.applied, self.reading - self.applied, rcond=0.05)[0].T)

    def misfit(self, matrix: Floats) -> float:
        """Return the sum of squares that the response `matrix` (3, 3) leaves."""
        return float(((self.reading - self.applied @ matrix.T) ** 2).sum())


def response(evidence: Evidence) -> Response | None:
    """Return the response by the phases at rest on several faces and by motion; None without either."""
    parts = [part for part in (_of_faces(evidence), _of_motion(evidence)) if part is not None]
    if not parts:
        return None
    return Response(np.concatenate([part.applied for part in parts]), np.concatenate([part.reading for part in parts]))


def size_of_score(evidence: Evidence, *probes: str) -> Floats:
    """Return the absolute scores (3,) of these probes, or of the means on faces if the probes have no values."""
    scored = [probe for probe in probes if np.isfinite(evidence.scores.get(probe, np.nan)).any()]
    return np.abs(evidence.score(*(scored or ["mean"])))


def _of_faces(evidence: Evidence) -> Response | None:
    """Return the response on faces, with the same weight for each attitude, however often it was recorded. None for a
    gyroscope, which measures nothing at rest.
    """
    if evidence.header.quantity == "angular_rate" or not any(evidence.fitted.rms):
        return None
    faces: dict[tuple[float, ...], list[Floats]] = {}
    for phase in evidence.still:
        if phase.raw.rows:
            reading = evidence.fitted.unbiased(phase.raw)
            applied = evidence.fitted.by_response(reading - mean(phase.residual))
            faces.setdefault(tuple(np.round(applied, 1).tolist()), []).append(np.array([applied, reading]))
    if len(faces) < 2:
        return None
    applied, reading = np.array([np.mean(pairs, axis=0) for pairs in faces.values()]).transpose(1, 0, 2)
    size = np.linalg.norm(applied, axis=1).mean()
    return (
        Response((applied - applied.mean(axis=0)) / size, (reading - reading.mean(axis=0)) / size) if size > 0 else None
    )


def _of_motion(evidence: Evidence) -> Response | None:
    """Return the shares of the reference's motion and the model's prediction of them, as means over phases. Both are
    small along an axis about which the box hardly turned, or along which it hardly moved. If no phase determines them,
    as in turns about single axes, the response to all motions together is used.
    """
    reading, applied = np.zeros((2, 3, 3))
    for step, probe in enumerate(("motion_gain", "motion_next", "motion_after")):
        reading[_AXES, (_AXES + step) % 3], applied[_AXES, (_AXES + step) % 3] = _mean(evidence, probe)
    if not np.isfinite([reading, applied]).all():
        reading, applied = response_to_all_motions(evidence), np.eye(3)
    if not (np.isfinite(reading).all() and (np.abs(applied) > _LEAST_SHARE).any()):
        return None
    return Response(MOTION_WEIGHT * applied.T, MOTION_WEIGHT * reading.T)


def turns_of(evidence: Evidence) -> list[Turn]:
    """Return the turns of a gyroscope between known attitudes, without its bias."""
    turns = [turn_of(phase.residual, phase.ups_box) for phase in evidence.phases if phase.ups_box is not None]
    return [turn for turn in turns if turn is not None]


def response_to_all_motions(evidence: Evidence) -> Floats:
    """Return (3, 3) response of the axes to the motions of all phases together; nan if these do not determine it."""
    crosses = [phase.cross for phase in evidence.phases if not phase.is_still and phase.cross is not None]
    return joint_gains(crosses, evidence.header.name)


def _mean(evidence: Evidence, probe: str) -> tuple[Floats, Floats]:
    """Return (3,) the mean value and expectation of a probe. Each phase is weighted by how well it determines the axis:
    a turn about one axis hardly determines the others. nan for an axis that no phase determines.
    """
    if probe not in evidence.scores:
        return np.full(3, np.nan), np.full(3, np.nan)
    values, expected, score = (table[probe] for table in (evidence.values, evidence.expected, evidence.scores))
    deviation = values - expected
    known = np.isfinite(deviation) & np.isfinite(score) & (score != 0) & (deviation != 0)
    weight = np.divide(score, deviation, out=np.zeros(score.shape), where=known) ** 2
    with np.errstate(invalid="ignore"):
        value, expectation = (
            (weight * np.where(known, rows, 0.0)).sum(axis=0) / weight.sum(axis=0) for rows in (values, expected)
        )
    return value, expectation


_AXIS_PROBES = (
    *("mean", "force_own", "force_next", "force_after"),
    *("motion_gain", "motion_along", "motion_next", "motion_after", "motion_across", "turn_factor"),
)
_BETTER_AXES = 0.4
"""Largest misfit of an exchange of axes, as a share of the misfit of the nominal axes: a true exchange is exact."""

_CHANGED_AXIS = 0.01
"""Cost of each axis that differs from nominal, as a share of the misfit of the nominal axes: an axis about which the
box does not turn stays nominal.
"""

_MOST_AXES = 3

_REVERSED = 0.5
"""Share of a rotation that an axis reads with the wrong sign, from which on it is reversed."""


def guess_axis_error(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the signed permutations that fit best, including left-handed ones. If the box turns about a single axis,
    which does not distinguish the axes, suggest a reversal of those that read its rotation with the wrong sign.
    """
    if not evidence.is_odd(*_AXIS_PROBES):
        return
    matrices = np.array([np.eye(3), *exchanges().values()])
    if (measured := response(evidence)) is not None:
        nominal, *others = (measured.misfit(matrix) for matrix in matrices)
    elif turns := turns_of(evidence):  # the matrix maps rates to readings, its transpose maps readings to rates
        nominal, *others = misses(turns, matrices.swapaxes(1, 2)).tolist()
    else:
        along, expected = _mean(evidence, "motion_along")
        is_reversed = (along < -_REVERSED) & (expected > _REVERSED)
        if is_reversed.any():
            signs = np.where(is_reversed, "-", "+")
            yield Hypothesis((AxisError("".join(sign + axis for sign, axis in zip(signs, "XYZ", strict=True))),))
        return
    misfits = {
        axes: misfit + _CHANGED_AXIS * nominal * np.count_nonzero(np.diag(matrix) != 1)
        for misfit, (axes, matrix) in zip(others, exchanges().items(), strict=True)
    }
    for axes in sorted(misfits, key=misfits.__getitem__)[:_MOST_AXES]:
        if misfits[axes] < _BETTER_AXES * nominal:
            yield Hypothesis((AxisError(axes),))


_LARGEST_DEG = 45.0
"""Largest angle of a misalignment in degrees: an axis that leans further is nearer to another axis."""


def guess_misalignment(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the angles of the off-diagonal errors of the response, on axes that deviate beyond the population."""
    score, measured_response = np.zeros((3, 3)), response(evidence)
    for step, way in enumerate(("next", "after"), start=1):
        score[_AXES, (_AXES + step) % 3] = size_of_score(evidence, f"force_{way}", f"motion_{way}", "motion_across")
    if measured_response is None or not (score > ODD).any():
        return
    gain = 1 + np.diag(measured_response.error)
    tangents = np.divide(measured_response.error, gain[:, None], out=np.zeros((3, 3)), where=gain[:, None] > 0)
    angles = np.degrees(np.arctan(np.where(score > DOUBTFUL, tangents, 0.0)))
    angles[np.abs(angles) > _LARGEST_DEG] = 0.0
    if angles.any():
        yield Hypothesis((Misalignment(tuple(angles[~np.eye(3, dtype=bool)].tolist())),), ("angles_deg",))


_LARGEST_ERROR = 0.9
"""Largest error of scale that is suggested."""

_ALONG, _TURNS = "motion_along", "turn_factor"

_RETURN, _FEWEST_VISITS = "force_return", 4
"""The statistic of faces that are up again, and the fewest phases that determine it: two faces, twice each."""

_AS_GOOD = 1.001
"""Ratio of the squares that two moments leave, up to which both fit equally well."""

_LEAST_FACTOR = 0.3
"""Least factor of the readings of turns that is attributed to an error of scale."""

_SMALLER = 0.8
"""Largest error in the first part of a motion, as a share of that in the second, if it begins within the motion."""

_LEAST_APPLIED = 0.3
"""Least force along an axis whose level determines a scale, as a share of the largest force."""


def guess_scale(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the diagonal of the response's error, on axes that deviate beyond the population, and errors of rotation,
    of turns and within a motion. For an accelerometer, also suggest the error that makes a step of the level within a
    log, on the axes that show it or on all, and the error by which faces differ when they are up again. If the box
    always has the same attitude, such a step is that of a bias: a scale must show in motion or on several faces.
    """
    if evidence.header.quantity == "specific_force":
        for step in level_steps(evidence):
            yield from _scale_of_step(evidence, step)
        yield from _scale_of_return(evidence)
    yield from _scale_of_rotation(evidence)
    yield from _scale_of_turns(evidence)
    yield from _scale_within_motion(evidence)
    score, measured_response = size_of_score(evidence, "force_own", "motion_gain"), response(evidence)
    if measured_response is None or not (score > ODD).any():
        return
    axis_error, doubtful = np.diag(measured_response.error), score > DOUBTFUL
    error = np.where(doubtful & (np.abs(axis_error) < _LARGEST_ERROR), axis_error, 0.0)
    yield from _scales(error)


def _scales(*errors: Floats) -> Iterator[Hypothesis]:
    """Suggest each of these errors (3,) that is not 0, once."""
    for error in dict.fromkeys(map(triple, errors)):
        if any(error):
            yield Hypothesis((Scale(error),), ("error",))


def _scale_of_rotation(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the missing share of motion along each axis that deviates, and the same share on all axes, because a
    rotation about a single axis does not distinguish them.
    """
    score = size_of_score(evidence, _ALONG)
    if evidence.is_odd("motion_gain", beyond=ODD) or not (score > ODD).any():
        return
    shift = evidence.shift(_ALONG)
    error = np.where((score > DOUBTFUL) & (np.abs(shift) < _LARGEST_ERROR), shift, 0.0)
    largest = float(error[score.argmax()])
    yield from _scales(np.full(3, largest), error)


def _scale_of_turns(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the scale by the turns from one rest to the next, for the only gyroscope."""
    score = np.abs(evidence.score(_TURNS))
    if evidence.others or not (score > ODD).any():
        return
    error = np.zeros(3)
    for axis in np.flatnonzero(score > DOUBTFUL):
        factor, expected = (table[_TURNS][:, axis] for table in (evidence.values, evidence.expected))
        known = np.isfinite(factor) & (np.abs(factor) > _LEAST_FACTOR)
        error[axis] = (expected[known] / factor[known]).mean() - 1 if known.any() else 0.0
    error = np.where(np.abs(error) < _LARGEST_ERROR, error, 0.0)
    largest = float(error[score.argmax()])
    yield from _scales(error, np.full(3, largest))


def _scale_within_motion(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the error of the second part of a motion, from some moment on, if the first part shows a smaller
    error.
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
        changes = (
            (second_score > DOUBTFUL) & (np.abs(second) < _LARGEST_ERROR) & (np.abs(first) < _SMALLER * np.abs(second))
        )
        error = np.where(changes, second, 0.0)
        if not (changes & (second_score > ODD)).any():
            continue
        begin_s, end_s = min(phase.start_ns for phase in moving) * 1e-9, max(phase.end_ns for phase in moving) * 1e-9
        when = When((Span(log, (begin_s + end_s) / 2, math.inf),))
        largest = float(error[second_score.argmax()])
        for scale in _scales(np.full(3, largest), error):
            yield replace(scale.at(when), begin_bounds_s=(begin_s, end_s))


def _scale_of_step(evidence: Evidence, step: LevelStep) -> Iterator[Hypothesis]:
    phases = [phase for phase in evidence.phases if phase.log == step.when.spans[-1].log]
    if all(phase.is_still for phase in phases) and len({phase.raw.phase.up for phase in phases}) < 2:
        return
    applied = _applied(evidence, step)
    size = np.abs(applied).max(initial=0.0)
    along = np.abs(applied) > _LEAST_APPLIED * size
    if not size or np.abs(step.size).argmax() not in np.flatnonzero(along):
        return
    error = np.divide(step.size, applied, out=np.zeros(3), where=along)
    largest = float(error[np.abs(error).argmax()])
    if abs(largest) < _LARGEST_ERROR:
        for scale in _scales(error, np.full(3, largest)):
            yield replace(scale.at(step.when), begin_bounds_s=step.begin_bounds_s)


def _scale_of_return(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a change of the response between two phases at rest, if faces differ from the previous time that they
    were up: the moment and the change that leave the least of the phases' means, less the mean of their face. Between
    two faces on which no force acts along the axis all moments fit equally well; the middle is used.
    """
    if not evidence.is_odd(_RETURN, beyond=ODD):
        return
    doubtful = np.abs(evidence.score(_RETURN)) > DOUBTFUL
    for log in sorted({phase.log for phase in evidence.still}):
        phases = sorted((p for p in evidence.still if p.log == log and p.raw.rows), key=lambda p: p.raw.phase.start_ns)
        phases = [phase for phase in phases if np.isfinite(applied_g([phase.residual])).all()]
        if len(phases) < _FEWEST_VISITS:
            continue
        applied = applied_g([phase.residual for phase in phases])
        face = np.unique(applied.round(), axis=0, return_inverse=True)[1]
        means = centre(np.array([mean(phase.residual) for phase in phases]), face)
        fits = []
        for first in range(1, len(phases)):
            change = centre(np.where(np.arange(len(phases))[:, None] >= first, applied, 0.0), face)
            square = (change**2).sum(axis=0)
            error = np.divide((change * means).sum(axis=0), square, out=np.zeros(3), where=(square > 0) & doubtful)
            fits.append((float(((means - change * error) ** 2)[:, doubtful].sum()), first, error))
        least = min(square for square, _, _ in fits)
        best_fits = [(first, error) for square, first, error in fits if square <= _AS_GOOD * least]
        before, after = phases[best_fits[0][0] - 1].raw.phase, phases[best_fits[-1][0]].raw.phase
        since = When((Span(log, (before.end_ns + after.start_ns) * 0.5e-9, math.inf),))
        if np.abs(best_fits[0][1]).max() < _LARGEST_ERROR:
            yield from (scale.at(since) for scale in _scales(best_fits[0][1]))


def _applied(evidence: Evidence, step: LevelStep) -> Floats:
    """Return (3,) the expected readings of the axes, without bias, in the phases at rest that reach into the step's
    last stretch.
    """
    span = step.when.spans[-1]
    applied = [
        evidence.fitted.by_response(evidence.fitted.unbiased(phase.raw) - mean(phase.residual))
        for phase in evidence.still
        if phase.log == span.log and span.moment_s < phase.raw.phase.end_ns * 1e-9 and phase.raw.rows
    ]
    return np.mean(applied, axis=0) if applied else np.zeros(3)
