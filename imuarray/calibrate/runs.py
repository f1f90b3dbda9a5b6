"""Runs of a turn-on series: their mean readings, runs with a start-up fault, and a test of the others for two states.

A run is a phase or a whole short log. `read_runs` returns the readings of a sensor in each run: the mean, the
temperature, and means of segments, which show how the reading wandered within the run. Faults and states are detected
in the run means, all axes together.

For the test of two states the scatter of all runs is whitened, that is, made equal in all directions; this loses no
information, because the common covariance is unknown. The most likely split into two groups is then the one with the
least scatter within them. The share of the scatter that it explains does not depend on the scale or correlation of the
axes, so its distribution by chance depends on the number of runs only. That distribution is simulated, for normal
scatter and for heavy tails (Student's t with three degrees of freedom), and the share must be significant under both.

If temperatures are known, each group is a line in temperature, and both lines have the same slope, so that a warm-up is
not mistaken for a state: scatter is the residual from a line, and a split explains ``|sum of one group|^2 / |its
membership less a line|^2``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.axes import up_vector
from imuarray.calibrate.pose_readings import sensor_in
from imuarray.calibrate.segments import MeanVariance, SegmentMeans, mean_of_series, segment_means, thermometer_of
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog

MIN_STATE_RUNS = 3
"""Fewest runs in a state; fewer runs that differ from the others are faults."""

MIN_RUNS = 2 * MIN_STATE_RUNS

SIGNIFICANT = 0.01

_APART = 8.0
_DRAWS = 1998
_PARTS = 9
"""Number of parts in which the draws are processed, to limit memory."""

_DIRECTIONS = 24
_UNEXPLAINED = 0.1
"""Least share of the group membership that temperature does not explain; below it a state can't be distinguished from
temperature."""

_RANGE_TOLERANCE = 0.15
"""Relative tolerance of a reading in another range: each range has an offset of its own (BMA-79)."""

Ranges = Mapping[str, Mapping[float, float]]
"""Counts per unit at each measuring range, keyed by chip or sensor, as in `imuarray.chips.CHIPS`."""
NO_RANGES: Ranges = MappingProxyType({})


@dataclass(frozen=True)
class BootFault:
    """A run with a start-up fault: its number, the ratio of its reading to the usual one on the axis that carries
    gravity (nan if none does), and the `range` whose sensitivity explains it (None: unexplained).
    """

    run: int
    ratio: float
    range: float | None
    unit: str = ""

    def __str__(self) -> str:
        if self.range is None:
            return f"run {self.run}: apart from all others, unexplained"
        return f"run {self.run}: {self.ratio:.2f} times the usual reading: started at {self.range:g} {self.unit}"


def explained_range(
    mean_lsb: Floats, usual_lsb: Floats, sensitivity: float, ranges: Mapping[float, float]
) -> tuple[float, float | None]:
    """Return the ratio of a reading to the usual one on the axis that carries gravity, and the other range whose
    sensitivity explains it (None if there is none).

    (nan, None) unless an axis usually carries more than half a g.
    """
    axis = int(np.abs(usual_lsb).argmax())
    if not abs(usual_lsb[axis]) > sensitivity / 2 or not np.isfinite(mean_lsb[axis]):
        return np.nan, None
    ratio = float(mean_lsb[axis] / usual_lsb[axis])
    errors = {range_: abs(ratio * sensitivity / lsb - 1) for range_, lsb in ranges.items()}
    nearest = min(errors, key=lambda range_: errors[range_], default=None)
    if nearest is None or ranges[nearest] == sensitivity or errors[nearest] > _RANGE_TOLERANCE:
        return ratio, None
    return ratio, nearest


def isolated_runs(means: Floats, floor: Floats) -> Booleans:
    """Return which runs (r, 3) are isolated: the distance to the second-nearest other run exceeds 8 spreads.

    The spread of an axis is the first quartile of the differences of all pairs (Rousseeuw and Croux, J. Am. Stat.
    Assoc. 88, 1993, p. 1273), which two states do not widen; `floor` (3,) is its lower limit.
    """
    if len(means) < MIN_RUNS:
        return np.zeros(len(means), bool)
    differences = np.abs(means[:, None] - means[None])
    pairs = differences[np.triu_indices(len(means), 1)]
    scale = np.maximum(2.2219 * np.quantile(pairs, 0.25, axis=0), np.maximum(floor, 1e-9))
    distance = np.sort(np.linalg.norm(differences / scale, axis=2), axis=1)
    return np.asarray(distance[:, MIN_STATE_RUNS - 1] > _APART)


def two_states(means: Floats, temperatures: Floats | None, seed: int) -> tuple[Booleans, float]:
    """Return the most likely split of runs (r, 3), True for runs that are not in the first run's group, and the
    probability of a split at least as good by chance.

    The linear effect of `temperatures` (r,) is removed first, also from the simulated draws. No split and 1.0 for fewer
    than 6 runs.
    """
    rows = len(means)
    if rows < MIN_RUNS:
        return np.zeros(rows, bool), 1.0
    warm = _unit(temperatures, rows)
    remaining = _detrend(means, warm)
    remaining = _whiten(remaining / np.maximum(remaining.std(axis=0), 1e-12))
    if remaining.shape[1] == 0:
        return np.zeros(rows, bool), 1.0
    share, second = best_split(remaining[None], warm)
    beaten = max(
        int(np.count_nonzero(by_chance >= share[0]))
        for by_chance in _chance_shares(rows, remaining.shape[1], seed, tuple(warm))
    )
    return second[0] ^ second[0, 0], (beaten + 1) / (_DRAWS + 1)


def best_split(points: Floats, warm: Floats) -> tuple[Floats, Booleans]:
    """Return for each set of white points (b, r, d), residuals of lines in `warm` (r,) (centred, of unit length or
    zero), the split into two groups of at least three that explains most of the scatter: the share explained (b,) and
    the members (b, r) of one group.

    The best split is a cut of the points sorted along some direction of their d coordinates and `warm`. The directions
    of the first 24 points are tried; then, three times, the direction that best separates the groups.
    """
    lifted = np.concatenate([points, np.broadcast_to(warm[:, None], (*points.shape[:2], 1))], axis=2)
    best, members = _cut(lifted, lifted[:, :_DIRECTIONS])
    for _ in range(3):
        share, cut = _cut(lifted, _towards(lifted, members)[:, None])
        better = share > best
        best, members = np.where(better, share, best), np.where(better[:, None], cut, members)
    return best, members


def _towards(lifted: Floats, members: Booleans) -> Floats:
    """Return the direction (b, d + 1) that separates the groups: from one centre to the other, with the common slope
    removed.
    """
    sums = np.einsum("br,brd->bd", members, lifted)
    count, rows = members.sum(axis=1), members.shape[1]
    alone = count * (rows - count) / rows - sums[:, -1] ** 2
    slope = sums[:, -1] * (sums[:, :-1] ** 2).sum(axis=1) / np.maximum(alone, 1e-9)
    return np.concatenate([sums[:, :-1], slope[:, None]], axis=1)


def _cut(lifted: Floats, directions: Floats) -> tuple[Floats, Booleans]:
    """Return the share explained (b,) by the best cut along any of the directions (b, k, d + 1), and the members (b, r)
    of its first group.
    """
    draws, rows, _ = lifted.shape
    order = np.argsort(np.einsum("brd,bkd->bkr", lifted, directions), axis=2)
    sums = np.cumsum(lifted[np.arange(draws)[:, None, None], order], axis=2)
    sums = sums[:, :, MIN_STATE_RUNS - 1 : rows - MIN_STATE_RUNS]
    first = np.arange(MIN_STATE_RUNS, rows - MIN_STATE_RUNS + 1)
    whole = first * (rows - first) / rows
    alone = whole - sums[..., -1] ** 2
    is_found = alone > _UNEXPLAINED * whole
    explained = np.where(is_found, (sums[..., :-1] ** 2).sum(axis=3) / np.where(is_found, alone, 1.0), 0.0)
    flat = explained.reshape(draws, -1)
    best = flat.argmax(axis=1)
    direction, cut = np.divmod(best, len(first))
    rank = np.argsort(order[np.arange(draws), direction], axis=1)
    return np.take_along_axis(flat, best[:, None], 1)[:, 0], rank < (cut + MIN_STATE_RUNS)[:, None]


def _unit(temperatures: Floats | None, rows: int) -> Floats:
    """Return temperatures (r,) centred and of unit length; zeros if they are not known or all equal."""
    centred = np.zeros(rows) if temperatures is None else temperatures - temperatures.mean()
    return np.asarray(centred / (float(np.linalg.norm(centred)) or 1.0))


def _detrend(points: Floats, warm: Floats) -> Floats:
    """Return points (..., r, d) less their mean and their linear dependence on `warm` (r,)."""
    centred = points - points.mean(axis=-2, keepdims=True)
    return np.asarray(centred - warm[:, None] * np.einsum("r,...rd->...d", warm, centred)[..., None, :])


def _whiten(points: Floats) -> Floats:
    """Return centred points (r, d) scaled to unit scatter in every direction in which they scatter."""
    left_vectors, values, _ = np.linalg.svd(points, full_matrices=False)
    return np.asarray(left_vectors[:, values > 1e-9 * max(float(values.max()), 1e-300)])


@lru_cache(maxsize=64)
def _chance_shares(rows: int, axes: int, seed: int, warm: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Return the shares explained (draws,) if there is one state: with normal scatter and with heavy tails."""
    generator = np.random.default_rng(seed)
    normal, heavy = generator.normal(size=(2, _DRAWS, rows, axes))
    heavy /= np.sqrt(generator.chisquare(3, (_DRAWS, rows, 1)) / 3)
    line = np.array(warm)
    first, second = (
        np.concatenate(
            [best_split(np.linalg.qr(_detrend(part, line))[0], line)[0] for part in np.split(sample, _PARTS)]
        )
        for sample in (normal, heavy)
    )
    return first, second


