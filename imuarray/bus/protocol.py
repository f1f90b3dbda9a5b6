"""The interface between the library and the wire."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol

from imuarray.clock import Clock


class Bus(Protocol):
    """An object that can carry one I2C transaction: a bus, or a channel of a multiplexer."""

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Carry out one transaction, ``S address+W write... [Sr address+R read...] P``; return the bytes that were
        read.

        With nothing to write the transaction is ``S address+R read... P``, and ``transfer(address)`` alone, ``S
        address+W P``, checks for an acknowledge. Raises OSError as Linux does: errno 6 or 121 when no chip
        acknowledges, 110 when the clock is held too long.
        """


class SpiPort(Protocol):
    """One chip select of an SPI controller."""

    def exchange(self, sent: bytes) -> bytes:
        """Send bytes while the chip is selected; return the same number of received bytes. OSError as Linux."""


class OpenBus(Bus, AbstractContextManager["OpenBus"], Protocol):
    """A bus that was opened from a URL, with the clock of its traffic."""

    clock: Clock
    source: str
    """The `source` of a log recorded over it: "i2c", "spi", "iio", "serial" or "emulated"."""

    def channel_bus(self, path: str) -> Bus:
        """Return the bus at `path`, for a sensor behind a kernel-driven mux channel; closed together with this one."""

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select at `path` with this mode and clock; this bus closes it. OSError or BusUrlError."""
