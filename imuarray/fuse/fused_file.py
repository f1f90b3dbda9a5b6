"""A fused result as a file: its format, writing, and reading with every part checked.

HDF5, format "imuarray-fused", with the names of a log's `/truth`; a reader ignores other columns. Texts have fixed
lengths, because other texts can't be read while a file is written (SWMR).

::

    /       attrs: format="imuarray-fused" format_version=1 epoch technique log calibration software
    /fused  time (n,) int64 ns since epoch
            specific_force (n, 3) m/s2, angular_rate (n, 3) rad/s, box frame; NaN: not enough axes
            specific_force_covariance (n, 6) (m/s2)^2, ...: xx yy zz xy xz yz (attr columns); NaN: a noise is not known
            specific_force_used (n, s) uint8, ...: axes of each sensor (attr sensors) that contribute: 1 x, 2 y, 4 z
            axis, entry, specific_force_sensor, ...: labels of the second dimensions (HDF5 dimension scales, as `time`
            is), so that xarray (engine h5netcdf) opens the group with named dimensions and time as a coordinate
    /events time (m,) int64 ns since epoch, and text (m,): sensor, kind, state, message: sensors that failed, were
            excluded and readmitted (`imuarray.fuse.FaultEvent`); empty without supervision, absent in older files
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, NotRequired, Self, TypedDict, Unpack

import h5py
import numpy as np
import numpy.typing as npt

from imuarray import __version__
from imuarray.arrays import Floats
from imuarray.atomic import whole_file
from imuarray.errors import LogError, OutputError, OutputExistsError
from imuarray.fuse.faults import FaultEvent
from imuarray.fuse.frames import ENTRIES, FusedBlock
from imuarray.log.chunks import ColumnWriter
from imuarray.log.columns import NamedColumn
from imuarray.log.disk_space import free_bytes, longest_file
from imuarray.log.format import FUSED
from imuarray.log.inspection import UnclosedFile, is_marked_open, refuse_hostile
from imuarray.log.untrusted_input import DAMAGE, MAX_TEXT_BYTES, open_file, read_texts
from imuarray.printable import printable
from imuarray.units import INERTIAL

MOST_SENSORS = 1024
"""Largest number of sensors whose use a file can record."""


_KINDS = MappingProxyType({"i": "int64", "f": "float", "u": "uint8"})


@dataclass(frozen=True)
class FusedHead:
    """Description of a fused file: `log` and `calibration` are the paths of the inputs, `sensors` the names, per
    quantity, of the sensors whose use it records.
    """

    technique: str
    log: str
    calibration: str
    epoch: str
    frames: int
    sensors: Mapping[str, tuple[str, ...]]


def is_fused(path: Path) -> bool:
    """Return whether a file declares itself a fused result; nothing else in it is read."""
    with suppress(*DAMAGE), h5py.File(UnclosedFile(path), "r") as file:
        return bool(file.attrs.get("format") == FORMAT)
    return False


def read_fused_head(path: str | PathLike[str]) -> FusedHead:
    """Return the head of a file that `write_fused` wrote; LogError for another or a hostile file."""
    with fused_columns(path) as (head, columns):
        sensors = {
            name.removesuffix(USED): texts_of(column.attrs, "sensors")
            for name, column in columns.items()
            if name.endswith(USED)
        }
        technique, log, calibration, epoch = (
            head.get(name, "") for name in ("technique", "log", "calibration", "epoch")
        )
        return FusedHead(technique, log, calibration, epoch, rows_of(columns), sensors)


def read_fused(path: str | PathLike[str], block: int = 1 << 14) -> Iterator[FusedBlock]:
    """Yield the blocks of a file that `write_fused` wrote, `block` frames at a time; LogError for a damaged or hostile
    file.
    """
    with fused_columns(path) as (_, columns):
        frames = rows_of(columns)
        for start in range(0, frames, block):
            rows = slice(start, min(start + block, frames))
            triads: dict[str, Floats] = {
                name: _finite(columns[name][rows], name, path) for name in INERTIAL if name in columns
            }
            yield FusedBlock(
                columns["time"][rows], triads, _parts(columns, COVARIANCE, rows), _parts(columns, USED, rows)
            )


def read_fused_events(path: str | PathLike[str]) -> tuple[FusedEvent, ...]:
    """Return the fault events in order of detection; empty if the file has no such table. LogError."""
    with fused_columns(path) as (_, columns):
        return events_in(columns["time"].file, str(path))


@contextmanager
def fused_columns(path: str | PathLike[str]) -> Iterator[tuple[dict[str, str], dict[str, NamedColumn]]]:
    """Open a fused file: the texts of its head, and its columns by name, `time` first, with the types and shapes of the
    format. LogError for another, damaged or hostile file.
    """
    with _open(Path(path)) as file:
        try:
            with h5py.File(UnclosedFile(Path(path)), "r") as inspected:
                refuse_hostile(file, inspected, str(path))
            head = {name: _text(value) for name, value in file.attrs.items() if isinstance(value, str | bytes)}
            version = file.attrs.get("format_version")
            group = file.get("fused")
            if head.get("format") != FORMAT or not isinstance(group, h5py.Group) or "time" not in group:
                raise LogError(f"{path}: not a fused result")
            if version != FORMAT_VERSION:
                raise LogError(f"{path}: format_version is {version!s:.20}; this software reads {FORMAT_VERSION}")
            columns = _check_columns(group, str(path))
        except DAMAGE as error:
            raise LogError(f"{path}: damaged or malformed: {printable(' '.join(str(error).split()))}") from None
        yield head, columns


def _open(path: Path) -> h5py.File:
    """Open the file, also while it is being written or after an interrupted write; LogError."""
    if not path.is_file() or not is_marked_open(path):
        return open_file(path)
    try:
        return h5py.File(UnclosedFile(path, check_heaps=False), "r")
    except OSError:
        raise LogError(f"{path}: was not closed and is damaged; fuse its log again") from None


def _check_columns(group: h5py.Group, where: str) -> dict[str, NamedColumn]:
    """Return the columns of a fused file, checked against the format; LogError."""
    formats: dict[str, tuple[str, int]] = {"time": ("i", 0)}
    for quantity in INERTIAL:
        formats |= {quantity: ("f", 3), quantity + COVARIANCE: ("f", len(ENTRIES)), quantity + USED: ("u", -1)}
    results: dict[str, NamedColumn] = {}
    for name, (kind, width) in formats.items():
        if name not in group:
            continue
        column = group[name]
        place = f"{where}: fused/{name}"
        if not isinstance(column, h5py.Dataset) or column.dtype.kind != kind:
            raise LogError(f"{place}: not a column of numbers of type {_KINDS[kind]}")
        shape = column.shape or ()
        tail = (shape[1:] if width < 0 else (width,)) if width else ()
        if len(shape) != (2 if width else 1) or shape[1:] != tail or max(tail, default=0) > MOST_SENSORS:
            raise LogError(f"{place}: its shape is {shape}; required is {_shape_text(width)}")
        results[name] = NamedColumn(column, place)
    return results


def rows_of(columns: Mapping[str, NamedColumn]) -> int:
    """Return the number of frames in every column: after an interrupted write some columns are longer than others."""
    return min(map(len, columns.values()))


def _shape_text(width: int) -> str:
    """Describe the shape of a column in words."""
    if width == 0:
        return "(n,)"
    return f"(n, {width})" if width > 0 else f"(n, sensors), at most {MOST_SENSORS} of these"


def _finite(triads: Floats, name: str, path: str | PathLike[str]) -> Floats:
    """Return the rows; LogError if a value is infinite."""
    if np.isinf(triads).any():
        raise LogError(f"{path}: fused/{name}: infinite values; unknown values must be NaN")
    return triads


def _parts(columns: Mapping[str, NamedColumn], suffix: str, rows: slice) -> dict[str, npt.NDArray[Any]]:
    """Read rows of the columns with a suffix, by quantity."""
    return {name.removesuffix(suffix): column[rows] for name, column in columns.items() if name.endswith(suffix)}


def texts_of(attributes: Mapping[str, Any], name: str) -> tuple[str, ...]:
    """Return an attribute that is a list of texts; empty for any other, or without one."""
    value = attributes.get(name)
    listed = value.tolist() if isinstance(value, np.ndarray) and value.ndim == 1 else []
    return tuple(map(_text, listed)) if all(isinstance(item, str | bytes) for item in listed) else ()


def _text(value: str | bytes) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


_TEXTS = {"sensor": 256, "kind": 32, "state": 32, "message": 1024}
"""The columns of text, and the number of bytes that are stored."""

_CHUNK = 16


class FusedEvent(NamedTuple):
    """One event of a sensor: `kind` of fault and `state` ("isolated", "readmitted", ...) as in `FaultEvent`, and the
    `message` for the user.
    """

    time_ns: int
    sensor: str
    kind: str
    state: str
    message: str

    @property
    def sentence(self) -> str:
        """The message, as of a `FaultEvent`."""
        return self.message


class StoredEvents:
    """The table of events of an open file, empty at first."""

    def __init__(self, file: h5py.File, epoch: str) -> None:
        self._group = file.create_group("events")
        self._group.create_dataset("time", (0,), np.int64, maxshape=(None,), chunks=(_CHUNK,))
        self._group["time"].attrs["units"] = f"nanoseconds since {epoch}"
        for name, length in _TEXTS.items():
            text = h5py.string_dtype("utf-8", length)
            self._group.create_dataset(name, (0,), text, maxshape=(None,), chunks=(_CHUNK,))

    def append(self, event: FaultEvent | FusedEvent) -> None:
        """Append an event. OSError."""
        texts = (event.sensor, event.kind, event.state, event.sentence)
        shortened = [_shorten(text, length) for text, length in zip(texts, _TEXTS.values(), strict=True)]
        for name, value in zip(("time", *_TEXTS), (event.time_ns, *shortened), strict=True):
            column = self._group[name]
            column.resize(column.shape[0] + 1, axis=0)
            column[-1] = value
            column.flush()


def events_in(file: h5py.File, place: str) -> tuple[FusedEvent, ...]:
    """Return the events that are complete in every column of a file: after an interrupted write some columns are longer
    than others. LogError if they can't be read.
    """
    group = file.get("events")
    if group is None:
        return ()
    try:
        rows = zip(*(_column(group[name]) for name in ("time", *_TEXTS)), strict=False)
        return tuple(FusedEvent(int(time), *(_text(text) for text in texts)) for time, *texts in rows)
    except DAMAGE:
        raise LogError(f"{place}: its events can't be read") from None


def _column(column: h5py.Dataset) -> list[Any]:
    """Read a whole column; ValueError, before reading, for an implausible size."""
    if column.ndim != 1 or column.nbytes > MAX_TEXT_BYTES:
        raise ValueError("no column of events")
    return read_texts(column)


def _shorten(text: str, length: int) -> bytes:
    """Return the first bytes of a text, without a partial character."""
    return text.encode()[:length].decode(errors="ignore").encode()


_SLACK_BYTES = 1 << 18
"""Bytes that HDF5 buffers or adds: a chunk of each column, and the index of the chunks."""

_COMPRESSED: Mapping[str, Any] = MappingProxyType({"compression": "gzip", "compression_opts": 1, "shuffle": True})
"""Storage of columns except triads: half of the bits of these are noise, and their compression would take a fifth of
the time of a fusion to save a fifth of the space.
"""

_AT_ONCE = 1 << 14
"""Number of frames that are written at once, four chunks: a chunk that is written in parts is compressed repeatedly."""

_NO_CACHE = 0
"""Bytes of HDF5's chunk cache: whole chunks are written once, and caching them would take 60 MB for a long log."""

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

