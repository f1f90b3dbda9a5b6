"""How single readings scatter at rest, and the colour of it: size, correlation from one reading to the next, lines.

Rows are read a block at a time. Stale, saturated and suspect rows are left out; readings on either side of a gap are no
neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.stability import NoiseLine
from imuarray.characterise.correlation import Autocovariance
from imuarray.characterise.lines import find_lines
from imuarray.characterise.noise import LEFT_OUT
from imuarray.characterise.spectrum import SEGMENT, Spectrum, Welch
from imuarray.characterise.stretch import GAP, broken_rows
from imuarray.log import SensorLog

Floats = npt.NDArray[np.float64]
Stretches = Sequence[tuple[SensorLog, slice]]

SEGMENT_ROWS = 256
"""The scatter is taken about the mean of so many rows, so that slow drift is not called noise."""

MOST_LINES = 8
"""Lines of an axis that are kept, the strongest."""

_BLOCK_ROWS = 256 * SEGMENT_ROWS

_AVERAGED = 16
"""A spectrum's segments are so short that the readings fill this many of them, if they can be."""

_ENOUGH_SEGMENTS = 16
"""From so many on, their variances tell how sure the pooled one is; fewer tell less than the law of white noise."""


@dataclass(frozen=True)
class Scatter:
    """Standard deviation of single readings (3,) in counts and its standard error; the correlation of neighbouring
    readings (3,), 0 on an axis that doesn't scatter, None where no readings are neighbours; the lines, axis by axis.
    """

    rms_lsb: Floats
    rms_sem_lsb: Floats
    correlation: Floats | None
    lines: tuple[NoiseLine, ...]


def scatter_of(stretches: Stretches, false_alarm: float) -> Scatter | None:
    """Pooled over the `stretches` of one sensor at rest; None if no segment of any has two sound readings.

    `false_alarm` is the chance that the spectrum of an axis without lines shows one.
    """
    clock, length = _clock(stretches), _spectrum_rows(stretches)
    welch = Welch(clock.rate_hz, length, columns=3) if clock.rate_hz > 0 and length else None
    products = Autocovariance(lags=1, columns=3, segment_rows=SEGMENT_ROWS)
    estimators = (products,) if welch is None else (products, welch)
    pooled = _Pooled()
    for sensor, rows in stretches:
        for part in _readings(sensor, rows, clock.limit_ns):
            pooled.add(part)
            for begins, run in _runs(part):
                for estimator in estimators:
                    if begins:
                        estimator.end_run()
                    estimator.update(run)
    if pooled.freedom == 0:
        return None
    rms = pooled.rms_lsb()
    lines = () if welch is None else _lines(welch.result(), rms, false_alarm)
    return Scatter(rms, pooled.rms_sem_lsb(), _neighbours(products), lines)


class _Clock(NamedTuple):
    """Readings a second, and the interval that is a gap."""

    rate_hz: float
    limit_ns: float


def _clock(stretches: Stretches) -> _Clock:
    """From the first block of the longest stretch; no rate where that has no two sound readings."""
    sensor, rows = max(stretches, key=lambda stretch: stretch[1].stop - stretch[1].start)
    part = slice(rows.start, min(rows.stop, rows.start + _BLOCK_ROWS))
    sound = (np.asarray(sensor.status[part]) & LEFT_OUT) == 0
    intervals = np.diff(np.asarray(sensor.time[part])[sound]).astype(float)
    if len(intervals) == 0:
        return _Clock(0.0, np.inf)
    limit_ns = GAP * float(np.quantile(intervals, 0.75))
    usual = intervals[(intervals > 0) & (intervals <= limit_ns)]
    return _Clock(1e9 / float(usual.mean()) if len(usual) else 0.0, limit_ns)


