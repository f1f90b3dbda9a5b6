"""All sensor axes of one quantity on one time grid, block by block.

The grid is the times of the reference sensor. Each sensor gives its nearest reading within half a frame; what the
motion did between the two instants is taken out with the slope of the array's own mean, which is far quieter than one
sensor, so that no reading is smoothed by its neighbours. Values are calibrated, in SI, along each sensor axis, with the
bias at the temperature of the reading where that is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.segments import Thermometer
from imuarray.errors import FusionError
from imuarray.fuse.axes import axes_of, directions
from imuarray.fuse.frames import Flags, Floats, Frames, Times
from imuarray.fuse.solve import solve_frames
from imuarray.fuse.splines import between_gaps
from imuarray.log import SensorLog
from imuarray.log.format import SATURATED, STALE, SUSPECT

BLOCK = 1 << 14
"""Frames that are worked on at once; the result does not depend on it."""

_NOT_KNOWN: Mapping[str, Thermometer] = MappingProxyType({})

_AT_END = 0.95
"""Share of the measuring range beyond which an axis of a triad that is flagged as saturated is the one at its end."""

_MARGIN = 32
"""Frames of overlap between blocks: a cubic spline forgets its ends by a factor of 3.7 a knot."""


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
        stale = np.repeat(np.stack([part.stale for part in parts], axis=1), 3, axis=1)
        clipped = np.concatenate([part.clipped for part in parts], axis=1)
        late_s = np.repeat(np.stack([part.late_s for part in parts], axis=1), 3, axis=1)
        values -= late_s * (_slope(grid, values, valid, rows, period_ns) @ rows.T)
        inner = slice(start - first, start - first + min(block, total - start))
        yield Frames(grid[inner], values[inner], valid[inner], clipped[inner], stale[inner])


class _Nearest(NamedTuple):
    """One sensor on the grid: values and clipped (n, 3) along its axes; valid, stale and late_s (n,)."""

    values: Floats
    clipped: npt.NDArray[np.int8]
    valid: Flags
    stale: Flags
    late_s: Floats


def _nearest(
    sensor: SensorLog, known: SensorCalibration, warm: Thermometer | None, grid: Times, period_ns: float
) -> _Nearest:
    """The readings nearest to each grid time, within half a frame."""
    half_ns = int(period_ns / 2)
    rows = sensor.between(int(grid[0]) - half_ns, int(grid[-1]) + half_ns + 1)
    time = np.asarray(sensor.time[rows])
    if len(time) == 0:
        nothing = np.zeros(len(grid), bool)
        empty = np.zeros((len(grid), 3))
        return _Nearest(empty, empty.astype(np.int8), nothing, nothing, np.zeros(len(grid)))
    after = np.minimum(np.searchsorted(time, grid), len(time) - 1)
    before = np.maximum(after - 1, 0)
    index = np.where(grid - time[before] <= time[after] - grid, before, after)
    late_ns = (time[index] - grid).astype(float)
    status = np.asarray(sensor.status[rows])[index]
    bias = known.bias_lsb if warm is None else known.bias_at(warm.at(time[index] * 1e-9))
    counts = np.asarray(sensor.counts[rows], float)[index]
    values = (counts - bias) / known.lsb_per_si
    valid = ((status & (SATURATED | SUSPECT)) == 0) & (np.abs(late_ns) <= half_ns)
    stale = (status & STALE) != 0
    return _Nearest(values, _clipped(sensor, counts, status), valid, stale, late_ns * 1e-9)


def _clipped(sensor: SensorLog, counts: Floats, status: npt.NDArray[np.uint16]) -> npt.NDArray[np.int8]:
    """(n, 3) the end at which an axis of a triad that is flagged as saturated stands."""
    flagged = (status & SATURATED) != 0
    if not flagged.any():
        return np.zeros(counts.shape, np.int8)
    at_end = (np.abs(counts) >= _AT_END * sensor.range * sensor.sensitivity) & flagged[:, None]
    return np.where(at_end, np.sign(counts), 0).astype(np.int8)


def _slope(grid: Times, values: Floats, valid: Flags, rows: Floats, period_ns: float) -> Floats:
    """(n, 3) change per second of the array's plain mean; zero where too little is valid to tell."""
    mean = solve_frames(values, valid.astype(float), rows)
    return np.nan_to_num(between_gaps(grid, mean, grid, gap_ns=5 * period_ns, derivative=1))
