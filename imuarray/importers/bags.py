"""ROS bags, 1 and 2, and MCAP files of either, read by rosbags. The supported messages of `sensor_msgs` are Imu,
MagneticField, FluidPressure and Temperature.

A topic is a kind of rows. The columns of an Imu are `stamp` (the header's, ns), `received` (ns), `angular_velocity.x`,
..., `linear_acceleration.z`; those of a MagneticField `magnetic_field.x`, ...; that of a Temperature `temperature`, of
a FluidPressure `fluid_pressure`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.errors import MissingExtraError, SourceError
from imuarray.importers.cells import Blocks, CellBlock
from imuarray.printable import printable

VALUES: Mapping[str, tuple[str, ...]] = {
    "sensor_msgs/msg/Imu": tuple(
        f"{field}.{axis}" for field in ("angular_velocity", "linear_acceleration") for axis in "xyz"
    ),
    "sensor_msgs/msg/MagneticField": tuple(f"magnetic_field.{axis}" for axis in "xyz"),
    "sensor_msgs/msg/FluidPressure": ("fluid_pressure",),
    "sensor_msgs/msg/Temperature": ("temperature",),
}
"""The columns of each type of message, in addition to `TIMES`."""

TIMES = ("stamp", "received")

_ROS1 = "ros1"
_UNKNOWN = -1.0
"""First covariance in an Imu message of a quantity that is not measured (sensor_msgs/Imu)."""

Message = tuple[int, int, tuple[float, ...]]
"""Stamp and arrival in ns, and the values."""


def open_rows(path: Path, progress: Callable[[int], None]) -> BagRows:
    """Open the topics of a bag; SourceError, MissingExtraError."""
    try:
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        older = get_typestore(Stores.ROS1_NOETIC)
    except ImportError:
        raise MissingExtraError("rosbags", "import") from None
    if path.suffix == ".mcap" and path.is_file():
        return BagRows(path, _Mcap(path, {"cdr": store.deserialize_cdr, _ROS1: older.deserialize_ros1}), progress)
    return BagRows(path, _Bag(path), progress)


class BagRows:
    """The messages of a bag as rows."""

    def __init__(self, path: Path, bag: Any, progress: Callable[[int], None]) -> None:
        self._path, self._bag, self._progress = path, bag, progress
        self.remarks: list[str] = []
        self._topics: dict[str, str] = self._guarded(bag.topics)
        if not self._topics:
            message_types = ", ".join(name.rsplit("/", 1)[-1] for name in VALUES)
            raise SourceError(f"{path}: contains no topic of {message_types}")

    def _guarded(self, call: Callable[[], Any]) -> Any:
        """Run a reader and turn its exceptions into SourceError."""
        try:
            return call()
        except SourceError:
            raise
        except Exception as error:  # rosbags, mcap, sqlite and zstd have no common exception
            raise SourceError(f"{self._path}: damaged, or not a bag: {printable(str(error))[:200]}") from None

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the columns of each topic."""
        return {topic: (*TIMES, *VALUES[kind]) for topic, kind in self._topics.items()}

    def blocks(self, columns: Sequence[str | int], kind: str | None, rows: int) -> Blocks:
        """Yield the messages of a topic (`kind`; None if only one topic has these columns); SourceError."""
        wanted = ", ".join(map(str, columns))
        fitting = [topic for topic, names in self.names().items() if all(column in names for column in columns)]
        topics = ", ".join(f"{topic} ({name.rsplit('/', 1)[-1]})" for topic, name in self._topics.items())
        if kind is None and len(fitting) != 1:
            raise SourceError(
                f"{self._path}: {len(fitting)} topics have columns {wanted}; the sensor's kind selects one of {topics}"
            )
        topic = fitting[0] if kind is None else kind
        if topic not in fitting:
            raise SourceError(f"{self._path}: no topic {topic!r} with columns {wanted}; it has {topics}")
        places = [self.names()[topic].index(str(column)) for column in columns]
        messages, start = self._bag.messages(topic), 0
        while part := self._guarded(lambda: list(islice(messages, rows))):
            yield CellBlock(str(self._path), range(start, start + len(part)), _columns(part)), places
            start += len(part)
        self._progress(self._path.stat().st_size)


def _columns(part: Sequence[Message]) -> list[npt.NDArray[np.number]]:
    """Return the times as integers and the values as floats."""
    stamps, received, values = zip(*part, strict=True)
    triads = np.array(values, np.float64)
    return [np.array(stamps, np.int64), np.array(received, np.int64), *triads.T]


def _row(message: Any, received_ns: int, kind: str) -> Message:
    stamp = message.header.stamp
    nanoseconds = int(getattr(stamp, "nanosec", 0) or getattr(stamp, "nsec", 0))
    values = tuple(float(_inside(message, name)) for name in VALUES[kind])
    if kind.endswith("/Imu"):
        turns, forces = message.angular_velocity_covariance[0], message.linear_acceleration_covariance[0]
        absent = (*[turns == _UNKNOWN] * 3, *[forces == _UNKNOWN] * 3)
        values = tuple(math.nan if no else value for no, value in zip(absent, values, strict=True))
    return int(stamp.sec) * 1_000_000_000 + nanoseconds, received_ns, values


def _inside(message: Any, name: str) -> Any:
    for part in name.split("."):
        message = getattr(message, part)
    return message


class _Bag:
    """A ROS 1 bag, or the folder of a ROS 2 bag, read by rosbags."""

    def __init__(self, path: Path) -> None:
        self._path = path.parent if path.suffix == ".db3" else path

    def _reader(self) -> Any:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        return AnyReader([self._path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))

    def topics(self) -> dict[str, str]:
        with self._reader() as reader:
            return {
                connection.topic: connection.msgtype
                for connection in reader.connections
                if connection.msgtype in VALUES
            }

    def messages(self, topic: str) -> Iterator[Message]:
        with self._reader() as reader:
            connections = [candidate for candidate in reader.connections if candidate.topic == topic]
            for connection, received_ns, raw in reader.messages(connections):
                yield _row(reader.deserialize(raw, connection.msgtype), int(received_ns), connection.msgtype)


class _Mcap:
    """A single MCAP file, read by Foxglove's reader; its messages are decoded by rosbags."""

    def __init__(self, path: Path, decoders: Mapping[str, Callable[[bytes, str], Any]]) -> None:
        try:
            import mcap.reader
        except ImportError:
            raise MissingExtraError("mcap", "import") from None
        self._path, self._decoders, self._make = path, decoders, mcap.reader.make_reader

    def topics(self) -> dict[str, str]:
        with self._path.open("rb") as file:
            summary = self._make(file).get_summary()
        if summary is None:
            raise SourceError(
                f"{self._path}: has no summary and may be truncated; Foxglove's `mcap recover` repairs it"
            )
        topics = {}
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            kind = _type(schema.name) if schema is not None else ""
            if kind in VALUES and channel.message_encoding in self._decoders:
                topics[str(channel.topic)] = kind
        return topics

    def messages(self, topic: str) -> Iterator[Message]:
        with self._path.open("rb") as file:
            for schema, channel, message in self._make(file).iter_messages(topics=[topic]):
                kind = _type(schema.name) if schema is not None else ""
                decoded = self._decoders[channel.message_encoding](message.data, kind)
                yield _row(decoded, int(message.log_time), kind)


def _type(name: str) -> str:
    """Return the ROS 2 name of a message type: sensor_msgs/Imu is its ROS 1 name."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[-1]}"
