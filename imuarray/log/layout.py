"""The layout of a log: groups of equally long columns, as rows of bytes in the journal and as groups in HDF5.

A block of rows in the journal is the columns of its group one after the other, little-endian. The groups are those of
the sensors in their order, then those of `TRACK_COLUMNS`, then `notes` (phases and events, one line of JSON each, as
bytes). The HDF5 attributes are those by which xarray (engine h5netcdf) and NeXus viewers recognise a group.

HDF5 protects its own structures, and `fletcher32` the chunks of columns. Texts of varying length are stored in heaps
without a checksum, and short tables contiguously in the file. A finished log therefore stores checksums of its texts
and of the tables of phases and events, as they were written. Attributes that other programs add are ignored.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.log.format import (
    ARRIVAL,
    FORMAT,
    FORMAT_VERSION,
    LONG_NAME,
    PLOTS,
    SINGLE_PRECISION,
    SYNC_PULSE,
    THERMOMETER_ATTRIBUTES,
    TIME_UNCERTAINTY,
    ClockRow,
    Event,
    Phase,
    Preamble,
    SensorHeader,
)
from imuarray.log.untrusted_input import DAMAGE, check_note, read_texts
from imuarray.units import SI_NAME, SI_PER_UNIT

CHUNK = 4096
"""Rows per chunk: about 40 s at 100 Hz; 24 KiB of counts."""

Columns = Mapping[str, npt.NDArray[Any]]
"""The columns of a stretch of rows."""

NOTES = "notes"
_TEXT = "text"


@dataclass(frozen=True)
class ColumnGroup:
    """A group of equally long columns; each is (name, little-endian type, shape of a row)."""

    path: str
    columns: tuple[tuple[str, str, tuple[int, ...]], ...]

    @property
    def row_bytes(self) -> int:
        """The number of bytes of one row, all columns together."""
        return sum(np.dtype(kind).itemsize * math.prod(tail) for _, kind, tail in self.columns)

    def checked(self, columns: Columns) -> dict[str, npt.NDArray[Any]]:
        """Return the columns in order and converted to their types; ValueError unless names match and lengths agree."""
        names = {name for name, _, _ in self.columns}
        if columns.keys() != names or len({len(rows) for rows in columns.values()}) != 1:
            lengths = ", ".join(f"{name} {len(rows)}" for name, rows in columns.items())
            expected = ", ".join(name for name, _, _ in self.columns)
            raise ValueError(f"/{self.path}: columns {expected} of one length; got {lengths}")
        checked = {name: np.ascontiguousarray(columns[name], kind) for name, kind, _ in self.columns}
        for name, _, tail in self.columns:
            if checked[name].shape[1:] != tail:
                raise ValueError(f"/{self.path}: column {name}: rows of shape {tail}; got {checked[name].shape[1:]}")
        return checked

    def encode(self, columns: Columns) -> bytes:
        """Return `checked` columns as bytes."""
        return b"".join([columns[name].tobytes() for name, _, _ in self.columns])

    def decode(self, payload: bytes | memoryview, rows: int) -> dict[str, npt.NDArray[Any]]:
        """Return the columns of `rows` rows, without copying."""
        columns, start = {}, 0
        for name, kind, tail in self.columns:
            count = rows * math.prod(tail)
            columns[name] = np.frombuffer(payload, kind, count, start).reshape(rows, *tail)
            start += count * np.dtype(kind).itemsize
        return columns

    def joined(self, parts: Sequence[Columns]) -> dict[str, npt.NDArray[Any]]:
        """Concatenate blocks of columns; empty columns if there is none."""
        return {
            name: np.concatenate([np.empty((0, *tail), kind), *(part[name] for part in parts)])
            for name, kind, tail in self.columns
        }


_Columns = tuple[tuple[str, str, tuple[int, ...]], ...]

STIMULUS: _Columns = (
    ("time", "<i8", ()),
    ("specific_force", "<f8", (3,)),
    ("angular_rate", "<f8", (3,)),
    ("temperature", "<f8", ()),
)
CLOCKS: _Columns = tuple((name.removesuffix("_ns"), "<i8", ()) for name in ClockRow._fields)

TRACK_COLUMNS: Mapping[str, _Columns] = MappingProxyType({"truth": STIMULUS, "reference": STIMULUS, "clocks": CLOCKS})
"""The groups that a log may have besides its sensors; a group exists if it has rows."""

TRACK_UNITS: Mapping[str, str] = MappingProxyType(
    {"specific_force": "m s-2", "angular_rate": "rad s-1", "temperature": "degC"}
    | {name: "ns" for name, _, _ in CLOCKS if name != "time"}
)
"""The units of the columns of these groups; `time` is in ns since the epoch."""

STIMULI = ("truth", "reference")

COMPENSATED_UNITS: Mapping[str, str] = MappingProxyType(
    {"temperature": "degC", "pressure": "Pa", ARRIVAL: "s", TIME_UNCERTAINTY: "s", SYNC_PULSE: "s"}
)
"""The units of the columns of a sensor that `SensorHeader.compensated` names."""


def sensor_group(header: SensorHeader) -> ColumnGroup:
    """Return the columns of `/sensors/<NAME>`."""
    width = (len(header.columns),)
    counts = "<i2" if header.columns == ("x", "y", "z") and header.count_bits <= 16 else "<i4"
    columns: _Columns = (("time", "<i8", ()), ("counts", counts, width), ("status", "<u2", ()))
    if header.has_temperature:
        columns += (("temperature_counts", "<i2", ()),)
    further = ((name, "<f4" if name in SINGLE_PRECISION else "<f8", ()) for name in header.compensated)
    return ColumnGroup(f"sensors/{header.name}", (*columns, *further))


def groups_of(sensors: Iterable[SensorHeader]) -> tuple[ColumnGroup, ...]:
    """Return all groups of a log with these sensors, in their order."""
    tracks = (ColumnGroup(name, columns) for name, columns in TRACK_COLUMNS.items())
    return (*(sensor_group(header) for header in sensors), *tracks, ColumnGroup(NOTES, ((_TEXT, "<u1", ()),)))


class OpenPhase(NamedTuple):
    """A phase that has begun and whose end is not known yet; `end_ns` is the latest possible end."""

    start_ns: int
    end_ns: int
    name: str
    up: str = ""


@dataclass
class Notes:
    """The phases and events of a log."""

    phases: list[Phase] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    begun: list[OpenPhase] = field(default_factory=list)

    def add(self, columns: Columns) -> None:
        """Read rows of the group `notes`; LogError."""
        try:
            for line in np.asarray(columns[_TEXT], np.uint8).tobytes().decode("ascii").splitlines():
                ((kind, fields),) = json.loads(line).items()
                check_note(fields, 1 if kind == "event" else 2)
                if kind == "phase":
                    self.phases.append(Phase(*fields))
                elif kind == "event":
                    self.events.append(Event(*fields))
                else:
                    self.begun.append(OpenPhase(*fields))
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
            raise LogError(f"phases and events can't be read: {error}") from None

    def phases_until(self, end_ns: int) -> list[Phase]:
        """Return all phases of a log that ends at `end_ns`; a phase that was never ended lasts until then."""
        ended = {(phase.start_ns, phase.name) for phase in self.phases}
        open_ended = (begun for begun in self.begun if (begun.start_ns, begun.name) not in ended)
        unfinished = (Phase(*begun)._replace(end_ns=min(begun.end_ns, end_ns)) for begun in open_ended)
        return [*self.phases, *(phase for phase in unfinished if phase.end_ns > phase.start_ns)]


def note_columns(note: Phase | Event | OpenPhase) -> dict[str, npt.NDArray[np.uint8]]:
    """Return a note as rows of the group `notes`."""
    kind = "begun" if isinstance(note, OpenPhase) else "event" if isinstance(note, Event) else "phase"
    line = json.dumps({kind: note}, default=lambda number: number.item()) + "\n"
    return {_TEXT: np.frombuffer(line.encode("ascii"), np.uint8)}


COMPRESSED: Mapping[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
"""How the columns of a finished log are stored: compressed, each chunk with a checksum."""

PLAIN: Mapping[str, Any] = {}
"""How the columns of a log are stored while it is written."""

LIBVER = "v110"
"""The earliest file format with single writer and multiple readers (SWMR). "latest" would depend on the installed HDF5,
and MATLAB, for example, cannot read that of HDF5 2.0.
"""

_STRING = h5py.string_dtype("utf-8")
_PLOTTED: Mapping[str, Any] = {"NX_class": "NXdata", "axes": ["time", "."]}
"""NeXus: rows over time; the second dimension has no numeric axis."""


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
    group["time"].make_scale("time")
    if "axis" in group:
        group["axis"].make_scale("axis")
    for name, dataset in group.items():
        if name in ("time", "axis"):
            continue
        dataset.dims[0].attach_scale(group["time"])
        if dataset.ndim == 2:
            dataset.dims[1].attach_scale(group["axis"])


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
    """Write a group of equally long columns from named tuples; whole numbers are stored as int64, everything else as
    text.
    """
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
    """Return the CRC-32 of the attributes, the phases and the events of an open HDF5 file; on damage h5py raises its
    own errors.
    """
    crcs = [0, *(_crc(_column(file[table][name]) for name in names) for table, names in _TABLES.items())]
    attributes = [_attributes(file.attrs, _LOG)]
    for name in sorted(file["sensors"]):
        group = file["sensors"][name]
        attributes += [name.encode(), _attributes(group.attrs, _SENSOR), _column(group["axis"])]
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


def _attributes(attributes: Mapping[str, Any], names: Sequence[str]) -> bytes:
    """Return the values of the attributes of these names that exist."""
    return b"\0".join(
        b"\1".join([name.encode(), *map(_bytes, np.ravel(attributes[name]))]) for name in names if name in attributes
    )


def _column(column: Any) -> bytes:
    """Read a whole column of numbers or texts."""
    if column.dtype.kind != "O":
        return np.ascontiguousarray(column[:]).tobytes()
    return b"\1".join(map(_bytes, read_texts(column)))


def _bytes(value: Any) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogateescape")
