"""A microcontroller on a board that answers with numbered bytes, its commands and its frames."""

from __future__ import annotations

import struct
import zlib
from typing import Any

from firmware_emulator.clock import VirtualClock
from firmware_emulator.serial_firmware import Firmware

MS, US = 1_000_000, 1000
TRANSACTION_NS = 100 * US


class Board:
    """Answers 0, 1, 2, ... at address 0x53, after a tenth of a millisecond; fails as configured."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.asked: list[tuple[int, bytes, int]] = []
        self.failures: list[int] = []

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        if address > 0x7F:
            raise ValueError(f"{address:#x}")
        self.asked.append((address, write, read))
        self.clock.advance(TRANSACTION_NS)
        if self.failures and (number := self.failures.pop(0)):
            raise OSError(number, "as told")
        if address != 0x53:
            raise OSError(121, "nobody")
        return bytes(range(read))


def bench(**given: Any) -> tuple[Firmware, Board, VirtualClock]:
    clock = VirtualClock(5 * MS)
    board = Board(clock)
    return Firmware(board, clock, **given), board, clock


def framed(kind: int, sequence: int, payload: bytes = b"") -> bytes:
    body = struct.pack("<HBHI", len(payload), kind, sequence, 0) + payload
    return b"\xa5\x5a" + body + struct.pack("<I", zlib.crc32(body))


def frame_fields(frame: bytes) -> tuple[int, int, int, bytes]:
    """Kind, sequence, time and payload of one frame, which must be whole."""
    length, kind, sequence, time_us = struct.unpack_from("<HBHI", frame, 2)
    assert frame[:2] == b"\xa5\x5a"
    assert len(frame) == 15 + length
    assert struct.pack("<I", zlib.crc32(frame[2:-4])) == frame[-4:]
    return kind, sequence, time_us, frame[11:-4]


def ask(firmware: Firmware, kind: int, payload: bytes = b"", sequence: int = 1) -> bytes:
    answer_kind, echoed, _, answer = frame_fields(firmware.feed(framed(kind, sequence, payload)))
    assert (answer_kind, echoed) == (kind | 0x80, sequence)
    return answer


ONE = bytes.fromhex("53 01 02 30")  # two bytes from register 0x30
NOBODY = bytes.fromhex("1d 01 02 30")


def started(period_us: int = 5000, *lists: str, **given: Any) -> tuple[Firmware, Board, VirtualClock]:
    firmware, board, clock = bench(**given)
    for sequence, text in enumerate(lists):
        assert ask(firmware, 3, bytes.fromhex(text), sequence) == b"\x00"
    assert ask(firmware, 4, struct.pack("<I", period_us), 99) == b"\x00"
    return firmware, board, clock


def run(firmware: Firmware, clock: VirtualClock, frames: int) -> list[tuple[int, int, int, bytes]]:
    sent = []
    for _ in range(frames):
        assert firmware.due_ns is not None
        clock.sleep_until(firmware.due_ns)
        sent += [frame_fields(frame) for frame in firmware.tick()]
    return sent
