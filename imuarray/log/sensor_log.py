"""One sensor of a log: its attributes, which are checked, and its columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast
from weakref import ref

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats
from imuarray.axes import orientation_of
from imuarray.errors import LogError
from imuarray.log.columns import DATASET, GROUP, Column, LiveGroup, NamedColumn, RowCache, named_column
from imuarray.log.format import (
    ADJUSTMENT_ATTRIBUTES,
    COUNT_BITS,
    FLAGS,
    RESOLUTION,
    SYNC_PULSE,
    THERMOMETER_ATTRIBUTES,
    TIME_UNCERTAINTY,
    CountScale,
    Phase,
    SensorHeader,
    ThermometerScale,
)
from imuarray.log.untrusted_input import plain_value
from imuarray.spelling import guess
from imuarray.units import QUANTITIES, SI_PER_UNIT, UNIT_OF, Quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from imuarray.calibrate import Calibration

_EDGE_ROWS = 4096

FARTHEST_NS = 1 << 62
"""Limit in ns of the distance of a log's times from its epoch: the difference of any two of them fits into 64 bits."""


class OpenLog(Protocol):
    """The interface of an open log that its sensors use."""

    path: Path

    @property
    def epoch(self) -> str:
        """ISO 8601 UTC of time 0."""
        ...

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Named stretches, in file order."""
        ...

    def __getitem__(self, name: str, /) -> SensorLog: ...


class SensorLog(CountScale):
    """The data of one sensor in a log. `time`, `counts`, ... behave like HDF5 datasets: slice them, or read them whole
    with `numpy.asarray`; LogError if they are damaged. A pickled sensor is stored as the path of its log and its name.
    """

    def __init__(
        self,
        group: h5py.Group | LiveGroup,
        where: str,
        log: OpenLog,
        opened: Callable[[Path], OpenLog],
        cache: RowCache | None = None,
    ) -> None:
        """Check the group; LogError. `where` is its name in errors; `opened` opens the log at a path in a process to
        which the sensor is sent; `cache` keeps rows of a file that does not change.
        """
        if not isinstance(group, GROUP):
            raise LogError(f"{where}: is not a group; a sensor is a group of columns with attributes")
        self._opened_group, self._cache = group, cache
        self._attributes = group.attrs
        self._attribute_names = frozenset(group.attrs)  # HDF5 is slow for an attribute that does not exist
        self._columns: dict[str, NamedColumn] = {}
        self._opened = opened
        self._log, self._path = ref(log), log.path  # a weak reference, so that an unused log is closed at once
        self.name = str(group.name).rsplit("/", 1)[-1]
        self.where = where
        self.chip = self._text("chip")
        self.quantity = self._text("quantity", QUANTITIES)
        self.unit = self._text("unit", tuple(SI_PER_UNIT))
        if self.is_triad and self.unit != UNIT_OF[self.quantity]:
            raise LogError(
                f"{where}: attribute unit is {self.unit!r}; allowed for {self.quantity} is {UNIT_OF[self.quantity]}"
            )
        # The words of a barometer or a thermometer have no scale of their own; not every recorder writes one.
        default = None if self.is_triad else 0.0
        self.range = self._magnitude("range", default)
        self.sensitivity = self._magnitude("sensitivity", default)
        self.rate_hz = self._magnitude("rate_hz", 0.0)
        self.bandwidth_hz = self._magnitude("bandwidth_hz", 0.0)
        self.delay_ns = round(self._number("delay_ns", 0.0))
        is_stated = self.is_triad or self._attribute("axes", "") != ""  # a barometer has no direction
        self.axes = self._text("axes") if is_stated else "+X+Y+Z"
        zero_degc, lsb_per_degc = (self._number(name, 0.0) for name in THERMOMETER_ATTRIBUTES)
        self.thermometer = ThermometerScale(zero_degc, lsb_per_degc) if lsb_per_degc else None
        self.adjustment_words = {
            name: round(self._number(name)) for name in ADJUSTMENT_ATTRIBUTES if name in self._attribute_names
        }
        self.position_mm = self._numbers("position_mm", np.zeros(3))
        self.orientation = self._orientation()
        self._check_columns()

    def _attribute(self, name: str, default: Any = None) -> Any:
        return self._attributes[name] if name in self._attribute_names else default

    def _text(self, attribute: str, allowed: tuple[str, ...] = ()) -> str:
        value = plain_value(self._attribute(attribute))
        if not isinstance(value, str) or (allowed and value not in allowed):
            choice = f"; allowed are {', '.join(allowed)}" if allowed else ""
            raise LogError(
                f"{self.where}: attribute {attribute} is {'missing' if value is None else repr(value)}{choice}"
            )
        return value

    def _number(self, attribute: str, default: float | None = None) -> float:
        value = plain_value(self._attribute(attribute, default))
        try:
            number = float(cast(Any, value))
        except (TypeError, ValueError):
            state = "missing" if value is None else repr(value)
            raise LogError(f"{self.where}: attribute {attribute} is {state}, a number is required") from None
        if not np.isfinite(number):
            raise LogError(f"{self.where}: attribute {attribute} is {number}, a finite number is required")
        return number

    def _magnitude(self, attribute: str, default: float | None = None) -> float:
        """Return an attribute that is not negative; 0 means unknown."""
        number = self._number(attribute, default)
        if number < 0:
            hint = "; the direction of an axis is stated by axes" if attribute == "sensitivity" else ""
            raise LogError(f"{self.where}: attribute {attribute} is {number:g}, 0 or more is required{hint}")
        return number

    def _numbers(self, attribute: str, default: Floats) -> Floats:
        """Return an attribute of several numbers, with the shape of its default."""
        value = self._attribute(attribute, default)
        try:
            numbers = np.asarray(value, float)
        except (TypeError, ValueError):
            numbers = np.array([])
        if numbers.shape != default.shape or not np.isfinite(numbers).all():
            kind = "a 3x3 rotation" if default.ndim == 2 else "three finite numbers"
            raise LogError(f"{self.where}: attribute {attribute} is not {kind}")
        return numbers

    def _orientation(self) -> Floats:
        """Return the stored matrix if there is one (a fused or foreign log may have a finer one), or that of `axes`."""
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
            if not isinstance(dataset, DATASET) or dataset.dtype.kind not in kind:
                numbers = "unsigned whole numbers" if kind == "u" else "whole numbers"
                raise LogError(f"{self.where}: column {name} is not a column of {numbers}{_type_of(dataset)}")
            self._columns[name] = named_column(
                dataset, f"{self.where}: {name}", self._cache, _working_type(name, dataset)
            )
            if dataset.shape[:1] != self.time.shape[:1]:
                shapes = f"its shape is {dataset.shape}, that of time {self.time.shape}"
                raise LogError(f"{self.where}: column {name} has another length than time: {shapes}")
            if name != "counts" and len(dataset.shape) != 1:
                raise LogError(
                    f"{self.where}: column {name} has shape {dataset.shape}, one number in each row is required"
                )
        if self.counts.ndim != 2 or (self.is_triad and self.counts.shape[1] != 3):
            raise LogError(f"{self.where}: column counts is not an (n, 3) table: its shape is {self.counts.shape}")
        edges = (slice(_EDGE_ROWS), slice(-_EDGE_ROWS, None))
        for edge in edges if len(self) > _EDGE_ROWS else edges[:1]:  # `verify` checks all rows
            try:
                times = self.time[edge]
            except LogError:  # raised again when these rows are read; other sensors may be intact
                continue
            self._check_times(times, edge.indices(len(self))[0])

    def _check_times(self, times: npt.NDArray[np.int64], first: int) -> None:
        """Raise LogError unless these times, which begin at row `first`, increase and are near enough to the epoch."""
        late = np.flatnonzero(np.diff(times) <= 0)
        if len(late):
            raise LogError(f"{self.where}: column time does not increase after row {first + late[0]}")
        if len(times) and max(-int(times[0]), int(times[-1])) >= FARTHEST_NS:
            at_s = int(times[0] if times[0] < 0 else times[-1]) * 1e-9
            raise LogError(
                f"{self.where}: column time reaches {at_s:.4g} s; allowed are {FARTHEST_NS * 1e-9:.4g} s (146 years)"
                " before and after the epoch, in ns"
            )

    @property
    def _adjustment_attributes(self) -> Mapping[str, object]:
        return self.adjustment_words

    @property
    def count_bits(self) -> int:
        """The number of bits of a triad's counts, from its attribute; 16 without one."""
        return round(self._number(COUNT_BITS, 16.0))

    @property
    def time(self) -> NamedColumn:
        """(n,) int64 ns since the log's epoch."""
        return self._column("time")

    @property
    def counts(self) -> NamedColumn:
        """(n, 3) raw counts of a triad; chip-specific columns otherwise."""
        return self._column("counts")

    @property
    def temperature_counts(self) -> NamedColumn | None:
        """(n,) raw counts of the chip's thermometer, if it has one."""
        return self._column("temperature_counts") if self._has("temperature_counts") else None

    @property
    def status(self) -> NamedColumn | npt.NDArray[np.uint16]:
        """The flags (n,) of `imuarray.log.format`; zeros if the log has none."""
        return self._column("status") if self._has("status") else np.zeros(len(self), np.uint16)

    def compensated(self, name: str) -> NamedColumn:
        """Return a column in physical units computed with the chip's own calibration ("temperature" degC, "pressure"
        Pa); LogError if the log does not have the column.
        """
        if not self.has_compensated(name):
            raise LogError(f"{self.where}: column {name} is missing")
        return self._column(name)

    @property
    def time_uncertainty(self) -> NamedColumn | None:
        """The largest possible error (n,) of the time of each row in s, for sensors whose queue was drained; None if
        the log does not state it.
        """
        return self._column(TIME_UNCERTAINTY) if self.has_compensated(TIME_UNCERTAINTY) else None

    @property
    def sync_pulse(self) -> NamedColumn | None:
        """The time (n,) in s from a synchronisation pulse to the row that it marks, the first after it; nan in all
        other rows. None for a sensor without pulses.
        """
        return self._column(SYNC_PULSE) if self.has_compensated(SYNC_PULSE) else None

    @property
    def _group(self) -> h5py.Group | LiveGroup:
        """The group of the open file; LogError if the log was closed."""
        if isinstance(self._opened_group, h5py.Group) and not self._opened_group:
            raise LogError(f"{self.where}: the log is closed; read it while it is open")
        return self._opened_group

    def _has(self, name: str) -> bool:
        return name in self._columns or self._group.get(name) is not None

    def _column(self, name: str) -> NamedColumn:
        """Return a column by its name. It is looked up once, because HDF5 takes as long for it as for reading some
        thousand rows.
        """
        if name not in self._columns:
            self._columns[name] = named_column(self._group[name], f"{self.where}: {name}", self._cache)
        return self._columns[name]

    def has_compensated(self, name: str) -> bool:
        """Return whether the log has a column of this name with one value per row."""
        dataset = self._group.get(name)
        return isinstance(dataset, DATASET) and dataset.shape == self.time.shape

    @property
    def count_columns(self) -> tuple[str, ...]:
        """The names of the columns of counts: x, y, z of a triad, else those in the log, or their numbers."""
        count = int(self.counts.shape[1])
        if self.is_triad:
            return ("x", "y", "z")
        stored = np.atleast_1d(np.asarray(self._group.attrs.get("columns", ()))).tolist()
        names = tuple(item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item) for item in stored)
        return names if len(set(names)) == count else tuple(map(str, range(count)))

    @property
    def attributes(self) -> Mapping[str, Any]:
        """All attributes as stored in the file."""
        return cast(Mapping[str, Any], self._group.attrs)

    def to_xarray(self, calibration: Calibration | None = None, *, phase: str = "") -> Any:
        """Return an `xarray.Dataset` of all rows, or of those of the phases named `phase`: physical values in SI in the
        box frame under the name of the quantity, by `calibration` or else the data sheet's sensitivity, raw counts,
        status and temperature, over `time` (datetime64, UTC). Every variable has its unit. LogError for a phase that
        the log lacks, MissingExtraError without xarray (extra "analysis").

        The biases of a calibration are subtracted without temperature compensation, unlike in `imuarray.export` and
        fusion.
        """
        from imuarray.log.datasets import sensor_dataset

        rows = self._rows_of(phase) if phase else slice(None)
        return sensor_dataset(self, self._whole_log().epoch, calibration).isel(time=rows)

    def to_pandas(self, calibration: Calibration | None = None, *, phase: str = "") -> Any:
        """Return the contents of `to_xarray` as a `pandas.DataFrame` indexed by time, with a column for each number:
        `angular_rate_X`, `counts_x`, `status`, ...; units by column in its `attrs`. MissingExtraError without xarray
        and pandas (extra "analysis").
        """
        from imuarray.log.datasets import table

        return table(self.to_xarray(calibration, phase=phase))

    def plot(self, calibration: Calibration | None = None) -> Figure:
        """Draw the physical values in the box frame over time, or the counts if their unit is unknown;
        MissingExtraError without matplotlib (extra "report").
        """
        from imuarray.log.datasets import log_figure

        return log_figure([self], calibration)

    def _rows_of(self, phase: str) -> Booleans:
        """Return (n,) the rows within the phases of a name; LogError if there is none."""
        phases = self._whole_log().phases
        chosen = [part for part in phases if part.name == phase]
        if not chosen:
            known = list(dict.fromkeys(part.name for part in phases))
            raise LogError(
                f"{self._path}: no phase {phase!r}; it has {', '.join(known) or 'no phases'}{guess(phase, known)}"
            )
        time = np.asarray(self.time[:])
        within = [(part.start_ns <= time) & (time < part.end_ns) for part in chosen]
        return np.asarray(np.any(within, axis=0))

    def _whole_log(self) -> OpenLog:
        log = self._log()
        return log if log is not None else self._opened(self._path)

    def __repr__(self) -> str:
        span = f" +-{self.range:g} {self.unit}" if self.range else ""
        return f"<SensorLog {self.name}: {self.chip}, {self.quantity}{span}, {len(self)} rows>"

    def __len__(self) -> int:
        return int(self.time.shape[0])

    def __reduce__(self) -> tuple[Callable[..., SensorLog], tuple[Any, ...]]:
        if (log := self._log()) is not None:
            return getitem, (log, self.name)
        return _reopen, (self._opened, self._path.absolute(), self.name)

    def blocks(self, rows: int = 1 << 16) -> Iterator[slice]:
        """Yield slices that cover the log, `rows` at a time."""
        return (slice(start, min(start + rows, len(self))) for start in range(0, len(self), rows))

    def flagged(self) -> dict[str, int]:
        """Return how many rows have each flag of `imuarray.log.format`."""
        counts = dict.fromkeys(FLAGS, 0)
        for block in self.blocks():
            status = np.asarray(self.status[block])
            for name, flag in FLAGS.items() if status.any() else ():
                counts[name] += int(np.count_nonzero(status & flag))
        return counts

    def between(self, start_ns: int, end_ns: int) -> slice:
        """Return the rows whose time lies in [start_ns, end_ns), without reading the whole column."""
        return slice(first_at(self.time, start_ns), first_at(self.time, end_ns))


