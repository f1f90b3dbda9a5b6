"""Reading a log: lazily, a slice at a time, and only if it is one; finished or not.

A file from elsewhere is checked before anything in it is believed: it must be a log of a known format, nothing in it
may lead outside it (links, external storage, virtual datasets), and the columns must be there, of the right kind and
length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, cast
from weakref import WeakValueDictionary, ref

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.axes import orientation_of
from imuarray.errors import LogError
from imuarray.log.column import Column, LiveGroup
from imuarray.log.format import FORMAT, FORMAT_VERSION, SOURCES, Event, Phase
from imuarray.log.guard import DAMAGE, open_file, read_texts
from imuarray.log.inspection import inspect
from imuarray.log.interrupted import LiveView, Rebuilt, may_be_unfinished, open_interrupted
from imuarray.log.journal import is_running
from imuarray.log.layout import CLOCKS
from imuarray.log.preamble import Preamble
from imuarray.units import QUANTITIES, SI_PER_UNIT

_EDGE_ROWS = 4096
_GROUP = (h5py.Group, LiveGroup)
_DATASET = (h5py.Dataset, Column)


class SensorLog:
    """One sensor's part of a log. `time`, `counts`, ... are HDF5 datasets: slice them, or `numpy.asarray` them
    whole. Pickled, it is its log's path and its name.
    """

    def __init__(self, group: h5py.Group | LiveGroup, where: str, log: Log) -> None:
        self._group = group
        self._log, self._path = ref(log), log.path  # no cycle: a log that nobody has any more is closed at once
        self.name = str(group.name).rsplit("/", 1)[-1]
        self.where = where
        self.chip = self._text("chip")
        self.quantity = self._text("quantity", QUANTITIES)
        self.unit = self._text("unit", tuple(SI_PER_UNIT))
        self.range = self._number("range")
        self.sensitivity = self._number("sensitivity")
        self.rate_hz = self._number("rate_hz", 0.0)
        self.bandwidth_hz = self._number("bandwidth_hz", 0.0)
        self.axes = self._text("axes")
        self.position_mm = self._numbers("position_mm", np.zeros(3))
        self.orientation = self._orientation()
        self._check_columns()

    def _text(self, attribute: str, allowed: tuple[str, ...] = ()) -> str:
        value = self._group.attrs.get(attribute)
        value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        if not isinstance(value, str) or (allowed and value not in allowed):
            choice = f"; allowed are {', '.join(allowed)}" if allowed else ""
            raise LogError(
                f"{self.where}: attribute {attribute} is {'missing' if value is None else repr(value)}{choice}"
            )
        return value

    def _number(self, attribute: str, default: float | None = None) -> float:
        value = self._group.attrs.get(attribute, default)
        try:
            number = float(cast(Any, value))
        except (TypeError, ValueError):
            raise LogError(f"{self.where}: attribute {attribute} is {value!r}, a number is wanted") from None
        if not np.isfinite(number):
            raise LogError(f"{self.where}: attribute {attribute} is {number}, a finite number is wanted")
        return number

    def _numbers(self, attribute: str, default: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """An attribute of several numbers, shaped as its default."""
        value = self._group.attrs.get(attribute, default)
        try:
            numbers = np.asarray(value, float)
        except (TypeError, ValueError):
            numbers = np.array([])
        if numbers.shape != default.shape or not np.isfinite(numbers).all():
            kind = "a 3x3 rotation" if default.ndim == 2 else "three finite numbers"
            raise LogError(f"{self.where}: attribute {attribute} is not {kind}")
        return numbers

    def _orientation(self) -> npt.NDArray[np.float64]:
        """The stored matrix if there is one (a fused or foreign log may have finer ones), else that of `axes`."""
        try:
            named = np.array(orientation_of(self.axes))
        except ValueError as error:
            raise LogError(f"{self.where}: {error}") from None
        stored = self._numbers("orientation", named)
        if not np.allclose(stored @ stored.T, np.eye(3), atol=1e-6) or np.linalg.det(stored) < 0:
            raise LogError(f"{self.where}: attribute orientation is not a 3x3 rotation")
        return stored

    def _check_columns(self) -> None:
        kinds = {"time": "iu", "counts": "iu", "status": "u", "temperature_counts": "iu"}
        for name, kind in kinds.items():
            dataset = self._group.get(name)
            if dataset is None:
                if name in ("time", "counts"):
                    raise LogError(f"{self.where}: column {name} is missing")
                continue
            if not isinstance(dataset, _DATASET) or dataset.dtype.kind not in kind:
                raise LogError(f"{self.where}: column {name} is no column of whole numbers")
            if dataset.shape[:1] != self._group["time"].shape[:1]:
                raise LogError(f"{self.where}: column {name} has another length than time")
        if self.counts.ndim != 2 or (self.is_triad and self.counts.shape[1] != 3):
            raise LogError(f"{self.where}: column counts is no (n, 3) table")
        for edge in (self.time[:_EDGE_ROWS], self.time[-_EDGE_ROWS:]):  # all of it is for `verify` to read
            if (np.diff(edge) <= 0).any():
                raise LogError(f"{self.where}: column time does not increase")

    @property
    def is_triad(self) -> bool:
        """True for an inertial or magnetic sensor: three axes."""
        return self.quantity in ("specific_force", "angular_rate", "magnetic_field")

    @property
    def time(self) -> h5py.Dataset:
        """(n,) int64 ns since the log's epoch."""
        return self._group["time"]

    @property
    def counts(self) -> h5py.Dataset:
        """(n, 3) raw counts of a triad; chip-specific columns otherwise."""
        return self._group["counts"]

    @property
    def temperature_counts(self) -> h5py.Dataset | None:
        """(n,) raw counts of the chip's thermometer, if it has one."""
        return self._group.get("temperature_counts")

    @property
    def status(self) -> h5py.Dataset | npt.NDArray[np.uint16]:
        """(n,) flags of `imuarray.log.format`; zeros in a log that has none."""
        dataset = self._group.get("status")
        return np.zeros(len(self), np.uint16) if dataset is None else dataset

    def compensated(self, name: str) -> h5py.Dataset:
        """A column in physical units that the chip's own calibration gave ("temperature" degC, "pressure" Pa);
        LogError.
        """
        dataset = self._group.get(name)
        if not isinstance(dataset, _DATASET) or dataset.shape != self.time.shape:
            raise LogError(f"{self.where}: column {name} is missing")
        return dataset

    @property
    def attributes(self) -> Mapping[str, Any]:
        """All attributes as they stand in the file."""
        return cast(Mapping[str, Any], self._group.attrs)

    def __len__(self) -> int:
        return int(self.time.shape[0])

    def __reduce__(self) -> tuple[Callable[[Log | Path, str], SensorLog], tuple[Log | Path, str]]:
        return _sensor_of, (self._log() or self._path.absolute(), self.name)

    def blocks(self, rows: int = 1 << 16) -> Iterator[slice]:
        """Slices that cover the log, `rows` at a time."""
        return (slice(start, min(start + rows, len(self))) for start in range(0, len(self), rows))

    def between(self, start_ns: int, end_ns: int) -> slice:
        """The rows whose time lies in [start_ns, end_ns), found without reading the column."""
        return slice(first_at(self.time, start_ns), first_at(self.time, end_ns))


