"""Response of a sensor's axes to what they should feel: to the faces that were up, and to the motion of the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.recording.turns import Turn
from imuarray.gap.statistics.probes.level import mean
from imuarray.gap.statistics.probes.motion import joint_gains
from imuarray.gap.statistics.probes.turns import turn_of

MOTION_WEIGHT = 0.1
"""Of a motion beside a face: shares of a noisy reference fill in what no face tells."""

_LEAST_SHARE = 0.1
"""A motion of which even the model shows less along every axis says nothing."""

ODD, DOUBTFUL = 2.5, 1.5
"""Scores beyond which there is something to explain, and beyond which an axis may have a part in it."""

_AXES = np.arange(3)


@dataclass(frozen=True)
class Response:
    """`felt` and `reading` (p, 3): what the sensor should have shown along its axes and what it did show, less their
    means; unit vectors where the attitude or the motion was all that changed.
    """

    felt: Floats
    reading: Floats

    @property
    def error(self) -> Floats:
        """(3, 3) E of reading = (1 + E) felt, row i of axis i; 0 for directions that were never felt."""
        return np.asarray(np.linalg.lstsq(self.felt, self.reading - self.felt, rcond=0.05)[0].T)

    def misfit(self, matrix: Floats) -> float:
        """Return the sum of squares that `matrix` (3, 3) as the response leaves."""
        return float(((self.reading - self.felt @ matrix.T) ** 2).sum())


def response(evidence: Evidence) -> Response | None:
    """Return the response by the phases at rest on several faces and by motion; None without either."""
    parts = [part for part in (_of_faces(evidence), _of_motion(evidence)) if part is not None]
    if not parts:
        return None
    return Response(np.concatenate([part.felt for part in parts]), np.concatenate([part.reading for part in parts]))


def size_of_score(evidence: Evidence, *probes: str) -> Floats:
    """Absolute scores (3,) by these probes, or by the means on faces where the probes have no values."""
    scored = [probe for probe in probes if np.isfinite(evidence.scores.get(probe, np.nan)).any()]
    return np.abs(evidence.score(*(scored or ["mean"])))


def _of_faces(evidence: Evidence) -> Response | None:
    """Return the same weight for each attitude, however often it was taken up. A gyroscope feels nothing at rest."""
    if evidence.header.quantity == "angular_rate" or not any(evidence.fitted.rms):
        return None
    faces: dict[tuple[float, ...], list[Floats]] = {}
    for phase in evidence.still:
        if phase.raw.rows:
            reading = evidence.fitted.unbiased(phase.raw)
            felt = evidence.fitted.by_response(reading - mean(phase.residual))
            faces.setdefault(tuple(np.round(felt, 1).tolist()), []).append(np.array([felt, reading]))
    if len(faces) < 2:
        return None
    felt, reading = np.array([np.mean(pairs, axis=0) for pairs in faces.values()]).transpose(1, 0, 2)
    size = np.linalg.norm(felt, axis=1).mean()
    return Response((felt - felt.mean(axis=0)) / size, (reading - reading.mean(axis=0)) / size) if size > 0 else None


def _of_motion(evidence: Evidence) -> Response | None:
    """Shares of the reference's motion beside what the model makes of them, in the mean over phases; along an axis
    about which the box hardly turned, or along which it hardly moved, both are small. If no phase tells them, as in
    turns about single axes, those of all motions together.
    """
    reading, felt = np.zeros((2, 3, 3))
    for step, probe in enumerate(("motion_gain", "motion_next", "motion_after")):
        reading[_AXES, (_AXES + step) % 3], felt[_AXES, (_AXES + step) % 3] = _mean(evidence, probe)
    if not np.isfinite([reading, felt]).all():
        reading, felt = response_to_all_motions(evidence), np.eye(3)
    if not (np.isfinite(reading).all() and (np.abs(felt) > _LEAST_SHARE).any()):
        return None
    return Response(MOTION_WEIGHT * felt.T, MOTION_WEIGHT * reading.T)


def turns_of(evidence: Evidence) -> list[Turn]:
    """Return the turns of a gyroscope between attitudes that are known, without its bias."""
    turns = [turn_of(phase.residual, phase.ups_box) for phase in evidence.phases if phase.ups_box is not None]
    return [turn for turn in turns if turn is not None]


def response_to_all_motions(evidence: Evidence) -> Floats:
    """Return (3, 3) response of the axes to the motions of all phases together, nan if these do not tell it."""
    crosses = [phase.cross for phase in evidence.phases if not phase.is_still and phase.cross is not None]
    return joint_gains(crosses, evidence.header.name)


def _mean(evidence: Evidence, probe: str) -> tuple[Floats, Floats]:
    """Return (3,) value and expectation, each phase by how well the axis is known in it: a turn about one axis knows
    little of the others. nan for an axis that no phase knows.
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
