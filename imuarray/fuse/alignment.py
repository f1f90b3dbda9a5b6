"""Alignment of all sensor axes of one quantity to one time grid, as a pure function of the readings around it.

`RowWindow` holds the rows of one sensor as they arrive, as long as they are required. `choose` selects the times of the
frames: those of a sensor that is read in the middle of them, and those of others while it is silent. `align` computes
the frames.

Each sensor contributes its nearest reading within half a frame. A reading belongs to an instant some time before it was
read; the change of the motion between that instant and the frame's is removed with the slope of the array's own mean.
The mean is far quieter than one sensor, so no reading is smoothed by its neighbours, and it is robust against a sensor
that fails (`imuarray.fuse.least_squares.consensus`). Its derivatives are those of cubic splines that do not reach
across gaps. Values are calibrated, in SI, along each sensor axis, with the bias at the temperature of the reading where
that is known.

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
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.calibrate import SensorCalibration
from imuarray.errors import FusionError
from imuarray.fuse.frames import Frames
from imuarray.fuse.least_squares import consensus
from imuarray.log import Block
from imuarray.log.format import SATURATED, STALE, SUSPECT

FOREVER_NS = 1 << 62
"""Later than any time of a log."""


class RowWindow:
    """A window that slides over one sensor's rows: `append` at its end, `forget` at its beginning."""

    def __init__(self) -> None:
        self._parts: list[Block] = []
        self.newest_ns = -FOREVER_NS
        self.ended = False
        """Nothing comes any more."""

    def append(self, block: Block) -> None:
        """Rows that follow those that are there; ValueError if they don't."""
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
        """All rows that are kept; None if there are none."""
        if len(self._parts) > 1:
            self._parts = [join_blocks(self._parts)]
        return self._parts[0] if self._parts else None

    def forget(self, before_ns: int) -> None:
        """Let go of the rows before a time."""
        kept = [part for part in self._parts if part.time[-1] >= before_ns]
        if kept and (first := int(np.searchsorted(kept[0].time, before_ns))):
            kept[0] = cut(kept[0], slice(first, None))
        self._parts = kept


def join_blocks(parts: list[Block]) -> Block:
    """Rows one after the other. All parts have the same columns."""
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
    """Some rows of a block, copied: what they were cut from can go."""
    compensated: Mapping[str, np.ndarray] = {name: column[rows].copy() for name, column in block.compensated.items()}
    degrees = None if block.temperature_counts is None else block.temperature_counts[rows].copy()
    return Block(block.time[rows].copy(), block.counts[rows].copy(), block.status[rows].copy(), degrees, compensated)


FIRST_ROWS = 64
"""Rows of each sensor by which the grid is chosen."""

_APART = 0.9
"""Share of a period within which two rows are of one frame."""
_SILENT = 1.75
"""Periods without a row after which others stand in: more than a frame that takes longer than others."""
_ALIKE = 0.25
"""Share by which periods of sensors that are read once a frame may differ."""
_TIE = 0.001
"""Share of a period by which a sensor must lie nearer to the middle to be taken in place of an earlier one."""