_SEGMENTS = 60
"""Number of segments of a run."""

_RUN = re.compile(r"run (\d{1,6})")


@dataclass(frozen=True)
class SensorRuns:
    """Runs of one sensor: their numbers, mean counts (r, 3), temperatures (r,) in degC (None: not known) and the means
    of their segments (empty if only the run means are known).

    `gravity_lsb` (3,) is gravity in the pose of the runs in counts by the data sheet's scale; zeros for a gyroscope.
    """

    sensor: str
    quantity: str
    unit: str
    range: float
    sensitivity: float
    numbers: tuple[int, ...]
    mean_lsb: Floats
    temperature_degc: Floats | None = None
    segments: tuple[SegmentMeans, ...] = ()
    gravity_lsb: Floats = field(default_factory=lambda: np.zeros(3))

    def in_run(self, used: Sequence[int]) -> tuple[MeanVariance, ...]:
        """Return for each axis the variance of a run's mean, estimated within the runs with indices `used`; empty if
        only the run means are known.

        A wander that is slower than the length of a run is not visible within it and counts as a change from run to
        run.
        """
        parts = [self.segments[place] for place in used] if self.segments else []
        parts = [part for part in parts if len(part.time_s) > 2]
        if not parts:
            return ()
        starts = np.cumsum([0, *(len(part.time_s) for part in parts[:-1])])
        gaps_s = np.diff(np.concatenate([part.time_s for part in parts]))
        gaps_s[starts[1:] - 1] = np.inf
        values = np.concatenate([part.mean for part in parts])
        return tuple(mean_of_series(column, gaps_s, starts) for column in values.T)


