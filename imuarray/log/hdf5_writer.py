"""The HDF5 file of a log that is being written: compressed columns under a temporary name, which is renamed when it is
complete (`Draft`), or a file that others can read while it grows (`LiveFile`).

The attributes are those by which xarray (engine h5netcdf) and NeXus viewers recognise a group. HDF5 protects its own
structures, and `fletcher32` the chunks of columns. Texts of varying length are stored in heaps without a checksum, and
short tables contiguously in the file. A finished log therefore stores checksums of its texts and of the tables of
phases and events, as they were written. Attributes that other programs add are ignored.
"""

from __future__ import annotations

import contextlib
import glob
import os
import re
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
from h5py import h5a, h5t

from imuarray.errors import LogError
from imuarray.log.chunks import ColumnWriter
from imuarray.log.commits import COMMITS, block_crc, row_of, width
from imuarray.log.disk_space import Allowance, sync_folder, write_errors
from imuarray.log.format import (
    CACHE_BYTES,
    COMPENSATED_UNITS,
    FORMAT,
    FORMAT_VERSION,
    LONG_NAME,
    PLOTS,
    PREAMBLE,
    PREAMBLE_CRC,
    STIMULI,
    THERMOMETER_ATTRIBUTES,
    TRACK_COLUMNS,
    TRACK_UNITS,
    Event,
    Phase,
    Preamble,
    SensorHeader,
)
from imuarray.log.journal import NOTES, ColumnGroup, Columns, Notes, groups_of, sensor_group
from imuarray.log.salvage import Mark
from imuarray.log.untrusted_input import DAMAGE, TEXT, read_texts
from imuarray.units import SI_NAME, SI_PER_UNIT

if sys.platform != "win32":
    import fcntl

CHUNK = 4096
"""Number of rows per chunk: about 40 s at 100 Hz; 24 KiB of counts."""

