"""The line between a chip's converter and the two wires: the output latch, the contacts, the cable.

`ChipLine` takes the place of the chip and answers to its address. It knows where each chip keeps its triad (ADX-27,
BMA-12, BMA-60, L3G-44) and which bit says that the triad is new (ADX-50, BMA-62, L3G-52).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from struct import Struct
from types import MappingProxyType
from typing import NamedTuple

from firmware_emulator.chip import Chip

Codes = tuple[int, int, int]
WORDS = Struct("<3h")


class TriadLayout(NamedTuple):
    """The place of a chip's triad: its first register, how far its codes are shifted up, and their width in bits."""

    first: int
    shift: int
    bits: int


LAYOUTS = MappingProxyType(
    {"adxl345": TriadLayout(0x32, 0, 13), "bma180": TriadLayout(0x02, 2, 14), "l3g4200d": TriadLayout(0x28, 0, 16)}
)
"""Layouts by chip; inertial chips only."""

Latch = Callable[[int, Codes], Codes]
Contact = Callable[[int], bool]
Cable = Callable[[int, bytes], bytes]
Reset = Callable[[int], int | None]


@dataclass
class Links:
    """The disturbances of a line, each a function of the instant in ns since power-on.

    latches: (at_ns, codes) -> codes as they are read. contacts: (at_ns) -> whether the chip is connected at all.
    cables: (at_ns, bytes sent) -> bytes received. resets: (at_ns) -> when the supply failed since last asked, or None.
    """

    latches: list[Latch] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    cables: list[Cable] = field(default_factory=list)
    resets: list[Reset] = field(default_factory=list)

    @property
    def idle(self) -> bool:
        """True if nothing acts."""
        return not (self.latches or self.contacts or self.cables or self.resets)


class ChipLine:
    """A chip of that `kind`, seen through `links`."""

    def __init__(self, chip: Chip, kind: str, links: Links, powered_on_ns: int = 0) -> None:
        self._chip = chip
        self._powered_on_ns = powered_on_ns
        self._links = links
        self._layout = LAYOUTS[kind]
        self._pointer = 0

    @property
    def address(self) -> int:
        """The chip's."""
        return self._chip.address

    @address.setter
    def address(self, value: int) -> None:
        self._chip.address = value

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Write to the chip; nothing is acknowledged while a contact is open."""
        since_ns = at_ns - self._powered_on_ns
        for reset in self._links.resets:
            failed_ns = reset(since_ns)
            if failed_ns is not None:
                self._chip.power_on(self._powered_on_ns + failed_ns)
        for closed in self._links.contacts:
            if not closed(since_ns):
                return -1 if not data else 0
        if data:
            self._pointer = data[0] & 0x7F
        return self._chip.write(data, at_ns, byte_ns)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read the chip, the triad through the latches, all bytes through the cable."""
        sent = self._chip.read(count, at_ns, byte_ns)
        at_ns -= self._powered_on_ns
        offset = self._layout.first - self._pointer
        if self._links.latches and offset >= 0 and count >= offset + WORDS.size:
            sent = self._latched(sent, offset, at_ns)
        for cable in self._links.cables:
            sent = cable(at_ns, sent)
        return sent

    def stop(self, at_ns: int) -> None:
        """Pass the STOP on to the chip."""
        self._chip.stop(at_ns)

    def _latched(self, sent: bytes, offset: int, at_ns: int) -> bytes:
        _, shift, bits = self._layout
        words = WORDS.unpack_from(sent, offset)
        low = (1 << shift) - 1
        codes = words[0] >> shift, words[1] >> shift, words[2] >> shift
        for latch in self._links.latches:
            codes = latch(at_ns, codes)
        top = (1 << bits - 1) - 1
        kept = [max(-top - 1, min(top, code)) << shift | word & low for code, word in zip(codes, words, strict=True)]
        return sent[:offset] + WORDS.pack(*kept) + sent[offset + WORDS.size :]
