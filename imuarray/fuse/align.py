"""All sensor axes of one quantity on one time grid, block by block.

The grid is the times of the reference sensor. Each sensor gives its nearest reading within half a frame; what the
motion did between the two instants is taken out with the slope of the array's own mean, which is far quieter than one
sensor, so that no reading is smoothed by its neighbours. Values are calibrated, in SI, along each sensor axis, with the
bias at the temperature of the reading where that is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.segments import Thermometer
from imuarray.errors import FusionError
from imuarray.fuse.splines import between_gaps
from imuarray.log import SensorLog
from imuarray.log.format import SATURATED, SUSPECT
from imuarray.units import SI_PER_UNIT

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

BLOCK = 1 << 14
"""Frames that are worked on at once; the result does not depend on it."""

_NOT_KNOWN: Mapping[str, Thermometer] = MappingProxyType({})

_MARGIN = 32
"""Frames of overlap between blocks: a cubic spline forgets its ends by a factor of 3.7 a knot."""


@dataclass(frozen=True)
class Axis:
    """One sensor axis: where it points in the box frame (unit vector) and what it is.

    `in_plane` is True for x and y, which lie in the plane of the chip; `range_si` the end of the measuring range, and
    `noise_si` the standard deviation of a reading (None: unknown), in m/s2 or rad/s.
    """

    sensor: str
    chip: str
    index: int
    direction_box: tuple[float, float, float]
    range_si: float
    noise_si: float | None

    @property
    def in_plane(self) -> bool:
        """True for x and y, which lie in the plane of the silicon; z stands on it."""
        return self.index < 2


@dataclass(frozen=True)
class Frames:
    """n frames of m axes: time (n,) ns, values (n, m) in SI along each axis, valid (n, m): there is a reading, no
    flag throws doubt on it, and its triad is off the ends of its range (a clipped reading is a bound, not a
    value).
    """

    time: Times
    values: Floats
    valid: Flags


def axes_of(sensors: Sequence[SensorLog], calibration: Calibration) -> list[Axis]:
    """Every axis of `sensors`, in order."""
    axes = []
    for sensor in sensors:
        known = calibration.of(sensor)
        for index, direction in enumerate(known.directions_box):
            noise = None if known.noise_lsb is None else float(known.noise_lsb[index] / known.lsb_per_si[index])
            x, y, z = (float(part) for part in direction)
            axes.append(
                Axis(sensor.name, sensor.chip, index, (x, y, z), sensor.range * SI_PER_UNIT[sensor.unit], noise)
            )
    return axes


def directions(axes: Sequence[Axis]) -> Floats:
    """(m, 3) unit vectors of the axes in the box frame: values = directions @ truth_box + errors."""
    return np.array([axis.direction_box for axis in axes])


def frames(
    sensors: Sequence[SensorLog],
    calibration: Calibration,
    reference: SensorLog,
    block: int = BLOCK,
    temperatures: Mapping[str, Thermometer] = _NOT_KNOWN,
) -> Iterator[Frames]:
    """The log's frames on the reference sensor's times, `block` at a time; FusionError if there are fewer than
    three. The bias of a sensor in `temperatures` (of its element, see `element_temperatures`) follows these.
    """
    total = len(reference)
    if total < 3:
        raise FusionError(f"{reference.where}: {total} rows, nothing to fuse")
    known = [calibration.of(sensor) for sensor in sensors]
    rows = directions(axes_of(sensors, calibration))
    period_ns = float(np.median(np.diff(np.asarray(reference.time[: BLOCK + 1]))))  # one for all blocks
    for start in range(0, total, block):
        first, last = max(0, start - _MARGIN), min(total, start + block + _MARGIN)
        grid = np.asarray(reference.time[first:last])
        parts = [
            _nearest(sensor, cal, temperatures.get(sensor.name), grid, period_ns)
            for sensor, cal in zip(sensors, known, strict=True)
        ]
        values = np.concatenate([part.values for part in parts], axis=1)
        valid = np.repeat(np.stack([part.valid for part in parts], axis=1), 3, axis=1)
        late_s = np.repeat(np.stack([part.late_s for part in parts], axis=1), 3, axis=1)
        values -= late_s * (_slope(grid, values, valid, rows, period_ns) @ rows.T)
        inner = slice(start - first, start - first + min(block, total - start))
        yield Frames(grid[inner], values[inner], valid[inner])


class _Nearest(NamedTuple):
    """One sensor on the grid: values (n, 3) in SI along its axes; valid and late_s (n,)."""

    values: Floats
    valid: Flags
    late_s: Floats


def _nearest(
    sensor: SensorLog, known: SensorCalibration, warm: Thermometer | None, grid: Times, period_ns: float
) -> _Nearest:
    """The readings nearest to each grid time, within half a frame."""
    half_ns = int(period_ns / 2)
    rows = sensor.between(int(grid[0]) - half_ns, int(grid[-1]) + half_ns + 1)
    time = np.asarray(sensor.time[rows])
    if len(time) == 0:
        return _Nearest(np.zeros((len(grid), 3)), np.zeros(len(grid), bool), np.zeros(len(grid)))
    after = np.minimum(np.searchsorted(time, grid), len(time) - 1)
    before = np.maximum(after - 1, 0)
    index = np.where(grid - time[before] <= time[after] - grid, before, after)
    late_ns = (time[index] - grid).astype(float)
    status = np.asarray(sensor.status[rows])[index]
    bias = known.bias_lsb if warm is None else known.bias_at(warm.at(time[index] * 1e-9))
    values = (np.asarray(sensor.counts[rows], float)[index] - bias) / known.lsb_per_si
    valid = ((status & (SATURATED | SUSPECT)) == 0) & (np.abs(late_ns) <= half_ns)
    return _Nearest(values, valid, late_ns * 1e-9)


def _slope(grid: Times, values: Floats, valid: Flags, rows: Floats, period_ns: float) -> Floats:
    """(n, 3) change per second of the array's plain mean; zero where too little is valid to tell."""
    mean = solve_frames(values, valid.astype(float), rows)
    return np.nan_to_num(between_gaps(grid, mean, grid, gap_ns=5 * period_ns, derivative=1))


def solve_frames(values: Floats, weights: Floats, rows: Floats) -> Floats:
    """Weighted least squares of ``values = rows @ truth_box`` for each frame: (n, 3), NaN where the axes do not span
    space.
    """
    if (weights == weights[0]).all():  # the usual case: one gain for the whole block
        gain, solvable = _gains(weights[:1], rows)
        return np.asarray(values @ gain[0].T if solvable[0] else np.full((len(values), 3), np.nan))
    gains, solvable = _gains(weights, rows)
    solution = np.einsum("nim,nm->ni", gains, values)
    solution[~solvable] = np.nan
    return np.asarray(solution)


def _gains(weights: Floats, rows: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """(n, 3, m) gains that turn axis values into a triad, and whether the weighted axes span space at all."""
    normal = np.einsum("nm,mi,mj->nij", weights, rows, rows, optimize=True)
    size = np.maximum(np.trace(normal, axis1=1, axis2=2), 1e-300)
    solvable = np.asarray(np.linalg.det(normal) > 1e-9 * size**3)
    normal[~solvable] = np.eye(3)
    return np.linalg.solve(normal, rows.T[None] * weights[:, None, :]), solvable
