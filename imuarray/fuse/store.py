"""A fused result as a file: HDF5, format "imuarray-fused", with the names of a log's `/truth`.

::

    /       attrs: format="imuarray-fused" format_version=1 epoch technique log calibration software
    /fused  time (n,) int64 ns since epoch
            specific_force (n, 3) m/s2, angular_rate (n, 3) rad/s, box frame; NaN: not enough axes
            specific_force_covariance (n, 6) (m/s2)^2, ...: xx yy zz xy xz yz (attr columns); NaN: a noise is not known
            specific_force_used (n, s) uint8, ...: which axes of each sensor (attr sensors) went into it: 1 x, 2 y, 4 z
    /events time (m,) int64 ns since epoch, and text (m,): sensor, kind, state, message: which sensors failed, were left
            out and came back (`imuarray.fuse.FaultEvent`); empty where nobody watched, not there in older files
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import h5py
import numpy as np
import numpy.typing as npt

from imuarray import __version__
from imuarray.atomic import whole_file
from imuarray.errors import OutputError, OutputExistsError
from imuarray.fuse.faults import FaultEvent
from imuarray.fuse.frames import ENTRIES, FusedBlock
from imuarray.fuse.stored_events import StoredEvents
from imuarray.log.format import FUSED
from imuarray.log.room import free_bytes, longest_file

_SLACK_BYTES = 1 << 18
"""What HDF5 holds back or adds: a chunk of each column, and where they are."""

_LEVEL = 1
"""Of the compression: half of a triad's bits are noise, of which the fourth level takes off no more than the first in
two to three times the time.
"""

_AT_ONCE = 1 << 14
"""Frames that are written at once, four chunks: a chunk that is written in parts is packed as often."""

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

FORMAT, FORMAT_VERSION = FUSED, 1

COVARIANCE, USED = "_covariance", "_used"
"""Behind a quantity: the name of a column of its covariances, of the sensors used."""


def write_fused(
    path: str | PathLike[str],
    blocks: Iterable[FusedBlock],
    *,
    epoch: str,
    technique: str,
    log: str,
    calibration: str = "",
    sensors: Mapping[str, Sequence[str]] = MappingProxyType({}),
    events: Sequence[FaultEvent] = (),
    force: bool = False,
    progress: Callable[[int], None] = lambda frames: None,
) -> int:
    """Write blocks as they come, under a temporary name until all are there; the number of frames. `sensors` names, per
    quantity, those whose use a block tells; `events` are read after the last block, so that they may be what `Watch`
    finds in the meantime. OutputExistsError, OutputError.
    """
    about = {"epoch": epoch, "technique": technique, "log": log, "calibration": calibration}
    with whole_file(path, force=force) as draft, h5py.File(draft, "w") as file:
        fused = _Fused(file, draft, about, sensors)
        frames = 0
        for block in _in_chunks(blocks, progress):
            fused.append(block)
            frames += len(block.time)
        for event in events:
            fused.events.append(event)
    return frames


def _in_chunks(blocks: Iterable[FusedBlock], progress: Callable[[int], None]) -> Iterator[FusedBlock]:
    """The same frames in blocks of `_AT_ONCE`, but for the last one; `progress` hears how many have come."""
    waiting: list[FusedBlock] = []
    count = total = 0
    for block in blocks:
        waiting.append(block)
        count, total = count + len(block.time), total + len(block.time)
        progress(total)
        if count >= _AT_ONCE:
            whole = FusedBlock.joined(waiting)
            for start in range(0, count - _AT_ONCE + 1, _AT_ONCE):
                yield whole.part(slice(start, start + _AT_ONCE))
            waiting = [whole.part(slice(count - count % _AT_ONCE, count))]
            count %= _AT_ONCE
    if count:
        yield FusedBlock.joined(waiting)


class LiveFused:
    """A fused result under its own name from its first frames on, to be read (SWMR) while it is written; not
    compressed, which would take the interpreter from a recording for milliseconds. A context manager.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        *,
        epoch: str,
        technique: str,
        log: str,
        calibration: str = "",
        sensors: Mapping[str, Sequence[str]] = MappingProxyType({}),
        force: bool = False,
    ) -> None:
        """OutputExistsError, OutputError."""
        self._path = Path(path)
        if self._path.exists() and not force:
            raise OutputExistsError(path)
        try:
            self._file = h5py.File(path, "w", libver=("v110", "v110"))
        except OSError as error:
            raise OutputError(path, error) from None
        about = {"epoch": epoch, "technique": technique, "log": log, "calibration": calibration}
        self._fused = _Fused(self._file, self._path, about, sensors, compressed=False)
        self.frames = 0

    def append(self, block: FusedBlock) -> None:
        """More frames. OSError."""
        self._fused.append(block)
        self.frames += len(block.time)
        if not self._file.swmr_mode:
            self._file.swmr_mode = True

    def event(self, event: FaultEvent) -> None:
        """What became of a sensor. OSError."""
        self._fused.events.append(event)

    def close(self) -> None:
        """Complete the file; one without frames goes."""
        self._file.close()
        if self.frames == 0:
            self._path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _ask_for_room(path: Path, block: FusedBlock) -> None:
    """OSError where there is no room for a block, before HDF5 runs into it: that it does not survive."""
    wanted = _SLACK_BYTES + sum(rows.nbytes for rows in _columns(block).values())
    limit = longest_file()
    if limit is not None and path.stat().st_size + wanted > limit:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
    if free_bytes(path) < wanted:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _columns(block: FusedBlock) -> dict[str, npt.NDArray[Any]]:
    """The columns of a block by name."""
    covariances = {name + COVARIANCE: rows.astype(np.float32) for name, rows in block.covariances.items()}
    used = {name + USED: np.asarray(rows) for name, rows in block.used.items()}
    return {"time": block.time, **block.triads, **covariances, **used}


