"""MCAP, which Foxglove opens: a channel for each sensor, events and phases, in the order of their times.

Topics: /sensors/NAME, /fused, /truth, /reference, /events, /phases. Messages are written as they come, in chunks that
are compressed one by one: memory doesn't grow with the log. Their kinds are `imuarray.export.mcap_schemas`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from heapq import merge
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from imuarray import __version__
from imuarray.atomic import whole_file
from imuarray.errors import ExportError, MissingExtraError
from imuarray.export import mcap_schemas as schemas
from imuarray.export.content import open_content
from imuarray.export.formats import Exported, Progress, Wanted
from imuarray.export.tables import Content, Meter, Table

if TYPE_CHECKING:
    from mcap.writer import Writer

_BLOCK = 1 << 11
"""Rows of each table that are held at once."""
_CHUNK_BYTES = 1 << 20
"""Messages that are packed together: what must be read to see one of them."""
_HARMLESS = frozenset({"imported", "simulated", "back", "recovered"})
"""Kinds of events that are no warnings."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_NS = 2**63


class _Message(NamedTuple):
    """When, of which channel, the how many-th of it, what."""

    time_ns: int
    channel: int
    sequence: int
    value: Mapping[str, Any]


def write(wanted: Wanted, path: Path, force: bool, progress: Progress) -> Exported:
    """Write all tables, phases and events to `path`, in SI unless other units are asked for; MissingExtraError,
    ExportError for an epoch that is no date.
    """
    try:
        from mcap.writer import Writer
    except ImportError:
        raise MissingExtraError("mcap", "export") from None
    with open_content(wanted, "si") as content:
        zero_ns = epoch_ns(content.epoch, path)
        with whole_file(path, force=force) as draft, draft.open("wb") as file:
            writer = Writer(file, chunk_size=_CHUNK_BYTES)
            writer.start(library=f"imuarray {__version__}")
            _say(writer, content)
            streams = _streams(writer, content, zero_ns, Meter(content, progress))
            for one in merge(*streams, key=lambda message: message.time_ns):
                if not 0 <= one.time_ns < _LAST_NS:
                    raise ExportError(f"{wanted.source}: a row of {one.time_ns} ns since 1970; MCAP has no such times")
                data = json.dumps(one.value, allow_nan=False, separators=(",", ":")).encode()
                writer.add_message(one.channel, one.time_ns, data, one.time_ns, one.sequence)
            writer.finish()  # type: ignore[no-untyped-call]
        return content.exported(path)


def epoch_ns(epoch: str, path: Path) -> int:
    """Nanoseconds from 1970 to an ISO 8601 time, UTC if it does not say; ExportError."""
    try:
        when = datetime.fromisoformat(epoch)
    except ValueError:
        raise ExportError(f"{path}: the epoch {epoch!r} is no date, without which MCAP has no times") from None
    since = (when if when.tzinfo else when.replace(tzinfo=UTC)) - _EPOCH
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def _say(writer: Writer, content: Content) -> None:
    """What is known of the whole: its head as metadata, the array's configuration as the file that it was."""
    head = {name: str(value) for name, value in content.head.items() if name != "config"}
    writer.add_metadata("imuarray", head)
    if config := content.head.get("config"):
        writer.add_attachment(0, 0, "array.toml", "application/toml", str(config).encode())


def _streams(writer: Writer, content: Content, zero_ns: int, meter: Meter) -> list[Iterator[_Message]]:
    """Messages of each channel, in the order of their times."""
    streams = []
    for table in content.tables:
        if len(table.columns) > 1 and table.name != "clocks":
            about = {
                name: value if isinstance(value, str) else json.dumps(value) for name, value in table.about.items()
            }
            kind = schemas.imu_schema() if schemas.is_imu(table) else schemas.table_schema(table)
            channel = _channel(writer, f"/{table.name}", kind, about)
            streams.append(_rows(table, channel, zero_ns, _frame(content), meter))
    if content.events or content.phases:
        kind = schemas.log_schema()
        streams.append(_events(content, _channel(writer, "/events", kind, {}), zero_ns))
        streams.append(_phases(content, _channel(writer, "/phases", kind, {}), zero_ns))
    return streams


def _frame(content: Content) -> str:
    """Physical values are in the box frame; counts are along each sensor's own axes."""
    return "sensor" if content.units == "counts" else "box"


def _channel(writer: Writer, topic: str, schema: Mapping[str, Any], about: dict[str, str]) -> int:
    kind = writer.register_schema(str(schema["title"]), "jsonschema", json.dumps(schema).encode())
    return writer.register_channel(topic, "json", kind, about)


def _rows(table: Table, channel: int, zero_ns: int, frame: str, meter: Meter) -> Iterator[_Message]:
    """The rows of a table as messages."""
    columns = table.columns[1:]
    names = [column.name for column in columns]
    message: Callable[[int, list[Any]], dict[str, Any]]
    if schemas.is_imu(table):
        message = lambda at_ns, row: schemas.imu_message(at_ns, dict(zip(names, row, strict=True)))  # noqa: E731
    else:
        message = lambda at_ns, row: schemas.table_message(at_ns, frame, columns, row)  # noqa: E731
    for rows in table.blocks(_BLOCK):
        times = (table.columns[0].read(rows) + zero_ns).tolist()
        values = zip(*(column.read(rows).tolist() for column in columns), strict=True)
        for number, (at_ns, row) in enumerate(zip(times, values, strict=True), rows.start):
            yield _Message(at_ns, channel, number & 0xFFFF_FFFF, message(at_ns, list(row)))
        meter.add(rows.stop - rows.start, len(table.columns))


def _events(content: Content, channel: int, zero_ns: int) -> Iterator[_Message]:
    ordered = sorted(content.events, key=lambda event: event.time_ns)
    for number, event in enumerate(ordered):
        at_ns = event.time_ns + zero_ns
        level = "INFO" if event.kind in _HARMLESS else "WARNING"
        said = f"{event.kind}: {event.message}"
        yield _Message(at_ns, channel, number, schemas.log_message(at_ns, level, event.sensor or "array", said))


def _phases(content: Content, channel: int, zero_ns: int) -> Iterator[_Message]:
    """A line where each phase begins, and one where it ends."""
    said = [(one.start_ns, f"{one.name} begins{f', {one.up} up' if one.up else ''}") for one in content.phases]
    said += [(one.end_ns, f"{one.name} ends") for one in content.phases]
    for number, (time_ns, text) in enumerate(sorted(said)):
        at_ns = time_ns + zero_ns
        yield _Message(at_ns, channel, number, schemas.log_message(at_ns, "INFO", "phase", text))
