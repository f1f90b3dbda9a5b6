"""A fused result as a file: HDF5, format "imuarray-fused", with the names of a log's `/truth`.

::

    /       attrs: format="imuarray-fused" format_version=1 epoch technique log calibration software
    /fused  time (n,) int64 ns since epoch
            specific_force (n, 3) m/s2, angular_rate (n, 3) rad/s, box frame; NaN: not enough axes
            specific_force_covariance (n, 6) (m/s2)^2, ...: xx yy zz xy xz yz (attr columns); NaN: a noise is not known
            specific_force_used (n, s) uint8, ...: which axes of each sensor (attr sensors) went into it: 1 x, 2 y, 4 z
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from imuarray import __version__
from imuarray.atomic import whole_file
from imuarray.errors import LogError
from imuarray.fuse.frames import ENTRIES, FusedBlock
from imuarray.log.guard import open_file
from imuarray.log.heaps import Inspected
from imuarray.log.inspection import refuse_hostile
from imuarray.log.room import free_bytes
from imuarray.units import INERTIAL

_SLACK_BYTES = 1 << 18
"""What HDF5 holds back or adds: a chunk of each column, and where they are."""

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "specific_force": "m s-2",
        "angular_rate": "rad s-1",
        "specific_force_covariance": "m2 s-4",
        "angular_rate_covariance": "rad2 s-2",
        "specific_force_used": "1",
        "angular_rate_used": "1",
    }
)

_COVARIANCE, _USED = "_covariance", "_used"


def write_fused(
    path: str | PathLike[str],
    blocks: Iterable[FusedBlock],
    *,
    epoch: str,
    technique: str,
    log: str,
    calibration: str = "",
    sensors: Mapping[str, Sequence[str]] = MappingProxyType({}),
    force: bool = False,
    progress: Callable[[int], None] = lambda frames: None,
) -> int:
    """Write blocks as they come, under a temporary name until all are there; the number of frames. `sensors` names, per
    quantity, those whose use a block tells. OutputExistsError, OutputError.
    """
    with whole_file(path, force=force) as draft, h5py.File(draft, "w") as file:
        file.attrs.update(
            format="imuarray-fused", format_version=1, epoch=epoch, technique=technique, log=log,
            calibration=calibration, software=f"imuarray {__version__}",
        )  # fmt: skip
        frames = 0
        for block in blocks:
            _ask_for_room(draft, block)
            _append(file.require_group("fused"), block, epoch, sensors)
            file.flush()
            frames += len(block.time)
            progress(frames)
    return frames


@dataclass(frozen=True)
class FusedHead:
    """What a fused file says of itself: `log` and `calibration` are the paths it was made from, `sensors` names, per
    quantity, those whose use it tells.
    """

    technique: str
    log: str
    calibration: str
    epoch: str
    frames: int
    sensors: Mapping[str, tuple[str, ...]]


def read_fused_head(path: str | PathLike[str]) -> FusedHead:
    """The head of a file that `write_fused` wrote; LogError for another one, or one built to do harm."""
    with _opened(Path(path)) as file:
        group = file["fused"]
        sensors = {
            name.removesuffix(_USED): tuple(str(one) for one in group[name].attrs.get("sensors", ()))
            for name in group
            if name.endswith(_USED)
        }
        technique, log, calibration, epoch = (
            str(file.attrs.get(name, "")) for name in ("technique", "log", "calibration", "epoch")
        )
        return FusedHead(technique, log, calibration, epoch, int(group["time"].shape[0]), sensors)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """A fused file that does no harm; LogError."""
    with open_file(path) as file:
        with h5py.File(Inspected(path), "r") as inspected:
            refuse_hostile(file, inspected, str(path))
        if str(file.attrs.get("format")) != "imuarray-fused" or "time" not in file.get("fused", {}):
            raise LogError(f"{path}: no fused result")
        yield file


def read_fused(path: str | PathLike[str], block: int = 1 << 14) -> Iterator[FusedBlock]:
    """The blocks of a file that `write_fused` wrote, `block` frames at a time; LogError for one built to do harm."""
    with _opened(Path(path)) as file:
        group = file["fused"]
        for start in range(0, group["time"].shape[0], block):
            rows = slice(start, start + block)
            yield FusedBlock(
                group["time"][rows],
                {name: group[name][rows] for name in group if name in INERTIAL},
                _parts(group, _COVARIANCE, rows),
                _parts(group, _USED, rows),
            )


def _parts(group: h5py.Group, suffix: str, rows: slice) -> dict[str, npt.NDArray[Any]]:
    """Rows of the columns with a suffix, by quantity."""
    return {name.removesuffix(suffix): group[name][rows] for name in group if name.endswith(suffix)}


def _ask_for_room(path: Path, block: FusedBlock) -> None:
    """OSError where there is no room for a block, before HDF5 runs into it: that it does not survive."""
    wanted = _SLACK_BYTES + sum(rows.nbytes for rows in _columns(block).values())
    if free_bytes(path) < wanted:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _columns(block: FusedBlock) -> dict[str, npt.NDArray[Any]]:
    """The columns of a block by name."""
    covariances = {name + _COVARIANCE: rows.astype(np.float32) for name, rows in block.covariances.items()}
    used = {name + _USED: np.asarray(rows) for name, rows in block.used.items()}
    return {"time": block.time, **block.triads, **covariances, **used}


def _append(group: h5py.Group, block: FusedBlock, epoch: str, sensors: Mapping[str, Sequence[str]]) -> None:
    for name, rows in _columns(block).items():
        if name not in group:
            tail = rows.shape[1:]
            column = group.create_dataset(
                name,
                (0, *tail),
                rows.dtype,
                maxshape=(None, *tail),
                chunks=(4096, *tail),
                compression="gzip",
                shuffle=True,
            )
            column.attrs["units"] = UNITS.get(name, f"nanoseconds since {epoch}")
            if name.endswith(_COVARIANCE):
                column.attrs["columns"] = list(ENTRIES)
            elif name.endswith(_USED) and (names := sensors.get(name.removesuffix(_USED))):
                column.attrs["sensors"] = list(names)
        dataset = group[name]
        dataset.resize(dataset.shape[0] + len(rows), axis=0)
        dataset[-len(rows) :] = rows
