"""Moments of the readings and temperatures in equal parts of a phase."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Indices, Integers, Times
from imuarray.gap.recording.recordings import Temperature
from imuarray.series import part_powers

POWERS = 4
"""Highest power of the readings that is summed."""


@dataclass(frozen=True)
class Segments:
    """s parts of a phase, of `width_s` each; nan where a part has no readings.

    `rows` (s,) is the number of rows and `time_s` (s,) their mean time; `temperature_degc` (s,) is the reference
    temperature at that time and `warming_degc_per_s` (s,) its mean rate of change over the part; `mean` (s, 3) and the
    central moments `variance`, `third`, `fourth` (s, 3), divided by the number of rows, are in counts and their powers;
    `thermometer` (s,) is the mean count of the chip's own thermometer, nan if it has none.
    """

    width_s: float
    rows: Integers
    time_s: Floats
    temperature_degc: Floats
    warming_degc_per_s: Floats
    mean: Floats
    variance: Floats
    third: Floats
    fourth: Floats
    thermometer: Floats

    @cached_property
    def steady_variance(self) -> Floats:
        """Variance (s, 3) less that of a straight line through the part; at least 1/12, the variance of rounding.

        The slope of the line follows from the means of the neighbouring parts: a change by c in equal steps has a
        variance of c^2 / 12.
        """
        change = np.zeros_like(self.mean)
        if len(change) > 1:
            change[1:-1] = (self.mean[2:] - self.mean[:-2]) / 2
            change[0], change[-1] = self.mean[1] - self.mean[0], self.mean[-1] - self.mean[-2]
        # next to a part without readings the change is nan, and the variance is not reduced
        return np.asarray(np.fmin(self.variance, np.maximum(self.variance - change * change / 12, 1 / 12)))


class SegmentTally:
    """Accumulates powers of the readings of [start_ns, end_ns) in `count` parts, for several `replicates` at once whose
    rows have the same times.
    """

    def __init__(self, start_ns: int, end_ns: int, count: int, replicates: int = 1) -> None:
        self._edges = start_ns + (np.arange(count + 1) * (end_ns - start_ns)) // count
        self._rows = np.zeros(count, np.int64)
        self._since_ns = np.zeros(count)
        self._powers = np.zeros((POWERS, count, 3 * replicates))
        self._thermometer = np.zeros((replicates, count))
        self._has_thermometer = False

    def update(self, time_ns: Times, apart: Floats, thermometers: npt.NDArray[np.int16] | None) -> None:
        """Add rows: times (n,), deviations (3 r, n) of counts from an origin, and the thermometers' counts (r, n), or
        (n,) for a single replicate.
        """
        part, starts, rows = self._parts(time_ns)
        self._rows[part] += rows
        self._since_ns[part] += np.add.reduceat(np.asarray(time_ns - self._edges[0], float), starts)
        compiled = part_powers(apart, starts)
        self._powers[:, part] += _part_powers(apart, starts) if compiled is None else compiled
        if thermometers is not None:
            self._has_thermometer = True
            self._thermometer[:, part] += np.add.reduceat(np.atleast_2d(thermometers).astype(float), starts, axis=1)

    def result(self, origin: Floats, temperature: Temperature) -> Segments:
        """Return the parts of the only replicate; `origin` (3,) is the reading in counts that was subtracted."""
        (segments,) = self.results(origin, temperature)
        return segments

    def results(self, origin: Floats, temperature: Temperature) -> list[Segments]:
        """Return the parts of each replicate; `origin` (3 r,)."""
        rows = np.where(self._rows, self._rows, np.nan)
        replicates, mean_ns = len(self._thermometer), self._since_ns / rows
        widths_ns = self._edges[1:] - self._edges[:-1]
        widths_s = widths_ns * 1e-9
        at_ns = self._edges[0] + np.rint(np.where(self._rows, mean_ns, widths_ns / 2)).astype(np.int64)
        ends_degc = np.asarray(temperature(self._edges), float)
        times = (
            float(widths_s.mean()),
            self._rows.copy(),
            (self._edges[0] + mean_ns) * 1e-9,
            np.asarray(temperature(at_ns), float),
            (ends_degc[1:] - ends_degc[:-1]) / widths_s,
        )
        mean, variance, third, fourth = (split_replicates(moment, replicates) for moment in self._moments(origin, rows))
        thermometer = self._thermometer / (rows if self._has_thermometer else np.nan)
        return [
            Segments(*times, mean[at], variance[at], third[at], fourth[at], thermometer[at]) for at in range(replicates)
        ]

    def _moments(self, origin: Floats, rows: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the means (s, 3 r) and the second to fourth central moments (s, 3 r)."""
        first, second, third, fourth = self._powers / rows[:, None]
        square = first * first
        return (
            first + origin,
            np.maximum(second - square, 0.0),
            third - (3 * second - 2 * square) * first,
            fourth - (4 * third - (6 * second - 3 * square) * first) * first,
        )

    def _parts(self, time_ns: Times) -> tuple[Indices, Indices, Indices]:
        """Return the parts that contain the times, the first row of each part and its number of rows."""
        ends = np.searchsorted(self._edges, time_ns[[0, -1]], side="right") - 1
        part = np.arange(ends[0], ends[1] + 1)
        starts = np.searchsorted(time_ns, self._edges[part])
        starts[0] = 0
        rows = np.concatenate([starts[1:], [len(time_ns)]]) - starts
        return part[rows > 0], starts[rows > 0], rows[rows > 0]


def _part_powers(apart: Floats, starts: Indices) -> Floats:
    """Return what `imuarray.series.part_powers` returns, without compiled code."""
    powers = np.empty((POWERS, *apart.shape))
    powers[0] = apart
    for power in range(1, POWERS):
        np.multiply(powers[power - 1], apart, out=powers[power])
    return np.asarray(np.add.reduceat(powers, starts, axis=2).transpose(0, 2, 1))


def split_replicates(columns: Floats, replicates: int) -> Floats:
    """Split joint columns (n, 3 r) into those of each replicate (r, n, 3)."""
    return np.ascontiguousarray(columns.reshape(len(columns), replicates, 3).swapaxes(0, 1))
