"""The serial link to an array on a microcontroller, byte by byte: the complete description for firmware.

Both sides send frames; every number is little-endian::

    offset  bytes
    0       2       sync: A5 5A
    2       2       n, length of the payload: at most 1024
    4       1       kind
    5       2       sequence
    7       4       time: microseconds on the microcontroller's counter at the beginning of the frame; 0 from the host
    11      n       payload
    11 + n  4       CRC-32 (zlib's and Ethernet's) of bytes 2 to 10 + n

A receiver that finds no valid frame at a sync continues its search one byte later, so that it detects an intact frame
among any other bytes. These are the commands of the host, and the payload of the answer, which has bit 7 of the kind
set and the command's sequence::

    01 HELLO                                                  version, lists u8, bytes u16
    02 TRANSFER  address, count u16, bytes to write           result, bytes that were read
    03 LIST      number, every u16, offset u16, requests      result
    04 START     period u32 (microseconds)                    result
    05 STOP                                                   result

`result` is 0 done, 1 no acknowledge, 2 the clock was held too long, 3 refused. A TRANSFER is one transaction: register
address out and bytes in (`imuarray.bus.protocol.Bus`). HELLO stops the stream of an earlier program; its answer states
the memory for lists: their number, and the bytes of their requests. A repeated command (the identical frame) is
answered again and not carried out again; HELLO is always carried out.

A list contains the requests of one frame of the array, as ``address, bytes to write u8, bytes to read u8, data to
write``. From START on, frame number 0, 1, 2, ... begins every `period`; in frame k the lists with ``k mod every ==
offset`` are executed, in order of their numbers, and the answer to each is sent at once. A request without an
acknowledge is tried a second time. STOP deletes all lists. After each list the microcontroller sends::

    D0 DATA      sequence: frame number mod 65536;  list number, then for each request: age u16, the bytes read

`age` is the time in microseconds from the START of the request to `time`, FFFD for any longer time; FFFF means that no
chip acknowledged, FFFE that the clock was held too long, and the bytes are 0. A microcontroller that is late omits
frames, and one with a full line omits DATA; their numbers are missing.

A host rejects DATA that can't be of the running stream (`imuarray.bus.serial_session`).

Firmware with further functions adds to the four bytes of its answer to HELLO: features u8 (bit 0 RESEND, bit 1 STATUS,
bit 2 counted requests), chip selects of SPI u8, bytes of DATA that it keeps u32. The further commands are::

    06 RESEND    first u16, count u16                         result, frames u16, next u16
    07 STATUS                                                 result, and the numbers below
    08 SELECT    chip select, mode, clock u32 (Hz)            result

DATA is kept, also after STOP, until it is acknowledged or newer DATA needs its memory. RESEND acknowledges the frame
numbers before `first` and requests DATA of the numbers `first` ... `first + count - 1` again, as identical bytes,
before its answer, which has the number of frames sent and the frame number to continue with if the line had no room for
all. STATUS returns, each as a u32 unless stated otherwise: u8 1 after a reset by the watchdog, u64 microseconds since
the start, then the numbers of DATA sent, frames omitted for lack of time, DATA for which the line had no room, DATA
overwritten before it was acknowledged, requests of lists that failed, bytes received that belonged to no frame. An
address from 80 on, in TRANSFER and LIST, is chip select `address - 80` of SPI: the data to write are sent, then zeros
while the requested bytes are received; there is no acknowledge.

Feature bit 2: a request of a list may be counted, so that a chip's queue is drained by its own count. Bit 7 of its
bytes to write is set (they are at most 127), and its rule is between the bytes to read and the data to write: offset
u8, order u8, mask u16, packet u8. The two bytes at `offset` in the answer to the previous request, high byte first if
bit 0 of `order` is set, and with `mask`, are a count of packets of `packet` bytes if bit 1 is set, else of bytes. The
number of whole packets that is read is the count, as far as the bytes to read have room; the rest of the answer is 0.
With a count of 0 there is no transaction. If the previous request failed, this one has failed in the same way.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

VERSION = 1
SYNC = b"\xa5\x5a"
MAX_PAYLOAD = 1024
MAX_LIST_READ = 255
"""Largest number of bytes that one request of a list reads."""
HELLO, TRANSFER, LIST, START, STOP = 0x01, 0x02, 0x03, 0x04, 0x05
RESEND, STATUS, SELECT = 0x06, 0x07, 0x08
CAN_RESEND, CAN_STATUS, CAN_COUNT = 0x01, 0x02, 0x04
FIRST_SELECT = 0x80
"""Address of chip select 0 of SPI."""
ANSWER = 0x80
DATA = 0xD0
DONE, NOBODY, HELD, REFUSED = 0, 1, 2, 3
AGE_NOBODY, AGE_HELD, AGE_LONGEST = 0xFFFF, 0xFFFE, 0xFFFD
SEQUENCES = 1 << 16
TIMES_US = 1 << 32

_HEADER = struct.Struct("<2sHBHI")
_BODY = _HEADER.size
_CRC = struct.Struct("<I")
OVERHEAD = _BODY + _CRC.size
"""Number of bytes of a frame outside its payload."""
_HELLO = struct.Struct("<BBH")
_FEATURES = struct.Struct("<BBI")
_SELECT = struct.Struct("<BBI")
_COUNTS = struct.Struct("<?Q6I")
_LIST = struct.Struct("<BHH")
_RULE = struct.Struct("<BBHB")
_COUNTED, _BIG_ENDIAN, _OF_PACKETS = 0x80, 0x01, 0x02
_LONGEST_WRITE = 0x7F
_TRANSFER = struct.Struct("<BH")

_NOTHING = (b"", 0, 0, 0, 0)
_ERRNO = {NOBODY: errno.EREMOTEIO, HELD: errno.ETIMEDOUT, REFUSED: errno.EOPNOTSUPP}


class LinkError(OSError):
    """An answer over the link is invalid or missing; errno is EPROTO (71)."""

    def __init__(self, text: str) -> None:
        super().__init__(errno.EPROTO, text)


class Frame(NamedTuple):
    """One frame; `time_us` as it was sent, not widened."""

    kind: int
    sequence: int
    time_us: int
    payload: bytes


class Capacity(NamedTuple):
    """The answer to HELLO: the protocol version, the number of lists, and the bytes of requests that fit; then what
    older firmware does not report: CAN_RESEND, CAN_STATUS, CAN_COUNT, chip selects of SPI, bytes of DATA that are kept.
    """

    version: int
    lists: int
    request_bytes: int
    features: int = 0
    selects: int = 0
    kept_bytes: int = 0


class FirmwareCounts(NamedTuple):
    """The answer to STATUS: whether this boot followed a reset by the watchdog, microseconds since the boot, then the
    numbers of DATA sent, frames omitted for lack of time, DATA for which the line had no room, DATA overwritten before
    it was acknowledged, requests of lists that failed, and received bytes that belonged to no frame.
    """

    watchdog_reset: bool
    up_us: int
    sent: int
    late: int
    dropped: int
    overwritten: int
    failures: int
    skipped: int


@dataclass(frozen=True)
class CountRule:
    """The rule for the length of a counted request: the two bytes at `offset` of the answer before it, with `mask`,
    are the number of packets of `packet` bytes, or the number of their bytes.
    """

    packet: int
    offset: int = 0
    mask: int = 0xFFFF
    is_big_endian: bool = False
    is_of_packets: bool = False

    def packets(self, answer: bytes) -> int:
        """Return the number of whole packets that is counted in `answer`, the answer to the previous request."""
        order: Literal["big", "little"] = "big" if self.is_big_endian else "little"
        count = int.from_bytes(answer[self.offset : self.offset + 2], order) & self.mask
        return count if self.is_of_packets else count // self.packet


@dataclass(frozen=True)
class Request:
    """One transaction of a list, which reads `read` bytes, or with `rule` at most `read` bytes."""

    address: int
    write: bytes
    read: int
    rule: CountRule | None = None

    @property
    def size(self) -> int:
        """The bytes that it occupies in a LIST."""
        return 3 + len(self.write) + (0 if self.rule is None else _RULE.size)

    def encode(self) -> bytes:
        """Return the bytes of the request in a LIST; ValueError if it writes more than a request can."""
        if len(self.write) > _LONGEST_WRITE:
            raise ValueError(f"{len(self.write)} bytes to write in a list; at most {_LONGEST_WRITE}")
        if self.rule is None:
            return bytes([self.address, len(self.write), self.read]) + self.write
        order = _BIG_ENDIAN * self.rule.is_big_endian | _OF_PACKETS * self.rule.is_of_packets
        rule = _RULE.pack(self.rule.offset, order, self.rule.mask, self.rule.packet)
        return bytes([self.address, _COUNTED | len(self.write), self.read]) + rule + self.write


@dataclass(frozen=True)
class PollList:
    """The requests of frames number `offset`, `offset` + `every`, ..."""

    every: int
    offset: int
    requests: tuple[Request, ...]

    @property
    def size(self) -> int:
        """The bytes of the payload of its answer, its number included."""
        return 1 + sum(2 + request.read for request in self.requests)


def frame_payload(kind: int, sequence: int, payload: bytes = b"", time_us: int = 0) -> bytes:
    """Return the bytes of one frame; ValueError for a payload that is too long."""
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"{len(payload)} bytes in a frame of the serial link; at most {MAX_PAYLOAD}")
    frame = _HEADER.pack(SYNC, len(payload), kind, sequence, time_us) + payload
    return frame + _CRC.pack(zlib.crc32(frame[2:]))


class Deframer:
    """A parser of received bytes, in pieces of any length, into frames. `skipped` counts the bytes that belonged to no
    frame.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self._waiting = b""

    def feed(self, data: bytes, *, final: bool = False) -> list[Frame]:
        """Return the frames that `data` completes; never raises. With `final` no data follow, and the bytes of an
        incomplete frame are skipped.
        """
        buffer = self._waiting + data
        frames: list[Frame] = []
        crc32, header, checksum, find = zlib.crc32, _HEADER.unpack_from, _CRC.unpack_from, buffer.find
        at, size, skipped = 0, len(buffer), 0
        while (start := find(SYNC, at)) >= 0:
            _, length, kind, sequence, time_us = header(buffer, start) if size - start >= _BODY else _NOTHING
            body, end = start + _BODY, start + _BODY + length
            if length <= MAX_PAYLOAD and end + 4 <= size:
                if crc32(buffer[start + 2 : end]) == checksum(buffer, end)[0]:
                    frames.append(Frame(kind, sequence, time_us, buffer[body:end]))
                    skipped += start - at
                    at = end + 4
                    continue
            elif length <= MAX_PAYLOAD and not final:
                break
            skipped += start + 1 - at  # no frame begins with this sync
            at = start + 1
        half = buffer.endswith(SYNC[:1]) and not final
        kept = max(at, start if start >= 0 else size - half)
        self.skipped += skipped + kept - at
        self._waiting = buffer[kept:]
        return frames


