"""Levels of the segments at rest: mean readings less the levels of the base model, and steps of level and noise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Indices, Integers
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.model.rest import REFERENCE_DEGC
from imuarray.gap.statistics.probes.force import applied_g
from imuarray.gap.statistics.probes.probe import once

_LEAST_ROWS = 4


@dataclass(frozen=True)
class Levels:
    """Levels of n segments that hold rows. `log` and `group` (n,): segments of one group belong to one log and face;
    `time_s`, `degc` (n,); `mean` (n, 3) in the sensor's unit less the base model's prediction, and its `square_error`
    (n, 3) for independent readings; `applied_g` (n, 3) specific force along the nominal axes, nan if no face is named;
    `thermometer` (n,) counts of the chip's own thermometer, nan if it has none; `width_s` (n,).
    """

    log: Integers
    group: Integers
    time_s: Floats
    degc: Floats
    mean: Floats
    square_error: Floats
    applied_g: Floats
    thermometer: Floats
    width_s: Floats

    @property
    def apart(self) -> Floats:
        """(n, 3) means less the mean of their group."""
        return centre(self.mean, self.group)

    @property
    def seconds(self) -> float:
        """Duration of all segments."""
        return float(self.width_s.sum())

    def groups(self) -> Iterator[Indices]:
        """Yield the segments of each group."""
        for group in np.unique(self.group):
            yield np.flatnonzero(self.group == group)


@once
def levels(evidence: Evidence) -> Levels:
    """Return levels of the segments of all phases at rest."""
    groups: dict[tuple[int, str], int] = {}
    parts = [
        _of_phase(phase, groups.setdefault((phase.log, phase.residual.phase.up), len(groups)))
        for phase in evidence.still
    ]
    if not parts:
        none, nothing = np.zeros((0, 3)), np.zeros(0)
        return Levels(np.zeros(0, int), np.zeros(0, int), nothing, nothing, none, none, none, nothing, nothing)
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Levels(*columns)


def centre(values: Floats, group: Integers) -> Floats:
    """Return (n, k) values less the mean of their group."""
    table = np.array(values, float)
    for number in np.unique(group):
        table[group == number] -= table[group == number].mean(axis=0)
    return table


class LogLevels(NamedTuple):
    """Levels `mean` (l, 3) of l logs, with the numbers `log` (l,), relative to each other on the faces that they share,
    and their squared errors (l, 3) for independent readings.
    """

    log: Integers
    mean: Floats
    square_error: Floats


def log_levels(table: Levels) -> LogLevels:
    """Return the levels in the order of the logs' numbers; empty without two logs that share a face."""
    members = list(table.groups())
    groups = [(int(table.log[at[0]]), tuple(np.nan_to_num(table.applied_g[at[0]], nan=9.0).round(3))) for at in members]
    means = np.array([table.mean[at].mean(axis=0) for at in members]).reshape(-1, 3)
    errors = np.array([table.square_error[at].mean(axis=0) / len(at) for at in members]).reshape(-1, 3)
    shared = {face for _, face in groups if sum(other == face for _, other in groups) > 1}
    apart: dict[int, list[tuple[Floats, Floats]]] = {}
    for face in shared:
        places = [place for place, (_, other) in enumerate(groups) if other == face]
        for place in places:
            level = means[place] - np.median(means[places], axis=0)
            apart.setdefault(groups[place][0], []).append((level, errors[place]))
    logs = sorted(apart) if len(apart) > 1 else []
    known = [apart[log] for log in logs]
    return LogLevels(
        np.array(logs, int),
        np.array([np.mean([level for level, _ in pairs], axis=0) for pairs in known]).reshape(-1, 3),
        np.array([np.mean([error for _, error in pairs], axis=0) / len(pairs) for pairs in known]).reshape(-1, 3),
    )


def _of_phase(evidence: PhaseEvidence, group: int) -> tuple[npt.NDArray[np.generic], ...]:
    part, header = evidence.residual.segments, evidence.residual.header
    is_usable = (part.rows >= _LEAST_ROWS) & np.isfinite(part.mean).all(axis=1)
    count = int(is_usable.sum())
    return (
        np.full(count, evidence.log),
        np.full(count, group),
        part.time_s[is_usable],
        part.temperature_degc[is_usable],
        part.mean[is_usable] / header.sensitivity,
        part.steady_variance[is_usable] / (part.rows[is_usable, None] - 1) / header.sensitivity**2,
        np.broadcast_to(applied_g([evidence.residual])[0], (count, 3)),
        part.thermometer[is_usable],
        np.full(count, part.width_s),
    )


