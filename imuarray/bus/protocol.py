"""The interface between the library and the wire, and the PCA9544A multiplexer, whose four channels are each a `Bus`.

NXP data sheet Rev 5. One control byte, no register address (PCA-02): bit 2 enables, bits 1:0 choose the channel
(PCA-03). The new channel is connected from the STOP on (PCA-06), so that selecting is a transaction of its own. The
chip has no reset (PCA-09).
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol

from imuarray.clock import Clock
from imuarray.facts import pca9544a


class Bus(Protocol):
    """Anything that can carry one I2C transaction; a channel of a multiplexer is one too."""

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """One transaction: ``S address+W write... [Sr address+R read...] P``; the bytes that were read.

        With nothing to write the transaction is ``S address+R read... P``, and ``transfer(address)`` alone, ``S
        address+W P``, asks whether anybody answers. Raises OSError as Linux does: errno 6 or 121 when no chip
        acknowledges, 110 when the clock is held too long.
        """


class SpiPort(Protocol):
    """One chip select of an SPI controller."""

    def exchange(self, sent: bytes) -> bytes:
        """Send bytes while the chip is selected; the bytes, as many, that came back meanwhile. OSError as Linux."""


class OpenBus(Bus, AbstractContextManager["OpenBus"], Protocol):
    """A bus that was opened from a URL, with the clock that its traffic obeys."""

    clock: Clock
    source: str
    """The `source` of a log recorded over it: "i2c", "spi", "iio", "serial" or "emulated"."""

    def channel_bus(self, path: str) -> Bus:
        """Return the bus at `path`, for a sensor behind a kernel-driven mux channel; closed together with this one."""

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select at `path`, clocked so; closed together with this bus. OSError or BusUrlError."""


class Pca9544a:
    """One multiplexer; remembers what is selected, and forgets it whenever a transaction fails."""

    def __init__(self, bus: Bus, address: int) -> None:
        self.bus = bus
        self.address = address
        self.selected: int | None = None

    def select(self, channel: int) -> None:
        """Connect `channel` if it is not connected; OSError when the mux does not answer."""
        if channel == self.selected:
            return
        self.selected = None
        setting = pca9544a.ENABLE(1) | pca9544a.CHANNEL(channel)
        self.bus.transfer(self.address, bytes([setting.value]))
        self.selected = channel

    def channel(self, channel: int) -> MuxChannel:
        """Return the bus behind one channel."""
        return MuxChannel(self, channel)


class MuxChannel:
    """One channel of a multiplexer: a bus that selects itself before it talks."""

    def __init__(self, mux: Pca9544a, channel: int) -> None:
        self.mux = mux
        self.number = channel

    def select(self) -> None:
        """Connect this channel now, so that the next transaction starts at once; OSError if the mux is silent."""
        self.mux.select(self.number)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """See `Bus.transfer`; a failed transaction makes the next one select anew."""
        self.mux.select(self.number)
        try:
            return self.mux.bus.transfer(address, write, read)
        except OSError:
            self.mux.selected = None
            raise
