"""Messages of a ROS 2 bag: `sensor_msgs` and `rcl_interfaces` in CDR, in SI in the box frame, a topic for each sensor.

::

    /sensors/NAME              Imu of an accelerometer or gyroscope, MagneticField, FluidPressure
    /sensors/NAME/temperature  Temperature of the chip's thermometer
    /fused, /truth, /reference Imu, with covariances where they are known
    /events, /phases           rcl_interfaces/msg/Log

The two halves of a six-axis chip (NAME_acc, NAME_gyro) whose rows have equal times are one Imu, /sensors/NAME.

A message of `sensor_msgs` is a header followed by numbers of 64 bits. The frame is the same in all messages, so that
they have equal length and numpy writes a block of them at once (CDR: OMG "DDS-RTPS" 2.2, chapter 10, little endian). In
ROS, the first covariance of a missing estimate is -1, and an unknown covariance is zero.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.errors import ExportError
from imuarray.export.mcap_schemas import ENTRIES_OF_COVARIANCE
from imuarray.export.tables import ExportTable, Meter, TableColumn, number_names

LOG = "rcl_interfaces/msg/Log"
LEVELS = {"INFO": 20, "WARNING": 30}
"""Levels of rcl_interfaces/msg/Log that are used here."""

FRAME = "box"
"""`frame_id` of every message: the frame of the array's box."""

_LAST_SECOND = 2**31 - 1
"""builtin_interfaces/Time counts seconds in an int32."""

_RULE = "=" * 80
_TIME = "int32 sec\nuint32 nanosec"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
_VECTOR = "float64 x\nfloat64 y\nfloat64 z"


def _definition(definition: str, **parts: str) -> str:
    """Return a message's definition, followed by those of its parts, in the form that rosbag2 stores."""
    texts = [definition, *(f"MSG: {name.replace('__', '/')}\n{text}" for name, text in parts.items())]
    return f"\n{_RULE}\n".join(texts) + "\n"


_STAMPED = {"std_msgs__Header": _HEADER, "builtin_interfaces__Time": _TIME}
DEFINITIONS: Mapping[str, str] = {
    "sensor_msgs/msg/Imu": _definition(
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
        **_STAMPED,
        geometry_msgs__Quaternion=f"{_VECTOR}\nfloat64 w",
        geometry_msgs__Vector3=_VECTOR,
    ),
    "sensor_msgs/msg/MagneticField": _definition(
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance",
        **_STAMPED,
        geometry_msgs__Vector3=_VECTOR,
    ),
    "sensor_msgs/msg/FluidPressure": _definition(
        "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance", **_STAMPED
    ),
    "sensor_msgs/msg/Temperature": _definition(
        "std_msgs/Header header\nfloat64 temperature\nfloat64 variance", **_STAMPED
    ),
    LOG: _definition(
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n"
        "string file\nstring function\nuint32 line",
        builtin_interfaces__Time=_TIME,
    ),
}
"""The definition of each type of message, which the bag contains so that any reader can decode it."""

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_IMU_NUMBERS = 37
_ORIENTATION_W, _ORIENTATION_COVARIANCE = 3, 4
_IMU = {"angular_rate": 13, "specific_force": 25}
"""Position of each triad among the numbers of an Imu; its covariance follows."""

Cells = Mapping[str, npt.NDArray[np.float64]]
"""The columns of some rows by name, (n, cells) each."""


class Topic(NamedTuple):
    """A topic of a bag: its name and type, its table, the columns that it needs, and the function that computes the
    numbers (n, k) of its messages; a row whose first number is nan has no message.
    """

    name: str
    kind: str
    table: ExportTable
    columns: tuple[TableColumn, ...]
    numbers: Callable[[Cells], Floats]

    def blocks(self, zero_ns: int, rows: int, meter: Meter) -> Iterator[tuple[Times, npt.NDArray[np.uint8]]]:
        """Yield times (n,) in ns since 1970 and messages (n, bytes); ExportError for a time ROS can't represent."""
        for part in self.table.blocks(rows):
            time_ns = np.asarray(self.table.columns[0].read(part) + zero_ns, np.int64)
            cells = {column.name: np.asarray(column.read(part), float) for column in self.columns}
            numbers = self.numbers({name: values.reshape(len(time_ns), -1) for name, values in cells.items()})
            has_values = ~np.isnan(numbers[:, 0])
            yield time_ns[has_values], _add_headers(time_ns[has_values], numbers[has_values])
            meter.add(part.stop - part.start, len(self.columns))


def topics(tables: Sequence[ExportTable]) -> Iterator[Topic]:
    """Yield the topics of the tables of a log or a fused file; a table without physical values has none."""
    names: set[str] = set()
    twins = _twins(tables)
    for table in tables:
        if table.name == "clocks" or table.name in twins.values():
            continue
        columns = {column.name: column for column in table.columns[1:]}
        name = table.name
        if table.name in twins:
            twin = next(table_of_twin for table_of_twin in tables if table_of_twin.name == twins[table.name])
            columns = {column.name: column for column in twin.columns[1:]} | columns
            name = table.name.removesuffix("_acc")
        free = next(wish for wish in number_names(_topic_name(name)) if wish not in names)
        names.add(free)
        yield from _topics_of(free, table, columns)