def transfer_payload(address: int, write: bytes, read: int) -> bytes:
    """Return the payload of TRANSFER; ValueError for a transfer that no adapter or no frame can carry."""
    if not 0 <= address <= 0x7F or read < 0:
        raise ValueError(f"transfer({address:#x}, read={read}): allowed are addresses of 7 bits and counts from 0")
    return _transfer_payload(address, write, read)


def exchange_payload(select: int, write: bytes, read: int) -> bytes:
    """Return the payload of TRANSFER on SPI: bytes out, then zeros while `read` bytes come in; ValueError for a
    transfer that no frame can carry.
    """
    return _transfer_payload(FIRST_SELECT + select, write, read)


def _transfer_payload(address: int, write: bytes, read: int) -> bytes:
    if max(len(write) + _TRANSFER.size, read + 1) > MAX_PAYLOAD:
        raise ValueError(
            f"address {address:#04x}: {max(len(write), read)} bytes; a frame of the link holds {MAX_PAYLOAD}"
        )
    return _TRANSFER.pack(address, read) + write


def select_payload(select: int, mode: int, clock_hz: int) -> bytes:
    """Return the payload of SELECT."""
    return _SELECT.pack(select, mode, clock_hz)


def list_payload(number: int, asked: PollList) -> bytes:
    """Return the payload of LIST; ValueError for a list that does not fit into frames."""
    body = b"".join(request.encode() for request in asked.requests)
    if max(_LIST.size + len(body), asked.size) > MAX_PAYLOAD:
        raise ValueError(f"list {number}: {max(len(body), asked.size)} bytes; a frame of the link holds {MAX_PAYLOAD}")
    return _LIST.pack(number, asked.every, asked.offset) + body


