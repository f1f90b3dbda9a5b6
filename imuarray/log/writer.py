"""Writing a log: created under a temporary name, filled in whole chunks, renamed when it is complete.

Blocks of any length go in; they are kept until a chunk is full, so that no write is ever a frame long. The file opens
in h5py, in xarray (engine h5netcdf) and in NeXus viewers: dimension scales, CF attributes, NXdata.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import h5py
import numpy as np
import numpy.typing as npt

from imuarray import __version__
from imuarray.errors import LogError, OutputExistsError
from imuarray.log.format import FORMAT, FORMAT_VERSION, LONG_NAME, Event, Phase, SensorHeader
from imuarray.units import SI_NAME, SI_PER_UNIT

CHUNK = 4096
"""Rows per chunk: about 40 s at 100 Hz; 24 KiB of counts."""

_TEXT = h5py.string_dtype("utf-8")


class Block(NamedTuple):
    """Rows of one sensor: time (n,) int64 ns since the epoch, counts (n, k), status (n,) flags, and what the chip has
    besides.
    """

    time: npt.NDArray[np.int64]
    counts: npt.NDArray[Any]
    status: npt.NDArray[np.uint16]
    temperature_counts: npt.NDArray[np.int16] | None = None
    compensated: Mapping[str, npt.NDArray[np.float64]] = {}


class Stimulus(NamedTuple):
    """Rows of `/truth` or `/reference`: time (n,) ns, specific force (n, 3) m/s2 and angular rate (n, 3) rad/s in the
    box frame, temperature (n,) degC.
    """

    time: npt.NDArray[np.int64]
    specific_force: npt.NDArray[np.float64]
    angular_rate: npt.NDArray[np.float64]
    temperature: npt.NDArray[np.float64]


class _Columns:
    """Equally long datasets that grow together, by whole chunks while the log is open."""

    def __init__(self, group: h5py.Group, columns: Mapping[str, tuple[Any, tuple[int, ...]]]) -> None:
        self.group = group
        self.pending: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in columns}
        self.waiting = 0
        self.rows = 0
        for name, (dtype, tail) in columns.items():
            group.create_dataset(
                name,
                (0, *tail),
                dtype,
                maxshape=(None, *tail),
                chunks=(CHUNK, *tail),
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )

    def append(self, **columns: npt.NDArray[Any]) -> None:
        if columns.keys() != self.pending.keys() or len({len(rows) for rows in columns.values()}) != 1:
            came = ", ".join(f"{name} {len(rows)}" for name, rows in columns.items())
            raise ValueError(f"{self.group.name}: columns {', '.join(self.pending)} of one length; came {came}")
        for name, rows in columns.items():
            self.pending[name].append(rows)
        self.waiting += len(next(iter(columns.values())))
        if self.waiting >= CHUNK:
            self.flush(self.waiting - (self.rows + self.waiting) % CHUNK)

    def flush(self, count: int | None = None) -> None:
        """Write the first `count` waiting rows (all of them if None)."""
        count = self.waiting if count is None else count
        if count == 0:
            return
        for name, parts in self.pending.items():
            rows = np.concatenate(parts)
            dataset = self.group[name]
            dataset.resize(self.rows + count, axis=0)
            dataset[self.rows :] = rows[:count]
            self.pending[name] = [rows[count:]]
        self.rows += count
        self.waiting -= count


class LogWriter:
    """A log being written; a context manager. Leaving it with an error removes the file, unless `keep()` was called."""

    def __init__(
        self,
        path: str | PathLike[str],
        sensors: Sequence[SensorHeader],
        *,
        source: str,
        epoch: str,
        config: str = "",
        force: bool = False,
    ) -> None:
        """Create `path` for `sensors`; `epoch` is the ISO 8601 UTC wall time of time 0. OutputExistsError, LogError."""
        self.path = Path(path)
        self.epoch = epoch
        if self.path.is_dir():
            raise LogError(f"{path}: is a folder; a log is a file")
        if self.path.exists() and not force:
            raise OutputExistsError(path)
        self._part = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")
        try:
            self._file = h5py.File(self._part, "w", libver="latest")
        except OSError as error:
            raise LogError(f"{path}: can't be written: {os.strerror(error.errno) if error.errno else error}") from None
        self._keep = False
        self._phases: list[Phase] = []
        self._events: list[Event] = []
        self._stimuli: dict[str, _Columns] = {}
        try:
            self._begin(sensors, source, config)
        except BaseException:
            self._file.close()
            self._part.unlink(missing_ok=True)
            raise

    def _begin(self, sensors: Sequence[SensorHeader], source: str, config: str) -> None:
        """Attributes and empty columns."""
        self._file.attrs.update(
            format=FORMAT,
            format_version=FORMAT_VERSION,
            epoch=self.epoch,
            source=source,
            config=config,
            software=f"imuarray {__version__}",
            Conventions="CF-1.8",
            NX_class="NXroot",
        )
        parent = self._file.create_group("sensors")
        self._last_ns = {header.name: -(2**63) for header in sensors}
        self._sensors = {header.name: _sensor_group(parent, header, self.epoch) for header in sensors}

    def append(self, sensor: str, block: Block) -> None:
        """Add rows of one sensor; ValueError unless time is strictly increasing, across blocks too."""
        if len(block.time) == 0:
            return
        if block.time[0] <= self._last_ns[sensor] or (np.diff(block.time) <= 0).any():
            raise ValueError(f"sensor {sensor}: time is not strictly increasing")
        self._last_ns[sensor] = int(block.time[-1])
        columns = {"time": block.time, "counts": block.counts, "status": block.status, **block.compensated}
        if block.temperature_counts is not None:
            columns["temperature_counts"] = block.temperature_counts
        self._sensors[sensor].append(**columns)

    def stimulus(self, name: str, rows: Stimulus) -> None:
        """Add rows to `/truth` or `/reference`."""
        if name not in self._stimuli:
            self._stimuli[name] = _stimulus_group(self._file, name, self.epoch)
        self._stimuli[name].append(**rows._asdict())

    def phase(self, phase: Phase) -> None:
        """Name a stretch of time."""
        self._phases.append(phase)

    def event(self, event: Event) -> None:
        """Note that something happened."""
        self._events.append(event)

    def flush(self) -> None:
        """Write everything that waits for its chunk to fill."""
        for columns in (*self._sensors.values(), *self._stimuli.values()):
            columns.flush()
        self._file.flush()

    def keep(self) -> None:
        """From now on the file is worth having, whatever happens."""
        self._keep = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None or self._keep:
                self._finish()
        finally:
            self._file.close()
        if kind is None or self._keep:
            self._part.replace(self.path)
        else:
            self._part.unlink(missing_ok=True)

    def _finish(self) -> None:
        self.flush()
        for columns in (*self._sensors.values(), *self._stimuli.values()):
            _attach_scales(columns.group)
        _table(self._file, "phases", Phase._fields, self._phases, {"start_ns": "start", "end_ns": "end"})
        _table(self._file, "events", Event._fields, self._events, {"time_ns": "time"})


def _sensor_group(parent: h5py.Group, header: SensorHeader, epoch: str) -> _Columns:
    """Create `/sensors/<NAME>` with its attributes and empty columns."""
    group = parent.create_group(header.name)
    triad = header.columns == ("x", "y", "z")
    group.attrs.update(
        chip=header.chip,
        quantity=header.quantity,
        range=header.range,
        unit=header.unit,
        sensitivity=header.sensitivity,
        rate_hz=header.rate_hz,
        bandwidth_hz=header.bandwidth_hz,
        axes=header.axes,
        orientation=np.array(header.orientation),
        position_mm=np.array(header.position_mm),
        columns=list(header.columns),
        NX_class="NXdata",
        signal="counts",
        **header.extra,
    )
    if header.delay_ns is not None:
        group.attrs["delay_ns"] = header.delay_ns
    columns: dict[str, tuple[Any, tuple[int, ...]]] = {
        "time": (np.int64, ()),
        "counts": (np.int16 if triad else np.int32, (len(header.columns),)),
        "status": (np.uint16, ()),
    }
    if header.has_temperature:
        columns["temperature_counts"] = (np.int16, ())
    columns.update(dict.fromkeys(header.compensated, (np.float64, ())))
    grown = _Columns(group, columns)
    group.create_dataset("axis", data=list(header.columns), dtype=_TEXT)
    group["time"].attrs["units"] = f"nanoseconds since {epoch}"
    group["time"].attrs["long_name"] = "start of the burst on the wire"
    counts = group["counts"].attrs
    counts["long_name"] = LONG_NAME[header.quantity]
    if triad and header.sensitivity:
        counts["units"] = SI_NAME[header.unit]
        counts["scale_factor"] = SI_PER_UNIT[header.unit] / header.sensitivity
        counts["add_offset"] = 0.0
    for name in header.compensated:
        group[name].attrs["units"] = {"temperature": "degC", "pressure": "Pa"}.get(name, "1")
    return grown


def _stimulus_group(file: h5py.File, name: str, epoch: str) -> _Columns:
    group = file.create_group(name)
    grown = _Columns(
        group,
        {
            "time": (np.int64, ()),
            "specific_force": (np.float64, (3,)),
            "angular_rate": (np.float64, (3,)),
            "temperature": (np.float64, ()),
        },
    )
    units = {
        "time": f"nanoseconds since {epoch}",
        "specific_force": "m s-2",
        "angular_rate": "rad s-1",
        "temperature": "degC",
    }
    for column, unit in units.items():
        group[column].attrs["units"] = unit
    group.create_dataset("axis", data=["X", "Y", "Z"], dtype=_TEXT)
    return grown


def _attach_scales(group: h5py.Group) -> None:
    """Dimension scales on every column: without them xarray invents names and finds no time."""
    group["time"].make_scale("time")
    group["axis"].make_scale("axis")
    for name, dataset in group.items():
        if name in ("time", "axis"):
            continue
        dataset.dims[0].attach_scale(group["time"])
        if dataset.ndim == 2:
            dataset.dims[1].attach_scale(group["axis"])


def _table(file: h5py.File, name: str, fields: Sequence[str], rows: Sequence[Any], renamed: Mapping[str, str]) -> None:
    """A group of equally long columns from named tuples; whole numbers are int64, the rest text."""
    group = file.create_group(name)
    for index, field in enumerate(fields):
        values = [row[index] for row in rows]
        column = renamed.get(field, field)
        if field.endswith("_ns"):
            group.create_dataset(column, data=np.array(values, np.int64))
        else:
            group.create_dataset(column, data=values, dtype=_TEXT)
