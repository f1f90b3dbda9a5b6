"""A log or a fused file as tables: raw counts with the data required to convert them, or physical values.

Physical values are specific force, angular rate and magnetic flux density in the box frame, degrees and pascals. The
bias of a calibration with temperature slopes follows the temperature recorded in the log, as in fusion. Its other
corrections (g-sensitivity, the start-up state of a gyroscope) are not applied.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.segments import TemperatureSeries, degc_of, has_zero
from imuarray.errors import ExportError, LogError
from imuarray.export.formats import UNITS, ExportRequest
from imuarray.export.tables import Content, ExportTable, TableColumn
from imuarray.fuse import fused_file
from imuarray.fuse.element_temperature import element_temperatures
from imuarray.log import Log, SensorLog, open_log
from imuarray.log.columns import NamedColumn
from imuarray.log.format import COMPENSATED_UNITS, FORMAT, FORMAT_VERSION, SINGLE_PRECISION, TRACK_UNITS, SensorHeader
from imuarray.log.sensor_log import recorded_header
from imuarray.units import SI_NAME, SI_PER_UNIT

_AXES = ("x", "y", "z")


def bias_temperatures(log: Log, calibration: Calibration) -> dict[str, TemperatureSeries]:
    """Return the temperature that the bias of each sensor with known slopes follows."""
    inertial = [*log.of("specific_force"), *log.of("angular_rate")]
    return element_temperatures(log, (sensor for sensor in inertial if len(sensor)), calibration)


def physical_columns(
    sensor: SensorLog, calibration: Calibration, units: str, warm: Mapping[str, TemperatureSeries]
) -> tuple[TableColumn, ...]:
    """Return the columns of a sensor, except time and status, in `units` ("si" or "sensor"); counts if no unit is
    known. CalibrationError if the calibration does not fit, or if neither it nor the log states a sensitivity.
    """
    if sensor.is_triad:
        return (_triad(sensor, calibration.or_nominal(sensor), units, warm.get(sensor.name)), *_temperature(sensor))
    return compensated_columns(sensor)


def compensated_columns(sensor: SensorLog) -> tuple[TableColumn, ...]:
    """Return the columns of the log that are already in physical units: compensated values of a barometer, delays of
    arrival, the uncertainty of times, and the times since synchronisation pulses.
    """
    columns = []
    for name, unit in COMPENSATED_UNITS.items():
        with suppress(LogError):
            columns.append(
                _stored_column(name, sensor.compensated(name), unit, "<f4" if name in SINGLE_PRECISION else "<f8")
            )
    return tuple(columns)


def _triad(sensor: SensorLog, parameters: SensorCalibration, units: str, warm: TemperatureSeries | None) -> TableColumn:
    scale = 1.0 if units == "si" else 1 / SI_PER_UNIT[sensor.unit]

    def read(rows: slice) -> npt.NDArray[np.float64]:
        counts = np.asarray(sensor.counts[rows], float)
        if warm is not None:
            counts -= parameters.bias_at(warm.at(np.asarray(sensor.time[rows]) * 1e-9)) - parameters.bias_lsb
        return parameters.stimulus_box(counts) * scale

    return TableColumn(sensor.quantity, "<f8", SI_NAME[sensor.unit] if units == "si" else sensor.unit, _AXES, read)


def _temperature(sensor: SensorLog) -> tuple[TableColumn, ...]:
    """Return the chip's own thermometer in degC, or its counts if it has no zero."""
    column = sensor.temperature_counts
    if column is None:
        return ()
    degc = degc_of(sensor)
    if degc is None or not has_zero(sensor):
        return (_stored_column("temperature_counts", column, "counts", "<i2"),)
    zero, step = degc
    return (TableColumn("temperature", "<f8", "degC", (), lambda rows: zero + step * np.asarray(column[rows], float)),)


def _stored_column(name: str, column: Any, unit: str, kind: str = "", cells: tuple[str, ...] = ()) -> TableColumn:
    """Return a column of a file, as it is stored or as numbers of the type `kind`."""
    kind = kind or column.dtype.newbyteorder("<").str
    return TableColumn(name, kind, unit, cells, lambda rows: np.asarray(column[rows], kind))


_OTHER_FIELDS = frozenset(
    {field.name for field in fields(SensorHeader)} | {"orientation", "NX_class", "signal", "comment"}
)


@contextmanager
def open_content(request: ExportRequest, usual: str = "counts") -> Iterator[Content]:
    """Open the tables of a log in `request.units`, or by default in SI with a calibration and otherwise in the `usual`
    units; or the tables of a fused file, which are in SI. ExportError for units that are not allowed, LogError,
    CalibrationError.
    """
    if request.units not in (None, *UNITS):
        raise ExportError(f"units {request.units!r}: allowed are {', '.join(UNITS)}")
    if request.units == "counts" and request.calibration is not None:
        raise ExportError("raw counts need no calibration; leave it out, or choose the units si or sensor")
    if request.source.is_file() and fused_file.is_fused(request.source):
        with _fused_content(request) as content:
            yield content
        return
    with open_log(request.source) as log:
        log.keep_rows()  # because tables read a few rows at a time
        yield _content(log, request, request.units or ("si" if request.calibration else usual))


def _content(log: Log, request: ExportRequest, units: str) -> Content:
    sensors = [log[name] for name in request.sensors] or list(log.sensors.values())
    calibration = request.calibration or Calibration()
    uncalibrated = () if request.calibration is None else _find_uncalibrated(log, sensors, calibration)
    warm = bias_temperatures(log, calibration) if units != "counts" else {}
    tables = []
    for sensor in sensors:
        rest = _raw_columns(sensor) if units == "counts" else physical_columns(sensor, calibration, units, warm)
        tables.append(_table(sensor, rest, sensor.name in calibration.sensors))
    head = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "log": log.path.name,
        "units": units,
        "epoch": log.epoch,
        "source": log.source,
        "config": log.config,
        "software": log.software,
        "frame_rate_hz": log.frame_rate_hz,
    }
    tracks = [] if request.sensors else list(_tracks(log))
    return Content(units, log.epoch, head, (*tables, *tracks), log.phases, log.events, uncalibrated)