def _topics_of(name: str, table: ExportTable, columns: Mapping[str, TableColumn]) -> Iterator[Topic]:
    """Yield the topics of one table."""
    inertial = [column for quantity, column in columns.items() if quantity.removesuffix("_covariance") in _IMU]
    if inertial:
        yield Topic(name, "sensor_msgs/msg/Imu", table, tuple(inertial), _imu)
    if (field := columns.get("magnetic_field")) is not None:
        yield Topic(name, "sensor_msgs/msg/MagneticField", table, (field,), partial(_values, unknown=9))
    if (pressure := columns.get("pressure")) is not None:
        yield Topic(name, "sensor_msgs/msg/FluidPressure", table, (pressure,), partial(_values, unknown=1))
    if (degrees := columns.get("temperature")) is not None:
        yield Topic(
            f"{name}/temperature", "sensor_msgs/msg/Temperature", table, (degrees,), partial(_values, unknown=1)
        )


def _topic_name(name: str) -> str:
    """Return the name of a topic: letters, digits and single underscores, none of its parts beginning with a digit
    (design.ros2.org/articles/topic_and_service_names.html).
    """
    parts = [re.sub(r"[^A-Za-z0-9]+", "_", part) for part in name.split("/", 1)]
    return "".join(f"/{part if part[:1].isalpha() else f's{part}'}" for part in parts)


def _twins(tables: Sequence[ExportTable]) -> dict[str, str]:
    """Return the accelerometers and the gyroscopes of the six-axis chips whose rows have equal times, by name."""
    by_name = {table.name: table for table in tables}
    pairs = {name: f"{name.removesuffix('_acc')}_gyro" for name in by_name if name.endswith("_acc")}
    stems = {name.removesuffix("_acc") for name in pairs}
    return {
        force: rate
        for force, rate in pairs.items()
        if rate in by_name and not stems & set(by_name) and _equal_times(by_name[force], by_name[rate])
    }


def _equal_times(first: ExportTable, second: ExportTable) -> bool:
    return first.rows == second.rows and all(
        np.array_equal(first.columns[0].read(rows), second.columns[0].read(rows)) for rows in first.blocks()
    )


def _imu(cells: Cells) -> Floats:
    """Return the numbers of an Imu (n, 37): no orientation, and rate and force if they are known."""
    count = len(next(iter(cells.values())))
    numbers = np.zeros((count, _IMU_NUMBERS))
    numbers[:, _ORIENTATION_W], numbers[:, _ORIENTATION_COVARIANCE] = 1.0, -1.0
    for quantity, place in _IMU.items():
        triad = cells.get(quantity, np.full((count, 3), np.nan))
        six = cells.get(f"{quantity}_covariance", np.full((count, 6), np.nan))
        is_finite = np.isfinite(triad).all(axis=1)
        has_covariance = is_finite & np.isfinite(six).all(axis=1)
        numbers[is_finite, place : place + 3] = triad[is_finite]
        numbers[has_covariance, place + 3 : place + 12] = six[has_covariance][:, ENTRIES_OF_COVARIANCE]
        numbers[~is_finite, place + 3] = -1.0
    return numbers


def _values(cells: Cells, *, unknown: int) -> Floats:
    """Return the numbers of a MagneticField, a FluidPressure or a Temperature: the value (n, k), and `unknown` zeros
    for its covariance, which is not known.
    """
    (values,) = cells.values()
    return np.hstack([values, np.zeros((len(values), unknown))])


def _check(time_ns: int) -> None:
    """Raise ExportError for a time in ns since 1970 that builtin_interfaces/Time can't represent."""
    if not 0 <= time_ns // 10**9 <= _LAST_SECOND:
        raise ExportError(f"a row of {time_ns} ns since 1970; ROS 2 has times from 1970 to 2038-01-19")


def _add_headers(time_ns: Times, numbers: Floats) -> npt.NDArray[np.uint8]:
    """Return messages (n, bytes) with a std_msgs/Header: times (n,) ns since 1970, followed by numbers (n, k)."""
    for extreme in (time_ns.min(initial=0), time_ns.max(initial=0)):
        _check(int(extreme))
    text = FRAME.encode() + b"\0"
    fill = -(12 + len(text)) % 8  # numbers begin at multiples of 8 after the first four bytes
    head = [("encoding", "S4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame", "u1", (len(text),))]
    layout = np.dtype([*head, ("fill", "u1", (fill,)), ("numbers", "<f8", (numbers.shape[1],))])
    messages = np.zeros(len(time_ns), layout)
    messages["encoding"], messages["length"] = _LITTLE_ENDIAN, len(text)
    messages["frame"] = np.frombuffer(text, np.uint8)
    messages["sec"], messages["nanosec"], messages["numbers"] = time_ns // 10**9, time_ns % 10**9, numbers
    return messages.view(np.uint8).reshape(len(messages), -1)


def log_message(time_ns: int, level: str, name: str, text: str) -> bytes:
    """Return a rcl_interfaces/msg/Log, as on the topic /rosout."""
    _check(time_ns)
    data = struct.pack("<iIB", time_ns // 10**9, time_ns % 10**9, LEVELS[level])
    for part in (name, text, "", ""):
        letters = part.encode("utf-8", "replace") + b"\0"
        data += bytes(-len(data) % 4) + struct.pack("<I", len(letters)) + letters
    return _LITTLE_ENDIAN + data + bytes(-len(data) % 4) + struct.pack("<I", 0)