@dataclass(frozen=True)
class FrameGrid:
    """`order`: the sensors (numbers) whose times make the grid, the best first; `period_ns` of a frame."""

    order: tuple[int, ...]
    period_ns: float

    @property
    def ahead_ns(self) -> int:
        """Return how far beyond a time every row must be known for it to be certain whether it is in the grid."""
        return round(_SILENT * len(self.order) * self.period_ns)

    def times(self, rows: Sequence[Times]) -> Times:
        """The grid over some rows of all sensors: those of the best one, and of each further one those in the pauses of
        the better ones. Certain up to `ahead_ns` from either end.
        """
        kept = rows[self.order[0]]
        for number in self.order[1:]:
            more = rows[number]
            if len(more := self._between(kept, more)):
                kept = np.sort(np.concatenate([kept, more]))
        return kept

    def _between(self, kept: Times, more: Times) -> Times:
        """Return those of `more` that stand in the pauses of `kept`; before its first and after its last row is a
        pause.
        """
        edges = np.concatenate([[-FOREVER_NS // 2], kept, [FOREVER_NS // 2]])  # their difference is a time too
        pauses = np.flatnonzero(np.diff(edges) >= _SILENT * self.period_ns)
        apart_ns = round(_APART * self.period_ns)
        first = np.searchsorted(more, edges[pauses] + apart_ns)
        last = np.searchsorted(more, edges[pauses + 1] - apart_ns, "right")
        return np.concatenate([more[:0], *(more[start:stop] for start, stop in zip(first, last, strict=True))])


def choose(first: Sequence[Times], groups: Sequence[Sequence[int]], where: Sequence[str]) -> FrameGrid:
    """The grid that costs least, by the `first` rows (at most `FIRST_ROWS` of each sensor); FusionError if there are
    too few.

    What a sensor that is read `late` did meanwhile is taken out with a slope that has noise: a quantity pays for the
    mean delay of its sensors, so that the largest of these (of the quantities' `groups` of sensors) is to be small.
    """
    enough = [number for number, time in enumerate(first) if len(time) >= 3]
    if not enough:
        raise FusionError(f"{where[0]}: {len(first[0])} rows, nothing to fuse")
    periods = {number: _period_ns(first[number]) for number in enough}
    usual = sorted(periods.values())[(len(periods) - 1) // 2]  # of two halves the faster one: no reading is passed over
    regular = [number for number in enough if abs(periods[number] - usual) <= _ALIKE * usual]
    delays = {number: _delay(first[number], first, groups, usual) for number in regular}
    best = sorted(regular, key=lambda number: (round(delays[number] / _TIE), number))
    return FrameGrid(tuple(best), periods[best[0]])


def _period_ns(time: Times) -> float:
    """Over two rows: a sensor that is read from either end of the frames in turn comes early and late in turn."""
    return float(np.median(time[2:] - time[:-2])) / 2


def _delay(grid: Times, first: Sequence[Times], groups: Sequence[Sequence[int]], period_ns: float) -> float:
    """The largest mean delay of a quantity's readings behind `grid`, as a share of the period."""
    means = []
    for group in groups:
        delays = [np.mean(late) for number in group if len(late := _late(grid, first[number], period_ns))]
        means.append(abs(float(np.mean(delays))) if delays else 0.0)
    return max(means, default=0.0)


def _late(grid: Times, time: Times, period_ns: float) -> Floats:
    """Delays of the readings nearest to `grid`, of those within half a period, as shares of it."""
    if len(time) == 0:
        return np.zeros(0)
    late = (time[nearest(time, grid)] - grid) / period_ns
    return np.asarray(late[np.abs(late) <= 0.5])


def nearest(time: Times, grid: Times) -> Times:
    """(n,) the index of the row of `time` (k,), k > 0, that is nearest to each of `grid` (n,)."""
    return np.asarray(np.searchsorted(time[:-1] + time[1:], 2 * grid))  # beyond the middle of two rows is the later one


def between_gaps(known: Times, rows: Floats, at: Times, gap_ns: float) -> Floats:
    """Rows (k, c) at times `known` (k,) ns, interpolated at `at` (n,) ns, which increase: (n, c).

    One spline for each stretch without a row that is not finite and without a pause longer than `gap_ns`; NaN outside
    the stretches.
    """
    result = np.full((len(at), rows.shape[1]), np.nan)
    for run in _stretches(known, rows, gap_ns):
        first, last = int(np.searchsorted(at, known[run][0])), int(np.searchsorted(at, known[run][-1], "right"))
        inside = at[first:last]
        row = run.start + np.searchsorted(known[run], inside)
        if np.array_equal(known[row], inside):  # nothing lies between the rows
            result[first:last] = rows[row]
            continue
        spline = _Spline((known[run] - known[0]) * 1e-9, rows[run])
        result[first:last] = spline.at((inside - known[0]) * 1e-9)
    return result


def derivatives(known: Times, rows: Floats, gap_ns: float) -> tuple[Floats, Floats]:
    """First and second derivative (k, c) per second of rows (k, c) at their own times (k,) ns, by the splines of
    `between_gaps`; zero where there is none.
    """
    first, second = np.zeros(rows.shape[::-1]).T, np.zeros(rows.shape[::-1]).T
    for run in _stretches(known, rows, gap_ns):
        spline = _Spline((known[run] - known[0]) * 1e-9, rows[run])
        first[run], second[run] = spline.slopes, spline.curvatures()
    return first, second


_NEGLIGIBLE = 1e-18
"""Factor of a neighbour that is lost in the rounding of a sum."""


class _Spline:
    """The cubic spline through rows (k, c) at knots (k,), k > 1, whose third derivative is the same on either side of
    the first and last inner knot ("not a knot"; de Boor, "A Practical Guide to Splines", 1978, chapter IV): the same
    spline as `scipy.interpolate.CubicSpline`, whose import would take a third of a second in every command.

    Inside it every column is contiguous, (c, k): numpy takes several times as long over rows of three.
    """

    def __init__(self, knots: Floats, rows: Floats) -> None:
        self._knots, self._columns = knots, np.ascontiguousarray(rows.T)
        self._widths = np.diff(knots)
        self._rises = np.diff(self._columns) / self._widths
        self._slopes = self._solved()

    @property
    def slopes(self) -> Floats:
        """(k, c) first derivatives at the knots."""
        return self._slopes.T

    def curvatures(self) -> Floats:
        """(k, c) second derivatives at the knots."""
        square, cube = self._powers()
        last = 2 * square[:, -1:] + 6 * cube[:, -1:] * self._widths[-1]
        return np.concatenate([2 * square, last], axis=1).T

    def at(self, places: Floats) -> Floats:
        """(n, c) at places (n,) from the first to the last knot."""
        piece = np.clip(np.searchsorted(self._knots, places, "right") - 1, 0, len(self._knots) - 2)
        square, cube = self._powers()
        beyond = places - self._knots[piece]
        result = beyond * cube[:, piece]
        for power in (square, self._slopes):
            result += power[:, piece]
            result *= beyond
        return np.asarray(self._columns[:, piece] + result).T

    def _powers(self) -> tuple[Floats, Floats]:
        """(c, k - 1) factors of the square and the cube of the way from the knot before."""
        bend = (self._slopes[:, :-1] + self._slopes[:, 1:] - 2 * self._rises) / self._widths
        return (self._rises - self._slopes[:, :-1]) / self._widths - bend, bend / self._widths

    def _solved(self) -> Floats:
        """(c, k) the slopes at the knots that make the second derivative continuous."""
        widths, rises, count = self._widths, self._rises, len(self._knots)
        if count == 2:
            return np.repeat(rises, 2, axis=1)
        wanted = np.empty(self._columns.shape)
        wanted[:, 1:-1] = 3 * (widths[1:] * rises[:, :-1] + widths[:-1] * rises[:, 1:])
        if count == 3:  # one parabola
            wanted[:, 0], wanted[:, -1] = 2 * rises[:, 0], 2 * rises[:, 1]
            h, g = widths
            matrix = np.array([[1.0, 1.0, 0.0], [g, 2 * (h + g), h], [0.0, 1.0, 1.0]])
            return np.asarray(np.linalg.solve(matrix, wanted.T)).T
        first, last = widths[0] + widths[1], widths[-2] + widths[-1]
        wanted[:, 0] = ((widths[0] + 2 * first) * widths[1] * rises[:, 0] + widths[0] ** 2 * rises[:, 1]) / first
        wanted[:, -1] = (widths[-1] ** 2 * rises[:, -2] + (2 * last + widths[-1]) * widths[-2] * rises[:, -1]) / last
        wanted[:, 1] -= wanted[:, 0]  # without the slope at either end, the rows of the others have a strong diagonal
        wanted[:, -2] -= wanted[:, -1]
        diagonal = 2 * (widths[:-1] + widths[1:])
        diagonal[0], diagonal[-1] = first, last
        before, after = -widths[1:] / diagonal, -widths[:-1] / diagonal
        before[0] = after[-1] = 0.0
        slopes = wanted
        slopes[:, 1:-1] = _relaxed(before, after, wanted[:, 1:-1] / diagonal)
        slopes[:, 0] = (wanted[:, 0] - first * slopes[:, 1]) / widths[1]
        slopes[:, -1] = (wanted[:, -1] - last * slopes[:, -2]) / widths[-2]
        return slopes


def _relaxed(before: Floats, after: Floats, alone: Floats) -> Floats:
    """Solve ``x[i] = alone[i] + before[i] x[i - 1] + after[i] x[i + 1]`` for x (c, k); the two factors (k,) of every
    row are below one together.

    Parallel cyclic reduction: putting in the neighbours' equations leaves the same equations between rows twice as far
    apart, whose factors are about the squares of those before, and soon too small for the precision (R. W. Hockney and
    C. R. Jesshope, "Parallel Computers 2", 1988, section 5.4.3).
    """
    apart, result = 1, alone
    while apart < len(before) and max(np.abs(before).max(), np.abs(after).max()) > _NEGLIGIBLE:
        later, sooner = before[apart:], after[:-apart]  # the factors of rows that have such a neighbour
        through = later * sooner
        own = np.ones(len(before))
        own[apart:] -= through
        own[:-apart] -= through
        more = result.copy()
        more[:, apart:] += later * result[:, :-apart]
        more[:, :-apart] += sooner * result[:, apart:]
        result = more / own
        further_before, further_after = np.zeros(len(before)), np.zeros(len(before))
        further_before[apart:] = later * before[:-apart]
        further_after[:-apart] = sooner * after[apart:]
        before, after, apart = further_before / own, further_after / own, 2 * apart
    return result


def _stretches(known: Times, rows: Floats, gap_ns: float) -> list[slice]:
    """The rows, two and more of them, between which nothing is missing."""
    finite = np.isfinite(rows)
    apart = np.asarray(np.diff(known) > gap_ns)
    if not finite.all():
        whole = np.asarray(finite.all(axis=1))
        apart |= ~whole[1:] | ~whole[:-1]
    bounds = [0, *(np.flatnonzero(apart) + 1).tolist(), len(known)]
    return [slice(start, stop) for start, stop in itertools.pairwise(bounds) if stop - start > 1]


MARGIN = 32
"""Frames on either side that frames in between depend on: a cubic spline forgets its ends by a factor of 3.7 a knot."""

_AT_END = 0.95
"""Share of the measuring range beyond which an axis of a triad that is flagged as saturated is the one at its end."""

_SAME_RATE = 0.1
"""Share by which the chip's rate and that of the frames may differ for them to be one."""

_SECOND_ORDER = 0.375 * (1 - 1 / np.sqrt(3))


class ElementTemperature(Protocol):
    """The temperature of a sensor's element."""

    def at(self, time_s: Floats) -> Floats:
        """Degrees (n,) at times (n,) in s since the log's epoch; NaN where it is not known."""
        ...


@dataclass(frozen=True)
class AlignedSensor:
    """One sensor of a quantity: its calibration, the end of its range in counts, how warm it was (None: unknown), how
    long it takes to make a reading (0: unknown), and by how much its filter is behind.
    """

    known: SensorCalibration
    end_lsb: float
    element: ElementTemperature | None = None
    conversion_s: float = 0.0
    delay_s: float = 0.0

    def age_s(self, period_s: float) -> float:
        """Return how old a reading is on average when it is read: half a conversion, unless there is one a frame, which
        then has the time at which it was made (a queue's, an imported recording's).
        """
        is_its_own = abs(self.conversion_s - period_s) < _SAME_RATE * period_s
        return self.delay_s + (0.0 if is_its_own else self.conversion_s / 2)


class _Part(NamedTuple):
    """One sensor on the grid: values (3, n) and clipped (n, 3) along its axes; valid, stale and late_s (n,)."""

    values: Floats
    clipped: npt.NDArray[np.int8]
    valid: Booleans
    stale: Booleans
    late_s: Floats


def align(
    units: Sequence[AlignedSensor], rows: Sequence[Block | None], grid: Times, period_ns: float, directions: Floats
) -> Frames:
    """The frames of one quantity at the times `grid` (n,) from the `rows` of its `units` around them; `directions`
    (m, 3) are those of all their axes in the box frame.

    Frames that are nearer than `MARGIN` to either end of the grid are as the rest only if nothing lies beyond it.
    """
    parts = [_on_grid(unit, block, grid, period_ns) for unit, block in zip(units, rows, strict=True)]
    columns = np.concatenate([part.values for part in parts])  # axis by axis, as numpy is fastest
    valid, late_s = np.stack([part.valid for part in parts]), np.stack([part.late_s for part in parts])
    each_valid = _by_axis(valid)
    if late_s.any():
        mean = consensus(columns.T, each_valid, directions, units[0].known.quantity)
        columns -= _motion(grid, mean, valid, late_s, period_ns, directions)
    clipped = np.concatenate([part.clipped for part in parts], axis=1)
    stale = _by_axis(np.stack([part.stale for part in parts]))
    return Frames(grid, np.ascontiguousarray(columns.T), each_valid, clipped, stale)


def _by_axis(sensors: Booleans) -> Booleans:
    """(n, 3 s) from (s, n): each sensor's three times."""
    return np.ascontiguousarray(np.repeat(sensors, 3, axis=0).T)


def _on_grid(unit: AlignedSensor, block: Block | None, grid: Times, period_ns: float) -> _Part:
    """The readings nearest to each grid time, within half a frame."""
    if block is None or len(block.time) == 0:
        nothing, empty = np.zeros(len(grid), bool), np.zeros((3, len(grid)))
        return _Part(empty, np.zeros((len(grid), 3), np.int8), nothing, nothing, np.zeros(len(grid)))
    rows = nearest(block.time, grid)
    index: Times | slice = rows
    if len(rows) and (np.diff(rows) == 1).all():  # one reading in each frame: views, no copies
        index = slice(int(rows[0]), int(rows[-1]) + 1)
    time, status = block.time[index], block.status[index]
    late_ns = (time - grid).astype(float)
    age_ns = 1e9 * unit.age_s(period_ns * 1e-9)
    counts = block.counts[index]
    values: Floats = np.subtract(counts.T, np.atleast_2d(_bias(unit, time)).T, out=np.empty((3, len(grid))))
    values /= unit.known.lsb_per_si[:, None]
    near = np.abs(late_ns) <= int(period_ns / 2)
    if not near.all():  # whatever else there is belongs to other frames
        values, status, late_ns = np.where(near, values, 0.0), status * near, late_ns * near
    late_ns -= age_ns * near
    valid = ((status & (SATURATED | SUSPECT)) == 0) & near
    return _Part(values, _clipped(unit, counts, status), valid, (status & STALE) != 0, late_ns * 1e-9)


def _bias(unit: AlignedSensor, time: Times) -> Floats:
    """(3,) or (n, 3) the bias in counts, at the temperature of the readings where it is known."""
    if unit.element is None:
        return unit.known.bias_lsb
    degc = unit.element.at(np.asarray(time * 1e-9, float))
    return np.where(np.isfinite(degc)[:, None], unit.known.bias_at(np.nan_to_num(degc)), unit.known.bias_lsb)


def _clipped(unit: AlignedSensor, counts: npt.NDArray[Any], status: npt.NDArray[np.uint16]) -> npt.NDArray[np.int8]:
    """(n, 3) the end at which an axis of a triad that is flagged as saturated stands."""
    flagged = (status & SATURATED) != 0
    if not flagged.any():
        return np.zeros(counts.shape, np.int8)
    counts = counts.astype(float)
    at_end = (np.abs(counts) >= _AT_END * unit.end_lsb) & flagged[:, None]
    return np.where(at_end, np.sign(counts), 0).astype(np.int8)


def _motion(grid: Times, mean: Floats, valid: Booleans, late_s: Floats, period_ns: float, directions: Floats) -> Floats:
    """(m, n) what the motion, the array's `mean` (n, 3), did along each axis between the grid and the reading of each
    sensor (s, n); zero where too little is valid to tell.
    """
    slope, curvature = derivatives(grid, mean, gap_ns=5 * period_ns)
    usual_s = (late_s * valid).sum(axis=0) / np.maximum(valid.sum(axis=0), 1)
    motion: Floats = directions @ (slope.T - _SECOND_ORDER * usual_s * curvature.T)
    return motion * np.repeat(late_s, 3, axis=0)
