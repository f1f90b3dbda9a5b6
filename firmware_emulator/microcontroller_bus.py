"""The buses of a microcontroller on the emulated array: I2C, and chip selects of SPI under addresses from 0x80 on.

`serve_bus` serves them on a socket to the host build of the firmware (`firmware/host/main.c`), one request and one
answer at a time, little-endian::

    request   'I' address u8, bytes to write u16, bytes to read u16, data to write     I2C transaction
              'S' select u8, bytes to write u16, bytes to read u16, data to write      SPI transaction
              'C' select u8, mode u16, 0 u16, clock u32                                mode and clock of a chip select
    answer    result u8 (0 done, 1 no acknowledge, 2 bus held, 3 refused), and after 0 the bytes read
"""

from __future__ import annotations

import errno
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from firmware_emulator.spi import ChipSelectPort

FIRST_SELECT = 0x80
"""Address of chip select 0."""
SELECTS = 8
DONE, NO_ACKNOWLEDGE, HELD, REFUSED = 0, 1, 2, 3
"""Result codes of a transaction: done, no acknowledge, bus held, refused."""
SPI_PATH = "/dev/spidev0."
"""Prefix of the bus names of controller 0: chip select N of this controller is chip select N of the microcontroller."""
SLOWEST_HZ = 1_000_000
"""The clock in Hz of a chip select that was not configured."""


class Transfers(Protocol):
    """The buses of a microcontroller; `MicrocontrollerBus` implements them."""

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Carry out one transaction; OSError like that of the emulated wire."""

    def set_select(self, select: int, mode: int, clock_hz: int) -> None:
        """Set mode and clock of a chip select; ValueError if no controller supports them. Not called without SPI."""


class Buses(Protocol):
    """The buses and chip selects of the emulated array."""

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Carry out one I2C transaction; OSError like that of the emulated wire."""

    def spi_port(self, path: str, mode: int, clock_hz: int) -> ChipSelectPort:
        """Return the chip select with this name; OSError if it has no sensor."""


class MicrocontrollerBus:
    """The buses of a microcontroller that is connected to `array`.

    An SPI transaction without a chip reads FF, like an open line.
    """

    def __init__(self, array: Buses) -> None:
        self._array = array
        self._ports: dict[int, ChipSelectPort | None] = {}

    def set_select(self, select: int, mode: int, clock_hz: int) -> None:
        """Set mode and clock of a chip select; ValueError if no controller supports them."""
        if select not in range(SELECTS):
            raise ValueError(f"chip select {select}: allowed are 0 to {SELECTS - 1}")
        try:
            self._ports[select] = self._array.spi_port(f"{SPI_PATH}{select}", mode, clock_hz)
        except FileNotFoundError:
            self._ports[select] = None

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Carry out one transaction; on SPI return the bytes that are received after `write`, while zeros are sent.

        OSError like that of the emulated wire; ValueError for a chip select that does not exist.
        """
        if address < FIRST_SELECT:
            return self._array.transfer(address, write, read)
        select = address - FIRST_SELECT
        if select not in self._ports:
            self.set_select(select, 0, SLOWEST_HZ)
        port = self._ports[select]
        if not write and not read:
            raise ValueError("an SPI transfer of no bytes")
        if port is None:
            return b"\xff" * read
        return port.exchange(write + bytes(read))[len(write) :]


def result_of(error: OSError | ValueError) -> int:
    """Return the code by which firmware reports a failed transaction."""
    if isinstance(error, OSError):
        return HELD if error.errno in (errno.ETIMEDOUT, errno.EAGAIN) else NO_ACKNOWLEDGE
    return REFUSED


_REQUEST = struct.Struct("<cBHH")
_CLOCK = struct.Struct("<I")


def serve_bus(bus: Transfers, connection: socket.socket) -> None:
    """Answer the requests of one program until it closes `connection` or ends; TypeError for an unknown request."""
    with connection, connection.makefile("rb") as stream, suppress(ConnectionError):
        while len(head := stream.read(_REQUEST.size)) == _REQUEST.size:
            kind, address, first, second = _REQUEST.unpack(head)
            connection.sendall(_answer(bus, kind, address, first, second, stream.read))


# The four fields of a request follow each other on the socket.
def _answer(bus: Transfers, kind: bytes, address: int, first: int, second: int, read: Callable[[int], bytes]) -> bytes:
    try:
        if kind == b"C":
            bus.set_select(address, first, *_CLOCK.unpack(read(_CLOCK.size)))
            return b"\0"
        if kind not in (b"I", b"S"):
            raise TypeError(f"a request of kind {kind!r} on the bus socket; allowed are I, S and C")
        write = read(first)
        return b"\0" + bus.transfer(address + (FIRST_SELECT if kind == b"S" else 0), write, second)
    except (OSError, ValueError) as error:
        return bytes([result_of(error)])
