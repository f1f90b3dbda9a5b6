"""The microcontroller's loop, without I/O: it accepts commands and executes the lists, frame after frame.

Like the paper's firmware (section 3.2) it repeatedly records a time and reads all sensors; the host determines which
sensors and how. Commands are processed between two frames. The answer to a command that cannot be carried out contains
an error result.

The framing of the link is written from the description in `imuarray.bus.serial_link` and shares no code with it, so
that a mistake in one of them is detected.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from firmware_emulator.clock import WireClock
from firmware_emulator.microcontroller_bus import (
    DONE,
    FIRST_SELECT,
    HELD,
    NO_ACKNOWLEDGE,
    REFUSED,
    Transfers,
    result_of,
)

VERSION = 1
LONGEST = 1024
"""Maximum number of bytes of payload."""
HEADER = 11
FIRST, SECOND = 0xA5, 0x5A


class Command(NamedTuple):
    """A frame from the host; `raw` is the whole frame."""

    kind: int
    sequence: int
    payload: bytes
    raw: bytes


class Receiver:
    """A parser that finds frames in the received bytes."""

    def __init__(self) -> None:
        self._frame = bytearray()

    def feed(self, data: bytes) -> Iterator[Command]:
        """Yield the frames that `data` completes."""
        for byte in data:
            self._frame.append(byte)
            yield from self._complete()

    def _complete(self) -> Iterator[Command]:
        """Yield frames at the front; bytes that cannot begin a frame are dropped."""
        while self._frame and (size := self._size()) <= len(self._frame):
            raw = bytes(self._frame[:size])
            if size and zlib.crc32(raw[2:-4]) == int.from_bytes(raw[-4:], "little"):
                del self._frame[:size]
                yield Command(raw[4], int.from_bytes(raw[5:7], "little"), raw[HEADER:-4], raw)
            else:
                del self._frame[0]

    def _size(self) -> int:
        """Return the length of the frame, or its smallest possible length if it is not known yet; 0 if the bytes are
        not a frame.
        """
        have = self._frame
        if have[0] != FIRST or (len(have) > 1 and have[1] != SECOND):
            return 0
        if len(have) < 4:
            return HEADER + 4
        length = have[2] | have[3] << 8
        return HEADER + length + 4 if length <= LONGEST else 0


def frame(kind: int, sequence: int, time_us: int, payload: bytes) -> bytes:
    """Return the bytes of a frame with this content."""
    body = struct.pack("<HBHI", len(payload), kind, sequence & 0xFFFF, time_us & 0xFFFFFFFF) + payload
    return bytes([FIRST, SECOND]) + body + struct.pack("<I", zlib.crc32(body))


FAILED_AGES = {NO_ACKNOWLEDGE: 0xFFFF, HELD: 0xFFFE}
LONGEST_AGE_US = 0xFFFD
ANSWER, DATA = 0x80, 0xD0
LISTS = 128
REQUEST_BYTES = 1536
"""Maximum memory for requests, in bytes: it fits, together with the other data, into the 2.5 KiB of the paper's
microcontroller.
"""


COUNTED = 0x80
"""Bit in the field "bytes to write" that marks a counted request."""
CAN_COUNT = 0x04


class FirmwareRequest(NamedTuple):
    """One transaction of a list; a counted one has a rule of five bytes."""

    address: int
    write: bytes
    read: int
    rule: bytes = b""

    def bytes_of(self, answer: bytes) -> int:
        """Return the number of bytes that are read after this answer."""
        if not self.rule:
            return self.read
        offset, order, mask, packet = struct.unpack("<BBHB", self.rule)
        high, low = (offset, offset + 1) if order & 1 else (offset + 1, offset)
        count = (answer[high] << 8 | answer[low]) & mask
        packets = count if order & 2 else count // packet
        return int(min(packets, self.read // packet) * packet)


@dataclass
class FirmwarePollList:
    """A list of requests for frames number `offset`, `offset` + `every`, ..."""

    every: int
    offset: int
    requests: list[FirmwareRequest] = field(default_factory=list)


class Firmware:
    """One microcontroller on `bus`. Its counter starts at `counter_us` and is fast by `drift` (1e-4: by 100 ppm);
    `clock` is true time. With `selects` chip selects it reports SPI; otherwise it answers like earlier firmware without
    SPI.
    """

    def __init__(
        self, bus: Transfers, clock: WireClock, *, counter_us: int = 0, drift: float = 0.0, selects: int = 0
    ) -> None:
        self.clock = clock
        self.bus = bus
        self.rate = 1 + drift
        self._counter_us = counter_us
        self._started_ns = clock.now_ns()
        self._receiver = Receiver()
        self._last = b"", b""  # command and answer
        self._lists: dict[int, FirmwarePollList] = {}
        self._period_ns = 0.0
        self._begun_ns = 0
        self._number = 0
        self._selects = selects
        self._commands = {1: self._hello, 2: self._transfer, 3: self._list, 4: self._start, 5: self._stop}
        if selects:
            self._commands[8] = self._select

    def time_us(self) -> int:
        """Return the counter, which does not wrap here."""
        return self._counter_us + int((self.clock.now_ns() - self._started_ns) * self.rate) // 1000

    @property
    def due_ns(self) -> int | None:
        """Return the time on the true clock at which the next frame begins; None while no frame is required."""
        return self._begun_ns + round(self._number * self._period_ns) if self._period_ns else None

    def feed(self, data: bytes) -> bytes:
        """Process bytes from the host; return the answers."""
        return b"".join(self._answer(command) for command in self._receiver.feed(data))

    def tick(self) -> list[bytes]:
        """Begin the next frame if it is due; return the bytes to send, one entry per list. A frame that would begin
        late by a whole period or more is omitted.
        """
        if self.due_ns is None or self.due_ns > self.clock.now_ns():
            return []
        late_ns = self.clock.now_ns() - self.due_ns
        self._number += int(late_ns // self._period_ns)
        number, self._number = self._number, self._number + 1
        return [
            self._execute(name, poll_list.requests, number)
            for name, poll_list in sorted(self._lists.items())
            if number % poll_list.every == poll_list.offset
        ]

    def _execute(self, name: int, requests: list[FirmwareRequest], number: int) -> bytes:
        results: list[tuple[int, int, bytes]] = []
        previous, answer = DONE, b""
        for request in requests:
            size = request.bytes_of(answer) if previous == DONE else 0
            if request.rule and not size:
                results.append((previous, self.time_us(), bytes(request.read)))
            else:
                results.append(self._try_twice(request, size if request.rule else request.read))
            previous, _, answer = results[-1]
        now_us, payload = self.time_us(), bytearray([name])
        for result, begun_us, data in results:
            age_us = FAILED_AGES.get(result, min(now_us - begun_us, LONGEST_AGE_US))
            payload += age_us.to_bytes(2, "little") + data
        return frame(DATA, number, now_us, bytes(payload))

    def _try_twice(self, request: FirmwareRequest, size: int) -> tuple[int, int, bytes]:
        """Return the result, the time of its START, and the `size` bytes that were read, padded with zeros."""
        for _ in range(2):
            begun_us = self.time_us()
            result, data = self._transaction(request.address, request.write, size)
            if result != NO_ACKNOWLEDGE:
                break
        return result, begun_us, data + bytes(request.read - size)

    def _transaction(self, address: int, write: bytes, read: int) -> tuple[int, bytes]:
        try:
            return DONE, self.bus.transfer(address, write, read)
        except (OSError, ValueError) as error:
            return result_of(error), bytes(read)

    def _answer(self, command: Command) -> bytes:
        if command.raw == self._last[0] and command.kind != 1:
            return self._last[1]
        handler = self._commands.get(command.kind)
        payload = bytes([REFUSED]) if handler is None else handler(command.payload)
        answer = frame(command.kind | ANSWER, command.sequence, self.time_us(), payload)
        self._last = command.raw, answer
        return answer

    def _hello(self, payload: bytes) -> bytes:
        self._stop(b"")
        further = struct.pack("<BBI", CAN_COUNT, self._selects, 0) if self._selects else b""
        return struct.pack("<BBH", VERSION, LISTS, REQUEST_BYTES) + further

    def _transfer(self, payload: bytes) -> bytes:
        if len(payload) < 3:
            return bytes([REFUSED])
        address, read = struct.unpack_from("<BH", payload)
        if read + 1 > LONGEST or address >= FIRST_SELECT + self._selects:
            return bytes([REFUSED])
        result, data = self._transaction(address, payload[3:], read)
        return bytes([result]) + (data if result == DONE else b"")

    def _list(self, payload: bytes) -> bytes:
        if len(payload) < 5:
            return bytes([REFUSED])
        number, every, offset = struct.unpack_from("<BHH", payload)
        requests = requests_in(payload[5:], self._selects)
        other_requests = [
            request for name, other in self._lists.items() if name != number for request in other.requests
        ]
        if (
            requests is None
            or not offset < every
            or number >= LISTS
            or size_of(other_requests + requests) > REQUEST_BYTES
        ):
            return bytes([REFUSED])
        if 1 + sum(2 + request.read for request in requests) > LONGEST:
            return bytes([REFUSED])
        self._lists[number] = FirmwarePollList(every, offset, requests)
        return bytes([DONE])

    def _start(self, payload: bytes) -> bytes:
        if len(payload) != 4 or not any(payload):
            return bytes([REFUSED])
        self._period_ns = int.from_bytes(payload, "little") * 1000 / self.rate
        self._begun_ns, self._number = self.clock.now_ns(), 0
        return bytes([DONE])

    def _select(self, payload: bytes) -> bytes:
        if len(payload) != 6 or payload[0] >= self._selects:
            return bytes([REFUSED])
        try:
            self.bus.set_select(*struct.unpack("<BBI", payload))
        except ValueError:
            return bytes([REFUSED])
        return bytes([DONE])

    def _stop(self, payload: bytes) -> bytes:
        self._lists.clear()
        self._period_ns = 0.0
        return bytes([DONE])


def requests_in(body: bytes, selects: int) -> list[FirmwareRequest] | None:
    """Return the requests of a LIST; None if one is incomplete, is for a chip select that does not exist (there are
    `selects`), or takes its length from bytes that the request before it does not read.
    """
    requests: list[FirmwareRequest] = []
    while body:
        if len(body) < 3 or body[0] >= FIRST_SELECT + selects:
            return None
        header = 8 if body[1] & COUNTED else 3
        end = header + (body[1] & ~COUNTED)
        request = FirmwareRequest(body[0], body[header:end], body[2], body[3:header])
        previous = requests[-1].read if requests else 0
        if len(body) < end or (request.rule and (request.rule[0] + 2 > previous or not request.rule[4])):
            return None
        requests.append(request)
        body = body[end:]
    return requests


def size_of(requests: list[FirmwareRequest]) -> int:
    """Return the number of bytes that the requests occupy in memory."""
    return sum(3 + len(request.rule) + len(request.write) for request in requests)