def change_between_logs(evidence: Evidence) -> Floats:
    """Return (3,) the change of the level if two or three logs record the same kind of experiment, on the axes on which
    it is significant; else 0.
    """
    counts = Counter(kind for _, kind in {(phase.log, phase.kind) for phase in evidence.still})
    if not any(1 < count < _SERIES for count in counts.values()):
        return np.zeros(3)
    probe = "level" if np.isfinite(evidence.values.get("level", np.full((1, 3), np.nan))).any() else "mean"
    return np.where(np.abs(evidence.score(probe)) > _CHANGED, evidence.shift(probe), 0.0)


_SERIES = 4
_CHANGED = 3.0


_LEAST = 3
"""Segments on each side of a step."""

_ROUNDING_LSB2 = 0.01
"""Least variance in squared counts, because constant readings have rounding noise too."""

_CLEAR = 15.0
"""Nats by which two states must fit better than one."""

_SURE = 3.0
"""Standard deviations of a segment's mean from which on the mean shows that a part of the segment has another state."""


class States(NamedTuple):
    """(3,) readings before and after a change, in the sensor's unit by the configured sensitivity, for the same face
    and temperature, and the noises before and after.
    """

    before: Floats
    after: Floats
    noise_before: Floats
    noise_after: Floats


class Onset(NamedTuple):
    """From `onset_s` in log number `log` on, another state holds. It explains the log by `nats` better than one
    state. `begin_bounds_s`: the gap between segments at rest in which the state changes, if it does.
    """

    log: int
    onset_s: float
    states: States
    nats: float
    begin_bounds_s: tuple[float, float] | None = None


class _Series(NamedTuple):
    """Segments in order: (s,) times, (s, 3) levels less the model's prediction, the prediction, its part that follows
    the temperature, and variances.
    """

    time_s: Floats
    residual: Floats
    predicted: Floats
    warm: Floats
    variance: Floats


def onsets(evidence: Evidence, ratio: float = 1.0) -> list[Onset]:
    """Return the clearest step of level and noise of each log that has a clear one; the clearest first.

    After the step a reading is multiplied by `ratio`, so the step differs from face to face.
    """
    steps: list[Onset] = []
    for log in dict.fromkeys(phase.log for phase in evidence.still):
        series = _series(evidence, [phase for phase in evidence.still if phase.log == log])
        if len(series.time_s) < 2 * _LEAST + 2:
            continue
        gains = _gains(series, ratio)
        at = int(gains.argmax())
        if gains[at] > _CLEAR:
            onset_s, bounds_s = _time(series, at, ratio, 1 / evidence.rows_per_s)
            steps.append(Onset(log, onset_s, _states(series, at, ratio), float(gains[at]), bounds_s))
    return sorted(steps, key=lambda step: -step.nats)


def states_of_logs(evidence: Evidence, rare: Booleans) -> States | None:
    """Return the states of the other logs (before) and of the `rare` ones of the logs (l,) (after), by the first phase
    at rest of each log, at the temperature of the rare ones: a chip's own thermometer may have any zero.
    """
    logs = sorted({phase.log for phase in evidence.still})
    if len(logs) != len(rare):
        return None
    series = [_series(evidence, [phase for phase in evidence.still if phase.log == log][:1]) for log in logs]
    sides = [[item for item, is_rare in zip(series, rare, strict=True) if is_rare == side] for side in (False, True)]
    usual, other = (_Series(*(np.concatenate(column) for column in zip(*side, strict=True))) for side in sides)
    if not len(usual.time_s) or not len(other.time_s):
        return None
    warmer = other.warm.mean(axis=0) - usual.warm.mean(axis=0)
    return States(
        usual.predicted.mean(axis=0) + usual.residual.mean(axis=0) + warmer,
        other.predicted.mean(axis=0) + other.residual.mean(axis=0),
        np.sqrt(np.median(usual.variance, axis=0)),
        np.sqrt(np.median(other.variance, axis=0)),
    )


