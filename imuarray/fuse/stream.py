"""Fusion of rows as they arrive, sensor by sensor, in pieces of any length.

A frame is fused as soon as no later row can change it: it waits for the rows of all sensors up to some frames after it.
A sensor that is silent for longer than a time-out is ignored; the array is fused without it until its rows arrive
again.

Direct combination is a fast path for blocks in which every reading was taken at the time of its frame, none is in
doubt, and the technique gives the axes the same weights in every frame. The result is then one matrix times the counts,
less a constant.

`AxisOffsets` handles frames that lack a reading. Without a calibration, or with an old one, the mean of an array
contains the mean of the biases of its sensors. In a frame without a reading of one of m axes the mean would therefore
jump by about ``(bias - mean bias) / (m - 1)``, and back in the next frame. That is common if each chip samples by its
own oscillator: a sensor that is slower than the frames has no reading from time to time. For such a frame the mean
difference of each axis from the array's mean over the last `RECENT` frames is attached (`Frames.offsets`), with which a
technique of fixed weights keeps the level of the whole array. Only earlier frames are used, so the result is the same
live and from a log. A step remains if a sensor is silent for longer than `RECENT` frames, if no recent frame has
readings of all sensors of the array, and in frames with a clipped reading, which the technique `ranges` handles.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, cast

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import SensorDescription
from imuarray.fuse.alignment import (
    FIRST_ROWS,
    FOREVER_NS,
    MARGIN,
    AlignedSensor,
    FrameGrid,
    RowWindow,
    align,
    choose_grid,
)
from imuarray.fuse.element_temperature import TemperatureSources
from imuarray.fuse.frames import Axis, Estimate, Frames
from imuarray.fuse.least_squares import ConstantGain, FixedWeights, consensus, frame_gains
from imuarray.fuse.pipeline import Out, Pipeline, QuantityPipeline, fused_block
from imuarray.log import Block
from imuarray.log.format import SATURATED, SUSPECT
from imuarray.units import INERTIAL, STANDARD_GRAVITY

RECENT = MARGIN
"""Largest number of frames over which an offset is averaged: its noise is then below a fifth of that of a reading, and
adds little to that of the result. `FusionStream` keeps the same number of frames.
"""

_AT_ONCE = 256
"""Number of frames that are computed together: their windows take some megabytes."""


class AxisOffsets:
    """Adds `Frames.offsets` to consecutive blocks of frames of one quantity; the result does not depend on the lengths
    of the blocks. `directions` (m, 3) are those of the axes in the box frame.
    """

    def __init__(self, directions: Floats) -> None:
        self._directions = directions
        self._values = np.zeros((0, len(directions)))
        self._valid = np.zeros((0, len(directions)), bool)

    def observe(self, frames: Frames) -> None:
        """Store the next block, which needs no offsets."""
        self._values = np.concatenate([self._values, frames.values[-RECENT:]])[-RECENT:]
        self._valid = np.concatenate([self._valid, frames.valid[-RECENT:]])[-RECENT:]

    def __call__(self, frames: Frames) -> Frames:
        """Return the next block, with offsets in frames that lack a reading if the recent frames determine them."""
        every = frames.valid.all()  # by far faster than frame by frame
        lacking = np.zeros(0, int) if every else np.flatnonzero(~frames.valid.all(axis=1) & ~_are_clipped(frames))
        if not len(lacking):
            self.observe(frames)
            return frames
        values = np.concatenate([np.zeros((RECENT, len(self._directions))), self._values, frames.values])
        valid = np.concatenate([np.zeros((RECENT, len(self._directions)), bool), self._valid, frames.valid])
        before = len(self._values)
        offsets, averaged = np.zeros(frames.values.shape), np.zeros(len(frames.time), np.int16)
        for start in range(0, len(lacking), _AT_ONCE):
            some = lacking[start : start + _AT_ONCE]
            windows = some[:, None] + before + np.arange(RECENT)
            offsets[some], averaged[some] = self._recent_offsets(values[windows], valid[windows], frames.valid[some])
        self.observe(frames)
        return replace(frames, offsets=offsets, averaged=averaged) if averaged.any() else frames

    def _recent_offsets(self, values: Floats, valid: Booleans, now: Booleans) -> tuple[Floats, npt.NDArray[np.int16]]:
        """Return the offsets (n, m) of n frames from the windows (n, RECENT, m) before them, and over how many frames
        they are averages (n,); `now` (n, m) are the axes that are valid in the frames themselves.
        """
        recent: Booleans = np.asarray(valid.any(axis=1))
        complete: Booleans = np.asarray((valid | ~recent[:, None]).all(axis=2))
        offsets, averaged = np.zeros(now.shape), np.zeros(len(now), np.int16)
        useful = complete.any(axis=1) & (recent & ~now).any(axis=1)
        patterns, which = np.unique(recent, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            gain, solvable = frame_gains(pattern[None].astype(float), self._directions)
            some = np.flatnonzero((which.reshape(-1) == number) & useful)
            if not solvable[0] or not len(some):
                continue
            counted = complete[some]
            sums = np.where(counted[:, :, None], values[some], 0.0).sum(axis=1)
            mean = sums / counted.sum(axis=1, keepdims=True)
            difference = mean - mean @ gain[0].T @ self._directions.T
            offsets[some] = np.where(pattern, difference, np.where(now[some], 0.0, np.nan))
            averaged[some] = counted.sum(axis=1)
        return offsets, averaged


def _are_clipped(frames: Frames) -> Booleans:
    """Return (n,) whether an axis is at an end of its range."""
    if frames.clipped is None:
        return np.zeros(len(frames.time), bool)
    return np.asarray(frames.clipped.any(axis=1))


Counts = npt.NDArray[Any]


class DirectCombination:
    """Fusion of one quantity by a technique with fixed weights."""

    def __init__(self, technique: FixedWeights, units: Sequence[AlignedSensor]) -> None:
        gain, self._estimate = technique.whole()
        bias = np.concatenate([unit.known.bias_lsb for unit in units])
        scale = np.concatenate([unit.known.lsb_per_si for unit in units])
        self._triads = ConstantGain(gain / scale, bias)

    def __call__(self, counts: Sequence[Counts]) -> Estimate:
        """Return the estimate of frames from the counts (n, 3) of each sensor."""
        return self._estimate(self._triads(counts))


def direct_combinations(
    techniques: Mapping[str, object], units: Mapping[str, Sequence[AlignedSensor]]
) -> dict[str, DirectCombination]:
    """Return the direct combination of every quantity; empty if there is none for one of them."""
    result = {
        quantity: DirectCombination(technique, units[quantity])
        for quantity, technique in techniques.items()
        if isinstance(technique, FixedWeights) and all(_is_plain(unit) for unit in units[quantity])
    }
    return result if len(result) == len(techniques) else {}


def _is_plain(unit: AlignedSensor) -> bool:
    """Return whether the reading of a sensor depends on its counts only, without corrections and delays."""
    known = unit.known
    return unit.element is None and known.g_sensitivity_lsb_per_g is None and not unit.delay_s and not unit.conversion_s


def plain_counts(blocks: Sequence[Block | None], grid: Times) -> list[Counts] | None:
    """Return the counts (n, 3) of each sensor at the times `grid` (n,), n > 0; None unless all exist and are valid."""
    result = []
    for block in blocks:
        if block is None:
            return None
        first = int(np.searchsorted(block.time, grid[0]))
        rows = slice(first, first + len(grid))
        if not np.array_equal(block.time[rows], grid) or (block.status[rows] & (SATURATED | SUSPECT)).any():
            return None
        result.append(block.counts[rows])
    return result


TIMEOUT_S = 3.0
"""Longest time in s to wait for a sensor; a recording writes its rows once per second."""


@dataclass(frozen=True)
class SensorGroup:
    """The sensors of one quantity, by their numbers among all sensors, and the directions (m, 3) of their axes."""

    numbers: tuple[int, ...]
    directions: Floats


class FusionStream(Generic[Out]):
    """Fuses rows as they are pushed; `finish` returns the rest. The result does not depend on the size of the
    pieces.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sequence[SensorDescription]],
        calibration: Calibration,
        factory: Callable[[float], Pipeline[Out]],
        temperatures: TemperatureSources,
        *,
        timeout_s: float = TIMEOUT_S,
        on_remark: Callable[[str], None] = lambda text: None,
    ) -> None:
        """`sensors` by quantity; `factory` creates their pipeline once the seconds from frame to frame are known;
        `temperatures` are those of their elements. `on_remark` receives a sentence when a sensor times out, and when
        its rows arrive again. CalibrationError if the calibration does not fit.
        """
        inertial = [sensor for group in sensors.values() for sensor in group]
        self._feeds = dict(temperatures.feeds)
        self._names = [sensor.name for sensor in inertial]
        self._where = [sensor.where for sensor in inertial]
        self._rows = {name: RowWindow() for name in (*self._names, *(set(self._feeds) - set(self._names)))}
        self._units = [
            AlignedSensor(
                calibration.or_nominal(sensor),
                sensor.range * sensor.sensitivity,
                temperatures.elements.get(sensor.name),
                1 / sensor.rate_hz if sensor.rate_hz > 0 else 0.0,
                (sensor.delay_ns or 0) * 1e-9,
            )
            for sensor in inertial
        ]
        self._delays_ns = {name: round(delay_s * 1e9) for name, delay_s in temperatures.delays_s.items()}
        self._elements = dict(temperatures.elements)
        self._groups: dict[str, SensorGroup] = {}
        self._offsets: dict[str, AxisOffsets] = {}
        self._combined = 0
        """Number of the last frames that were combined directly, and not yet observed for offsets."""
        for quantity, group in sensors.items():
            numbers = tuple(self._names.index(sensor.name) for sensor in group)
            along = np.concatenate([self._units[number].known.directions_box for number in numbers])
            self._groups[quantity] = SensorGroup(numbers, along)
            self._offsets[quantity] = AxisOffsets(self._groups[quantity].directions)
        self._factory = factory
        self._pipeline: Pipeline[Out] | None = None
        self._direct: Mapping[str, DirectCombination] = {}
        self._axes: Mapping[str, Sequence[Axis]] = {}
        self._timeout_ns = timeout_s * 1e9
        self._on_remark = on_remark
        self._silent: set[str] = set()
        self._grid: FrameGrid | None = None
        self._asleep_until_ns = -FOREVER_NS
        """Time up to which rows must be known before the next frames can be complete."""
        self._times: Times = np.zeros(0, np.int64)
        """Times of frames: the last ones that were fused, and those that wait."""
        self._fused = 0
        """Number of these that were fused."""

    @property
    def sensors(self) -> Collection[str]:
        """The sensors whose rows are required."""
        return self._rows.keys()

    @property
    def thermometers(self) -> Collection[str]:
        """The sensors whose temperature is required."""
        return self._feeds.keys()

    @property
    def pipeline(self) -> Pipeline[Out] | None:
        """The pipeline; None before the first frames."""
        return self._pipeline

    @property
    def rows_kept(self) -> int:
        """Number of rows that wait for other sensors, or on which later frames depend."""
        return sum(len(rows) for rows in self._rows.values())

    def push(self, sensor: str, block: Block) -> Iterator[Out]:
        """Push rows of one sensor, and yield the frames that are complete with them, often none. Rows of sensors that
        are not required are ignored; ValueError unless the rows are later than those before.
        """
        if sensor in self._rows and len(block.time):
            self._rows[sensor].append(block)
            if sensor in self._feeds:
                self._feeds[sensor](block)
            yield from self._advance()

    def end(self, sensor: str) -> Iterator[Out]:
        """End a sensor, which has no more rows; yield the frames that are complete without it."""
        if sensor in self._rows:
            self._rows[sensor].ended = True
            yield from self._advance()

    def finish(self) -> Iterator[Out]:
        """Yield the remaining frames; FusionError if every sensor had fewer than three rows."""
        for rows in self._rows.values():
            rows.ended = True
        yield from self._advance()
        if self._pipeline is not None:
            yield from self._pipeline.finish()

    def _advance(self) -> Iterator[Out]:
        """Fuse the complete frames."""
        known_ns = self._known_ns()
        if known_ns < self._asleep_until_ns:
            return
        if self._grid is None or self._pipeline is None:
            self._grid = self._choose_grid(known_ns)
            if self._grid is None:
                return
            self._pipeline = self._factory(self._grid.period_ns * 1e-9)
            self._prepare_direct_combination(self._pipeline)
        final = known_ns == FOREVER_NS
        self._extend(self._grid, known_ns)
        ready = len(self._times) if final else len(self._times) - MARGIN
        if ready - self._fused < (1 if final else MARGIN):  # fewer frames would take as long
            missing = MARGIN - max(ready - self._fused, -MARGIN)
            self._asleep_until_ns = min(known_ns + round(missing * self._grid.period_ns / 2), FOREVER_NS)
            return
        yield from self._fuse(self._pipeline, self._grid, slice(self._fused, ready))
        first = max(0, ready - MARGIN)
        self._times, self._fused = self._times[first:], ready - first
        before_ns = int(self._times[0]) - 2 * self._grid.ahead_ns
        for rows in self._rows.values():
            rows.forget(before_ns)

    def _known_ns(self) -> int:
        """Return the time up to which the rows of all sensors that have not timed out are known."""
        newest_ns = max(rows.newest_ns for rows in self._rows.values())
        known_ns = FOREVER_NS
        for name, rows in self._rows.items():
            if rows.ended:
                continue
            delay_ns = self._delays_ns.get(name, 0)
            reached_ns = rows.newest_ns + delay_ns
            late = newest_ns - max(reached_ns, delay_ns) > self._timeout_ns
            if late != (name in self._silent):
                self._silent ^= {name}
                self._on_remark(f"{name}: {'silent, fused without it' if late else 'fused again'}")
            known_ns = min(known_ns, newest_ns if late else reached_ns)
        return known_ns

    def _choose_grid(self, known_ns: int) -> FrameGrid | None:
        """Return the grid once the first rows of all sensors that have not timed out are known; None before."""
        blocks = [self._rows[name].block for name in self._names]
        first = [np.zeros(0, np.int64) if block is None else block.time[:FIRST_ROWS] for block in blocks]
        waiting = any(
            len(time) < FIRST_ROWS and not self._rows[name].ended and name not in self._silent
            for name, time in zip(self._names, first, strict=True)
        )
        if waiting or known_ns < 0:
            return None
        return choose_grid(first, [group.numbers for group in self._groups.values()], self._where)

    def _extend(self, grid: FrameGrid, known_ns: int) -> None:
        """Append the frames whose times have become certain."""
        blocks = [self._rows[name].block for name in self._names]
        times = grid.times([np.zeros(0, np.int64) if block is None else block.time for block in blocks])
        after_ns = self._times[-1] if len(self._times) else -FOREVER_NS
        certain_ns = known_ns if known_ns == FOREVER_NS else known_ns - grid.ahead_ns
        self._times = np.concatenate([self._times, times[(times > after_ns) & (times <= certain_ns)]])

    def _prepare_direct_combination(self, pipeline: object) -> None:
        """Set up direct combination for the pipeline if possible."""
        if isinstance(pipeline, QuantityPipeline):
            units = {quantity: [self._units[k] for k in group.numbers] for quantity, group in self._groups.items()}
            self._direct, self._axes = direct_combinations(pipeline.techniques, units), pipeline.axes

    def _fuse(self, pipeline: Pipeline[Out], grid: FrameGrid, frames: slice) -> Iterator[Out]:
        """Fuse some of the frames, by direct combination if possible."""
        if self._direct:
            time, blocks = self._times[frames], [self._rows[name].block for name in self._names]
            counts = plain_counts(blocks, time)
            if counts is not None:
                result = {
                    quantity: self._direct[quantity]([counts[number] for number in group.numbers])
                    for quantity, group in self._groups.items()
                }
                self._combined += len(time)
                yield cast(Out, fused_block(time, result, self._axes))  # the result of `QuantityPipeline`
                return
        yield from pipeline(*self._align(grid, frames))

    def _align(self, grid: FrameGrid, selection: slice) -> tuple[dict[str, Frames], dict[str, Floats]]:
        """Return the selected frames by quantity, and their temperatures by sensor."""
        first = max(0, selection.start - MARGIN)
        around = self._times[first : selection.stop + MARGIN]
        inner = slice(selection.start - first, selection.stop - first)
        blocks = [self._rows[name].block for name in self._names]
        frames, combined = {}, {}
        for quantity, group in self._groups.items():
            units = [self._units[number] for number in group.numbers]
            rows = [blocks[number] for number in group.numbers]
            aligned = align(units, rows, around, grid.period_ns, group.directions)
            frames[quantity] = aligned.part(inner)
            combined[quantity] = aligned.part(slice(max(0, inner.start - self._combined), inner.start))
        self._remove_g_sensitivity(frames)
        for quantity, offsets in self._offsets.items():
            offsets.observe(combined[quantity])
            frames[quantity] = offsets(frames[quantity])
        self._combined = 0
        seconds: Floats = np.asarray(around[inner] * 1e-9, float)
        return frames, {name: element.at(seconds) for name, element in self._elements.items()}

    def _remove_g_sensitivity(self, frames: dict[str, Frames]) -> None:
        """Subtract the effect of the specific force from the readings of gyroscopes, as far as it was calibrated."""
        force, rate = (self._groups.get(quantity) for quantity in INERTIAL)
        if force is None or rate is None or all(response is None for response in self._responses(rate)):
            return
        forces = frames["specific_force"]
        force_g = consensus(forces.values, forces.valid, force.directions, "specific_force") / STANDARD_GRAVITY
        for place, response in enumerate(self._responses(rate)):
            if response is not None:
                frames["angular_rate"].values[:, 3 * place : 3 * place + 3] -= np.nan_to_num(force_g) @ response.T

    def _responses(self, group: SensorGroup) -> list[Floats | None]:
        """Return each sensor's response (3, 3), in SI along its axes, to 1 g along each box axis; None if unknown."""
        known = [self._units[number].known for number in group.numbers]
        return [
            None if item.g_sensitivity_lsb_per_g is None else item.g_sensitivity_lsb_per_g / item.lsb_per_si[:, None]
            for item in known
        ]
