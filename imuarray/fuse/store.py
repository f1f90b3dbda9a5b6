"""A fused result as a file: HDF5, format "imuarray-fused", with the names of a log's `/truth`.

::

    /       attrs: format="imuarray-fused" format_version=1 epoch technique log calibration software /fused  time (n,)
    int64 ns since epoch, specific_force (n, 3) m/s2, angular_rate (n, 3) rad/s, box frame; NaN: not enough axes
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Iterator
from os import PathLike
from pathlib import Path

import h5py
import numpy as np

from imuarray import __version__
from imuarray.atomic import whole_file
from imuarray.fuse.fuse import FusedBlock
from imuarray.log.guard import open_file
from imuarray.log.heaps import Inspected
from imuarray.log.inspection import refuse_hostile
from imuarray.log.room import free_bytes

_SLACK_BYTES = 1 << 18
"""What HDF5 holds back or adds: a chunk of each column, and where they are."""

UNITS = {"specific_force": "m s-2", "angular_rate": "rad s-1"}


def write_fused(
    path: str | PathLike[str],
    blocks: Iterable[FusedBlock],
    *,
    epoch: str,
    technique: str,
    log: str,
    calibration: str = "",
    force: bool = False,
    progress: Callable[[int], None] = lambda frames: None,
) -> int:
    """Write blocks as they come, under a temporary name until all are there; the number of frames.
    OutputExistsError, OutputError.
    """
    with whole_file(path, force=force) as draft, h5py.File(draft, "w") as file:
        file.attrs.update(
            format="imuarray-fused", format_version=1, epoch=epoch, technique=technique, log=log,
            calibration=calibration, software=f"imuarray {__version__}",
        )  # fmt: skip
        frames = 0
        for block in blocks:
            _ask_for_room(draft, block)
            _append(file.require_group("fused"), block, epoch)
            file.flush()
            frames += len(block.time)
            progress(frames)
    return frames


def read_fused(path: str | PathLike[str], block: int = 1 << 14) -> Iterator[FusedBlock]:
    """The blocks of a file that `write_fused` wrote, `block` frames at a time; LogError for one built to do harm."""
    with open_file(Path(path)) as file:
        with h5py.File(Inspected(Path(path)), "r") as inspected:
            refuse_hostile(file, inspected, str(path))
        group = file["fused"]
        for start in range(0, group["time"].shape[0], block):
            rows = slice(start, start + block)
            triads = {name: group[name][rows] for name in group if name != "time"}
            yield FusedBlock(group["time"][rows], triads)


def _ask_for_room(path: Path, block: FusedBlock) -> None:
    """OSError where there is no room for a block, before HDF5 runs into it: that it does not survive."""
    wanted = _SLACK_BYTES + block.time.nbytes + sum(rows.nbytes for rows in block.triads.values())
    if free_bytes(path) < wanted:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _append(group: h5py.Group, block: FusedBlock, epoch: str) -> None:
    columns = {"time": block.time, **block.triads}
    for name, rows in columns.items():
        if name not in group:
            tail = rows.shape[1:]
            group.create_dataset(
                name,
                (0, *tail),
                rows.dtype,
                maxshape=(None, *tail),
                chunks=(4096, *tail),
                compression="gzip",
                shuffle=True,
            )
            group[name].attrs["units"] = UNITS.get(name, f"nanoseconds since {epoch}")
        dataset = group[name]
        dataset.resize(dataset.shape[0] + len(rows), axis=0)
        dataset[-len(rows) :] = np.asarray(rows)
