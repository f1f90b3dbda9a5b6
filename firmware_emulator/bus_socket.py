"""Serves the buses of an emulated array on a socket, to the host build of the firmware (`firmware/host/main.c`).

One question and one answer at a time, little-endian::

    question  'I' address u8, bytes to write u16, bytes to read u16, what to write     I2C transaction
              'S' select u8, bytes to write u16, bytes to read u16, what to write      SPI transaction
              'C' select u8, mode u16, 0 u16, clock u32                                mode and clock of a chip select
    answer    result u8 (0 done, 1 nobody, 2 held, 3 refused), and after 0 the bytes read
"""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from typing import Protocol

from firmware_emulator.microcontroller_bus import FIRST_SELECT, Transfers, result_of

_QUESTION = struct.Struct("<cBHH")
_CLOCK = struct.Struct("<I")


def serve_bus(bus: Transfers, connection: socket.socket) -> None:
    """Answer the requests of one program until it closes `connection` or ends; TypeError for an unknown request."""
    with connection, connection.makefile("rb") as stream, suppress(ConnectionError):
        while len(head := stream.read(_QUESTION.size)) == _QUESTION.size:
            kind, address, first, second = _QUESTION.unpack(head)
            connection.sendall(_answer(bus, kind, address, first, second, stream.read))


class _Read(Protocol):
    def __call__(self, size: int, /) -> bytes: ...


# The four fields of a question stand beside each other on the socket.
def _answer(bus: Transfers, kind: bytes, address: int, first: int, second: int, read: _Read) -> bytes:
    try:
        if kind == b"C":
            bus.set_select(address, first, *_CLOCK.unpack(read(_CLOCK.size)))
            return b"\0"
        if kind not in (b"I", b"S"):
            raise TypeError(f"a question of kind {kind!r} on the bus socket; allowed are I, S and C")
        write = read(first)
        return b"\0" + bus.transfer(address + (FIRST_SELECT if kind == b"S" else 0), write, second)
    except (OSError, ValueError) as error:
        return bytes([result_of(error)])
