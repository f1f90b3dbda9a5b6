"""Registers of eight bits and the fields inside them.

``CTRL[3:0]`` is a field, ``RANGE(0b11)`` a value that knows its register, ``RANGE.of(byte)`` the code inside a byte,
and ``MEASURE(1) | LINK(0)`` two settings of one register that are written together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

Access = Literal["r", "w", "rw"]


@dataclass(frozen=True)
class Setting:
    """Bits to be written into one register: `value` where `mask` is 1, the rest left as it is."""

    register: Register
    mask: int
    value: int

    def __or__(self, other: Setting) -> Setting:
        """Both settings at once; ValueError when they belong to two registers or claim the same bit."""
        if other.register != self.register:
            raise ValueError(
                f"settings of two registers, {self.register.address:#04x} and {other.register.address:#04x}"
            )
        if other.mask & self.mask:
            raise ValueError(f"register {self.register.address:#04x}: bits {other.mask & self.mask:#04x} set twice")
        return Setting(self.register, self.mask | other.mask, self.value | other.value)

    def mismatch(self, byte: int) -> str:
        """Return a clause that says what the register reads, and what it should."""
        return f"register {self.register.address:#04x} reads {byte:#04x}, configured {self.into(byte):#04x}"

    def into(self, byte: int) -> int:
        """Return `byte` with these bits replaced: the middle of a read-modify-write."""
        return byte & ~self.mask & 0xFF | self.value


@dataclass(frozen=True)
class Field:
    """Bits `high` down to `low` of a register."""

    register: Register
    high: int
    low: int

    @cached_property
    def mask(self) -> int:
        """The field's bits, in place."""
        return (1 << self.high + 1) - (1 << self.low)

    def __call__(self, code: int) -> Setting:
        """The setting that writes `code`; ValueError when it does not fit."""
        if not 0 <= code <= self.mask >> self.low:
            raise ValueError(f"register {self.register.address:#04x} bits {self.high}:{self.low}: {code} does not fit")
        return Setting(self.register, self.mask, code << self.low)

    def of(self, byte: int) -> int:
        """Return the code that `byte` holds in this field."""
        return (byte & self.mask) >> self.low


@dataclass(frozen=True)
class Register:
    """One byte of a chip's map: where it is, who may write it, what it holds after power-on, which bits are reserved,
    and how many bytes are read from there on to read it back without disturbing a chip that measures.

    `bank`: which of several maps it is in, of a chip that has more than one.
    """

    address: int
    access: Access = "rw"
    reset: int = 0x00
    reserved: int = 0x00
    readback_bytes: int = 1
    bank: int = 0

    @cached_property
    def pointer(self) -> bytes:
        """Return the address as the byte that begins a transaction."""
        return bytes([self.address])

    def __getitem__(self, bits: int | slice) -> Field:
        """``REGISTER[5]`` or ``REGISTER[7:4]``, written as the data sheets write bits: high, low, both included."""
        high, low = (bits.start, bits.stop) if isinstance(bits, slice) else (bits, bits)
        if not 7 >= high >= low >= 0:
            raise ValueError(f"register {self.address:#04x}: no bits {high}:{low} in a byte")
        return Field(self, high, low)