def _type_of(column: object) -> str:
    """Return the type of a column that is refused, as part of a sentence."""
    return f" but of {column.dtype}" if isinstance(column, DATASET) else ""


def _working_type(name: str, column: h5py.Dataset | Column) -> np.dtype[Any]:
    """Return the type in which a column is read: times as int64, and counts without a sign in a type with one, because
    differences of unsigned numbers wrap around and sums of uint64 and int64 are rounded to 53 bits.
    """
    stored: np.dtype[Any] = column.dtype.newbyteorder("=")
    if name == "time":
        return np.dtype(np.int64)
    if name == "status" or stored.kind == "i":
        return stored
    return np.dtype(f"i{min(2 * stored.itemsize, 8)}")


def _reopen(opened: Callable[[Path], OpenLog], path: Path, name: str) -> SensorLog:
    return opened(path)[name]


def first_at(time: NamedColumn, at_ns: int, rows: int | None = None) -> int:
    """Return the number of the first row of an increasing column whose time is `at_ns` or later, among its first `rows`
    (None: all); `rows` if there is none. It is found by bisection, with one chunk read at the end.
    """
    low, high = 0, int(time.shape[0]) if rows is None else rows
    while high - low > 4096:
        middle = (low + high) // 2
        low, high = (middle, high) if time[middle] < at_ns else (low, middle)
    return low + int(np.searchsorted(time[low:high], at_ns))


