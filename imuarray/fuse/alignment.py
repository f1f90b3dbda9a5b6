"""Alignment of all sensor axes of one quantity to one time grid, as a pure function of the readings around it.

`RowWindow` holds the rows of one sensor as long as they are required. `choose_grid` selects the times of the frames:
those of a sensor that is read in the middle of a frame and, while it is silent, those of other sensors. `align`
computes the frames.

Each sensor contributes its nearest reading within half a frame. A reading belongs to an instant some time before it was
read; the change of the motion between that instant and the frame is removed with the slope of the array's own mean. The
noise of the mean is much smaller than that of one sensor, so no reading is smoothed by its neighbours, and the mean is
robust against a sensor that fails (`imuarray.fuse.least_squares.consensus`). Its derivatives are those of cubic splines
that do not extend across gaps. Values are calibrated, in SI, along each sensor axis, with the bias at the temperature
of the reading if that is known.

The slope m' of a spline through white noise has 1.18 times the standard deviation of the noise, per frame, and
increases the variance of the mean of readings with the mean delay d, in frames, by ``9 (2 / sqrt 3 - 1) d^2`` of its
value. The curvature m'' is correlated with the noise of the mean itself, by ``-6 (sqrt 3 - 1)`` of its variance. The
second order of Taylor's series requires ``d^2 m'' / 2``; a smaller part of it, ``K d^2 m''`` with ``K = 3/8 (1 - 1 /
sqrt 3)``, compensates the noise that the slope added, except for terms in d^4, and also follows the motion better.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.calibrate import SensorCalibration
from imuarray.errors import FusionError
from imuarray.fuse import compiled_frames
from imuarray.fuse.compiled_frames import Readings, Tolerance
from imuarray.fuse.frames import Frames
from imuarray.fuse.least_squares import consensus
from imuarray.log import Block
from imuarray.log.format import SATURATED, STALE, SUSPECT
from imuarray.printable import counted
from imuarray.splines import cubic_spline

FOREVER_NS = 1 << 62
"""A time in ns that is later than any time of a log."""


class RowWindow:
    """A window that slides over one sensor's rows: `append` at its end, `forget` at its beginning."""

    def __init__(self) -> None:
        self._parts: list[Block] = []
        self.newest_ns = -FOREVER_NS
        self.ended = False
        """True if no more rows will follow."""

    def append(self, block: Block) -> None:
        """Append rows; ValueError unless they are later than all rows before."""
        if len(block.time) == 0:
            return
        if block.time[0] <= self.newest_ns:
            raise ValueError(f"row at {block.time[0]} ns comes after one at {self.newest_ns} ns")
        self._parts.append(block)
        self.newest_ns = int(block.time[-1])

    def __len__(self) -> int:
        return sum(len(part.time) for part in self._parts)

    @property
    def block(self) -> Block | None:
        """All rows in the window; None if there are none."""
        if len(self._parts) > 1:
            self._parts = [join_blocks(self._parts)]
        return self._parts[0] if self._parts else None

    def forget(self, before_ns: int) -> None:
        """Drop the rows before a time."""
        kept = [part for part in self._parts if part.time[-1] >= before_ns]
        if kept and (first := int(np.searchsorted(kept[0].time, before_ns))):
            kept[0] = cut(kept[0], slice(first, None))
        self._parts = kept


def join_blocks(parts: list[Block]) -> Block:
    """Concatenate blocks of rows with the same columns."""
    first = parts[0]
    degrees = [part.temperature_counts for part in parts if part.temperature_counts is not None]
    return Block(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.status for part in parts]),
        np.concatenate(degrees) if degrees else None,
        {name: np.concatenate([part.compensated[name] for part in parts]) for name in first.compensated},
    )


def cut(block: Block, rows: slice) -> Block:
    """Copy some rows of a block, so that the block itself can be freed."""
    compensated: Mapping[str, np.ndarray] = {name: column[rows].copy() for name, column in block.compensated.items()}
    degrees = None if block.temperature_counts is None else block.temperature_counts[rows].copy()
    return Block(block.time[rows].copy(), block.counts[rows].copy(), block.status[rows].copy(), degrees, compensated)


