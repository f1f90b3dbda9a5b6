"""The fused output of the last seconds: from the result that is written beside the log, else the simple average of the
rows at hand.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import LogError
from imuarray.fuse import FusedBlock, fuse
from imuarray.log import Log
from imuarray.log.guard import DAMAGE, open_file
from imuarray.log.heaps import Inspected
from imuarray.log.inspection import refuse_hostile
from imuarray.monitor.snapshot import Floats, FusedView
from imuarray.units import INERTIAL

TECHNIQUE = "mean"
_LAST_NS = 1_000_000_000


def fused_now(log: Log, calibration: Calibration) -> FusedView:
    """The average of the sensors of `log`, which holds the last seconds; ImuArrayError says why it can't be had."""
    blocks = list(fuse(log, calibration, TECHNIQUE))
    time = np.concatenate([block.time for block in blocks])
    known = blocks[0].triads
    triads = {quantity: np.concatenate([block.triads[quantity] for block in blocks]) for quantity in known}
    return _view(TECHNIQUE, bool(calibration.sensors), FusedBlock(time, triads))


def fused_beside(path: Path, epoch: str, start_ns: int) -> FusedView | None:
    """The last rows of `RUN_fused.h5` beside the log at `path`, from `start_ns` on; None if it is not there, is of
    another log or ends before.
    """
    beside = path.with_name(f"{path.stem}_fused{path.suffix}")
    if not beside.is_file():
        return None
    try:
        with open_file(beside) as file:
            with h5py.File(Inspected(beside), "r") as inspected:
                refuse_hostile(file, inspected, str(beside))
            if str(file.attrs.get("epoch", "")) != epoch:
                return None
            group = file["fused"]
            first = _first_at(group["time"], start_ns)
            time = np.asarray(group["time"][first:], np.int64)
            triads: dict[str, Floats] = {
                str(name): np.asarray(group[name][first:], float) for name in INERTIAL if name in group
            }
            if len(time) < 2 or any(triad.shape != (len(time), 3) for triad in triads.values()):
                return None
            technique = str(file.attrs.get("technique", "fused"))
            return _view(technique, bool(file.attrs.get("calibration", "")), FusedBlock(time, triads))
    except (LogError, *DAMAGE):
        return None


def _first_at(time: h5py.Dataset, at_ns: int) -> int:
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