def read_runs(logs: Sequence[Log], sensor: SensorLog) -> SensorRuns:
    """Read the runs of one sensor: every phase `run <k>`, or the whole log if it has none, numbered in order.

    CalibrationError if the sensor's configuration differs between logs, if two runs have the same number, or if the
    box had several poses.
    """
    numbers: list[int] = []
    segments: list[SegmentMeans | None] = []
    temperatures: list[float] = []
    kinds: set[str] = set()
    ups: set[str] = set()
    for place, log in enumerate(logs, start=1):
        sensor_of_log = sensor_in(log, sensor)
        for number, rows, up in _runs_in(log, sensor_of_log, place):
            if number in numbers:
                raise CalibrationError(f"{log.path}: run {number} occurs twice")
            part = _segments(sensor_of_log, rows)
            numbers.append(number)
            segments.append(part)
            kind, degc = _temperature(log, sensor_of_log, part)
            kinds.add(kind)
            temperatures.append(degc)
            ups.add(up)
    if len(ups) > 1:
        raise CalibrationError(
            f"{sensor.where}: runs with up {', '.join(map(repr, sorted(ups)))}: one pose is required"
        )
    means = [np.full(3, np.nan) if part is None else part.mean.mean(axis=0) for part in segments]
    return SensorRuns(
        sensor.name,
        sensor.quantity,
        sensor.unit,
        sensor.range,
        sensor.sensitivity,
        tuple(numbers),
        np.array(means),
        np.array(temperatures) if len(kinds - {""}) == 1 and "none" not in kinds else None,
        tuple(SegmentMeans(np.zeros(0), np.zeros((0, 3))) if part is None else part for part in segments),
        _gravity(sensor, "".join(ups), np.array(means)),
    )