FIRST_ROWS = 64
"""Number of rows of each sensor from which the grid is chosen."""

_APART = 0.9
"""Share of a period within which two rows belong to one frame."""
_SILENT = 1.75
"""Number of periods without a row after which another sensor determines the grid: longer than a slow frame."""
_SAME_PERIOD = 0.25
"""Largest relative difference between the periods of sensors that are read once per frame."""
_TIE = 0.001
"""Share of a period by which a sensor must be nearer to the middle of the frame to be preferred to an earlier one."""


@dataclass(frozen=True)
class FrameGrid:
    """Times of frames: `order` are the numbers of the sensors that determine the times, the best first; `period_ns` is
    the time between frames.
    """

    order: tuple[int, ...]
    period_ns: float

    @property
    def ahead_ns(self) -> int:
        """Time after a row up to which all rows must be known to decide whether the row is in the grid."""
        return round(_SILENT * len(self.order) * self.period_ns)

    def times(self, rows: Sequence[Times]) -> Times:
        """Return the grid from the rows of all sensors: the times of the best sensor, and those of each further sensor
        in the pauses of the better ones. It is final except within `ahead_ns` of either end.
        """
        kept = rows[self.order[0]]
        pauses = self._pauses(kept)
        for number in self.order[1:]:
            if len(more := self._times_in_pauses(pauses, rows[number])):
                kept = np.sort(np.concatenate([kept, more]))
                pauses = self._pauses(kept)
        return kept

    def _pauses(self, kept: Times) -> tuple[Times, Times]:
        """Return begin and end (p,) of the pauses of `kept`; the time before its first row and after its last row
        counts as a pause.
        """
        edges = np.concatenate([[-FOREVER_NS // 2], kept, [FOREVER_NS // 2]])  # half, so that differences fit int64
        pauses = np.flatnonzero(np.diff(edges) >= _SILENT * self.period_ns)
        return edges[pauses], edges[pauses + 1]

    def _times_in_pauses(self, pauses: tuple[Times, Times], rows: Times) -> Times:
        """Return the times of `rows` within pauses."""
        apart_ns = round(_APART * self.period_ns)
        begins, ends = pauses
        if len(begins) == 2 and len(rows) and rows[0] > ends[0] - apart_ns and rows[-1] < begins[1] + apart_ns:
            return rows[:0]  # the usual case: no pause, except before and after all rows
        first = np.searchsorted(rows, begins + apart_ns)
        last = np.searchsorted(rows, ends - apart_ns, "right")
        return np.concatenate([rows[:0], *(rows[start:stop] for start, stop in zip(first, last, strict=True))])


def choose_grid(first: Sequence[Times], groups: Sequence[Sequence[int]], where: Sequence[str]) -> FrameGrid:
    """Return the grid with the smallest mean delays, by the `first` rows (at most `FIRST_ROWS` of each sensor);
    FusionError if there are too few.

    The correction for the delay of a reading uses a slope with noise, so the noise of a quantity grows with the mean
    delay of its sensors. The largest of these means over the quantities (`groups` of sensors) is minimised.
    """
    enough = [number for number, time in enumerate(first) if len(time) >= 3]
    if not enough:
        raise FusionError(f"{where[0]}: {counted(len(first[0]), 'row')}; at least three are required")
    first_equal = _first_equal(first)
    periods_of_first = {number: _period_ns(first[number]) for number in {first_equal[number] for number in enough}}
    periods = {number: periods_of_first[first_equal[number]] for number in enough}
    usual = sorted(periods.values())[(len(periods) - 1) // 2]  # the lower median: no reading of a faster half is lost
    regular = [number for number in enough if abs(periods[number] - usual) <= _SAME_PERIOD * usual]
    distinct = {first_equal[number] for number in regular}
    delays_of_first = {number: _delay(first[number], first, groups, usual) for number in distinct}
    delays = {number: delays_of_first[first_equal[number]] for number in regular}
    best = sorted(regular, key=lambda number: (round(delays[number] / _TIE), number))
    return FrameGrid(tuple(best), periods[best[0]])


def _first_equal(times: Sequence[Times]) -> list[int]:
    """Return, for each array of times, the number of the first one that is equal: sensors that are read at once."""
    numbers: dict[bytes, int] = {}
    return [numbers.setdefault(time.tobytes(), number) for number, time in enumerate(times)]


def _period_ns(time: Times) -> float:
    """Return the median period over two rows: in frames that are read in alternating order, a sensor is alternately
    early and late.
    """
    return float(np.median(time[2:] - time[:-2])) / 2


def _delay(grid: Times, first: Sequence[Times], groups: Sequence[Sequence[int]], period_ns: float) -> float:
    """Return the largest mean delay of a quantity's readings behind `grid`, as a share of the period."""
    means = []
    for group in groups:
        delays = [np.mean(late) for number in group if len(late := _late(grid, first[number], period_ns))]
        means.append(abs(float(np.mean(delays))) if delays else 0.0)
    return max(means, default=0.0)


def _late(grid: Times, time: Times, period_ns: float) -> Floats:
    """Return the delays of the readings nearest to `grid`, in periods; only readings within half a period count."""
    if len(time) == 0:
        return np.zeros(0)
    late = (time[nearest(time, grid)] - grid) / period_ns
    return np.asarray(late[np.abs(late) <= 0.5])


def nearest(time: Times, grid: Times) -> Times:
    """Return (n,) the index of the row of `time` (k,), k > 0, that is nearest to each of `grid` (n,)."""
    return np.asarray(np.searchsorted(time[:-1] + time[1:], 2 * grid))  # the later row beyond the middle of two rows


def between_gaps(known: Times, rows: Floats, at: Times, gap_ns: float) -> Floats:
    """Interpolate rows (k, c) at times `known` (k,) ns at the increasing times `at` (n,) ns; returns (n, c).

    There is one spline for each stretch of finite rows without a pause longer than `gap_ns`; NaN outside the stretches.
    """
    result = np.full((len(at), rows.shape[1]), np.nan)
    for run in _stretches(known, rows, gap_ns):
        first, last = int(np.searchsorted(at, known[run][0])), int(np.searchsorted(at, known[run][-1], "right"))
        inside = at[first:last]
        if _are_rows(known[run], inside[:_SAMPLE]) and _are_rows(known[run], inside):  # the sample usually differs
            result[first:last] = rows[run.start + np.searchsorted(known[run], inside)]
            continue
        knots, places = (known[run] - known[0]) * 1e-9, (inside - known[0]) * 1e-9
        compiled = compiled_frames.spline_at(knots, rows[run], places)
        result[first:last] = cubic_spline(knots, rows[run])(places) if compiled is None else compiled
    return result


_SAMPLE = 8
"""Number of times that are compared with those of the rows first; all times are compared only if these agree."""


def _are_rows(known: Times, at: Times) -> bool:
    """Return whether the times `at`, which are within `known`, are all in `known`."""
    return bool(np.array_equal(known[np.searchsorted(known, at)], at))


def derivatives(known: Times, rows: Floats, gap_ns: float) -> tuple[Floats, Floats]:
    """Return first and second derivative (k, c) per second of rows (k, c) at their own times (k,) ns, by the splines of
    `between_gaps`; zero outside the stretches.
    """
    first, second = np.zeros(rows.shape[::-1]).T, np.zeros(rows.shape[::-1]).T
    for run in _stretches(known, rows, gap_ns):
        knots = (known[run] - known[0]) * 1e-9
        compiled = compiled_frames.spline_derivatives(knots, rows[run])
        if compiled is None:
            spline = cubic_spline(knots, rows[run])
            compiled = spline(knots, 1), spline(knots, 2)
        first[run], second[run] = compiled
    return first, second


def _stretches(known: Times, rows: Floats, gap_ns: float) -> list[slice]:
    """Return the stretches of at least two rows without gaps."""
    finite = np.isfinite(rows)
    apart = np.asarray(np.diff(known) > gap_ns)
    if not finite.all():
        whole = np.asarray(finite.all(axis=1))
        apart |= ~whole[1:] | ~whole[:-1]
    bounds = [0, *(np.flatnonzero(apart) + 1).tolist(), len(known)]
    return [slice(start, stop) for start, stop in itertools.pairwise(bounds) if stop - start > 1]


MARGIN = 32
"""Number of frames on either side on which a frame depends: the influence of a cubic spline's ends decreases by a
factor of 3.7 per knot."""

_AT_END = 0.95
"""Share of the measuring range above which an axis of a triad that is flagged as saturated counts as clipped."""

_SAME_RATE = 0.1
"""Largest relative difference between the chip's rate and that of the frames if there is one reading per frame."""

_SECOND_ORDER = 0.375 * (1 - 1 / np.sqrt(3))


class ElementTemperature(Protocol):
    """The temperature of a sensor's element."""

    def at(self, time_s: Floats) -> Floats:
        """Return degrees Celsius (n,) at times (n,) in s since the log's epoch; NaN if not known."""
        ...


@dataclass(frozen=True)
class AlignedSensor:
    """One sensor of a quantity: its calibration, the end of its range in counts, the temperature of its element (None:
    unknown), the duration of a conversion (0: unknown), and the delay of its filter.
    """

    known: SensorCalibration
    end_lsb: float
    element: ElementTemperature | None = None
    conversion_s: float = 0.0
    delay_s: float = 0.0

    def age_s(self, period_s: float) -> float:
        """Return the mean age of a reading when it is read: half a conversion, or none if there is one conversion per
        frame, whose time stamp is then the time of the conversion (a queue, an imported recording).
        """
        is_synchronous = abs(self.conversion_s - period_s) < _SAME_RATE * period_s
        return self.delay_s + (0.0 if is_synchronous else self.conversion_s / 2)


def align(
    units: Sequence[AlignedSensor], rows: Sequence[Block | None], grid: Times, period_ns: float, directions: Floats
) -> Frames:
    """Return the frames of one quantity at the times `grid` (n,) from the `rows` of its `units` around them;
    `directions` (m, 3) are those of all their axes in the box frame.

    Frames within `MARGIN` of either end of the grid are final only if the log ends there.
    """
    readings = Readings.empty(len(units), len(grid))
    ends = [
        _set_on_grid(unit, block, grid, period_ns, readings.of(place))
        for place, (unit, block) in enumerate(zip(units, rows, strict=True))
    ]
    columns, valid, stale, late_s = readings  # one row per axis, which is fastest in numpy
    each_valid, delay_noise, clipped = _repeat_axes(valid), None, None
    if late_s.any():
        mean = consensus(columns.T, each_valid, directions, units[0].known.quantity)
        slopes = derivatives(grid, mean, gap_ns=_GAP_PERIODS * period_ns)
        _remove_motion(columns, slopes, valid, late_s, directions)
        delay_noise = _delay_noise(grid, slopes[0], valid, late_s, period_ns)
    if any(part is not None for part in ends):
        nowhere = np.zeros((len(grid), 3), np.int8)
        clipped = np.concatenate([nowhere if part is None else part for part in ends], axis=1)
    each_stale = _repeat_axes(stale) if stale.any() else None
    return Frames(grid, columns.T, each_valid, clipped, each_stale, delay_noise=delay_noise)


def _repeat_axes(sensors: Booleans) -> Booleans:
    """Repeat flags (s, n) of sensors for each of their axes: (n, 3 s)."""
    first = bool(sensors.flat[0]) if sensors.size else False
    if (sensors == first).all():  # the usual case
        return np.full((sensors.shape[1], 3 * len(sensors)), first)
    return np.ascontiguousarray(np.repeat(sensors, 3, axis=0).T)


def _set_on_grid(
    unit: AlignedSensor, block: Block | None, grid: Times, period_ns: float, into: Readings
) -> npt.NDArray[np.int8] | None:
    """Set the readings of one sensor nearest to each grid time, within half a frame; return `_find_clipped`."""
    if block is None or len(block.time) == 0:
        for part in into:
            part[...] = 0
        return None
    half_ns, age_ns = int(period_ns / 2), 1e9 * unit.age_s(period_ns * 1e-9)
    if unit.element is None:
        tolerance = Tolerance(half_ns, age_ns, SATURATED, SATURATED | SUSPECT, STALE)
        columns = block.time, block.counts, block.status
        factors = unit.known.bias_lsb, unit.known.lsb_per_si
        are_apart = compiled_frames.nearest_readings(columns, grid, factors, tolerance, into)
        if are_apart is False:
            _keep_in_nearest_frames(into, grid)
        if are_apart is not None:
            return None
    rows = nearest(block.time, grid)
    index: Times | slice = rows
    if len(rows) and (np.diff(rows) == 1).all():  # one reading in each frame: a slice avoids copies
        index = slice(int(rows[0]), int(rows[-1]) + 1)
    time, status = block.time[index], block.status[index]
    late_ns = (time - grid).astype(float)
    counts = block.counts[index]
    np.subtract(counts.T, np.atleast_2d(_bias(unit, time)).T, out=into.values)
    np.divide(into.values, unit.known.lsb_per_si[:, None], out=into.values)
    near = np.abs(late_ns) <= half_ns
    if not near.all():  # other readings belong to other frames
        into.values[:, ~near] = 0.0
        status, late_ns = status * near, late_ns * near
    late_ns -= age_ns * near
    into.valid[:] = ((status & (SATURATED | SUSPECT)) == 0) & near
    into.stale[:] = (status & STALE) != 0
    np.multiply(late_ns, 1e-9, out=into.late_s)
    _keep_in_nearest_frames(into, grid)
    return _find_clipped(unit, counts, status)


def _keep_in_nearest_frames(readings: Readings, grid: Times) -> None:
    """Keep each reading of one sensor in the nearest frame only. Where frames are not regular, a reading may lie within
    half a frame of two of them, and would count twice.
    """
    late_ns, valid = readings.late_s * 1e9, readings.valid
    shared = np.flatnonzero(valid[1:] & valid[:-1] & (np.abs(np.diff(late_ns) + np.diff(grid)) < 0.5))
    if len(shared):
        farther = shared + (np.abs(late_ns[shared + 1]) >= np.abs(late_ns[shared]))
        for part in readings:
            part[..., farther] = 0


def _bias(unit: AlignedSensor, time: Times) -> Floats:
    """Return the bias (3,) or (n, 3) in counts, at the temperature of the readings where that is known."""
    if unit.element is None:
        return unit.known.bias_lsb
    degc = unit.element.at(np.asarray(time * 1e-9, float))
    return np.where(np.isfinite(degc)[:, None], unit.known.bias_at(np.nan_to_num(degc)), unit.known.bias_lsb)


def _find_clipped(
    unit: AlignedSensor, counts: npt.NDArray[Any], status: npt.NDArray[np.uint16]
) -> npt.NDArray[np.int8] | None:
    """Return the end of the range (n, 3), +1 or -1, of the clipped axes of triads flagged as saturated, 0 elsewhere;
    None if no triad is flagged.
    """
    flagged = (status & SATURATED) != 0
    if not flagged.any():
        return None
    counts = counts.astype(float)
    at_end = (np.abs(counts) >= _AT_END * unit.end_lsb) & flagged[:, None]
    return np.where(at_end, np.sign(counts), 0).astype(np.int8)


def _remove_motion(
    columns: Floats, derivatives: tuple[Floats, Floats], valid: Booleans, late_s: Floats, directions: Floats
) -> None:
    """Subtract from columns (m, n) the change of the motion along each axis from the grid time to the reading of each
    sensor, `late_s` (s, n) later; `derivatives` (n, 3) are those of the array's mean.
    """
    slope, curvature = derivatives
    if compiled_frames.remove_motion(columns, (slope.T, curvature.T), (valid, late_s), directions, _SECOND_ORDER):
        return
    usual_s = (late_s * valid).sum(axis=0) / np.maximum(valid.sum(axis=0), 1)
    motion: Floats = directions @ (slope.T - _SECOND_ORDER * usual_s * curvature.T)
    columns -= motion * np.repeat(late_s, 3, axis=0)


_GAP_PERIODS = 5
"""Longest pause, in periods, over which the slope of the motion is known."""

_OWN = (5 * np.sqrt(3) - 7.5, 0.09996)
_ACROSS = (-9.919, -2.517)
_OWN_CURVATURE = 6 * (np.sqrt(3) - 1)
_SLOPE_POWER = (9 * (2 / np.sqrt(3) - 1), 2.06)
_CURVATURE_POWER = 36.0
_LATER = 6.9
"""Weights of a spline's slope s' and curvature s'' at a knot, in periods, for white noise at the knots.

For regular knots: `_OWN_CURVATURE` is minus the weight of the knot's own value in s'', and the first element of
`_SLOPE_POWER` and `_CURVATURE_POWER` are the sums of squares of all weights in s' and in s''. For irregular knots, to
first order in the difference of the steps after and before the knot, and in that of the steps next to these: `_OWN`
yields the own weight in s', `_ACROSS` the sum of the products of the weights in s' and s''. The sum of squares in s'
increases by the second element of `_SLOPE_POWER` times the square of the own weight. In a slope s' - c s'', the
difference of the sums of squares after and before the knot, relative to their sum, is ``tanh(-own weight in s' -
_LATER c)``. The values were computed by small changes of the knots of SciPy's spline; the tests compare them with it.
"""
_SPLINE_WEIGHTS = np.array([*_OWN, *_ACROSS, _OWN_CURVATURE, *_SLOPE_POWER, _CURVATURE_POWER, _LATER, _SECOND_ORDER])
"""All these weights in the order of the compiled code."""


def _noise_of_slopes(grid: Times, usual_s: Floats, variance: Floats, period_ns: float) -> Floats:
    """Return (2, n) per second the weight of the mean of a frame itself in the slope at it, and the root of the sum of
    squares of the weights of all frames, for frames at `grid` (n,) with mean delays `usual_s` (n,).

    Each weight counts by the `variance` (n,) of its frame's mean relative to that with all sensors. Of the other
    frames, the two next to a frame have nearly all the weight.
    """
    steps = np.diff(grid) * 1e-9
    steps[steps > _GAP_PERIODS * period_ns * 1e-9] = period_ns * 1e-9
    steps = np.pad(steps, 2, mode="edge") if len(steps) else np.full(4, period_ns * 1e-9)
    further_before, before, after, further_after = (steps[k : k + len(grid)] for k in range(4))
    period_s = (further_before + before + after + further_after) / 4
    near, far = (after - before) / period_s, (further_after - further_before) / period_s
    own, across = _OWN[0] * near + _OWN[1] * far, _ACROSS[0] * near + _ACROSS[1] * far
    second = _SECOND_ORDER * usual_s / period_s
    power = _SLOPE_POWER[0] + _SLOPE_POWER[1] * own**2 - 2 * second * across + _CURVATURE_POWER * second**2
    of_slope, own = own, own + _OWN_CURVATURE * second
    if not (variance == 1).all():
        later, neighbours = np.tanh(-of_slope - _LATER * second), np.pad(variance, 1, mode="edge")
        others = np.maximum(power - own**2, 0.0) / 2
        power = others * ((1 - later) * neighbours[:-2] + (1 + later) * neighbours[2:]) + own**2 * variance
        own *= variance
    return np.asarray([own, np.sqrt(np.maximum(power, 0.0))] / period_s, np.float32)


def _delay_noise(
    grid: Times, slope: Floats, valid: Booleans, late_s: Floats, period_ns: float
) -> npt.NDArray[np.float32]:
    """Return `Frames.delay_noise` (n, 2 s) of readings `late_s` (s, n); zero where the `slope` (n, 3) is not known."""
    periods_ns = period_ns, _GAP_PERIODS * period_ns
    compiled = compiled_frames.delay_noise(grid, slope, (valid, late_s), periods_ns, _SPLINE_WEIGHTS)
    if compiled is not None:
        return compiled
    present = np.maximum(valid.sum(axis=0), 1)
    usual_s = (late_s * valid).sum(axis=0) / present
    noise = _noise_of_slopes(grid, usual_s, len(valid) / present, period_ns) * slope.T.any(axis=0)
    return np.asarray(noise[:, None] * late_s, np.float32).reshape(-1, len(grid)).T