COMPRESSED: Mapping[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
"""Storage of the columns of a finished log: compressed, each chunk with a checksum."""

PLAIN: Mapping[str, Any] = {}
"""Storage of the columns of a log while it is written: not compressed, without checksums."""

LIBVER = "v110"
"""The earliest file format with single writer and multiple readers (SWMR). "latest" would depend on the installed HDF5,
and MATLAB, for example, cannot read that of HDF5 2.0.
"""

_STRING = h5py.string_dtype("utf-8")
_PLOTTED: Mapping[str, Any] = {"NX_class": "NXdata", "axes": ["time", "."]}
"""NeXus: rows over time; the second dimension has no numeric axis."""

_EMPTY_BYTES = 1 << 14
"""Upper estimate of the bytes that HDF5 needs for a group and its columns."""

_REVISED_CHUNKS = 16
"""Number of chunks of a column that are revised together: half a megabyte."""

_TEXT_BYTES = 64
_SETTLED_BYTES = 1 << 24
_RENAMED = {"start_ns": "start", "end_ns": "end", "time_ns": "time"}


_PART = re.compile(r"\..+\.(\d+)(\.live)?\.part")
"""The temporary name of a log, with the number of the process that writes it."""


def sweep(path: Path) -> None:
    """Remove logs under temporary names that killed processes left in the folder of the log at `path`."""
    for part in path.parent.glob(f".*{glob.escape(path.suffix)}.*.part"):
        name = _PART.fullmatch(part.name)
        if name is not None and not _is_alive(int(name[1])) and not _is_locked(part):
            with contextlib.suppress(OSError):  # it belongs to another user
                part.unlink()


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _is_locked(path: Path) -> bool:
    """Return whether HDF5 has the file open for writing, perhaps on another machine; it then holds a lock."""
    if sys.platform == "win32":
        return False
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(fd)
    return False


class Draft:
    """A log in preparation: rows are added by group and written in whole chunks; `close` makes it a complete log, which
    `publish` gives its name.
    """

    def __init__(self, path: Path, preamble: Preamble, chunk: int = CHUNK, *, durable: bool = False) -> None:
        """Begin; LogError if the file cannot be written, ValueError for impossible headers.

        `durable` is slower: space is allocated before it is needed instead of only checked, and `close` waits for the
        disk.
        """
        self.path = path
        self.part = path.with_name(f".{path.name}.{os.getpid()}.part")
        self.groups = groups_of(preamble.sensors)
        self.notes = Notes()
        self._end_ns = 0
        self._measured: set[tuple[str, str]] = set()
        self._epoch, self._chunk = preamble.epoch, chunk
        self._waiting: list[list[Columns]] = [[] for _ in self.groups]
        self._rows = [0] * len(self.groups)
        self._unwritten = [0] * len(self.groups)
        self._writers: dict[int, dict[str, ColumnWriter]] = {}
        self._reserved_bytes = 0
        self._durable = durable
        sweep(path)
        try:
            with write_errors(path):
                self.part.unlink(missing_ok=True)
                self.file = h5py.File(self.part, "w", libver=LIBVER, rdcc_nbytes=CACHE_BYTES)
                self._room = Allowance(self.part, path, allocate=durable)
        except LogError:
            with contextlib.suppress(OSError):  # a full disk may accept the name but not the first bytes
                self.part.unlink(missing_ok=True)
            raise
        try:
            with write_errors(path):
                self._room.reserve(len(self.groups) * _EMPTY_BYTES + len(preamble.config) * 4)
                self.file.attrs.update(log_attributes(preamble))
                self.file.create_group("sensors")
                for header in preamble.sensors:
                    create_sensor(self.file, header, preamble.epoch, chunk, COMPRESSED)
        except BaseException:
            self.discard()
            raise

    def append(self, number: int, columns: Columns) -> None:
        """Add rows of the group of this number (`imuarray.log.journal`); LogError."""
        if self.groups[number].path == NOTES:
            self.notes.add(columns)
            return
        self._waiting[number].append(columns)
        self._unwritten[number] += len(columns["time"])
        if self._unwritten[number] >= self._chunk:
            whole = self._unwritten[number] - (self._rows[number] + self._unwritten[number]) % self._chunk
            self._write(number, whole)

    def _write(self, number: int, count: int) -> None:
        """Write the first `count` buffered rows of a group."""
        if count:
            with write_errors(self.path):
                self._write_rows(self.groups[number], number, count)

    def _write_rows(self, group: ColumnGroup, number: int, count: int) -> None:
        if group.path in TRACK_COLUMNS and group.path not in self.file:
            self._room.reserve(_EMPTY_BYTES)
            create_track(self.file, group.path, self._epoch, self._chunk, COMPRESSED)
        self._room.reserve(count * group.row_bytes)
        self._reserved_bytes += count * group.row_bytes
        rows = group.joined(self._waiting[number])
        if group.path in STIMULI:
            self._measured |= {(group.path, name) for name, values in rows.items() if np.isfinite(values[:count]).any()}
        self._end_ns = max(self._end_ns, int(rows["time"][count - 1]) + 1)
        if number not in self._writers:
            stored = self.file[group.path]
            self._writers[number] = {name: ColumnWriter(stored[name]) for name in rows}
        for name, writer in self._writers[number].items():
            writer.append(rows[name][:count])
        self._rows[number] += count
        self._unwritten[number] -= count
        self._waiting[number] = [{name: values[count:] for name, values in rows.items()}]
        if self._reserved_bytes > _SETTLED_BYTES:
            self.file.flush()
            self._room.settle()
            self._reserved_bytes = 0

    def flush(self) -> None:
        """Write all buffered rows."""
        for number, count in enumerate(self._unwritten):
            self._write(number, count)
        with write_errors(self.path):
            self.file.flush()

    def stretches(self, number: int) -> Sequence[Columns]:
        """Return the rows of a group so far, read back from the file."""
        self.flush()
        group: ColumnGroup = self.groups[number]
        if self._rows[number] == 0:
            return []
        return [{name: np.asarray(self.file[group.path][name][:]) for name, _, _ in group.columns}]

    def revise(self, number: int, name: str, change: Callable[[Columns], npt.NDArray[Any]]) -> None:
        """Replace the values of a column of a group by those that `change` computes from each block of rows, the same
        number of them; ValueError if times no longer increase.
        """
        self.flush()
        group = self.groups[number]
        last_ns: int | None = None
        for start in range(0, self._rows[number], _REVISED_CHUNKS * self._chunk):
            part = slice(start, min(start + _REVISED_CHUNKS * self._chunk, self._rows[number]))
            values = change({column: np.asarray(self.file[group.path][column][part]) for column, _, _ in group.columns})
            if name == "time":
                if (np.diff(values) <= 0).any() or (last_ns is not None and values[0] <= last_ns):
                    raise ValueError(f"/{group.path}: time is not strictly increasing")
                last_ns = int(values[-1])
                self._end_ns = max(self._end_ns, last_ns + 1)
            with write_errors(self.path):
                self.file[group.path][name][part] = values

    def close(self) -> None:
        """Write everything and close the file. `part` is then a complete log; if it is `durable`, it is on the disk."""
        self.flush()
        texts = sum(len(event.sensor + event.kind + event.message) * 4 + _TEXT_BYTES for event in self.notes.events)
        texts += sum(len(phase.name) * 4 + _TEXT_BYTES for phase in self.notes.phases)
        self._room.reserve(texts + 4 * _EMPTY_BYTES)
        with write_errors(self.path):
            self._close()
        if self._durable:
            self._room.sync()
        self._room.close()

    def _close(self) -> None:
        """Write everything except the columns, and close the file."""
        self._writers.clear()
        for group in self.groups:
            if group.path in self.file:
                if group.path in STIMULI:  # a quantity that was not measured has no column, instead of one of nan
                    for name, _, _ in group.columns:
                        if (group.path, name) not in self._measured:
                            del self.file[group.path][name]
                attach_scales(self.file[group.path])
        names = [group.path.removeprefix("sensors/") for group in self.groups if "/" in group.path]
        if names:
            write_plots(self.file, names)
        write_table(self.file, "phases", Phase._fields, self.notes.phases_until(self._end_ns), _RENAMED)
        write_table(self.file, "events", Event._fields, self.notes.events, _RENAMED)
        self.file.attrs[CHECK_SUMS] = np.array(check_sums(self.file), np.uint32)
        self.file.close()
        self._room.trim()

    def publish(self, path: Path) -> None:
        """Rename a closed draft: from now on it is the log at `path`."""
        self.part.replace(path)

    def discard(self) -> None:
        """Remove all files of the draft."""
        with contextlib.suppress(Exception):
            self.file.close()
        self._room.close()
        self.part.unlink(missing_ok=True)


_COMMIT_ROWS = 64


class LiveFile:
    """The HDF5 file of a log that is being recorded. Its columns only ever grow, by commits."""

    def __init__(self, path: Path, preamble: Preamble, chunk: int = CHUNK) -> None:
        """Create the file with all groups and attributes under a temporary name; rename it once it is on the disk."""
        self._groups = groups_of(preamble.sensors)
        self._rows = [0] * len(self._groups)
        self._identity = preamble.identity
        self._chunk = chunk
        part = path.with_name(f".{path.name}.{os.getpid()}.live.part")
        part.unlink(missing_ok=True)
        self.file = h5py.File(part, "w", libver=LIBVER, rdcc_nbytes=CACHE_BYTES)
        self._room = Allowance(part, path)
        try:
            self._room.reserve((len(self._groups) + 1) * _EMPTY_BYTES + len(preamble.config) * 8)
            self._create(preamble, chunk)
            self._room.sync()
            part.replace(path)
            sync_folder(path)
        except BaseException:
            self.close()
            part.unlink(missing_ok=True)
            raise

    def _create(self, preamble: Preamble, chunk: int) -> None:
        self.file.attrs.update(log_attributes(preamble))
        text = preamble.to_json()
        self.file.attrs.update({PREAMBLE: text, PREAMBLE_CRC: zlib.crc32(text.encode())})
        for header in preamble.sensors:
            create_sensor(self.file, header, preamble.epoch, chunk, PLAIN)
        for name in TRACK_COLUMNS:
            create_track(self.file, name, preamble.epoch, chunk, PLAIN)
        create_columns(self.file, self._groups[-1], chunk, PLAIN)
        columns = width(self._groups)
        self.file.create_dataset(COMMITS, (0, columns), "<i8", maxshape=(None, columns), chunks=(_COMMIT_ROWS, columns))
        self.file.swmr_mode = True

    def commit(self, waiting: Sequence[Sequence[Columns]], mark: Mark) -> None:
        """Add rows of all groups: everything that the journal holds before `mark`; LogError."""
        added = {number: self._groups[number].joined(parts) for number, parts in enumerate(waiting) if parts}
        for number, rows in added.items():
            self._add(number, rows)
        self.file.flush()
        self._room.sync()
        table = self.file[COMMITS]
        self._room.reserve(_COMMIT_ROWS * 8 * table.shape[1] if len(table) % _COMMIT_ROWS == 0 else 0)
        table.resize(len(table) + 1, axis=0)
        table[-1] = row_of(mark, block_crc(self._groups, added), self._rows, self._identity)
        table.flush()

    def _add(self, number: int, rows: Columns) -> None:
        group, start = self._groups[number], self._rows[number]
        count = len(next(iter(rows.values())))
        chunks = -(-(start + count) // self._chunk) - -(-start // self._chunk)
        self._room.reserve(chunks * self._chunk * group.row_bytes)
        for name, values in rows.items():
            dataset = self.file[group.path][name]
            dataset.resize(start + count, axis=0)
            dataset[start:] = values
        self._rows[number] = start + count

    def close(self) -> None:
        """Close the file; committed rows are in it."""
        with contextlib.suppress(Exception):  # the journal has the rows that this can't write
            self.file.close()
        self._room.close()


def log_attributes(preamble: Preamble) -> dict[str, Any]:
    """Return the attributes of the file itself."""
    attributes = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "epoch": preamble.epoch,
        "source": preamble.source,
        "config": preamble.config,
        "software": preamble.software,
        "Conventions": "CF-1.8",
        "NX_class": "NXroot",
    }
    return attributes | ({"frame_rate_hz": float(preamble.frame_rate_hz)} if preamble.frame_rate_hz else {})


def sensor_attributes(header: SensorHeader) -> dict[str, Any]:
    """Return the attributes of `/sensors/<NAME>`; ValueError for impossible axes."""
    attributes = {
        "chip": header.chip,
        "quantity": header.quantity,
        "range": header.range,
        "unit": header.unit,
        "sensitivity": header.sensitivity,
        "rate_hz": header.rate_hz,
        "bandwidth_hz": header.bandwidth_hz,
        "axes": header.axes,
        "orientation": np.array(header.orientation),
        "position_mm": np.array(header.position_mm),
        "columns": list(header.columns),
        "NX_class": "NXcollection",
        **header.extra,
    }
    return attributes | ({} if header.delay_ns is None else {"delay_ns": header.delay_ns})


def create_columns(file: h5py.File, group: ColumnGroup, chunk: int, storage: Mapping[str, Any]) -> h5py.Group:
    """Create a group with its columns, empty and resizable."""
    created = file.create_group(group.path)
    for name, kind, tail in group.columns:
        created.create_dataset(name, (0, *tail), kind, maxshape=(None, *tail), chunks=(chunk, *tail), **storage)
    return created


def create_sensor(
    file: h5py.File, header: SensorHeader, epoch: str, chunk: int, storage: Mapping[str, Any]
) -> h5py.Group:
    """Create `/sensors/<NAME>` with its attributes and empty columns; ValueError for impossible axes."""
    attributes = sensor_attributes(header)
    group = create_columns(file, sensor_group(header), chunk, storage)
    group.attrs.update(attributes)
    group.create_dataset("axis", data=list(header.columns), dtype=_STRING)
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    group["time"].attrs["long_name"] = "start of the burst on the wire"
    counts = group["counts"].attrs
    counts["long_name"] = LONG_NAME[header.quantity]
    if header.columns == ("x", "y", "z") and header.sensitivity:
        counts["units"] = SI_NAME[header.unit]
        counts["scale_factor"] = SI_PER_UNIT[header.unit] / header.sensitivity
        counts["add_offset"] = 0.0
        group.attrs["comment"] = (
            f"counts are raw; readers that apply scale_factor (xarray) show {SI_NAME[header.unit]}."
            f" unit, {header.unit}, is that of range and sensitivity only."
        )
    for name in header.compensated:
        group[name].attrs["units"] = COMPENSATED_UNITS.get(name, "1")
    return group


def create_track(file: h5py.File, name: str, epoch: str, chunk: int, storage: Mapping[str, Any]) -> h5py.Group:
    """Create a group of `TRACK_COLUMNS`, empty."""
    group = create_columns(file, ColumnGroup(name, TRACK_COLUMNS[name]), chunk, storage)
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    for column, _, _ in TRACK_COLUMNS[name][1:]:
        group[column].attrs["units"] = TRACK_UNITS[column]
    if name in STIMULI:
        group.attrs.update(_PLOTTED, signal="specific_force", auxiliary_signals=["angular_rate"])
        group.create_dataset("axis", data=["X", "Y", "Z"], dtype=_STRING)
    return group


def attach_scales(group: h5py.Group) -> None:
    """Attach dimension scales to every column; without them xarray invents names and does not recognise the time."""
    scales = {name: group[name] for name in ("time", "axis") if name in group}
    for name, scale in scales.items():
        scale.make_scale(name)
    for name, dataset in group.items():
        if name in scales:
            continue
        dataset.dims[0].attach_scale(scales["time"])
        if dataset.ndim == 2:
            dataset.dims[1].attach_scale(scales["axis"])


def write_plots(file: h5py.File, names: Sequence[str]) -> None:
    """Write `/plots`: for each sensor its counts over time, as NeXus viewers (silx, h5web) look for them.

    A sensor's own group can't provide this, because its attribute `axes` holds the box axes. The columns are soft links
    to those of the sensor, the only links in a log; the reader does not follow them (`imuarray.log.inspection`).
    """
    plots = file.create_group(PLOTS)
    plots.attrs.update(NX_class="NXentry", default=min(names))
    file.attrs["default"] = PLOTS
    for name in names:
        plot = plots.create_group(name)
        plot.attrs.update(_PLOTTED, signal="counts")
        for column in ("time", "counts", "axis"):  # netCDF requires the names of both dimensions
            plot[column] = h5py.SoftLink(f"/sensors/{name}/{column}")


def write_table(
    file: h5py.File, name: str, fields: Sequence[str], rows: Sequence[Any], renamed: Mapping[str, str]
) -> None:
    """Write a group of equally long columns from named tuples; whole numbers are stored as int64, all else as text."""
    group = file.create_group(name)
    for index, key in enumerate(fields):
        values = [row[index] for row in rows]
        column = renamed.get(key, key)
        if key.endswith("_ns"):
            group.create_dataset(column, data=np.array(values, np.int64))
        else:
            group.create_dataset(column, data=values, dtype=_STRING)


CHECK_SUMS = "text_crc32"
"""The root attribute: a CRC-32 for each of `PARTS`."""

_LOG = ("format", "epoch", "source", "config", "software", "Conventions", "NX_class")
_SENSOR = ("chip", "quantity", "unit", "axes", "columns", "NX_class", *THERMOMETER_ATTRIBUTES)
_TABLES: Mapping[str, Sequence[str]] = {
    "phases": ("start", "end", "name", "up"),
    "events": ("time", "sensor", "kind", "message"),
}
PARTS = ("attributes", *_TABLES)


def check_sums(file: Any) -> list[int]:
    """Return the CRC-32 of the attributes, phases and events of an open HDF5 file; damage raises h5py's own errors."""
    crcs = [0, *(_crc(_column(file[table][name]) for name in names) for table, names in _TABLES.items())]
    sensors, attributes = file["sensors"], [_attributes(file, _LOG)]
    for name in sorted(sensors):
        group = sensors[name]
        attributes += [name.encode(), _attributes(group, _SENSOR), _column(group["axis"])]
    crcs[0] = _crc(iter(attributes))
    return crcs


def changed_parts(file: Any) -> list[str]:
    """Return the `PARTS` that differ from what was written; none for a log without checksums."""
    stored = file.attrs.get(CHECK_SUMS)
    if not isinstance(stored, np.ndarray) or stored.shape != (len(PARTS),):
        return []
    try:
        return [part for part, crc, was in zip(PARTS, check_sums(file), stored.tolist(), strict=True) if crc != was]
    except DAMAGE:
        return ["attributes, phases or events"]


def _crc(parts: Iterator[bytes]) -> int:
    crc = 0
    for part in parts:
        crc = zlib.crc32(part + b"\0", crc)
    return crc


def _attributes(item: Any, names: Sequence[str]) -> bytes:
    """Return the values of the attributes of these names that exist; texts without decoding, which takes longer."""
    stored: list[bytes] = []
    h5a.iterate(item.id, stored.append)
    parts = []
    for name in names:
        if (key := name.encode()) not in stored:
            continue
        attribute = h5a.open(item.id, key)
        kind = attribute.get_type()
        if isinstance(kind, h5t.TypeStringID) and kind.is_variable_str():
            values = np.empty(attribute.get_space().get_simple_extent_dims(), object)
            attribute.read(values, TEXT)
        else:
            values = np.ravel(item.attrs[name])
        parts.append(b"\1".join([key, *map(_bytes, values.ravel())]))
    return b"\0".join(parts)


def _column(column: Any) -> bytes:
    """Read a whole column of numbers or texts."""
    if column.dtype.kind != "O":
        return np.ascontiguousarray(column[:]).tobytes()
    return b"\1".join(map(_bytes, read_texts(column)))


def _bytes(value: Any) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogateescape")