def _find_uncalibrated(log: Log, sensors: list[SensorLog], calibration: Calibration) -> tuple[str, ...]:
    """Return the triads that are missing in a calibration; ExportError if it has none of them."""
    triads = [sensor.name for sensor in sensors if sensor.is_triad]
    unknown = tuple(name for name in triads if name not in calibration.sensors)
    if triads and len(unknown) == len(triads):
        names = ", ".join(calibration.sensors) or "no sensor"
        raise ExportError(f"{log.path}: has {', '.join(triads)}; the calibration contains {names}")
    return unknown


def _table(sensor: SensorLog, rest: tuple[TableColumn, ...], calibrated: bool) -> ExportTable:
    header = asdict(full_header(sensor))
    attributes: dict[str, Any] = {"orientation": sensor.orientation.tolist(), "calibrated": calibrated}
    if sensor.is_triad and sensor.sensitivity:
        attributes["si_per_count"] = SI_PER_UNIT[sensor.unit] / sensor.sensitivity
    time, status = _stored_column("time", sensor.time, "ns", "<i8"), _stored_column("status", sensor.status, "1", "<u2")
    columns = (time, *rest[:1], status, *rest[1:])
    return ExportTable(f"sensors/{sensor.name}", len(sensor), columns, header | attributes)


def _raw_columns(sensor: SensorLog) -> tuple[TableColumn, ...]:
    """Return all columns of a sensor as they are stored in the log, except time and status."""
    columns = [_stored_column("counts", sensor.counts, "counts", cells=sensor.count_columns)]
    if sensor.temperature_counts is not None:
        columns.append(_stored_column("temperature_counts", sensor.temperature_counts, "counts"))
    return (*columns, *compensated_columns(sensor))


def full_header(sensor: SensorLog) -> SensorHeader:
    """Return the header with which the sensor can be written again, with all its attributes."""
    extra = {name: value for name, item in sensor.attributes.items() if (value := _plain(item)) is not None}
    delay = extra.pop("delay_ns", None)
    return replace(
        recorded_header(sensor),
        columns=sensor.count_columns,
        compensated=tuple(column.name for column in compensated_columns(sensor)),
        delay_ns=delay if isinstance(delay, int) else None,
        extra={name: value for name, value in extra.items() if name not in _OTHER_FIELDS},
    )


def _plain(value: Any) -> int | float | str | None:
    """Return an attribute that is one finite number or one text; None for any other."""
    item = value.item() if isinstance(value, np.generic) else value
    item = item.decode("utf-8", "replace") if isinstance(item, bytes) else item
    if isinstance(item, float) and not math.isfinite(item):
        return None
    return item if isinstance(item, int | float | str) and not isinstance(item, bool) else None


def _tracks(log: Log) -> Iterator[ExportTable]:
    for name, track in (("truth", log.truth), ("reference", log.reference), ("clocks", log.clocks)):
        if track is None:
            continue
        stored = {part: column for part, column in track._asdict().items() if column is not None}
        columns = []
        for part, column in stored.items():
            unit = "ns" if part == "time" else TRACK_UNITS[part]
            cells = _AXES if len(column.shape) == 2 else ()
            columns.append(_stored_column(part, column, unit, "<i8" if unit == "ns" else "<f8", cells))
        about = {"name": name, "frame": "box", "columns": list(stored)}
        yield ExportTable(name, len(track.time), tuple(columns), about)


def head_with(content: Content, **more: Any) -> Mapping[str, Any]:
    """Return the head with the description of each table and the entries `more`."""
    return {**content.head, "tables": {table.name: dict(table.about) for table in content.tables}, **more}


@contextmanager
def _fused_content(request: ExportRequest) -> Iterator[Content]:
    """Open the table of a fused file; ExportError for options that apply only to a log, LogError for a damaged or
    hostile file.
    """
    path = request.source
    if request.sensors or request.calibration is not None or request.units not in (None, "si"):
        raise ExportError(f"{path}: a fused result; it has no sensors to choose or convert, and is in SI")
    with fused_file.fused_columns(path) as (attributes, columns):
        head: dict[str, Any] = {"format": fused_file.FORMAT, "format_version": fused_file.FORMAT_VERSION, "units": "si"}
        head |= {name: attributes.get(name, "") for name in ("epoch", "technique", "log", "calibration", "software")}
        listed = sorted(columns.items(), key=lambda item: (item[0] != "time", item[0]))
        fused = tuple(
            _stored_column(name, column, "ns", "<i8")
            if name == "time"
            else _stored_column(name, column, fused_file.UNITS.get(name, "1"), cells=_cells(column))
            for name, column in listed
        )
        table = ExportTable("fused", fused_file.rows_of(columns), fused, {"name": "fused", "frame": "box"})
        yield Content("si", head["epoch"], head, (table,))


def _cells(column: NamedColumn) -> tuple[str, ...]:
    """Return the names of the cells of a row: x, y, z, the entries of a covariance, or a flag for each sensor."""
    if len(column.shape) == 1:
        return ()
    count = column.shape[1]
    names = (
        fused_file.texts_of(column.attrs, "columns") or fused_file.texts_of(column.attrs, "sensors") or ("x", "y", "z")
    )
    return names if len(names) == len(set(names)) == count else tuple(str(index) for index in range(count))
