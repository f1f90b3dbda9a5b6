"""The messages of an MCAP file for Foxglove: JSON, with a JSON Schema for each kind of message.

A sensor's message has its time, its frame and a field for each column: ``{"x", "y", "z"}`` for a triad. Messages with
specific force and angular rate (a fused result, the truth) have the names of ROS's sensor_msgs/Imu: covariances are row
by row, and their first entry is -1 if the quantity is missing; `linear_acceleration` is specific force, as in ROS.
Events are foxglove.Log (docs.foxglove.dev/docs/sdk/schemas/log), so that the Log panel shows them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from imuarray.export.tables import ExportTable, TableColumn

TIME: Mapping[str, Any] = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
    "required": ["sec", "nsec"],
}
LEVELS = {"INFO": 2, "WARNING": 3}
"""Levels of foxglove.Log that are used here."""

_NUMBER: Mapping[str, Any] = {"type": "number"}
_NINE: Mapping[str, Any] = {"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9}
ENTRIES_OF_COVARIANCE = (0, 3, 4, 3, 1, 5, 4, 5, 2)
"""Position of the nine entries of a covariance among the six that are stored (xx yy zz xy xz yz)."""
_NOT_KNOWN = [-1.0, *[0.0] * 8]
_IMU = {"angular_rate": "angular_velocity", "specific_force": "linear_acceleration"}


def time_of(nanoseconds: int) -> dict[str, int]:
    """Return nanoseconds since 1970 in Foxglove's form of a time."""
    return {"sec": nanoseconds // 1_000_000_000, "nsec": nanoseconds % 1_000_000_000}


def is_imu(table: ExportTable) -> bool:
    """Return whether a table has specific force and angular rate."""
    return set(_IMU) <= {column.name for column in table.columns}


def log_schema() -> dict[str, Any]:
    """Return the schema of foxglove.Log."""
    levels = [{"title": name, "const": number} for name, number in LEVELS.items()]
    text = {"type": "string"}
    fields = {"timestamp": TIME, "level": {"oneOf": levels}, "message": text, "name": text, "file": text}
    return _object("foxglove.Log", {**fields, "line": {"type": "integer", "minimum": 0}})


def log_message(nanoseconds: int, level: str, name: str, message: str) -> dict[str, Any]:
    """Return a foxglove.Log message."""
    message_log = {"timestamp": time_of(nanoseconds), "level": LEVELS[level], "message": message, "name": name}
    return {**message_log, "file": "", "line": 0}


def imu_schema() -> dict[str, Any]:
    """Return the schema of sensor_msgs/Imu, in JSON."""
    triad = _object("", dict.fromkeys("xyz", _NUMBER))
    header = _object("", {"stamp": TIME, "frame_id": {"type": "string"}})
    covariances = {f"{name}_covariance": _NINE for name in ("orientation", *_IMU.values())}
    schema = _object("imuarray.Imu", {"header": header, **covariances})
    schema["properties"] |= dict.fromkeys(_IMU.values(), triad) | {"temperature": _NUMBER}
    return schema


def imu_message(nanoseconds: int, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return an Imu message. `row` has a triad by quantity, the six entries of its covariance by quantity with
    "_covariance", and a temperature.
    """
    message: dict[str, Any] = {"header": {"stamp": time_of(nanoseconds), "frame_id": "box"}}
    message["orientation_covariance"] = _NOT_KNOWN
    for quantity, name in _IMU.items():
        triad, six = row[quantity], row.get(f"{quantity}_covariance", [math.nan] * 6)
        is_finite = _finite(triad)
        if is_finite:
            message[name] = dict(zip("xyz", triad, strict=True))
        # In ROS, a covariance of zeros means that it is not known.
        covariance = [six[entry] for entry in ENTRIES_OF_COVARIANCE] if _finite(six) else [0.0] * 9
        message[f"{name}_covariance"] = covariance if is_finite else _NOT_KNOWN
    if _finite([row.get("temperature", math.nan)]):
        message["temperature"] = row["temperature"]
    return message


def table_schema(table: ExportTable) -> dict[str, Any]:
    """Return the schema of a sensor's messages."""
    fields = {column.name: _field(column) for column in table.columns if column.name != "time"}
    schema = _object(f"imuarray.{table.short}", {"timestamp": TIME, "frame_id": {"type": "string"}})
    schema["properties"] |= fields
    return schema


def table_message(nanoseconds: int, frame: str, columns: Sequence[TableColumn], row: Sequence[Any]) -> dict[str, Any]:
    """Return the message of a row of a sensor's table; values that are not finite are omitted."""
    message: dict[str, Any] = {"timestamp": time_of(nanoseconds), "frame_id": frame}
    for column, value in zip(columns, row, strict=True):
        cells = value if column.cells else [value]
        if _finite(cells):
            message[column.name] = dict(zip(column.cells, value, strict=True)) if column.cells else value
    return message


def _field(column: TableColumn) -> dict[str, Any]:
    """Return a number, or one for each cell; the unit is its description."""
    kind = {"type": "number" if column.kind[1] == "f" else "integer", "description": column.unit}
    return _object("", dict.fromkeys(column.cells, kind)) if column.cells else kind


def _object(title: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    named = {"title": title} if title else {}
    return {**named, "type": "object", "properties": dict(fields), "required": list(fields)}


def _finite(values: Sequence[float]) -> bool:
    return all(math.isfinite(value) for value in values)
