"""The fused output of the last seconds: from the result that is written beside the log, else the simple average of the
rows at hand.
"""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import LogError
from imuarray.fuse import FusedBlock, fuse
from imuarray.fuse.fused_file import fused_columns, rows_of
from imuarray.log import Log, first_at
from imuarray.monitor.snapshot import Floats, FusedView
from imuarray.units import INERTIAL

TECHNIQUE = "mean"
_LAST_NS = 1_000_000_000
_PATIENCE_S = (0.02, 0.05, 0.0)
"""Behind each attempt to read a result at the very moment at which it is written."""


def fused_now(log: Log, calibration: Calibration) -> FusedView:
    """The average of the sensors of `log`, which holds the last seconds; ImuArrayError says why it can't be had."""
    block = FusedBlock.joined(list(fuse(log, calibration, TECHNIQUE)))
    return _view(TECHNIQUE, bool(calibration.sensors), block)


def fused_beside(path: Path, epoch: str, start_ns: int, given: Path | None = None) -> FusedView | None:
    """The last rows of the result that is written, or was, beside the log at `path`, from `start_ns` on: `RUN_fused.h5`
    or the file `given`; of a log cut into parts that of the part (`RUN_001_fused.h5`, `GIVEN_001.h5`) or of the whole.
    None if it is not there, is of another log or ends before.
    """
    cut = re.fullmatch(r"(.+)(_\d{3,})", path.stem)
    whole, part = (cut[1], cut[2]) if cut else (path.stem, "")
    if given is None:
        names = [path.with_name(f"{stem}_fused{path.suffix}") for stem in (path.stem, whole)]
    else:
        names = [given.with_stem(given.stem + part), given]
    for beside in dict.fromkeys(names):
        for patience_s in _PATIENCE_S if beside.is_file() else ():
            try:
                view = _read(beside, epoch, start_ns)
            except LogError:  # it was being written just then, or is none
                time.sleep(patience_s)
                continue
            if view is not None:
                return view
            break
    return None


def _read(path: Path, epoch: str, start_ns: int) -> FusedView | None:
    """As it is on the disk now, without a lock that could be in the way of whoever writes it. LogError."""
    with fused_columns(path) as (said, columns):
        if said.get("epoch") != epoch:
            return None
        rows = rows_of(columns)  # the newest may be there in part
        first = first_at(columns["time"], start_ns, rows)
        at_ns = np.asarray(columns["time"][first:rows], np.int64)
        triads: dict[str, Floats] = {
            name: np.asarray(columns[name][first:rows], float) for name in INERTIAL if name in columns
        }
    if len(at_ns) < 2 or not triads:
        return None
    return _view(said.get("technique", "fused"), bool(said.get("calibration")), FusedBlock(at_ns, triads))


def _view(technique: str, calibrated: bool, block: FusedBlock) -> FusedView:
    last = block.time >= block.time[-1] - _LAST_NS
    means, noise = {}, {}
    for quantity, triad in block.triads.items():
        known = np.isfinite(triad).all(axis=1)
        means[quantity] = triad[last & known].mean(axis=0) if (last & known).any() else np.full(3, np.nan)
        steps = np.diff(triad[known], axis=0)
        noise[quantity] = np.std(steps, axis=0) / np.sqrt(2) if len(steps) > 1 else np.full(3, np.nan)
    return FusedView(technique, calibrated, block.time, block.triads, means, noise)
