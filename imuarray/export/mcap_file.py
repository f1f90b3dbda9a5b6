"""MCAP, which Foxglove opens: a channel for each sensor, events and phases, in the order of their times.

Topics: /sensors/NAME, /fused, /truth, /reference, /events, /phases. Messages are created and written in blocks of rows,
in chunks that are compressed one by one, so that memory does not grow with the log. Their types are defined by
`imuarray.export.mcap_schemas` or, for the tool "ros2", by `imuarray.export.ros2_messages`.

A JSON message consists of a template, which all rows with the same known values share, and the texts of the values.
Within a block these are padded with spaces to equal length, which JSON allows around numbers, so that numpy can
assemble all rows at once.

Importing this module raises MissingExtraError without the package `mcap`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import as_strided

from imuarray import __version__
from imuarray.arrays import Indices, Times
from imuarray.atomic import whole_file
from imuarray.errors import ExportError, MissingExtraError
from imuarray.export import mcap_schemas as schemas
from imuarray.export import ros2_messages as ros2
from imuarray.export.content import open_content
from imuarray.export.formats import ExportRequest, ExportSummary, Progress
from imuarray.export.tables import Content, ExportTable, Meter, TableColumn
from imuarray.fuse.optimal.geometry import patterns
from imuarray.log.health import is_trouble
from imuarray.wall_time import unix_ns

try:
    from imuarray.export.mcap_container import MESSAGE_HEAD, Container, message_heads
except ImportError:
    raise MissingExtraError("mcap", "export") from None

_BLOCK = 1 << 12
"""Rows of each table that are in memory at a time."""
_CHUNK_BYTES = 1 << 20
"""Bytes of messages that are compressed together; a reader must decompress all of them to read one message."""

Texts = npt.NDArray[np.uint8]

_STAND_IN_NS = 1234567890_987654321
"""A time in a template: its seconds and nanoseconds are placeholders for those of the rows."""
_SECONDS, _NANOSECONDS = _STAND_IN_NS // 10**9, _STAND_IN_NS % 10**9
_STAND_IN = re.compile(rf"(?<=:){_SECONDS}(?=,)|(?<=:){_NANOSECONDS}(?=}})|7\.(\d{{5}})1e-301")
"""The placeholders of times and of cells in a template; no other text of a message matches."""


class _EqualMessages(NamedTuple):
    """Equally long messages with their heads, as numpy items; `places` (k,) are their rows, ascending."""

    places: Indices
    messages: npt.NDArray[np.void]


class _ChannelMessages(NamedTuple):
    """Messages of one channel in the order of their times (n,) in ns, with their lengths (n,) in bytes and parts."""

    time_ns: Times
    lengths: Times
    parts: list[_EqualMessages]

    def joined(self, other: _ChannelMessages) -> _ChannelMessages:
        count = len(self.time_ns)
        return _ChannelMessages(
            np.concatenate([self.time_ns, other.time_ns]),
            np.concatenate([self.lengths, other.lengths]),
            [*self.parts, *(_EqualMessages(part.places + count, part.messages) for part in other.parts)],
        )

    def split(self, count: int) -> tuple[_ChannelMessages, _ChannelMessages]:
        first, rest = [], []
        for places, messages in self.parts:
            index = int(np.searchsorted(places, count))
            if index:
                first.append(_EqualMessages(places[:index], messages[:index]))
            if index < len(places):
                rest.append(_EqualMessages(places[index:] - count, messages[index:]))
        return (
            _ChannelMessages(self.time_ns[:count], self.lengths[:count], first),
            _ChannelMessages(self.time_ns[count:], self.lengths[count:], rest),
        )

    def copy_to(self, content: npt.NDArray[np.uint8], starts: Indices) -> None:
        """Copy each message into the bytes `content`, at its start (n,)."""
        for places, messages in self.parts:
            width = messages.dtype.itemsize
            anywhere = as_strided(content[:width].view(messages.dtype), (len(content) - width + 1,), (1,))
            anywhere[starts[places]] = messages


def _sort_messages(time_ns: Times, parts: Sequence[_EqualMessages]) -> _ChannelMessages:
    """Return the messages of rows at times (n,), sorted by time, even if the rows are not."""
    if (np.diff(time_ns) < 0).any():
        order = np.argsort(time_ns, kind="stable")
        ranks = np.empty(len(order), np.intp)
        ranks[order] = np.arange(len(order))
        time_ns = time_ns[order]
        orders = [np.argsort(ranks[part.places]) for part in parts]
        parts = [
            _EqualMessages(ranks[part.places][rank], part.messages[rank])
            for part, rank in zip(parts, orders, strict=True)
        ]
    lengths = np.empty(len(time_ns), np.int64)
    for places, messages in parts:
        lengths[places] = messages.dtype.itemsize
    return _ChannelMessages(time_ns, lengths, list(parts))


class _ChannelStream:
    """The messages of one channel, a block of rows at a time."""

    def __init__(self, channel: int, blocks: Iterator[_ChannelMessages]) -> None:
        self.channel, self._blocks = channel, blocks
        self.waiting = _ChannelMessages(np.zeros(0, np.int64), np.zeros(0, np.int64), [])
        self._last = False

    @property
    def ended(self) -> bool:
        return self._last and not len(self.waiting.time_ns)

    def fill(self) -> None:
        """Read blocks until many rows are buffered: messages are merged only up to the earliest end of all buffers."""
        while not self._last and len(self.waiting.time_ns) < _BLOCK:
            block = next(self._blocks, None)
            if block is None:
                self._last = True
                continue
            self.waiting = self.waiting.joined(block)

    def take(self, until_ns: int) -> _ChannelMessages:
        """Return the buffered messages up to a time, and remove them."""
        count = int(np.searchsorted(self.waiting.time_ns, until_ns, "right"))
        messages, self.waiting = self.waiting.split(count)
        return messages


def write(request: ExportRequest, path: Path, force: bool, progress: Progress) -> ExportSummary:
    """Write all tables, phases and events to `path`, in SI unless other units are requested; ExportError for an epoch
    that is not a date, and for units that ROS 2 does not allow.
    """
    for_ros2 = request.tool == "ros2"
    if for_ros2 and request.units not in (None, "si"):
        raise ExportError(f"{path}: messages of ROS 2 are in SI; leave units out")
    with open_content(request, "si") as content:
        zero_ns = unix_ns(content.epoch)
        if zero_ns is None:
            raise ExportError(f"{path}: the epoch {content.epoch!r} is not a date, which MCAP needs")
        with whole_file(path, force=force) as draft, draft.open("wb") as file:
            container = Container(file, f"imuarray {__version__}", "ros2" if for_ros2 else "")
            _write_head(container, content)
            streams = _ros2_streams if for_ros2 else _streams
            _merge(container, streams(container, content, zero_ns, Meter(content, progress)), str(request.source))
            container.finish()
        return content.exported(path)


def _merge(container: Container, streams: Sequence[_ChannelStream], source: str) -> None:
    """Write all messages in the order of their times; messages of equal times are in the order of the streams.
    ExportError for a time that MCAP can't represent.
    """
    while True:
        for stream in streams:
            stream.fill()
        going = [stream for stream in streams if not stream.ended]
        if not going:
            return
        until_ns = min(int(stream.waiting.time_ns[-1]) for stream in going)
        parts = [stream.take(until_ns) for stream in going]
        numbers = [len(part.time_ns) for part in parts]
        time_ns, lengths = (np.concatenate([part[column] for part in parts]) for column in (0, 1))
        order = np.argsort(time_ns, kind="stable")
        ends = np.cumsum(lengths[order])
        starts = np.empty(len(order), np.int64)
        starts[order] = ends - lengths[order]
        channels = np.repeat([stream.channel for stream in going], numbers)[order]
        time_ns = time_ns[order]
        if time_ns[0] < 0:
            raise ExportError(f"{source}: a row of {time_ns[0]} ns since 1970; MCAP has no such times")
        content = np.empty(ends[-1], np.uint8)
        for part, own in zip(parts, np.split(starts, np.cumsum(numbers)[:-1]), strict=True):
            part.copy_to(content, own)
        first = 0
        while first < len(ends):
            start = int(ends[first - 1]) if first else 0
            last = min(int(np.searchsorted(ends, start + _CHUNK_BYTES)) + 1, len(ends))
            rows, offsets = slice(first, last), np.concatenate([[0], ends[first : last - 1] - start])
            container.chunk(content[start : ends[last - 1]], channels[rows], time_ns[rows], offsets)
            first = last


def _write_head(container: Container, content: Content) -> None:
    """Write the log's head as metadata and the array's configuration as an attachment."""
    container.metadata("imuarray", {name: str(value) for name, value in content.head.items() if name != "config"})
    if config := content.head.get("config"):
        container.attachment("array.toml", "application/toml", str(config).encode())


def _streams(container: Container, content: Content, zero_ns: int, meter: Meter) -> list[_ChannelStream]:
    """Return the messages of each channel, in the order of their times."""
    streams = []
    for table in content.tables:
        if len(table.columns) > 1 and table.name != "clocks":
            metadata = {
                name: value if isinstance(value, str) else json.dumps(value) for name, value in table.about.items()
            }
            kind = schemas.imu_schema() if schemas.is_imu(table) else schemas.table_schema(table)
            channel = _channel(container, f"/{table.name}", kind, metadata)
            streams.append(_ChannelStream(channel, _rows(table, channel, zero_ns, _frame(content), meter)))
    if content.events or content.phases:
        kind = schemas.log_schema()
        for topic, entries in (("/events", _events(content)), ("/phases", _phases(content))):
            channel = _channel(container, topic, kind, {})
            streams.append(_ChannelStream(channel, _entries(entries, channel, zero_ns, _json_entry)))
    return streams


def _ros2_streams(container: Container, content: Content, zero_ns: int, meter: Meter) -> list[_ChannelStream]:
    """Return the messages of each topic of ROS 2; topics of the same type share its definition."""
    streams, schemas_of = [], dict.fromkeys(ros2.DEFINITIONS, 0)

    def channel_of(topic: str, kind: str) -> int:
        schemas_of[kind] = schemas_of[kind] or container.schema(kind, ros2.DEFINITIONS[kind].encode(), "ros2msg")
        return container.channel(topic, schemas_of[kind], {}, "cdr")

    for topic in ros2.topics(content.tables):
        channel = channel_of(topic.name, topic.kind)
        streams.append(_ChannelStream(channel, _ros2_rows(topic.blocks(zero_ns, _BLOCK, meter), channel)))
    for name, entries in (("/events", _events(content)), ("/phases", _phases(content))):
        if entries:
            channel = channel_of(name, ros2.LOG)
            streams.append(_ChannelStream(channel, _entries(entries, channel, zero_ns, ros2.log_message)))
    return streams


def _ros2_rows(blocks: Iterator[tuple[Times, Texts]], channel: int) -> Iterator[_ChannelMessages]:
    """Yield the messages of a topic with their heads."""
    first = 0
    for time_ns, texts in blocks:
        sequence = np.arange(first, first + len(time_ns))
        first += len(time_ns)
        if (np.diff(time_ns) < 0).any():
            order = np.argsort(time_ns, kind="stable")
            time_ns, texts = time_ns[order], texts[order]
        messages = _add_heads(texts, channel, sequence & 0xFFFF_FFFF, time_ns)
        yield _sort_messages(time_ns, [_EqualMessages(np.arange(len(time_ns)), messages)])


def _frame(content: Content) -> str:
    """Return the frame of the values: the box for physical values, the sensor for counts."""
    return "sensor" if content.units == "counts" else "box"


def _channel(container: Container, topic: str, schema: Mapping[str, Any], metadata: dict[str, str]) -> int:
    kind = container.schema(str(schema["title"]), json.dumps(schema).encode(), "jsonschema")
    return container.channel(topic, kind, metadata, "json")


def _rows(table: ExportTable, channel: int, zero_ns: int, frame: str, meter: Meter) -> Iterator[_ChannelMessages]:
    columns = table.columns[1:]
    message: Callable[[Sequence[Any]], dict[str, Any]]
    if schemas.is_imu(table):
        names = [column.name for column in columns]
        message = lambda row: schemas.imu_message(_STAND_IN_NS, dict(zip(names, row, strict=True)))  # noqa: E731
    else:
        message = lambda row: schemas.table_message(_STAND_IN_NS, frame, columns, row)  # noqa: E731
    texts_of = [_NumberTexts() for column in columns for _ in range(max(1, len(column.cells)))]
    for rows in table.blocks(_BLOCK):
        time_ns = np.asarray(table.columns[0].read(rows) + zero_ns, np.int64)
        cells = [np.asarray(column.read(rows)).reshape(len(time_ns), -1) for column in columns]
        finite = np.stack([np.isfinite(cell).all(axis=1) for cell in cells], axis=1)
        sequence = np.arange(rows.start, rows.stop) & 0xFFFF_FFFF
        parts = []
        for present, selection in patterns(finite):
            form = _form(message, columns, present.tolist())
            whole = _fill_form(form, time_ns[selection], [cell[selection] for cell in cells], texts_of)
            messages = _put_heads(whole, channel, sequence[selection], time_ns[selection])
            parts.append(_EqualMessages(np.arange(len(time_ns))[selection], messages))
        yield _sort_messages(time_ns, parts)
        meter.add(rows.stop - rows.start, len(table.columns))


def _form(
    message: Callable[[Sequence[Any]], dict[str, Any]], columns: Sequence[TableColumn], present: Sequence[bool]
) -> list[bytes | int]:
    """Return the template of messages in which the columns `present` have values: texts, and between them -2 for the
    seconds, -1 for the nanoseconds, or the number of a cell, counted over all columns.
    """
    row, number = [], 0
    for column, is_present in zip(columns, present, strict=True):
        count = max(1, len(column.cells))
        numbers = [float(f"7.{number + cell:05d}1e-301") if is_present else np.nan for cell in range(count)]
        row.append(numbers if column.cells else numbers[0])
        number += count
    text = json.dumps(message(row), allow_nan=False, separators=(",", ":"))
    form: list[bytes | int] = []
    end = 0
    for match in _STAND_IN.finditer(text):
        form.append(text[end : match.start()].encode())
        form.append(int(match[1]) if match[1] else -2 if match[0] == str(_SECONDS) else -1)
        end = match.end()
    return [*form, text[end:].encode()]


def _fill_form(
    form: Sequence[bytes | int],
    time_ns: Times,
    columns: Sequence[npt.NDArray[Any]],
    texts_of: Sequence[_NumberTexts],
) -> Texts:
    """Return messages (n, h + l) from their template, times (n,) and columns (n, cells), with one of `texts_of` for
    each cell. The first h bytes are reserved for the head.
    """
    cells = [cell for column in columns for cell in column.T]
    texts_by_form: dict[int, Texts] = {}
    for part in form:
        if not isinstance(part, bytes) and part not in texts_by_form:
            texts_by_form[part] = (
                _digits(time_ns // 10**9 if part == -2 else time_ns % 10**9)
                if part < 0
                else texts_of[part](cells[part])
            )
    line = b"".join(part if isinstance(part, bytes) else texts_by_form[part][0].tobytes() for part in form)
    position = MESSAGE_HEAD.itemsize
    messages = np.empty((len(time_ns), position + len(line)), np.uint8)
    messages[:, position:] = np.frombuffer(line, np.uint8)  # the first message, on which the differences are written
    for part in form:
        width = len(part) if isinstance(part, bytes) else texts_by_form[part].shape[1]
        if not isinstance(part, bytes) and texts_by_form[part].strides[0]:
            messages[:, position : position + width] = texts_by_form[part]
        position += width
    return messages


def _digits(values: Times) -> Texts:
    """Return the text (n, w) of non-negative integers, right-aligned with spaces."""
    largest = int(values.max(initial=0))
    width, table = len(str(largest)), _four_digits()
    words = np.empty((len(values), -(-width // 4)), np.uint32)
    rest = values.astype(np.uint32) if largest < 1 << 32 else values
    for group in range(words.shape[1] - 1, -1, -1):
        upper = rest // 10**4
        words[:, group] = table[rest - upper * 10**4]
        rest = upper
    texts = words.view(np.uint8)[:, -width:]
    short = np.flatnonzero(values < 10 ** (width - 1))
    if width > 1 and len(short):
        powers = 10 ** np.arange(width - 1, 0, -1)
        texts[short, :-1] = np.where(values[short, None] < powers, np.uint8(ord(" ")), texts[short, :-1])
    return texts


@cache
def _four_digits() -> npt.NDArray[np.uint32]:
    """Return the texts 0000 to 9999 as words of 32 bits (10000,), which avoid three of four divisions."""
    return np.frombuffer("".join(f"{number:04d}" for number in range(10**4)).encode(), np.uint32)


_MOST_KNOWN = 1 << 10
"""Largest number of different values of a cell with texts that are kept from one block to the next."""


class _NumberTexts:
    """The JSON texts of one cell of a table, block after block; each different number is converted once.

    A sensor at rest has few different codes, and most of them occur in the next block too: a search in the known codes
    takes a fifth of the time of sorting the block.
    """

    def __init__(self) -> None:
        self._known: npt.NDArray[Any] = np.zeros(0, np.int64)
        self._texts = np.zeros(0, "S1")
        self._lengths = np.zeros(0, np.intp)

    def __call__(self, values: npt.NDArray[Any]) -> Texts:
        """Return the texts (n, w) of numbers (n,), left-aligned with spaces."""
        if len(values) and (values == values[0]).all() and values[0] != 0:
            text = np.frombuffer(json.dumps(values[0].item()).encode(), np.uint8)
            return np.broadcast_to(text, (len(values), len(text)))
        is_float = values.dtype == np.float64
        places = self._places(np.ascontiguousarray(values).view(np.int64) if is_float else values, is_float)
        width = int(self._lengths[places].max(initial=1))
        return self._texts[places].view(np.uint8).reshape(len(values), -1)[:, :width]

    def _places(self, bits: npt.NDArray[Any], is_float: bool) -> Indices:
        """Return the indices (n,) of numbers in the list of known numbers; unknown ones are added to it. Floats are
        compared by their `bits`, because -0.0 and 0.0 have different texts.
        """
        if len(self._known):
            places = np.minimum(np.searchsorted(self._known, bits), len(self._known) - 1)
            is_new = self._known[places] != bits
            if not is_new.any():
                return places
            self._known = np.union1d(self._known, bits[is_new])
        if not 0 < len(self._known) <= _MOST_KNOWN:
            self._known = np.unique(bits)
        numbers = (self._known.view(np.float64) if is_float else self._known).tolist()
        texts = np.array(json.dumps(numbers, separators=(",", ":"))[1:-1].encode().split(b","))
        self._lengths = np.char.str_len(texts)
        characters = texts.view(np.uint8)
        characters[characters == 0] = ord(" ")
        self._texts = texts
        return np.searchsorted(self._known, bits)


def _add_heads(texts: Texts, channel: int, sequence: Times, time_ns: Times) -> npt.NDArray[np.void]:
    """Return (n,) equally long messages (n, l), each with its head."""
    room = np.empty((len(texts), MESSAGE_HEAD.itemsize), np.uint8)
    return _put_heads(np.concatenate([room, texts], axis=1), channel, sequence, time_ns)


def _put_heads(whole: Texts, channel: int, sequence: Times, time_ns: Times) -> npt.NDArray[np.void]:
    """Write the heads of equally long messages into their first bytes; return the messages (n,)."""
    length = MESSAGE_HEAD.itemsize
    heads = message_heads(channel, sequence, time_ns, whole.shape[1] - length)
    whole[:, :length] = heads.view(np.uint8).reshape(len(whole), -1)
    return whole.view(f"V{whole.shape[1]}")[:, 0]


class _Entry(NamedTuple):
    """An entry of the log panel."""

    time_ns: int
    level: str
    name: str
    text: str


def _json_entry(nanoseconds: int, level: str, name: str, text: str) -> bytes:
    value = schemas.log_message(nanoseconds, level, name, text)
    return json.dumps(value, allow_nan=False, separators=(",", ":")).encode()


def _entries(
    entries: Sequence[_Entry], channel: int, zero_ns: int, encode: Callable[[int, str, str, str], bytes]
) -> Iterator[_ChannelMessages]:
    """Yield the entries in the order of their times, one part for each; no messages without entries."""
    if not entries:
        return
    time_ns = np.array([entry.time_ns + zero_ns for entry in entries], np.int64)
    parts = []
    for number, entry in enumerate(entries):
        data = encode(int(time_ns[number]), entry.level, entry.name, entry.text)
        text, place = np.frombuffer(data, np.uint8), np.array([number])
        parts.append(_EqualMessages(place, _add_heads(text[None], channel, place, time_ns[number : number + 1])))
    yield _sort_messages(time_ns, parts)


def _events(content: Content) -> list[_Entry]:
    entries = []
    for event in sorted(content.events, key=lambda event: event.time_ns):
        level = "WARNING" if is_trouble(event) else "INFO"
        entries.append(_Entry(event.time_ns, level, event.sensor or "array", f"{event.kind}: {event.message}"))
    return entries


def _phases(content: Content) -> list[_Entry]:
    entries = [
        (phase.start_ns, f"{phase.name} begins{f', {phase.up} up' if phase.up else ''}") for phase in content.phases
    ]
    entries += [(phase.end_ns, f"{phase.name} ends") for phase in content.phases]
    return [_Entry(time_ns, "INFO", "phase", text) for time_ns, text in sorted(entries)]
