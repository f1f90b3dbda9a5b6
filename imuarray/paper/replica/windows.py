"""What a simulated sensor gave over stretches of time, row by row and nothing kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from imuarray.log.writer import Block
from imuarray.simulate.motion.felt import Motion

Floats = npt.NDArray[np.float64]
Spans = Sequence[tuple[int, int]]

_BLOCK = 1 << 16


class Triad(Protocol):
    """What is read of a simulated sensor."""

    rows: int

    def block(self, start: int, stop: int) -> Block:
        """Rows start ... stop - 1."""


class Window(NamedTuple):
    """A stretch of one sensor: number of readings, mean and standard deviation of x, y, z and its thermometer (4,)."""

    rows: int
    mean: Floats
    std: Floats


class Series(NamedTuple):
    """Every reading of a sensor: ns since the run began (n,), counts (n, 3)."""

    time_ns: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int16]


class Kept:
    """A sensor that keeps what is read of it: a figure needs no second simulation."""

    def __init__(self, sensor: Triad) -> None:
        self.rows = sensor.rows
        self._sensor = sensor
        self._blocks: list[Block] = []

    def block(self, start: int, stop: int) -> Block:
        """Rows start ... stop - 1 of the sensor."""
        self._blocks.append(self._sensor.block(start, stop))
        return self._blocks[-1]

    @property
    def series(self) -> Series:
        """What was read so far, in the order of reading."""
        return Series(*(np.concatenate(column) for column in zip(*(b[:2] for b in self._blocks), strict=True)))


class Line(NamedTuple):
    """A straight line per axis: LSB per degC and LSB at 0 degC (3,)."""

    slope: Floats
    intercept: Floats


def blocks(sensor: Triad) -> Iterator[Block]:
    """All rows of a sensor, a stretch at a time."""
    for start in range(0, sensor.rows, _BLOCK):
        yield sensor.block(start, min(start + _BLOCK, sensor.rows))


def windows(sensor: Triad, spans: Spans) -> list[Window]:
    """What a sensor gave from the first to before the second nanosecond of each span."""
    sums = np.zeros((3, len(spans), 4))
    centre: Floats | None = None
    for block in blocks(sensor):
        told = block.temperature_counts
        column = np.full(len(block.time), np.nan) if told is None else told
        rows = np.column_stack([block.counts, column]).astype(float)  # int16 squares would overflow
        centre = rows[0] if centre is None else centre
        for index, (start, stop) in enumerate(spans):
            part = rows[slice(*np.searchsorted(block.time, (start, stop)))] - centre
            sums[:, index] += np.stack([np.full(4, len(part)), part.sum(axis=0), (part**2).sum(axis=0)])
    return [_window(count, total, squares, centre) for count, total, squares in sums.transpose(1, 0, 2)]


def _window(count: Floats, total: Floats, squares: Floats, centre: Floats | None) -> Window:
    mean = total / count
    std = np.sqrt(np.maximum(squares - count * mean**2, 0) / (count - 1))
    return Window(int(count[0]), mean + (0.0 if centre is None else centre), std)


def line(sensor: Triad, motion: Motion) -> Line:
    """Counts against the box's temperature, by least squares."""
    moments = np.zeros((2, 5))
    for block in blocks(sensor):
        degc = motion.felt(block.time).temperature_degc
        with_one = np.stack([np.ones(len(degc)), degc])
        moments += with_one @ np.column_stack([with_one.T, block.counts])
    intercept, slope = np.linalg.solve(moments[:, :2], moments[:, 2:])
    return Line(slope, intercept)