_LONG_NAMES: Mapping[str, str] = MappingProxyType(
    {"time": "start of the frame"}
    | {quantity: f"fused {quantity.replace('_', ' ')} in the box frame" for quantity in INERTIAL}
    | {
        f"{quantity}_covariance": f"covariance of the error of the fused {quantity.replace('_', ' ')}"
        for quantity in INERTIAL
    }
    | {f"{quantity}_used": "axes of each sensor in use: 1 x, 2 y, 4 z" for quantity in INERTIAL}
)

FORMAT, FORMAT_VERSION = FUSED, 1

COVARIANCE, USED = "_covariance", "_used"
"""Suffixes of a quantity for the columns of its covariances and of the sensors used."""


class FusedOrigin(TypedDict):
    """Origin of a fused result: the `epoch` of its times, the `technique`, the paths of `log` and `calibration` ("" or
    missing: data-sheet values).
    """

    epoch: str
    technique: str
    log: str
    calibration: NotRequired[str]


def write_fused(
    path: str | PathLike[str],
    blocks: Iterable[FusedBlock],
    *,
    sensors: Mapping[str, Sequence[str]] = MappingProxyType({}),
    events: Sequence[FaultEvent | FusedEvent] = (),
    force: bool = False,
    progress: Callable[[int], None] = lambda frames: None,
    **origin: Unpack[FusedOrigin],
) -> int:
    """Write blocks as they arrive, under a temporary name until the last one, and return the number of frames.

    `sensors` are the names, per quantity, of the sensors whose use a block records; `events` are read after the last
    block, so that `Watch.on_fault` may fill them meanwhile. OutputExistsError, OutputError.
    """
    with whole_file(path, force=force) as draft, h5py.File(draft, "w", rdcc_nbytes=_NO_CACHE) as file:
        fused = _FusedColumns(file, draft, origin, sensors)
        frames = 0
        for block in _regroup(blocks, progress):
            fused.append(block)
            frames += len(block.time)
        for event in events:
            fused.events.append(event)
    return frames