def recorded_header(sensor: SensorLog) -> SensorHeader:
    """Return the header with which the data of `sensor` can be written again."""
    x, y, z = sensor.position_mm.tolist()
    bits = {COUNT_BITS: sensor.count_bits} if sensor.is_triad and sensor.count_bits > 16 else {}
    columns = {"pressure": ("ut", "up"), "temperature": ("t",)}.get(sensor.quantity, ("x", "y", "z"))
    compensated = {"pressure": ("temperature", "pressure"), "temperature": ("temperature",)}.get(sensor.quantity, ())
    return SensorHeader(
        name=sensor.name,
        chip=sensor.chip,
        quantity=cast(Quantity, sensor.quantity),
        unit=sensor.unit,
        range=sensor.range,
        sensitivity=sensor.sensitivity,
        rate_hz=sensor.rate_hz,
        bandwidth_hz=sensor.bandwidth_hz,
        axes=sensor.axes,
        position_mm=(x, y, z),
        columns=columns,
        has_temperature=sensor.temperature_counts is not None,
        compensated=compensated,
        extra={
            **({} if sensor.thermometer is None else sensor.thermometer.attributes),
            **bits,
            **sensor.adjustment_words,
            **({RESOLUTION: str(sensor.attributes[RESOLUTION])} if RESOLUTION in sensor.attributes else {}),
        },
    )