class _Fused:
    """An HDF5 file that a result goes into; its columns are made by the first block."""

    def __init__(
        self,
        file: h5py.File,
        path: Path,
        about: Mapping[str, str],
        sensors: Mapping[str, Sequence[str]],
        compressed: bool = True,
    ) -> None:
        file.attrs.update(format=FORMAT, format_version=FORMAT_VERSION, **about, software=f"imuarray {__version__}")
        file.attrs.update(NX_class="NXroot", default="fused")  # what viewers of NeXus files look for
        self._file, self._path, self._sensors = file, path, sensors
        self._group = file.create_group("fused")
        self.events = StoredEvents(file, about["epoch"])
        self._epoch = about["epoch"]
        self._filters: dict[str, Any] = (
            {"compression": "gzip", "compression_opts": _LEVEL, "shuffle": True, "fletcher32": True}
            if compressed
            else {}
        )
        self._live = not compressed
        self._datasets: dict[str, h5py.Dataset] = {}

    def append(self, block: FusedBlock) -> None:
        """More rows of every column. OSError."""
        _ask_for_room(self._path, block)
        columns = _columns(block)
        if not len(self._group):
            signal, *others = block.triads
            self._group.attrs.update(NX_class="NXdata", axes=["time", "."], signal=signal)
            if others:
                self._group.attrs["auxiliary_signals"] = others
        for name in columns.keys() - self._group.keys():
            self._create(name, columns[name])
        for name, rows in columns.items():
            dataset = self._datasets.setdefault(name, self._group[name])
            dataset.resize(dataset.shape[0] + len(rows), axis=0)
            dataset[-len(rows) :] = rows
            if self._live:
                dataset.flush()
        if self._live:
            self._file.flush()

    def _create(self, name: str, rows: npt.NDArray[Any]) -> None:
        tail = rows.shape[1:]
        column = self._group.create_dataset(
            name, (0, *tail), rows.dtype, maxshape=(None, *tail), chunks=(4096, *tail), **self._filters
        )
        column.attrs["units"] = UNITS.get(name, f"nanoseconds since {self._epoch}")
        if name.endswith(COVARIANCE):
            column.attrs["columns"] = list(ENTRIES)
        elif name.endswith(USED) and (names := self._sensors.get(name.removesuffix(USED))):
            column.attrs["sensors"] = list(names)