def request_bytes(lists: Sequence[PollList]) -> int:
    """Return the bytes of requests in all lists, as HELLO counts them."""
    return sum(request.size for asked in lists for request in asked.requests)


def start_payload(period_us: int) -> bytes:
    """Return the payload of START."""
    return struct.pack("<I", period_us)


def resend_payload(first: int, count: int) -> bytes:
    """Return the payload of RESEND: `count` frame numbers from `first` on."""
    return struct.pack("<HH", first % SEQUENCES, count)


def sent_again(payload: bytes) -> tuple[int, int]:
    """Decode the answer to RESEND: the number of frames that were sent again, and the frame number, mod 65536, to
    continue with; errors as of `outcome_of`.
    """
    frames, following = struct.unpack("<HH", outcome_of(payload, 4, "frames to be sent again"))
    return frames, following


def capacity_of(payload: bytes) -> Capacity:
    """Decode the answer to HELLO; LinkError for an invalid payload."""
    if len(payload) < _HELLO.size:
        raise LinkError(f"the answer to HELLO has {len(payload)} bytes; {_HELLO.size} are required")
    further = _FEATURES.unpack_from(payload, _HELLO.size) if len(payload) >= _HELLO.size + _FEATURES.size else ()
    return Capacity(*_HELLO.unpack_from(payload), *further)


def counts_of(payload: bytes) -> FirmwareCounts:
    """Decode the answer to STATUS; LinkError for an invalid payload."""
    return FirmwareCounts(*_COUNTS.unpack(outcome_of(payload, _COUNTS.size, "status")))


def outcome_of(payload: bytes, count: int, what: str) -> bytes:
    """Return the `count` bytes after a result of 0; OSError as in Linux for results 1 to 3, LinkError for any other."""
    if not payload or payload[0] not in (DONE, *_ERRNO):
        raise LinkError(f"{what}: the microcontroller answers {payload[:8].hex() or 'nothing'}")
    if payload[0] != DONE:
        number = _ERRNO[payload[0]]
        raise OSError(number, f"{os.strerror(number)}: {what}")
    if len(payload) != 1 + count:
        raise LinkError(f"{what}: {len(payload) - 1} bytes received; {count} requested")
    return payload[1:]