def _regroup(blocks: Iterable[FusedBlock], progress: Callable[[int], None]) -> Iterator[FusedBlock]:
    """Yield the frames in blocks of `_AT_ONCE`, except the last; `progress` is called with their number so far."""
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
    """A fused result that can be read (SWMR) under its own name while it is written; not compressed, because that would
    block the interpreter for milliseconds during a recording. A context manager.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        *,
        sensors: Mapping[str, Sequence[str]] = MappingProxyType({}),
        force: bool = False,
        **origin: Unpack[FusedOrigin],
    ) -> None:
        """OutputExistsError, OutputError."""
        self._path = Path(path)
        if self._path.exists() and not force:
            raise OutputExistsError(path)
        try:
            self._file = h5py.File(path, "w", libver=("v110", "v110"))
        except OSError as error:
            raise OutputError(path, error) from None
        self._fused = _FusedColumns(self._file, self._path, origin, sensors, compressed=False)
        self.frames = 0

    def append(self, block: FusedBlock) -> None:
        """Append more frames. OSError."""
        self._fused.append(block)
        self.frames += len(block.time)
        if not self._file.swmr_mode:
            self._file.swmr_mode = True

    def event(self, event: FaultEvent) -> None:
        """Write an event of a sensor. OSError."""
        self._fused.events.append(event)

    def close(self) -> None:
        """Complete the file; a file without frames is deleted."""
        self._file.close()
        if self.frames == 0:
            self._path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _require_disk_space(path: Path, block: FusedBlock) -> None:
    """Raise OSError if the disk has no space for a block; HDF5 does not recover from a failed write."""
    required = _SLACK_BYTES + sum(rows.nbytes for rows in _columns(block).values())
    limit = longest_file()
    if limit is not None and path.stat().st_size + required > limit:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
    if free_bytes(path) < required:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _columns(block: FusedBlock) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of a block by name."""
    covariances = {name + COVARIANCE: rows.astype(np.float32) for name, rows in block.covariances.items()}
    used = {name + USED: np.asarray(rows) for name, rows in block.used.items()}
    return {"time": block.time, **block.triads, **covariances, **used}


