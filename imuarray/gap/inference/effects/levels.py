"""A sensor's segments at rest, one after the other: where its readings lie, less the levels of the base model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Indices, Integers
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.statistics.probes.force import felt_g
from imuarray.gap.statistics.probes.probe import once

_LEAST_ROWS = 4


@dataclass(frozen=True)
class Levels:
    """n segments that hold rows. `log` and `group` (n,): those of one group are of one log and face; `time_s`, `degc`
    (n,); `mean` (n, 3) in the sensor's unit less what the base model predicts, and its `square_error` (n, 3) if
    readings are independent; `felt_g` (n, 3) specific force along the nominal axes, nan where no face is named;
    `thermometer` (n,) counts of the chip's own, nan if it has none; `width_s` (n,).
    """

    log: Integers
    group: Integers
    time_s: Floats
    degc: Floats
    mean: Floats
    square_error: Floats
    felt_g: Floats
    thermometer: Floats
    width_s: Floats

    @property
    def apart(self) -> Floats:
        """(n, 3) mean less that of the group."""
        return centre(self.mean, self.group)

    @property
    def seconds(self) -> float:
        """All segments' time."""
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
    groups = [(int(table.log[at[0]]), tuple(np.nan_to_num(table.felt_g[at[0]], nan=9.0).round(3))) for at in members]
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
        np.broadcast_to(felt_g([evidence.residual])[0], (count, 3)),
        part.thermometer[is_usable],
        np.full(count, part.width_s),
    )


def change_between_logs(evidence: Evidence) -> Floats:
    """Return (3,) by how much two or three logs of one kind differ in level, where evidence of both parts tells; else
    0.
    """
    counts = Counter(kind for _, kind in {(phase.log, phase.kind) for phase in evidence.still})
    if not any(1 < count < _SERIES for count in counts.values()):
        return np.zeros(3)
    probe = "level" if np.isfinite(evidence.values.get("level", np.full((1, 3), np.nan))).any() else "mean"
    return np.where(np.abs(evidence.score(probe)) > _CHANGED, evidence.shift(probe), 0.0)


_SERIES = 4
_CHANGED = 3.0
