"""A log or a fused file as tables: raw counts with all that is needed to convert them, or physical values."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import ExportError
from imuarray.export.formats import UNITS, ExportRequest
from imuarray.export.fused import fused_content
from imuarray.export.physical import compensated_columns, physical_columns, warmth
from imuarray.export.tables import Column, Content, Table
from imuarray.fuse.fused_file import is_fused
from imuarray.log import Log, SensorLog, open_log
from imuarray.log.format import FORMAT, FORMAT_VERSION, SensorHeader
from imuarray.log.layout import TRACK_UNITS
from imuarray.log.sensor_log import recorded_header
from imuarray.units import SI_PER_UNIT

_KNOWN = frozenset({field.name for field in fields(SensorHeader)} | {"orientation", "NX_class", "signal", "comment"})


@contextmanager
def open_content(request: ExportRequest, usual: str = "counts") -> Iterator[Content]:
    """Open the tables of a log in `request.units`, else physical with a calibration, else in the `usual` ones; or those
    of a fused file, which is in SI. ExportError for units that are not allowed, LogError, CalibrationError.
    """
    if request.units not in (None, *UNITS):
        raise ExportError(f"units {request.units!r}: allowed are {', '.join(UNITS)}")
    if request.units == "counts" and request.calibration is not None:
        raise ExportError("raw counts need no calibration; leave it out, or say units si or sensor")
    if request.source.is_file() and is_fused(request.source):
        with fused_content(request) as content:
            yield content
        return
    with open_log(request.source) as log:
        yield _content(log, request, request.units or ("si" if request.calibration else usual))


def _content(log: Log, request: ExportRequest, units: str) -> Content:
    sensors = [log[name] for name in request.sensors] or list(log.sensors.values())
    calibration = request.calibration or Calibration()
    uncalibrated = () if request.calibration is None else _uncalibrated(log, sensors, calibration)
    warm = warmth(log, calibration) if units != "counts" else {}
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


def _uncalibrated(log: Log, sensors: list[SensorLog], calibration: Calibration) -> tuple[str, ...]:
    """Triads that a calibration does not know; ExportError if it knows none of them."""
    triads = [sensor.name for sensor in sensors if sensor.is_triad]
    unknown = tuple(name for name in triads if name not in calibration.sensors)
    if triads and len(unknown) == len(triads):
        known = ", ".join(calibration.sensors) or "no sensor"
        raise ExportError(f"{log.path}: has {', '.join(triads)}; the calibration contains {known}")
    return unknown


def _table(sensor: SensorLog, rest: tuple[Column, ...], calibrated: bool) -> Table:
    """A sensor's table, with its header."""
    header = asdict(full_header(sensor))
    more: dict[str, Any] = {"orientation": sensor.orientation.tolist(), "calibrated": calibrated}
    if sensor.is_triad and sensor.sensitivity:
        more["si_per_count"] = SI_PER_UNIT[sensor.unit] / sensor.sensitivity
    status = Column("status", "<u2", "1", (), lambda rows: np.asarray(sensor.status[rows]))
    columns = (_time(sensor.time), *rest[:1], status, *rest[1:])
    return Table(f"sensors/{sensor.name}", len(sensor), columns, header | more)


def _raw_columns(sensor: SensorLog) -> tuple[Column, ...]:
    """Everything that a log holds of a sensor, as it holds it."""
    counts, degrees = sensor.counts, sensor.temperature_counts
    kind = counts.dtype.newbyteorder("<").str
    columns = [Column("counts", kind, "counts", _cells(sensor), lambda rows: np.asarray(counts[rows]))]
    if degrees is not None:
        width = degrees.dtype.newbyteorder("<").str
        columns.append(Column("temperature_counts", width, "counts", (), lambda rows: np.asarray(degrees[rows])))
    return (*columns, *compensated_columns(sensor))


def _time(column: Any) -> Column:
    return Column("time", "<i8", "ns", (), lambda rows: np.asarray(column[rows], np.int64))


def _cells(sensor: SensorLog) -> tuple[str, ...]:
    """Return the names of the columns of counts."""
    count = int(sensor.counts.shape[1])
    if sensor.is_triad:
        return ("x", "y", "z")
    stored = np.atleast_1d(np.asarray(sensor.attributes.get("columns", ()))).tolist()
    names = tuple(item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item) for item in stored)
    return names if len(set(names)) == count else tuple(str(index) for index in range(count))


def full_header(sensor: SensorLog) -> SensorHeader:
    """Return all that a log says of a sensor, as the header with which it would be written again."""
    extra = {name: value for name, item in sensor.attributes.items() if (value := _plain(item)) is not None}
    delay = extra.pop("delay_ns", None)
    return replace(
        recorded_header(sensor),
        columns=_cells(sensor),
        compensated=tuple(column.name for column in compensated_columns(sensor)),
        delay_ns=delay if isinstance(delay, int) else None,
        extra={name: value for name, value in extra.items() if name not in _KNOWN},
    )


def _plain(value: Any) -> int | float | str | None:
    """An attribute that is one finite number or one text; None for any other."""
    item = value.item() if isinstance(value, np.generic) else value
    item = item.decode("utf-8", "replace") if isinstance(item, bytes) else item
    if isinstance(item, float) and not math.isfinite(item):
        return None
    return item if isinstance(item, int | float | str) and not isinstance(item, bool) else None


def _tracks(log: Log) -> Iterator[Table]:
    """Yield the tables beside those of the sensors: truth, reference, clocks."""
    for name, track in (("truth", log.truth), ("reference", log.reference), ("clocks", log.clocks)):
        if track is None:
            continue
        there = {part: column for part, column in track._asdict().items() if column is not None}
        columns = tuple(_track_column(part, column) for part, column in there.items())
        yield Table(name, len(track.time), columns, {"name": name, "frame": "box", "columns": list(there)})


def _track_column(name: str, column: Any) -> Column:
    if name == "time":
        return _time(column)
    unit = TRACK_UNITS[name]
    kind = "<i8" if unit == "ns" else "<f8"
    cells = ("x", "y", "z") if len(column.shape) == 2 else ()
    return Column(name, kind, unit, cells, lambda rows: np.asarray(column[rows], kind))


def head_with(content: Content, **more: Any) -> Mapping[str, Any]:
    """The head with what is said of each table, and more."""
    return {**content.head, "tables": {table.name: dict(table.about) for table in content.tables}, **more}
