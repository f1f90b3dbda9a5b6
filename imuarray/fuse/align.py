"""All sensor axes of one quantity on one time grid: a pure function of the readings around it.

Each sensor gives its nearest reading within half a frame, which was made some time before it was read; what the motion
did between the instant of the frame and that one is taken out with the slope of the array's own mean, which is far
quieter than one sensor, so that no reading is smoothed by its neighbours (and of which a sensor that fails does not get
hold: `consensus.py`). Values are calibrated, in SI, along each
sensor axis, with the bias at the temperature of the reading where that is known.

The slope m' of a spline through white noise scatters by 1.18 a frame, and makes the mean of readings whose mean delay
is d noisier by ``9 (2 / sqrt 3 - 1) d^2`` of its variance, d in frames. The curvature m'' goes against the noise of the
mean itself, by ``-6 (sqrt 3 - 1)`` of its variance: a part ``K d^2 m''`` of the second order of Taylor's series, whose
half is wanted, with ``K = 3/8 (1 - 1 / sqrt 3)``, takes back what the slope added, but for terms in d^4, and the
motion is followed the better for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import SensorCalibration
from imuarray.fuse.consensus import consensus
from imuarray.fuse.frames import Flags, Floats, Frames, Times
from imuarray.fuse.grid import nearest
from imuarray.fuse.splines import derivatives
from imuarray.log import Block
from imuarray.log.format import SATURATED, STALE, SUSPECT

MARGIN = 32
"""Frames on either side that frames in between depend on: a cubic spline forgets its ends by a factor of 3.7 a knot."""

_AT_END = 0.95
"""Share of the measuring range beyond which an axis of a triad that is flagged as saturated is the one at its end."""

_Kind = TypeVar("_Kind", bound=np.generic)

_SAME_RATE = 0.1
"""Share by which the chip's rate and that of the frames may differ for them to be one."""

_SECOND_ORDER = 0.375 * (1 - 1 / np.sqrt(3))


class Warmth(Protocol):
    """How warm a sensor's element was."""

    def at(self, time_s: Floats) -> Floats:
        """Degrees (n,) at times (n,) in s since the log's epoch; NaN where it is not known."""
        ...


@dataclass(frozen=True)
class Unit:
    """One sensor of a quantity: its calibration, the end of its range in counts, how warm it was (None: unknown), how
    long it takes to make a reading (0: unknown), and by how much its filter is behind.
    """

    known: SensorCalibration
    end_lsb: float
    warmth: Warmth | None = None
    conversion_s: float = 0.0
    delay_s: float = 0.0

    def age_s(self, period_s: float) -> float:
        """How old a reading is on average when it is read: half a conversion, unless there is one a frame, which then
        has the time at which it was made (a queue's, an imported recording's).
        """
        is_its_own = abs(self.conversion_s - period_s) < _SAME_RATE * period_s
        return self.delay_s + (0.0 if is_its_own else self.conversion_s / 2)


class _Part(NamedTuple):
    """One sensor on the grid: values and clipped (n, 3) along its axes; valid, stale and late_s (n,)."""

    values: Floats
    clipped: npt.NDArray[np.int8]
    valid: Flags
    stale: Flags
    late_s: Floats


def align(
    units: Sequence[Unit], rows: Sequence[Block | None], grid: Times, period_ns: float, directions: Floats
) -> Frames:
    """The frames of one quantity at the times `grid` (n,) from the `rows` of its `units` around them; `directions`
    (m, 3) are those of all their axes in the box frame.

    Frames that are nearer than `MARGIN` to either end of the grid are as the rest only if nothing lies beyond it.
    """
    parts = [_on_grid(unit, block, grid, period_ns) for unit, block in zip(units, rows, strict=True)]
    values = np.concatenate([part.values for part in parts], axis=1)
    valid = _by_axis([part.valid for part in parts])
    late_s = _by_axis([part.late_s for part in parts])
    if late_s.any():
        mean = consensus(values, valid, directions, units[0].known.quantity)
        values -= _motion(grid, mean, valid, late_s, period_ns, directions)
    clipped = np.concatenate([part.clipped for part in parts], axis=1)
    return Frames(grid, values, valid, clipped, _by_axis([part.stale for part in parts]))


def _by_axis(columns: Sequence[npt.NDArray[_Kind]]) -> npt.NDArray[_Kind]:
    """(n, 3 s) from s columns (n,): each sensor's three times."""
    return np.repeat(np.stack(columns, axis=1), 3, axis=1)


def _on_grid(unit: Unit, block: Block | None, grid: Times, period_ns: float) -> _Part:
    """The readings nearest to each grid time, within half a frame."""
    if block is None or len(block.time) == 0:
        nothing, empty = np.zeros(len(grid), bool), np.zeros((len(grid), 3))
        return _Part(empty, empty.astype(np.int8), nothing, nothing, np.zeros(len(grid)))
    index = nearest(block.time, grid)
    time, status = block.time[index], block.status[index]
    late_ns = (time - grid).astype(float)
    age_ns = 1e9 * unit.age_s(period_ns * 1e-9)
    counts = block.counts[index].astype(float)
    values = (counts - _bias(unit, time)) / unit.known.lsb_per_si
    near = np.abs(late_ns) <= int(period_ns / 2)
    if not near.all():  # whatever else there is belongs to other frames
        values, status, late_ns = np.where(near[:, None], values, 0.0), status * near, late_ns * near
    late_ns -= age_ns * near
    valid = ((status & (SATURATED | SUSPECT)) == 0) & near
    return _Part(values, _clipped(unit, counts, status), valid, (status & STALE) != 0, late_ns * 1e-9)


def _bias(unit: Unit, time: Times) -> Floats:
    """(3,) or (n, 3) the bias in counts, at the temperature of the readings where it is known."""
    if unit.warmth is None:
        return unit.known.bias_lsb
    degc = unit.warmth.at(np.asarray(time * 1e-9, float))
    return np.where(np.isfinite(degc)[:, None], unit.known.bias_at(np.nan_to_num(degc)), unit.known.bias_lsb)


def _clipped(unit: Unit, counts: Floats, status: npt.NDArray[np.uint16]) -> npt.NDArray[np.int8]:
    """(n, 3) the end at which an axis of a triad that is flagged as saturated stands."""
    flagged = (status & SATURATED) != 0
    if not flagged.any():
        return np.zeros(counts.shape, np.int8)
    at_end = (np.abs(counts) >= _AT_END * unit.end_lsb) & flagged[:, None]
    return np.where(at_end, np.sign(counts), 0).astype(np.int8)


def _motion(grid: Times, mean: Floats, valid: Flags, late_s: Floats, period_ns: float, directions: Floats) -> Floats:
    """(n, m) what the motion, the array's `mean` (n, 3), did along each axis between the grid and the reading; zero
    where too little is valid to tell.
    """
    slope, curvature = derivatives(grid, mean, gap_ns=5 * period_ns)
    usual_s = (late_s * valid).sum(axis=1, keepdims=True) / np.maximum(valid.sum(axis=1, keepdims=True), 1)
    return np.asarray(late_s * ((slope - _SECOND_ORDER * usual_s * curvature) @ directions.T))
