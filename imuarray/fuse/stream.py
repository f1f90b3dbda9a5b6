"""Fusion of rows as they arrive, sensor by sensor, in pieces of any length.

A frame is fused as soon as nothing that arrives later can change it: it waits for the rows of all sensors up to some
frames beyond it. A sensor that is silent for longer than a time-out is not waited for; the array is fused without it
until its rows arrive again.

Direct combination is a short cut for blocks in which every reading was taken at the time of its frame, none is in
doubt, and the technique gives the axes the same weights in every frame. The result is then one matrix times the counts,
less a constant.

`AxisOffsets` serves frames that lack a reading. Without a calibration, or with an old one, the mean of an array
contains the mean of the biases of its sensors. In a frame without a reading of one of m axes the mean would therefore
jump by about ``(bias - mean bias) / (m - 1)``, and back in the next frame. That is common where each chip samples by
an oscillator of its own: a sensor that is slower than the frames has none to give from time to time. For such a frame
the mean difference of each axis from the array's mean over the last `RECENT` frames is attached (`Frames.offsets`); a
technique of fixed weights keeps the level of the whole array with it. Only frames before are used, so the result is the
same live and from a log. A step remains where a sensor is silent for longer than `RECENT` frames, where no recent frame
has readings of all sensors of the array, and in frames with a clipped reading: they are for the technique `ranges`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar, cast, runtime_checkable

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import Described
from imuarray.fuse.alignment import FIRST_ROWS, FOREVER_NS, MARGIN, AlignedSensor, FrameGrid, RowWindow, align, choose
from imuarray.fuse.element_temperature import TemperatureSources
from imuarray.fuse.frames import Estimate, Frames, axes_of, directions
from imuarray.fuse.least_squares import ConstantGain, consensus, frame_gains
from imuarray.fuse.pipeline import ByQuantity, Pipeline, fused_block
from imuarray.log import Block
from imuarray.log.format import SATURATED, SUSPECT
from imuarray.units import INERTIAL, STANDARD_GRAVITY

RECENT = MARGIN
"""Frames over which an offset is averaged: its noise is then below a fifth of one reading's, and of the result's far
less. `FusionStream` keeps no more of them.
"""

_AT_ONCE = 256
"""Frames that are computed together: their windows take some megabytes."""


class AxisOffsets:
    """Completes frames of one quantity by `Frames.offsets`; fed with consecutive blocks, on whose lengths the result
    does not depend. `directions` (m, 3) are those of the axes in the box frame.
    """

    def __init__(self, directions: Floats) -> None:
        self._directions = directions
        self._values = np.zeros((0, len(directions)))
        self._valid = np.zeros((0, len(directions)), bool)

    def observe(self, frames: Frames) -> None:
        """Take note of the next block, which needs no offsets."""
        self._values = np.concatenate([self._values, frames.values[-RECENT:]])[-RECENT:]
        self._valid = np.concatenate([self._valid, frames.valid[-RECENT:]])[-RECENT:]

    def __call__(self, frames: Frames) -> Frames:
        """Return the next block, with the offsets of frames that lack a reading if the recent frames tell them."""
        lacking = np.flatnonzero(~frames.valid.all(axis=1) & ~_clipped(frames))
        if not len(lacking):
            self.observe(frames)
            return frames
        values = np.concatenate([np.zeros((RECENT, len(self._directions))), self._values, frames.values])
        valid = np.concatenate([np.zeros((RECENT, len(self._directions)), bool), self._valid, frames.valid])
        before = len(self._values)
        offsets = np.zeros(frames.values.shape)
        for start in range(0, len(lacking), _AT_ONCE):
            some = lacking[start : start + _AT_ONCE]
            windows = some[:, None] + before + np.arange(RECENT)
            offsets[some] = self._of(values[windows], valid[windows], frames.valid[some])
        self.observe(frames)
        return replace(frames, offsets=offsets) if offsets.any() else frames

    def _of(self, values: Floats, valid: Booleans, now: Booleans) -> Floats:
        """(n, m) offsets of n frames from the windows (n, RECENT, m) before them; `now` (n, m): which axes are valid in
        the frames themselves.
        """
        recent: Booleans = np.asarray(valid.any(axis=1))
        complete: Booleans = np.asarray((valid | ~recent[:, None]).all(axis=2))
        offsets = np.zeros(now.shape)
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
        return offsets


def _clipped(frames: Frames) -> Booleans:
    """(n,) whether an axis stands at an end of its range."""
    if frames.clipped is None:
        return np.zeros(len(frames.time), bool)
    return np.asarray(frames.clipped.any(axis=1))


Counts = npt.NDArray[Any]


@runtime_checkable
class FixedWeighing(Protocol):
    """A technique that does with every whole frame the same."""

    def whole(self) -> tuple[Floats, Callable[[Floats], Estimate]]:
        """The gain (3, m) that makes a triad of values, and what makes the estimate of frames, all axes valid, of their
        triads (n, 3).
        """
        ...


class DirectCombination:
    """One quantity by a technique that weighs alike in every frame."""

    def __init__(self, technique: FixedWeighing, units: Sequence[AlignedSensor]) -> None:
        gain, self._estimate = technique.whole()
        bias = np.concatenate([unit.known.bias_lsb for unit in units])
        scale = np.concatenate([unit.known.lsb_per_si for unit in units])
        self._triads = ConstantGain(gain / scale, bias)

    def __call__(self, counts: Sequence[Counts]) -> Estimate:
        """The estimate of the frames whose counts (n, 3) of each sensor these are."""
        return self._estimate(self._triads(counts))


def direct_combinations(
    techniques: Mapping[str, object], units: Mapping[str, Sequence[AlignedSensor]]
) -> dict[str, DirectCombination]:
    """The short way of every quantity; empty if one of them has none."""
    result = {
        quantity: DirectCombination(technique, units[quantity])
        for quantity, technique in techniques.items()
        if isinstance(technique, FixedWeighing) and all(_is_plain(unit) for unit in units[quantity])
    }
    return result if len(result) == len(techniques) else {}


def _is_plain(unit: AlignedSensor) -> bool:
    """Return whether nothing but its counts says what it feels, and when."""
    known = unit.known
    return unit.element is None and known.g_sensitivity_lsb_per_g is None and not unit.delay_s and not unit.conversion_s


def plain_counts(blocks: Sequence[Block | None], grid: Times) -> list[Counts] | None:
    """The counts (n, 3) of each sensor at the times `grid` (n,), n > 0; None unless all are there and sound."""
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


Out = TypeVar("Out")

TIMEOUT_S = 3.0
"""A recording writes its rows once a second."""


@dataclass(frozen=True)
class SensorGroup:
    """The sensors of one quantity (numbers of all sensors), and where their axes point (m, 3)."""

    numbers: tuple[int, ...]
    directions: Floats


class FusionStream(Generic[Out]):
    """Fuses rows as they are pushed; `finish` gives the rest. The result does not depend on how the rows are cut."""

    def __init__(
        self,
        sensors: Mapping[str, Sequence[Described]],
        calibration: Calibration,
        making: Callable[[float], Pipeline[Out]],
        temperatures: TemperatureSources,
        *,
        timeout_s: float = TIMEOUT_S,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """`sensors` by quantity; `making` makes their pipeline, once it is known how many seconds lie from frame to
        frame; `temperatures` of their elements. `tell` is told which sensor is not waited for any more, and
        which one is back. CalibrationError if the calibration does not fit.
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
        """How many of the last frames were combined directly: their offsets are still to be observed."""
        for quantity, group in sensors.items():
            numbers = tuple(self._names.index(sensor.name) for sensor in group)
            self._groups[quantity] = SensorGroup(numbers, directions(axes_of(group, calibration)))
            self._offsets[quantity] = AxisOffsets(self._groups[quantity].directions)
        self._making = making
        self._pipeline: Pipeline[Out] | None = None
        self._direct: Mapping[str, DirectCombination] = {}
        self._timeout_ns = timeout_s * 1e9
        self._tell = tell
        self._silent: set[str] = set()
        self._grid: FrameGrid | None = None
        self._asleep_until_ns = -FOREVER_NS
        """Nothing can be complete before rows are known up to here."""
        self._times: Times = np.zeros(0, np.int64)
        """Times of frames: the last ones that were given out, and those that wait."""
        self._given = 0
        """How many of them were given out."""

    @property
    def sensors(self) -> Collection[str]:
        """The sensors whose rows it wants."""
        return self._rows.keys()

    @property
    def thermometers(self) -> Collection[str]:
        """Return the sensors whose temperature the technique needs."""
        return self._feeds.keys()

    @property
    def pipeline(self) -> Pipeline[Out] | None:
        """Return the pipeline that is fed; None before the first frames."""
        return self._pipeline

    @property
    def rows_kept(self) -> int:
        """Rows that wait for those of other sensors, or that frames to come depend on."""
        return sum(len(rows) for rows in self._rows.values())

    def push(self, sensor: str, block: Block) -> Iterator[Out]:
        """Rows of one sensor, and what is complete with them: nothing, mostly. Sensors that don't matter are ignored;
        ValueError if the rows don't follow those before.
        """
        if sensor in self._rows and len(block.time):
            self._rows[sensor].append(block)
            if sensor in self._feeds:
                self._feeds[sensor](block)
            yield from self._advance()

    def end(self, sensor: str) -> Iterator[Out]:
        """End a sensor, from which no more rows come; yield what is complete without it."""
        if sensor in self._rows:
            self._rows[sensor].ended = True
            yield from self._advance()

    def finish(self) -> Iterator[Out]:
        """Yield everything that is left; FusionError if there were fewer than three rows of every sensor."""
        for rows in self._rows.values():
            rows.ended = True
        yield from self._advance()
        if self._pipeline is not None:
            yield from self._pipeline.finish()

    def _advance(self) -> Iterator[Out]:
        """Fuse what is complete."""
        known_ns = self._known_ns()
        if known_ns < self._asleep_until_ns:
            return
        if self._grid is None or self._pipeline is None:
            self._grid = self._choice(known_ns)
            if self._grid is None:
                return
            self._pipeline = self._made(self._making(self._grid.period_ns * 1e-9))
        final = known_ns == FOREVER_NS
        self._extend(self._grid, known_ns)
        ready = len(self._times) if final else len(self._times) - MARGIN
        if ready - self._given < (1 if final else MARGIN):  # fewer at a time would cost as much
            missing = MARGIN - max(ready - self._given, -MARGIN)
            self._asleep_until_ns = min(known_ns + round(missing * self._grid.period_ns / 2), FOREVER_NS)
            return
        yield from self._fused(self._pipeline, self._grid, slice(self._given, ready))
        first = max(0, ready - MARGIN)
        self._times, self._given = self._times[first:], ready - first
        self._forget(int(self._times[0]) - 2 * self._grid.ahead_ns)

    def _known_ns(self) -> int:
        """Up to when every row is there that is waited for."""
        newest_ns = max(rows.newest_ns for rows in self._rows.values())
        known_ns = FOREVER_NS
        for name, rows in self._rows.items():
            delay_ns = self._delays_ns.get(name, 0)
            reached_ns = rows.newest_ns + delay_ns
            late = newest_ns - max(reached_ns, delay_ns) > self._timeout_ns
            if late != (name in self._silent) and not rows.ended:
                self._silent ^= {name}
                self._tell(f"{name}: {'silent, fused without it' if late else 'fused again'}")
            if not rows.ended:
                known_ns = min(known_ns, newest_ns if late else reached_ns)
        return known_ns

    def _choice(self, known_ns: int) -> FrameGrid | None:
        """The grid, once the first rows of all sensors that are waited for are there."""
        blocks = [self._rows[name].block for name in self._names]
        first = [np.zeros(0, np.int64) if block is None else block.time[:FIRST_ROWS] for block in blocks]
        waiting = any(
            len(time) < FIRST_ROWS and not self._rows[name].ended and name not in self._silent
            for name, time in zip(self._names, first, strict=True)
        )
        if waiting or known_ns < 0:
            return None
        return choose(first, [group.numbers for group in self._groups.values()], self._where)

    def _extend(self, grid: FrameGrid, known_ns: int) -> None:
        """Frames whose times have become certain."""
        blocks = [self._rows[name].block for name in self._names]
        times = grid.times([np.zeros(0, np.int64) if block is None else block.time for block in blocks])
        after_ns = self._times[-1] if len(self._times) else -FOREVER_NS
        certain_ns = known_ns if known_ns == FOREVER_NS else known_ns - grid.ahead_ns
        self._times = np.concatenate([self._times, times[(times > after_ns) & (times <= certain_ns)]])

    def _made(self, pipeline: Pipeline[Out]) -> Pipeline[Out]:
        """The pipeline, with the short way through it if there is one."""
        if isinstance(pipeline, ByQuantity):
            units = {quantity: [self._units[k] for k in group.numbers] for quantity, group in self._groups.items()}
            self._direct = direct_combinations(pipeline.techniques, units)
        return pipeline

    def _fused(self, pipeline: Pipeline[Out], grid: FrameGrid, wanted: slice) -> Iterator[Out]:
        """The frames of the times `wanted`, by the short way if it leads there."""
        if self._direct and isinstance(pipeline, ByQuantity):
            time, blocks = self._times[wanted], [self._rows[name].block for name in self._names]
            counts = plain_counts(blocks, time)
            if counts is not None:
                result = {
                    quantity: self._direct[quantity]([counts[number] for number in group.numbers])
                    for quantity, group in self._groups.items()
                }
                self._combined += len(time)
                yield cast(Out, fused_block(time, result, pipeline.axes))  # what `QuantityPipeline` gives
                return
        yield from pipeline(*self._frames(grid, wanted))

    def _frames(self, grid: FrameGrid, wanted: slice) -> tuple[dict[str, Frames], dict[str, Floats]]:
        """Frames by quantity, and temperatures by sensor, of the times `wanted`."""
        first = max(0, wanted.start - MARGIN)
        around = self._times[first : wanted.stop + MARGIN]
        inner = slice(wanted.start - first, wanted.stop - first)
        blocks = [self._rows[name].block for name in self._names]
        frames, combined = {}, {}
        for quantity, group in self._groups.items():
            units = [self._units[number] for number in group.numbers]
            rows = [blocks[number] for number in group.numbers]
            aligned = align(units, rows, around, grid.period_ns, group.directions)
            frames[quantity] = aligned.part(inner)
            combined[quantity] = aligned.part(slice(max(0, inner.start - self._combined), inner.start))
        self._felt(frames)
        for quantity, offsets in self._offsets.items():
            offsets.observe(combined[quantity])
            frames[quantity] = offsets(frames[quantity])
        self._combined = 0
        seconds: Floats = np.asarray(around[inner] * 1e-9, float)
        return frames, {name: element.at(seconds) for name, element in self._elements.items()}

    def _felt(self, frames: dict[str, Frames]) -> None:
        """Takes out of what gyroscopes read what they feel of the specific force, as far as that was calibrated."""
        force, rate = (self._groups.get(quantity) for quantity in INERTIAL)
        if force is None or rate is None or all(response is None for response in self._responses(rate)):
            return
        feels = frames["specific_force"]
        force_g = consensus(feels.values, feels.valid, force.directions, "specific_force") / STANDARD_GRAVITY
        for place, response in enumerate(self._responses(rate)):
            if response is not None:
                frames["angular_rate"].values[:, 3 * place : 3 * place + 3] -= np.nan_to_num(force_g) @ response.T

    def _responses(self, group: SensorGroup) -> list[Floats | None]:
        """Return the reading of each sensor of a group, in SI along its axes, under one g along each box axis; None if
        unknown.
        """
        known = [self._units[number].known for number in group.numbers]
        return [
            None if item.g_sensitivity_lsb_per_g is None else item.g_sensitivity_lsb_per_g / item.lsb_per_si[:, None]
            for item in known
        ]

    def _forget(self, before_ns: int) -> None:
        for rows in self._rows.values():
            rows.forget(before_ns)