def first_at(time: h5py.Dataset, at_ns: int) -> int:
    """The first row of an increasing column whose time is `at_ns` or later; by bisection, reading one chunk at the
    end.
    """
    low, high = 0, int(time.shape[0])
    while high - low > 4096:
        middle = (low + high) // 2
        low, high = (middle, high) if time[middle] < at_ns else (low, middle)
    return low + int(np.searchsorted(time[low:high], at_ns))


class Track(NamedTuple):
    """`/truth` or `/reference`: datasets time (n,) ns, specific_force (n, 3) m/s2 and angular_rate (n, 3) rad/s in
    the box frame, temperature (n,) degC; None for what the log does not have.
    """

    time: h5py.Dataset
    specific_force: h5py.Dataset | None
    angular_rate: h5py.Dataset | None
    temperature: h5py.Dataset | None


class ClockTrack(NamedTuple):
    """`/clocks`: datasets (n,) ns of the log's own time and of four clocks of the machine (`imuarray.log.format`)."""

    time: h5py.Dataset
    monotonic: h5py.Dataset
    monotonic_raw: h5py.Dataset
    boottime: h5py.Dataset
    realtime: h5py.Dataset


class Log:
    """An open log; a context manager. `log["Gyro1"].counts[1000:2000]` reads a thousand rows and no more.

    It can be pickled, as its path: another process opens the file itself, for reading, and then again only if no log
    that came to it so is open there any more. A log that came so is shared; whoever closes it closes it for all.
    """

    def __init__(self, path: str | PathLike[str], *, thorough: bool = False) -> None:
        """Open and check `path`; LogError says what is missing or wrong with it. `thorough` reads all of a log that was
        not finished, and checks every block of it.
        """
        self.path = Path(path)
        try:
            self._file = _open(self.path, thorough)
        except DAMAGE as error:
            raise LogError(f"{path}: damaged or malformed: {' '.join(str(error).split())}") from None
        except LogError as error:  # what is wrong with its parts does not say whose they are
            if str(error).startswith(str(path)):
                raise
            raise LogError(f"{path}: {error}") from None
        try:
            self._check()
            self.sensors: Mapping[str, SensorLog] = {
                name: SensorLog(group, f"{path}, sensor {name}", self) for name, group in self._file["sensors"].items()
            }
        except BaseException as error:
            self._file.close()
            if isinstance(error, DAMAGE):
                raise LogError(f"{path}: damaged or malformed: {' '.join(str(error).split())}") from None
            raise

    def _check(self) -> None:
        attributes = self._file.attrs
        if str(_plain(attributes.get("format"))) != FORMAT:
            raise LogError(f"{self.path}: an HDF5 file, but no log: attribute format is not {FORMAT!r}")
        version = attributes.get("format_version")
        if str(version) != str(FORMAT_VERSION):
            raise LogError(f"{self.path}: log format {version}; this software reads format {FORMAT_VERSION}")
        if _plain(attributes.get("source")) not in SOURCES:
            raise LogError(
                f"{self.path}: attribute source is {attributes.get('source')!r}; allowed are {', '.join(SOURCES)}"
            )
        if not isinstance(self._file.get("sensors"), Mapping | h5py.Group) or len(self._file["sensors"]) == 0:
            raise LogError(f"{self.path}: group sensors is missing or empty")

    @property
    def preamble(self) -> Preamble | None:
        """What an unfinished log was begun with; None for one that is finished."""
        return self._file.preamble if isinstance(self._file, LiveView | Rebuilt) else None

    @property
    def state(self) -> str:
        """ "finished", "being written" or "interrupted"; of an unfinished log all that was acknowledged can be read."""
        if self.preamble is None:
            return "finished"
        return "being written" if is_running(self.path) else "interrupted"

    @property
    def is_rebuilt(self) -> bool:
        """Whether the HDF5 file of an unfinished log was of no use, and everything comes from its journal."""
        return isinstance(self._file, Rebuilt)

    @property
    def epoch(self) -> str:
        """ISO 8601 UTC of time 0."""
        return _text(self._file.attrs.get("epoch", ""))

    @property
    def source(self) -> str:
        """Where the counts came from: one of `imuarray.log.format.SOURCES`."""
        return _text(self._file.attrs["source"])

    @property
    def config(self) -> str:
        """The array's TOML text, "" if the log has none."""
        return _text(self._file.attrs.get("config", ""))

    @property
    def software(self) -> str:
        """What wrote the log."""
        return _text(self._file.attrs.get("software", ""))

    def __getitem__(self, name: str) -> SensorLog:
        """One sensor by name; LogError names those that there are."""
        if name not in self.sensors:
            raise LogError(f"{self.path}: no sensor {name!r}; it has {', '.join(self.sensors)}")
        return self.sensors[name]

    def of(self, quantity: str) -> list[SensorLog]:
        """The sensors that measure `quantity`."""
        return [sensor for sensor in self.sensors.values() if sensor.quantity == quantity]

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """Named stretches, in file order."""
        columns = self._columns("phases", ("start", "end", "name", "up"), numbers=2)
        return tuple(Phase(start, end, name, up) for start, end, name, up in zip(*columns, strict=True))

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """What happened, in file order."""
        columns = self._columns("events", ("time", "sensor", "kind", "message"), numbers=1)
        return tuple(Event(*row) for row in zip(*columns, strict=True))

    def _columns(self, name: str, columns: tuple[str, ...], numbers: int) -> list[list[Any]]:
        """Equally long columns: the first `numbers` of them whole numbers, the others text."""
        group = self._file.get(name)
        if group is None:
            return [[] for _ in columns]
        try:
            values = [[_plain(value) for value in read_texts(group[column])] for column in columns]
        except DAMAGE:
            raise LogError(f"{self.path}: group {name} lacks one of the columns {', '.join(columns)}") from None
        if len({len(column) for column in values}) != 1:
            raise LogError(f"{self.path}: group {name} has columns of different lengths")
        for index, column in enumerate(values):
            if not all(isinstance(value, int if index < numbers else str) for value in column):
                kind = "whole numbers" if index < numbers else "text"
                raise LogError(f"{self.path}: group {name}: column {columns[index]} holds no {kind}")
        return values

    @property
    def truth(self) -> Track | None:
        """What the box really felt, in a simulated or emulated log."""
        return self._track("truth")

    @property
    def reference(self) -> Track | None:
        """What a reference instrument saw, if one was there."""
        return self._track("reference")

    @property
    def clocks(self) -> ClockTrack | None:
        """What the machine's clocks said now and then."""
        group = self._file.get("clocks")
        if group is None:
            return None
        columns = [group.get(column) for column, _, _ in CLOCKS]
        if any(not isinstance(column, _DATASET) or column.dtype.kind != "i" for column in columns) or (
            len({column.shape for column in columns}) != 1
        ):
            raise LogError(f"{self.path}: group clocks lacks a column, or they differ in length")
        return ClockTrack(*columns)

    def _track(self, name: str) -> Track | None:
        group = self._file.get(name)
        if group is None:
            return None
        if not isinstance(group, _GROUP) or "time" not in group:
            raise LogError(f"{self.path}: group {name} has no time")
        columns = [group.get(column) for column in ("specific_force", "angular_rate", "temperature")]
        for column, tail in zip(columns, ((3,), (3,), ()), strict=True):
            if column is not None and column.shape != (*group["time"].shape, *tail):
                raise LogError(f"{self.path}: group {name}: a column has another shape than time")
        return Track(group["time"], *columns)

    def __reduce__(self) -> tuple[Callable[[Path], Log], tuple[Path]]:
        return _shared, (self.path.absolute(),)

    @property
    def is_open(self) -> bool:
        """Whether it can be read."""
        return bool(self._file)

    def close(self) -> None:
        """Close the file; its datasets can't be read any more."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _open(path: Path, thorough: bool) -> h5py.File | LiveView:
    """The file, or what is to be seen of a log that is being written or was never finished."""
    unfinished = open_interrupted(path, thorough=thorough) if may_be_unfinished(path) else None
    if unfinished is not None:
        return unfinished
    file = open_file(path)
    try:
        inspect(path, file)
    except BaseException:
        file.close()
        raise
    return file


def open_log(path: str | PathLike[str]) -> Log:
    """Open a log for reading; LogError, one line, if it is missing, truncated, foreign, malformed or hostile.

    One that is being written, or whose writing was cut short, is read as far as its rows were acknowledged when it was
    opened (`Log.state`); nothing on the disk is changed.
    """
    return Log(path)


_SHARED: WeakValueDictionary[Path, Log] = WeakValueDictionary()
"""Logs that came to this process as their paths."""


def _shared(path: Path) -> Log:
    """The log at a path as it was unpickled before, if it is still open; else opened. LogError as `open_log`."""
    log = _SHARED.get(path)
    if log is None or not log.is_open:
        log = _SHARED[path] = open_log(path)
    return log


def _sensor_of(log: Log | Path, name: str) -> SensorLog:
    return (log if isinstance(log, Log) else _shared(log))[name]


def _plain(value: Any) -> Any:
    """Text as str whichever way HDF5 stored it."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _text(value: Any) -> str:
    """An attribute as text."""
    return str(_plain(value))
