"""SPI of Linux: /dev/spidevN.M through SPI_IOC_MESSAGE, one device file for each chip select. Facts LNX-50 ... LNX-53.

`SpiChip` makes a chip select a `Bus`: a register is read and written by the same calls as on I2C, so that drivers do
not depend on the kind of bus. SPI has no acknowledge: a missing chip reads 00 or ff, which only its identity or its
configuration reveals. The structure of each message is kept, as those of I2C are (`imuarray.bus.linux`), because the
poll loop repeats the same few.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
from functools import lru_cache
from typing import NamedTuple

from imuarray.bus.protocol import SpiPort
from imuarray.chips import SpiRules
from imuarray.errors import BusUrlError

READ = 0x80
"""Bit of the first byte that makes a transfer a read; the same for all supported chips."""
MAX_MESSAGE = 4096
"""Largest number of bytes of one message, unless spidev was loaded with another bufsiz (LNX-52)."""
KEPT = 256
"""Number of messages whose structures are kept."""
SPI_IOC_WR_MODE = 0x40016B01  # LNX-51
SPI_IOC_WR_BITS_PER_WORD = 0x40016B03
SPI_IOC_WR_MAX_SPEED_HZ = 0x40046B04
SPI_IOC_MESSAGE_1 = 0x40206B00
"""One transfer of 32 bytes (LNX-51)."""


class SpiChip:
    """The chip at `port` as a `Bus`; the address of a transfer is ignored.

    ValueError for a read without the address of one register, which SPI does not have."""

    def __init__(self, port: SpiPort, rules: SpiRules) -> None:
        self.port = port
        self._rules = rules

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Write a register's address and bytes for it, or read bytes from this register on. With neither, read a
        register and discard it: there is no acknowledge, so only the controller can fail.
        """
        if not read and not write:
            self.port.exchange(bytes([READ, 0]))
            return b""
        message = self.message(write, read)
        answer = self.port.exchange(message + bytes(read))
        return answer[len(message) :]

    def message(self, write: bytes, read: int) -> bytes:
        """Return the bytes to send for this transfer before `read` bytes are received; ValueError as of `transfer`."""
        if len(write) != 1 if read else not write:
            raise ValueError("SPI: a read begins with the address of one register")
        several = read > 1 or len(write) > 2  # an address and one byte
        first = write[0] & self._rules.address_bits | (self._rules.count_on if several else 0)
        return bytes([first | READ if read else first]) + write[1:]


class SpiTransfer(ctypes.Structure):
    """``struct spi_ioc_transfer`` (LNX-51)."""

    _fields_ = (
        ("tx_buf", ctypes.c_uint64),
        ("rx_buf", ctypes.c_uint64),
        ("len", ctypes.c_uint32),
        ("speed_hz", ctypes.c_uint32),
        ("delay_usecs", ctypes.c_uint16),
        ("bits_per_word", ctypes.c_uint8),
        ("cs_change", ctypes.c_uint8),
        ("tx_nbits", ctypes.c_uint8),
        ("rx_nbits", ctypes.c_uint8),
        ("word_delay_usecs", ctypes.c_uint8),
        ("pad", ctypes.c_uint8),
    )


class _Message(NamedTuple):
    """A kept message; `sent` is the memory to which the structure points."""

    structure: SpiTransfer
    answer: ctypes.Array[ctypes.c_char]
    sent: ctypes.Array[ctypes.c_char]

    @classmethod
    def of(cls, sent: bytes) -> _Message:
        buffer = ctypes.create_string_buffer(sent, len(sent))
        answer = ctypes.create_string_buffer(len(sent))
        structure = SpiTransfer(tx_buf=ctypes.addressof(buffer), rx_buf=ctypes.addressof(answer), len=len(sent))
        return cls(structure, answer, buffer)


class LinuxSpiPort:
    """A chip select of this machine, locked for this object; BusUrlError if it can't be opened."""

    def __init__(self, path: str, mode: int, clock_hz: int) -> None:
        self.path = path
        self._kept = lru_cache(KEPT)(_Message.of)
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise BusUrlError(
                f"spi:{path}: {error.strerror or error}; chip selects are /dev/spidev* (enable SPI, join group spi)"
            ) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            fcntl.ioctl(self._file, SPI_IOC_WR_MODE, bytes([mode]))
            fcntl.ioctl(self._file, SPI_IOC_WR_BITS_PER_WORD, bytes([8]))
            fcntl.ioctl(self._file, SPI_IOC_WR_MAX_SPEED_HZ, bytes(ctypes.c_uint32(clock_hz)))
        except BlockingIOError:
            self.close()
            raise BusUrlError(f"spi:{path}: another program has locked this chip select") from None
        except OSError as error:
            self.close()
            raise BusUrlError(
                f"spi:{path}: refuses mode {mode} or a clock of {clock_hz} Hz: {error.strerror or error}"
            ) from error

    def exchange(self, sent: bytes) -> bytes:
        """Exchange bytes as `SpiPort.exchange`; ValueError for more than a message carries."""
        if len(sent) > MAX_MESSAGE:
            raise ValueError(f"spi:{self.path}: {len(sent)} bytes, a message carries at most {MAX_MESSAGE}")
        message = self._kept(sent)
        fcntl.ioctl(self._file, SPI_IOC_MESSAGE_1, message.structure)
        return message.answer.raw

    def close(self) -> None:
        """Close the chip select."""
        os.close(self._file)


class SpiPorts:
    """The chip selects that were opened, each once."""

    def __init__(self) -> None:
        self._ports: dict[str, LinuxSpiPort] = {}

    def port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select at `path`; BusUrlError."""
        if path not in self._ports:
            self._ports[path] = LinuxSpiPort(path, mode, clock_hz)
        return self._ports[path]

    def close(self) -> None:
        """Close all of them."""
        for port in self._ports.values():
            port.close()
        self._ports.clear()
