"""`opposed`: the error that all units of a design share, estimated from anti-parallel axes and removed.

Axes along a box axis read ``truth + c + own error``, axes against it ``-truth + c + own error``, so half the sum C of
the two means is c, independent of the truth. The same holds for even-order terms, which do not change sign (paper,
section 2.1); odd-order terms do not contribute. c is slow (temperature, supply), so it is low-passed and adds no noise.

It is used only as far as units with the same direction agree. With `n+` and `n-` axes and a variance s2 of the slow
errors within a direction, C has an expected square of ``(2 c)^2 + s2 (1/n+ + 1/n-)``; if units share nothing, ``F = C^2
/ (s2 (1/n+ + 1/n-))`` has Fisher's distribution with 1 and n+ + n- - 2 degrees of freedom. c is used from the F that is
exceeded by chance with twice the probability `significance`, and in full from the F that is exceeded with that
probability; its value is C/2 times ``1 - 1/F``, the share of C^2 that is due to the common part. If units share
nothing, this increases the average's drift by less than 1 % (three axes).

The level of the errors at the start (the remaining turn-on biases) and their change since then are tested separately,
because units with different initial biases may have the same drift. For the change, C^2 and s2 are variances over the
whole time since the start.

`capabilities` states for every pair of anti-parallel axes, from a calibration, which errors it can cancel: the mean of
a pair, with opposite signs, contains half the difference of the two errors, of the slopes with temperature and of the
biases.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import BIAS
from imuarray.calibrate.opposed import OPPOSED, compare_opposed
from imuarray.fuse.frames import Axis, Estimate, Frames, axes_of, directions
from imuarray.fuse.least_squares import Technique, mean, solve_frames
from imuarray.log import SensorLog
from imuarray.products import multiply_rows
from imuarray.recursion import first_order

_WITHIN = 1.96
"""Standard errors to either side of a 95 % interval."""


@dataclass(frozen=True)
class Reduction:
    """Reduction of an error by a pair of axes, in SI (slopes per degC): of one axis (`single`, the mean of the two
    magnitudes) and of their mean in the box frame (`remaining`, standard error `remaining_sem`).

    `reduction` is the ratio of the two, with the 95 % interval `least` to `most` (inf if nothing may remain);
    `p_value` is the probability of such errors if opposition of the axes gains nothing.
    """

    single: float
    remaining: float
    remaining_sem: float
    reduction: float
    least: float
    most: float
    p_value: float


@dataclass(frozen=True)
class Pair:
    """Two axes ("Gyro1 y") of one `chip`, opposite along `box_axis`, with the reduction of their drift with temperature
    and of their bias; None unless the calibration contains both.

    `is_bias` is False if a slope may be one of scale, which opposition does not cancel.
    """

    first: str
    second: str
    chip: str
    box_axis: str
    drift: Reduction | None
    bias: Reduction | None
    is_bias: bool = True


def capabilities(sensors: Sequence[SensorLog], calibration: Calibration) -> list[Pair]:
    """Return every pair of opposing axes of two of `sensors` (of one quantity) of one design, by their calibrated
    directions; measuring ranges may differ.
    """
    parameters = {sensor.name: calibration.or_nominal(sensor) for sensor in sensors}
    return [
        Pair(
            first.label,
            second.label,
            first.chip,
            "XYZ"[int(np.abs(first.direction_box).argmax())],
            _reduction(*(_drift(parameters[axis.sensor], axis.index) for axis in (first, second))),
            _reduction(*(_bias(parameters[axis.sensor], axis.index) for axis in (first, second))),
            all(_is_bias(parameters[axis.sensor], axis.index) for axis in (first, second)),
        )
        for first, second in _opposing(axes_of(sensors, calibration))
    ]


def _opposing(axes: Sequence[Axis]) -> Iterator[tuple[Axis, Axis]]:
    for first, second in combinations(axes, 2):
        similar = first.chip == second.chip and first.sensor != second.sensor
        if similar and np.dot(first.direction_box, second.direction_box) < OPPOSED:
            yield first, second


def _is_bias(parameters: SensorCalibration, index: int) -> bool:
    return parameters.thermal is None or parameters.thermal.meaning[index] == BIAS


def _drift(parameters: SensorCalibration, index: int) -> tuple[float, float] | None:
    """Return the slope of an axis with temperature and its standard error, in SI per degC; None if not measured."""
    if parameters.thermal is None:
        return None
    slope, sem = parameters.thermal.slope_lsb_per_degc[index], parameters.thermal.slope_sem_lsb_per_degc[index]
    return slope / parameters.lsb_per_si[index], sem / parameters.lsb_per_si[index]


def _bias(parameters: SensorCalibration, index: int) -> tuple[float, float] | None:
    """Return the bias of an axis and its standard error, in SI; None if not measured."""
    if parameters.bias_sem_lsb is None:
        return None
    scale = parameters.lsb_per_si[index]
    return parameters.bias_lsb[index] / scale, parameters.bias_sem_lsb[index] / scale


def _reduction(error: tuple[float, float] | None, other_error: tuple[float, float] | None) -> Reduction | None:
    """Return the reduction of two errors, each with its standard error; its interval collapses to a point for standard
    errors of zero. None if one of them is not known.
    """
    if error is None or other_error is None:
        return None
    (first, sem_first), (second, sem_second), tiny = error, other_error, np.finfo(float).tiny
    remaining, sem, reduction, p_value, _ = compare_opposed(first, second, max(sem_first, tiny), max(sem_second, tiny))
    single = (abs(first) + abs(second)) / 2
    low, high = abs(remaining) - _WITHIN * sem, abs(remaining) + _WITHIN * sem
    return Reduction(
        float(single),
        float(remaining),
        float(sem),
        float(reduction),
        float(single / high) if high > 0 else np.inf,
        float(single / low) if low > 0 else np.inf,
        float(p_value),
    )


SMOOTHING_S = 10.0
"""Time constant of the low-pass."""

_JUDGED = 6.0
"""Time constant of the low-pass before the test of the change, as a multiple of `SMOOTHING_S`, which suppresses noise.
"""

_SIGNIFICANCE = 0.05
_LOST_OF_THREE = 0.125
"""Value of `lost` in `significance` for one axis along and two against the box axis."""


@dataclass(frozen=True)
class OpposingGroup:
    """Axes (indices) of one design along and against one box axis."""

    along: tuple[int, ...]
    against: tuple[int, ...]
    box_axis: str = ""


def opposing_groups(axes: Sequence[Axis]) -> list[OpposingGroup]:
    """Return every design and box axis that has axes in both directions, but not equally many of each: equal numbers
    cancel in the average.
    """
    rows = directions(axes)
    main = np.abs(rows).argmax(axis=1)
    groups: dict[tuple[str, int], tuple[list[int], list[int]]] = {}
    for index, axis in enumerate(axes):
        ways = groups.setdefault((axis.chip, int(main[index])), ([], []))
        ways[0 if rows[index, main[index]] > 0 else 1].append(index)
    return [
        OpposingGroup(tuple(along), tuple(against), "XYZ"[axis])
        for (_, axis), (along, against) in groups.items()
        if 0 < len(along) != len(against) > 0
    ]


@cache
def significance(along: int, against: int) -> float:
    """Return the significance level of the test for a common drift with so many axes in each direction.

    It is 5 % for three axes and decreases with the loss by a false detection: a wrong c adds the variance of C/2 times
    the square of the imbalance ``(n- - n+) / n`` to that of the average, s2/n.
    """
    lost = (1 / along + 1 / against) * (against - along) ** 2 / (4 * (along + against))
    return _SIGNIFICANCE * min(1.0, _LOST_OF_THREE / lost) ** 2 if lost else _SIGNIFICANCE


@cache
def _limits(along: int, against: int) -> tuple[float, float]:
    """Return the F from which a common error is used, and that from which it is used in full."""
    from scipy.special import fdtri  # scipy.stats is slow to import

    chance = significance(along, against)
    low, high = fdtri(1, along + against - 2, [1 - 2 * chance, 1 - chance])
    return float(low), float(high)


class CommonErrorEstimate:
    """The running estimate of one group's common error, over consecutive blocks."""

    def __init__(self, group: OpposingGroup, seconds: float = SMOOTHING_S) -> None:
        self.members = [*group.along, *group.against]
        self._along = len(group.along)
        self._slow = Smoother(seconds, len(self.members))
        self._slower = Smoother(_JUDGED * seconds, len(self.members))
        self._freedom = len(self.members) - 2
        self._spread = 1 / len(group.along) + 1 / len(group.against)
        self._limits = _limits(len(group.along), len(group.against))
        self._level = np.zeros(len(self.members))
        self._rows = 0
        self._sums = np.zeros((2, 1 + len(self.members)))

    def estimate(self, time: npt.NDArray[np.int64], residual: Floats, valid: npt.NDArray[np.bool_]) -> Floats:
        """Return the common error (n,) in the unit of `residual` (n, m), axis values less the average triad along
        them.
        """
        errors = np.where(valid[:, self.members], residual[:, self.members], np.nan)
        slow = self._slow(time, errors)
        start = self._slow.begin  # the level is the low-pass at this row
        if start < len(slow) and self._rows == 0:
            self._level = slow[start].copy()
        level = np.concatenate([slow[:start], np.broadcast_to(self._level, (len(slow) - start, len(self.members)))])
        parts = self._parts(level)
        common = self._trust(parts**2) * parts[:, 0] / 2
        if start < len(slow):
            change = slow[start:] - self._level
            slow_parts = self._parts(self._slower(time[start:], change))
            common[start:] += self._trust(self._variances(slow_parts)) * self._parts(change)[:, 0] / 2
        return np.asarray(common)

    def _parts(self, errors: Floats) -> Floats:
        """Return (n, 1 + m) the sum of the means of both directions, and the difference of each axis from the mean of
        its direction.
        """
        ways = errors[:, : self._along], errors[:, self._along :]
        total = sum((way.mean(axis=1, keepdims=True) for way in ways), np.zeros((len(errors), 1)))
        return np.concatenate([total, *(way - way.mean(axis=1, keepdims=True) for way in ways)], axis=1)

    def _variances(self, parts: Floats) -> Floats:
        """Return the sums of squares (n, 1 + m) about the mean in time, over all rows so far."""
        sums = self._sums[:, None, :] + np.cumsum([parts, parts**2], axis=1)
        number = self._rows + np.arange(1, len(parts) + 1)[:, None]
        if len(parts):
            self._rows, self._sums = int(number[-1, 0]), sums[:, -1]
        return np.asarray(np.maximum(sums[1] - sums[0] ** 2 / number, 0))

    def _trust(self, squares: Floats) -> Floats:
        """Return the factor (n,) of the common part, 0 to 1, from the squares (n, 1 + m) of `_parts`."""
        variances = squares[:, 1:].sum(axis=1) / self._freedom * self._spread
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(squares[:, 0] > 0, squares[:, 0] / variances, 0.0)
            low, high = np.log(self._limits)
            surely = np.clip((np.log(ratio) - low) / (high - low), 0, 1)
        return np.asarray(surely * (1 - 1 / np.maximum(ratio, 1.0)))