def _series(evidence: Evidence, phases: list[PhaseEvidence]) -> _Series:
    scale, parts = evidence.header.sensitivity, []
    for phase in phases:
        raw, residual = phase.raw.segments, phase.residual.segments
        is_usable = (raw.rows > 3) & np.isfinite(raw.temperature_degc)
        warm = (raw.temperature_degc[is_usable, None] - REFERENCE_DEGC) * np.array(evidence.fitted.slope)
        predicted = (raw.mean[is_usable] - residual.mean[is_usable]) / scale
        variance = raw.steady_variance[is_usable] * (raw.rows[is_usable] / (raw.rows[is_usable] - 1.0))[:, None]
        variance = np.maximum(variance, _ROUNDING_LSB2) / scale**2
        parts.append((raw.time_s[is_usable], residual.mean[is_usable] / scale, predicted, warm, variance))
    return _Series(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _unscaled(series: _Series, ratio: float) -> Floats:
    """Return (s, 3) deviations of the levels from the model if readings are multiplied by `ratio`."""
    return (series.residual + series.predicted) / ratio - series.predicted


def _gains(series: _Series, ratio: float) -> Floats:
    """Return the nats by which two levels and variances, which change before a segment, explain the segments better
    than one level and variance; -inf for the first `_LEAST` segments, no entry for the last ones.
    """
    spread = np.log(series.variance)
    values = np.concatenate([series.residual, spread], axis=1)
    later = np.concatenate([ratio * _unscaled(series, ratio), spread], axis=1)
    whole = (len(values) * values.var(axis=0)).clip(1e-30)
    parts = _squares_before(values) + _squares_before(later[::-1])[::-1]
    gains = len(values) / 2 * np.log(whole / parts.clip(1e-6 * whole)).sum(axis=1)
    return np.concatenate([np.full(_LEAST, -np.inf), gains[_LEAST : len(values) - _LEAST]])


def _squares_before(values: Floats) -> Floats:
    """Return (n + 1, k) the sums of squared deviations from their mean of the rows before each row, and of all rows."""
    centred = values - values.mean(axis=0)
    sums, squares = (np.cumsum(powers, axis=0) for powers in (centred, centred * centred))
    rows = np.arange(1, len(values) + 1)[:, None]
    return np.concatenate([np.zeros((1, values.shape[1])), np.maximum(squares - sums * sums / rows, 0.0)])


def _states(series: _Series, at: int, ratio: float) -> States:
    """Return the states by the segments that lie wholly on either side, for the face that is up at the step."""
    before, after = slice(None, at - 1), slice(at + 1, None)
    face = series.predicted[at]
    return States(
        face + np.median(series.residual[before], axis=0),
        ratio * (face + np.median(_unscaled(series, ratio)[after], axis=0)),
        np.sqrt(np.median(series.variance[before], axis=0)),
        np.sqrt(np.median(series.variance[after], axis=0)),
    )


def _time(series: _Series, at: int, ratio: float, row_s: float) -> tuple[float, tuple[float, float] | None]:
    """Return the time of the step, between two rows that are `row_s` apart; and the gap between segments in which it
    lies, if it does.

    The means of the segments before and after the step may contain a share of the other state. A share is that of the
    nearest number of rows; one within the scatter of a mean is none, because a single row with the wrong state would
    deviate by the whole step. A step in a gap is in its middle.
    """
    low = np.median(series.residual[: at - 1], axis=0)
    inner = slice(at - 1, at + 1)
    faces = series.predicted[inner]
    high = ratio * (faces + np.median(_unscaled(series, ratio)[at + 1 :], axis=0)) - faces
    axis = int(np.abs(high - low).sum(axis=0).argmax())
    width_s = float(np.median(np.diff(series.time_s)))
    step = high[:, axis] - low[axis]
    shares = np.divide(series.residual[inner, axis] - low[axis], step, out=np.zeros(2), where=step != 0)
    error = np.sqrt(series.variance[inner, axis] * row_s / width_s)
    scatter = np.divide(error, np.abs(step), out=np.ones(2), where=step != 0)
    parts = np.clip([shares[0], 1 - shares[1]], 0.0, 1.0)  # of the segment before in the new state, and vice versa
    inside_s = np.where(parts > _SURE * scatter, np.round(parts * width_s / row_s) * row_s, 0.0)
    end_s, begin_s = (series.time_s[inner] + [width_s / 2, -width_s / 2]).tolist()
    if begin_s - end_s < width_s:
        return float((end_s + begin_s) / 2 + inside_s[1] - inside_s[0]), None
    if inside_s.any():
        return float(begin_s + inside_s[1] if inside_s[1] > inside_s[0] else end_s - inside_s[0]), None
    return (end_s + begin_s) / 2, (end_s, begin_s)
