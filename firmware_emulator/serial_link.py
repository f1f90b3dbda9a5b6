"""The serial link as firmware sees it: bytes come one after the other, and memory is small.

Written from the description in `imuarray.bus.serial_link`, and apart from it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

VERSION = 1
LONGEST = 1024
"""Bytes of payload."""
HEADER = 11
FIRST, SECOND = 0xA5, 0x5A


class Command(NamedTuple):
    """A frame of the host; `raw` is all of it."""

    kind: int
    sequence: int
    payload: bytes
    raw: bytes


class Receiver:
    """Finds frames in what arrives."""

    def __init__(self) -> None:
        self._frame = bytearray()

    def feed(self, data: bytes) -> Iterator[Command]:
        """The frames that `data` completes."""
        for byte in data:
            self._frame.append(byte)
            yield from self._complete()

    def _complete(self) -> Iterator[Command]:
        """Frames at the front; what can't become one is dropped, byte by byte."""
        while self._frame and (size := self._size()) <= len(self._frame):
            raw = bytes(self._frame[:size])
            if size and zlib.crc32(raw[2:-4]) == int.from_bytes(raw[-4:], "little"):
                del self._frame[:size]
                yield Command(raw[4], int.from_bytes(raw[5:7], "little"), raw[HEADER:-4], raw)
            else:
                del self._frame[0]

    def _size(self) -> int:
        """Return the length of the frame as far as it is known; 0 if the bytes are no frame."""
        have = self._frame
        if have[0] != FIRST or (len(have) > 1 and have[1] != SECOND):
            return 0
        if len(have) < 4:
            return HEADER + 4
        length = have[2] | have[3] << 8
        return HEADER + length + 4 if length <= LONGEST else 0


def frame(kind: int, sequence: int, time_us: int, payload: bytes) -> bytes:
    """Return what is sent."""
    body = struct.pack("<HBHI", len(payload), kind, sequence & 0xFFFF, time_us & 0xFFFFFFFF) + payload
    return bytes([FIRST, SECOND]) + body + struct.pack("<I", zlib.crc32(body))