def run_stretches(log: Log, place: int) -> list[tuple[str, int, int]]:
    """Return name, start and end (ns) of every run of one log: its phases `run <k>`, or the whole log."""
    named = [phase for phase in log.phases if _RUN.fullmatch(phase.name)]
    if named:
        return [(f"{log.path}, {phase.name}", phase.start_ns, phase.end_ns) for phase in named]
    times = [(int(sensor.time[0]), int(sensor.time[len(sensor) - 1])) for sensor in log.sensors.values() if len(sensor)]
    return [(f"run {place}, {log.path}", min(times)[0], max(end for _, end in times))] if times else []


def _runs_in(log: Log, sensor: SensorLog, place: int) -> list[tuple[int, slice, str]]:
    """Return (number, rows, up) of the runs of one log."""
    named = [(phase, _RUN.fullmatch(phase.name)) for phase in log.phases]
    runs = [(int(match[1]), sensor.between(phase.start_ns, phase.end_ns), phase.up) for phase, match in named if match]
    ups = {phase.up for phase in log.phases}
    return runs or [(place, slice(0, len(sensor)), ups.pop() if len(ups) == 1 else "")]


def _segments(sensor: SensorLog, rows: slice) -> SegmentMeans | None:
    """Return the means of about sixty segments of a run; None if it has no valid reading."""
    if rows.stop <= rows.start:
        return None
    span_s = (int(sensor.time[rows.stop - 1]) - int(sensor.time[rows.start])) * 1e-9
    try:
        return segment_means(sensor, max(span_s / _SEGMENTS, 1e-9), within=rows)
    except CalibrationError:
        return None


def _temperature(log: Log, sensor: SensorLog, run: SegmentMeans | None) -> tuple[str, float]:
    """Return the kind of thermometer, and the mean temperature over a run in degC; ("", nan) for a run without
    readings, ("none", nan) without a thermometer.
    """
    if run is None:
        return "", float("nan")
    thermometer = thermometer_of(log, sensor, 1.0)
    return (
        ("none", float("nan")) if thermometer is None else (thermometer.kind, float(thermometer.at(run.time_s).mean()))
    )


def _gravity(sensor: SensorLog, up: str, means: Floats) -> Floats:
    """Return gravity (3,) in counts by the data sheet's scale: along the axis that the phases state, or as measured."""
    if sensor.quantity != "specific_force":
        return np.zeros(3)
    if up:
        return np.asarray(sensor.sensitivity * (sensor.orientation.T @ np.array(up_vector(up))))
    median = np.nanmedian(means, axis=0)
    length = float(np.linalg.norm(median))
    return np.asarray(median * (sensor.sensitivity / length)) if length else np.zeros(3)
