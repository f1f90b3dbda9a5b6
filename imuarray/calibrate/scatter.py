"""How single readings scatter at rest, and the colour of it: size, correlation from one reading to the next, lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.noise_lines import noise_lines
from imuarray.calibrate.sound_readings import SEGMENT_ROWS, Readings, Stretches, clock_of, readings, runs_of
from imuarray.calibrate.stability import NoiseLine
from imuarray.characterise.correlation import Autocovariance

Floats = npt.NDArray[np.float64]

_ENOUGH_SEGMENTS = 16
"""From so many on, their variances tell how sure the pooled one is; fewer tell less than the law of white noise."""


@dataclass(frozen=True)
class Scatter:
    """Standard deviation of single readings (3,) in counts about the means of segments and its standard error; the
    correlation of neighbouring readings (3,), 0 on an axis that doesn't scatter, None where no readings are neighbours;
    the lines, axis by axis.
    """

    rms_lsb: Floats
    rms_sem_lsb: Floats
    correlation: Floats | None
    lines: tuple[NoiseLine, ...]


def scatter_of(stretches: Stretches, false_alarm: float) -> Scatter | None:
    """Pooled over the `stretches` of one sensor at rest; None if no segment of any has two sound readings.

    `false_alarm` is the chance that the spectrum of an axis without lines shows one.
    """
    clock = clock_of(stretches)
    products = Autocovariance(lags=1, columns=3, segment_rows=SEGMENT_ROWS)
    pooled = _Pooled()
    for sensor, rows in stretches:
        for part in readings(sensor, rows, clock.limit_ns):
            pooled.add(part)
            for is_first, run in runs_of(part):
                if is_first:
                    products.end_run()
                products.update(run)
        products.end_run()
    if pooled.freedom == 0:
        return None
    rms = pooled.rms_lsb()
    lines = noise_lines(stretches, clock, rms, false_alarm)
    return Scatter(rms, pooled.rms_sem_lsb(), _neighbours(products), lines)


class _Pooled:
    """Sums of squares about the means of segments, over all segments."""

    def __init__(self) -> None:
        self.freedom = 0
        self._segments = 0
        self._squares = np.zeros(3)
        self._freedom_squares = 0.0
        self._mixed = np.zeros(3)
        self._squares_squares = np.zeros(3)

    def add(self, part: Readings) -> None:
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
