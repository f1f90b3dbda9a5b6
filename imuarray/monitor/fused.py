"""The fused output of the last seconds: from the result that is written beside the log, else the simple average of the
rows at hand.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import LogError
from imuarray.fuse import FusedBlock, fuse
from imuarray.fuse.fused_file import fused_columns, rows_of
from imuarray.log import Log
from imuarray.log.column import NamedColumn
from imuarray.monitor.snapshot import Floats, FusedView
from imuarray.units import INERTIAL

TECHNIQUE = "mean"
_LAST_NS = 1_000_000_000


def fused_now(log: Log, calibration: Calibration) -> FusedView:
    """The average of the sensors of `log`, which holds the last seconds; ImuArrayError says why it can't be had."""
    block = FusedBlock.joined(list(fuse(log, calibration, TECHNIQUE)))
    return _view(TECHNIQUE, bool(calibration.sensors), block)


def fused_beside(path: Path, epoch: str, start_ns: int) -> FusedView | None:
    """The last rows of `RUN_fused.h5` beside the log at `path`, from `start_ns` on; None if it is not there, is of
    another log or ends before.
    """
    beside = path.with_name(f"{path.stem}_fused{path.suffix}")
    if not beside.is_file():
        return None
    try:
        with fused_columns(beside) as (said, columns):
            if said.get("epoch") != epoch:
                return None
            first, last = _first_at(columns["time"], start_ns), rows_of(columns)
            time = np.asarray(columns["time"][first:last], np.int64)
            triads: dict[str, Floats] = {
                name: np.asarray(columns[name][first:last], float) for name in INERTIAL if name in columns
            }
            if len(time) < 2:
                return None
            technique = said.get("technique", "fused")
            return _view(technique, bool(said.get("calibration")), FusedBlock(time, triads))
    except LogError:
        return None


def _first_at(time: NamedColumn, at_ns: int) -> int:
    """The first row whose time is `at_ns` or later; by bisection."""
    low, high = 0, int(time.shape[0])
    while low < high:
        middle = (low + high) // 2
        low, high = (middle + 1, high) if int(time[middle]) < at_ns else (low, middle)
    return low


def _view(technique: str, calibrated: bool, block: FusedBlock) -> FusedView:
    last = block.time >= block.time[-1] - _LAST_NS
    means, noise = {}, {}
    for quantity, triad in block.triads.items():
        known = np.isfinite(triad).all(axis=1)
        means[quantity] = triad[last & known].mean(axis=0) if (last & known).any() else np.full(3, np.nan)
        steps = np.diff(triad[known], axis=0)
        noise[quantity] = np.std(steps, axis=0) / np.sqrt(2) if len(steps) > 1 else np.full(3, np.nan)
    return FusedView(technique, calibrated, block.time, block.triads, means, noise)