def _spectrum_rows(stretches: Stretches) -> int:
    """Rows of a spectrum's segment: a power of two that fits in the longest stretch; 0 if that is too short."""
    lengths = [rows.stop - rows.start for _, rows in stretches]
    longest = min(max(lengths), max(SEGMENT_ROWS, sum(lengths) // _AVERAGED), SEGMENT)
    return int(2 ** np.floor(np.log2(longest))) if longest >= SEGMENT_ROWS else 0


class _Readings(NamedTuple):
    """Sound readings of one block: counts (n, 3), the segment of the stretch that each is in, and whether it doesn't
    continue the one before.
    """

    counts: Floats
    segment: npt.NDArray[np.int64]
    is_first: npt.NDArray[np.bool_]


def _readings(sensor: SensorLog, rows: slice, limit_ns: float) -> Iterator[_Readings]:
    last_ns, breaks, breaks_then = -np.inf, 0, 0
    for start in range(rows.start, rows.stop, _BLOCK_ROWS):
        part = slice(start, min(start + _BLOCK_ROWS, rows.stop))
        status = np.asarray(sensor.status[part])
        sound = (status & LEFT_OUT) == 0
        so_far = breaks + np.cumsum(broken_rows(status))
        breaks = int(so_far[-1])
        if not sound.any():
            continue
        time = np.asarray(sensor.time[part])[sound].astype(float)
        apart = np.diff(time, prepend=last_ns) > limit_ns
        apart |= np.diff(so_far[sound], prepend=breaks_then) > 0
        segment = (np.flatnonzero(sound) + start - rows.start) // SEGMENT_ROWS
        yield _Readings(np.asarray(sensor.counts[part], float)[sound], segment, apart)
        last_ns, breaks_then = float(time[-1]), int(so_far[sound][-1])


def _runs(part: _Readings) -> Iterator[tuple[bool, Floats]]:
    """The readings between gaps, and whether there is one before them."""
    edges = np.flatnonzero(part.is_first)
    if len(edges) == 0 or edges[0] > 0:
        yield False, part.counts[: edges[0]] if len(edges) else part.counts
    for begin, end in pairwise([*edges.tolist(), len(part.counts)]):
        yield True, part.counts[begin:end]


class _Pooled:
    """Sums of squares about the means of segments, over all segments."""

    def __init__(self) -> None:
        self.freedom = 0
        self._segments = 0
        self._squares = np.zeros(3)
        self._freedom_squares = 0.0
        self._mixed = np.zeros(3)
        self._squares_squares = np.zeros(3)

    def add(self, part: _Readings) -> None:
        """The readings of a block that ends where a segment does."""
        _, begin, number = np.unique(part.segment, return_index=True, return_counts=True)
        means = np.add.reduceat(part.counts, begin, axis=0) / number[:, None]
        squares = np.add.reduceat((part.counts - np.repeat(means, number, axis=0)) ** 2, begin, axis=0)
        several = number > 1
        squares, freedom = squares[several], number[several] - 1
        self.freedom += int(freedom.sum())
        self._segments += len(freedom)
        self._squares += squares.sum(axis=0)
        self._freedom_squares += float((freedom.astype(float) ** 2).sum())
        self._mixed += freedom @ squares
        self._squares_squares += (squares**2).sum(axis=0)

    def rms_lsb(self) -> Floats:
        """Standard deviation of single readings."""
        return np.asarray(np.sqrt(self._squares / self.freedom))

    def rms_sem_lsb(self) -> Floats:
        """Its standard error, by what the variances of the segments scatter: correlated or not, normal or not."""
        variance = self._squares / self.freedom
        if self._segments < _ENOUGH_SEGMENTS:
            return np.asarray(np.sqrt(variance / (2 * self.freedom)))
        about = self._squares_squares - 2 * variance * self._mixed + variance**2 * self._freedom_squares
        about = np.maximum(about, 0.0) * self._segments / (self._segments - 1)
        return np.asarray(np.sqrt(about) / self.freedom / (2 * np.sqrt(np.where(variance > 0, variance, np.inf))))


def _neighbours(products: Autocovariance) -> Floats | None:
    """Correlation of neighbours (3,); None where there were none."""
    correlation = products.correlation()
    if not np.isfinite(correlation[0]).any() and not products.result().rows:
        return None
    return np.asarray(np.clip(np.nan_to_num(correlation[1]), -1, 1))


def _lines(spectrum: Spectrum, rms_lsb: Floats, false_alarm: float) -> tuple[NoiseLine, ...]:
    """The strongest lines of every axis; a line's share is that of its sine in the variance."""
    found = []
    for index, rms in enumerate(rms_lsb):
        for line in find_lines(spectrum, index, false_alarm).lines[:MOST_LINES]:
            share = min(1.0, line.amplitude**2 / 2 / float(rms) ** 2)
            found.append(
                NoiseLine(
                    "xyz"[index],
                    line.frequency_hz,
                    line.amplitude,
                    share,
                    line.frequency_error_hz,
                    line.amplitude_error,
                )
            )
    return tuple(found)