class Smoother:
    """First-order low-pass over consecutive blocks of rows (n, k), which begins as a running mean.

    The running mean becomes an exponential one after the time constant, so that there is no transient from an arbitrary
    start; from then on the time constant is the number of rows until then. NaN is replaced by the value before it.
    """

    def __init__(self, seconds: float, columns: int) -> None:
        self.begin = 0
        """First row of the last block with an exponential mean; its length if there is none."""
        self._span_ns = seconds * 1e9
        self._first_ns: int | None = None
        self._rows_held = 0
        self._rows = 0
        self._state = np.zeros(columns)
        self._last = np.zeros(columns)

    def __call__(self, time: npt.NDArray[np.int64], rows: Floats) -> Floats:
        """Return the low-passed `rows` at `time` (n,) ns."""
        filled = self._hold(rows)
        begin = self.begin = self._begin(time)
        smoothed = np.empty_like(filled)
        if begin:
            counts = self._rows + np.arange(1, begin + 1)[:, None]
            smoothed[:begin] = (self._state * self._rows + np.cumsum(filled[:begin], axis=0)) / counts
            self._state = smoothed[begin - 1]
        if begin < len(filled):
            gain = 1 / self._rows_held
            drive = gain * filled[begin:]
            drive[0] += (1 - gain) * self._state
            smoothed[begin:] = first_order(drive, 1 - gain)
            self._state = smoothed[-1]
        self._rows += len(filled)
        return smoothed

    def _begin(self, time: npt.NDArray[np.int64]) -> int:
        """Return the first row after the running mean."""
        if self._rows_held or len(time) == 0:
            return 0
        self._first_ns = int(time[0]) if self._first_ns is None else self._first_ns
        begin = int(np.searchsorted(time, self._first_ns + self._span_ns))
        self._rows_held = self._rows + begin if begin < len(time) else 0
        return begin

    def _hold(self, rows: Floats) -> Floats:
        """Return `rows` with NaN replaced by the last finite value."""
        is_finite = np.isfinite(rows)
        if is_finite.all():
            self._last = rows[-1] if len(rows) else self._last
            return rows
        source = np.maximum.accumulate(np.where(is_finite, np.arange(len(rows))[:, None], -1), axis=0)
        filled = np.where(source >= 0, np.take_along_axis(rows, np.maximum(source, 0), axis=0), self._last)
        self._last = filled[-1]
        return filled


def opposed(axes: Sequence[Axis]) -> Technique:
    """Return the technique that estimates the error that all units of a design share from anti-parallel axes, and
    removes it (paper, section 2.1).

    It cancels errors that are equal in all units, as far as these agree: the level at the start, drift with
    temperature, the mean of even-order terms. With equal numbers of axes in both directions the average cancels them
    already; with all axes in one direction they can't be estimated. `capabilities` states what can be cancelled.
    """
    average = mean(axes)
    rows = directions(axes)
    modes = [CommonErrorEstimate(group) for group in opposing_groups(axes)]

    def fused(frames: Frames) -> Estimate:
        weights = frames.valid.astype(float)
        residual = frames.values - multiply_rows(solve_frames(frames.values, weights, rows), rows.T)
        values = frames.values.copy()
        for mode in modes:
            values[:, mode.members] -= mode.estimate(frames.time, residual, frames.valid)[:, None]
        return average(replace(frames, values=values))

    return fused


def changes(axes: Sequence[Axis]) -> list[str]:
    """Return the designs and box axes that differ from the average."""
    return [f"{axes[group.along[0]].chip} along {group.box_axis}" for group in opposing_groups(axes)]
