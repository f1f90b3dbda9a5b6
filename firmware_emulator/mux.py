"""PCA9544A: one control byte that says which of four channels joins the trunk, if any (NXP data sheet Rev 5, 2014).

The byte reads back at once, but the wires are switched only by the STOP that ends the transaction
(PCA-06, DEC-40), also when that transaction was broken off (DEC-41).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from firmware_emulator.chip import Target
from imuarray.facts import pca9544a as facts

NO_CHANNEL = -1


class Pca9544aChip:
    """The multiplexer as a device on the trunk; `channels` holds the devices behind each of its channels.

    `route` is the channel that is connected now, `NO_CHANNEL` if none. `interrupts` are the inputs INT3 ... INT0 as
    bits 3:0, 1 where an input is pulled low (PCA-12).
    """

    def __init__(
        self, address: int, channels: Mapping[int, Sequence[Target]] | None = None, powered_on_ns: int = 0
    ) -> None:
        self.address = address
        self.channels = {channel: tuple((channels or {}).get(channel, ())) for channel in facts.CHANNELS}
        self.interrupts = 0
        self.power_on(powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Control register 0, no channel connected (PCA-05)."""
        self.control = facts.CONTROL.reset
        self.route = NO_CHANNEL

    @property
    def ordered(self) -> int:
        """The channel that the control register asks for, `NO_CHANNEL` if none."""
        return facts.CHANNEL.of(self.control) if facts.ENABLE.of(self.control) else NO_CHANNEL

    def branch(self) -> Sequence[Target]:
        """Return the devices that are joined to the trunk now."""
        return self.channels.get(self.route, ())

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Every byte goes to the control register: the last one stays (PCA-02, PCA-08)."""
        if data:
            self.control = data[-1] & (facts.ENABLE.mask | facts.CHANNEL.mask)
        return len(data)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Return the control register, repeated `count` times."""
        return bytes([self.interrupts << 4 & 0xF0 | self.control]) * count

    def stop(self, at_ns: int) -> None:
        """Switch the wires to what the control register says."""
        self.route = self.ordered
