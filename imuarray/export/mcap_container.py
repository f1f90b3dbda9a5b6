"""The container of an MCAP file (mcap.dev/spec): chunks of many messages at once, their index, and the summary.

The package `mcap` defines and writes all record types; its own writer takes one message at a time, which costs more
than all other steps of an export.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from imuarray.arrays import Times

_MAGIC = b"\x89MCAP0\r\n"
_COMPRESSION = "zstd"
_LEVEL = 1
"""Compression level: it takes two thirds of the time of the default level, 3, and files are 4 % larger."""
_INDEX_HEAD = struct.Struct("<BQHI")
_FOOTER_HEAD = struct.Struct("<BQQQ")

MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""The bytes before the data of a message; `length` is the number of bytes after the length field."""

_BEFORE_LENGTH = 9
"""Bytes of opcode and length."""


def message_heads(channel: int, sequence: Times, time_ns: Times, data_bytes: int) -> npt.NDArray[np.void]:
    """Return (n,) heads of messages of equally long data."""
    heads = np.zeros(len(time_ns), MESSAGE_HEAD)
    heads["opcode"], heads["channel"] = int(Opcode.MESSAGE), channel
    heads["length"] = MESSAGE_HEAD.itemsize - _BEFORE_LENGTH + data_bytes
    heads["sequence"], heads["log_time"], heads["publish_time"] = sequence, time_ns, time_ns
    return heads


class Container:
    """Writes an MCAP file: schemas and channels, then chunks, then `finish`; metadata and attachments between them."""

    def __init__(self, file: IO[bytes], library: str, profile: str = "") -> None:
        self._file = file
        self._schemas: list[Any] = []
        self._channels: list[Any] = []
        self._chunks, self._chunk_index = 0, RecordBuilder()
        self._attachments: list[Any] = []
        self._metadata: list[Any] = []
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = 0, 0
        self._packer = zstandard.ZstdCompressor(level=_LEVEL)
        file.write(_MAGIC)
        self._put(records.Header(profile=profile, library=library))

    def schema(self, name: str, text: bytes, encoding: str) -> int:
        """Return the number of a new schema; its `encoding` is one of MCAP's registry ("jsonschema", "ros2msg")."""
        record = records.Schema(id=len(self._schemas) + 1, data=text, encoding=encoding, name=name)
        self._schemas.append(record)
        self._put(record)
        return len(self._schemas)

    def channel(self, topic: str, schema: int, metadata: Mapping[str, str], encoding: str) -> int:
        """Return the number of a new channel of messages; their `encoding` is "json" or "cdr"."""
        number = len(self._channels) + 1
        record = records.Channel(
            id=number, topic=topic, message_encoding=encoding, schema_id=schema, metadata=dict(metadata)
        )
        self._channels.append(record)
        self._put(record)
        return number

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write texts by name."""
        start = self._file.tell()
        length = self._put(records.Metadata(name=name, metadata=dict(values)))
        self._metadata.append(records.MetadataIndex(offset=start, length=length, name=name))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file as an attachment."""
        start = self._file.tell()
        length = self._put(records.Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        self._attachments.append(
            records.AttachmentIndex(
                offset=start,
                length=length,
                create_time=0,
                log_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def chunk(
        self, content: npt.NDArray[np.uint8], channels: npt.NDArray[np.intp], time_ns: Times, offsets: Times
    ) -> None:
        """Write the messages with heads in the bytes `content`: their channels, times and offsets in it (n,), n > 0."""
        data = content.data
        first_ns, last_ns, start = int(time_ns.min()), int(time_ns.max()), self._file.tell()
        length = self._put(
            records.Chunk(
                compression=_COMPRESSION,
                data=self._packer.compress(data),
                message_end_time=last_ns,
                message_start_time=first_ns,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        index_start, places = self._file.tell(), {}
        by_channel = np.argsort(channels.astype(np.uint16), kind="stable")  # a radix sort: MCAP's numbers have 16 bits
        all_entries = np.empty((len(channels), 2), "<u8")
        all_entries[:, 0], all_entries[:, 1] = time_ns[by_channel], offsets[by_channel]
        counts, ended = np.bincount(channels), 0
        for channel in np.flatnonzero(counts).tolist():
            count = int(counts[channel])
            entries = all_entries[ended : ended + count].tobytes()
            ended += count
            places[channel] = self._file.tell()
            self._file.write(_INDEX_HEAD.pack(int(Opcode.MESSAGE_INDEX), 6 + len(entries), channel, len(entries)))
            self._file.write(entries)
            self._counts[channel] = self._counts.get(channel, 0) + count
        packed = length - (_BEFORE_LENGTH + 40 + len(_COMPRESSION))  # less the other fields of a chunk
        self._first_ns = min(self._first_ns, first_ns) if self._chunks else first_ns
        self._last_ns = max(self._last_ns, last_ns)
        self._chunks += 1
        records.ChunkIndex(  # stored as the bytes of the summary, in a tenth of the memory of the object
            chunk_length=length,
            chunk_start_offset=start,
            compression=_COMPRESSION,
            compressed_size=packed,
            message_end_time=last_ns,
            message_index_length=self._file.tell() - index_start,
            message_index_offsets=places,
            message_start_time=first_ns,
            uncompressed_size=len(data),
        ).write(self._chunk_index)

    def finish(self) -> None:
        """Write the end of the data, and the summary: all records except messages, and the index."""
        self._put(records.DataEnd(data_section_crc=0))
        start = at = self._file.tell()
        groups: dict[Opcode, bytes] = {
            Opcode.SCHEMA: _bytes_of(self._schemas),
            Opcode.CHANNEL: _bytes_of(self._channels),
            Opcode.STATISTICS: _bytes_of([self._statistics()]),
            Opcode.CHUNK_INDEX: self._chunk_index.end(),  # type: ignore[no-untyped-call]
            Opcode.ATTACHMENT_INDEX: _bytes_of(self._attachments),
            Opcode.METADATA_INDEX: _bytes_of(self._metadata),
        }
        offsets = []
        for opcode, text in groups.items():
            if text:
                offsets.append(records.SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(text)))
                at += len(text)
        crc = 0
        for text in (*groups.values(), _bytes_of(offsets)):
            self._file.write(text)
            crc = zlib.crc32(text, crc)
        crc = zlib.crc32(_FOOTER_HEAD.pack(int(Opcode.FOOTER), 20, start, at), crc)
        self._put(records.Footer(summary_start=start, summary_offset_start=at, summary_crc=crc))
        self._file.write(_MAGIC)

    def _statistics(self) -> Any:
        return records.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=self._first_ns,
            message_end_time=self._last_ns,
            schema_count=len(self._schemas),
        )

    def _put(self, record: Any) -> int:
        text = _bytes_of([record])
        self._file.write(text)
        return len(text)


def _bytes_of(group: Sequence[Any]) -> bytes:
    builder = RecordBuilder()
    for record in group:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