class _FusedColumns:
    """An HDF5 file for a result; the first block determines its columns."""

    def __init__(
        self,
        file: h5py.File,
        path: Path,
        origin: FusedOrigin,
        sensors: Mapping[str, Sequence[str]],
        compressed: bool = True,
    ) -> None:
        file.attrs.update(
            format=FORMAT,
            format_version=FORMAT_VERSION,
            **{"calibration": "", **origin},
            software=f"imuarray {__version__}",
        )
        file.attrs.update(NX_class="NXroot", default="fused")  # for viewers of NeXus files
        self._file, self._path, self._sensors = file, path, sensors
        self._group = file.create_group("fused")
        self.events = StoredEvents(file, origin["epoch"])
        self._epoch = origin["epoch"]
        self._live = not compressed
        self._writers: dict[str, ColumnWriter] = {}
        if self._live:
            file.flush()  # a file without frames is recognised if its writer is killed

    def append(self, block: FusedBlock) -> None:
        """Append more rows of every column. OSError."""
        _require_disk_space(self._path, block)
        columns = _columns(block)
        if not len(self._group):
            signal, *other_quantities = block.triads
            self._group.attrs.update(NX_class="NXdata", axes=["time", "."], signal=signal)
            if other_quantities:
                self._group.attrs["auxiliary_signals"] = other_quantities
        for name in [name for name in columns if name not in self._group]:  # time first: it is a dimension of the rest
            self._create(name, columns[name])
        for name, rows in columns.items():
            if name not in self._writers:
                self._writers[name] = ColumnWriter(self._group[name])
            self._writers[name].append(rows)
            if self._live:
                self._group[name].flush()
        if self._live:
            self._file.flush()

    def _create(self, name: str, rows: npt.NDArray[Any]) -> None:
        tail = rows.shape[1:]
        filters: dict[str, Any] = {} if self._live else {"fletcher32": True}
        if not self._live and name not in INERTIAL:
            filters |= _COMPRESSED
        column = self._group.create_dataset(
            name, (0, *tail), rows.dtype, maxshape=(None, *tail), chunks=(4096, *tail), **filters
        )
        column.attrs["units"] = UNITS.get(name, f"nanoseconds since {self._epoch}")
        column.attrs["long_name"] = _LONG_NAMES[name]
        if name == "time":
            column.make_scale("time")
            return
        dimension, labels = "axis", tuple("XYZ")
        if name.endswith(COVARIANCE):
            column.attrs["columns"] = list(ENTRIES)
            dimension, labels = "entry", ENTRIES
        elif name.endswith(USED):
            names = tuple(self._sensors.get(name.removesuffix(USED), ()))
            if names:
                column.attrs["sensors"] = list(names)
            dimension = f"{name.removesuffix(USED)}_sensor"
            labels = names if len(names) == tail[0] else tuple(map(str, range(tail[0])))
        column.dims[0].attach_scale(self._group["time"])
        column.dims[1].attach_scale(self._scale(dimension, labels))

    def _scale(self, name: str, labels: Sequence[str]) -> h5py.Dataset:
        """Return the labels of a dimension as a dimension scale, from which netCDF readers take its name."""
        if name not in self._group:
            longest = max(1, *(len(label.encode()) for label in labels))
            kind = h5py.string_dtype("utf-8", longest if self._live else None)
            values = [label.encode() for label in labels] if self._live else list(labels)
            self._group.create_dataset(name, data=np.array(values, kind))
            self._group[name].make_scale(name)
        return self._group[name]
