"""The interface of every emulated chip: a page of registers behind an address pointer, fed by a sensing element.

The wire speaks to a `Target`; a `Chip` is the usual one. Its subclasses (`firmware_emulator.chips`) define the effect
of reading and writing each register, and its time. Times are integer nanoseconds of the emulated clock.
"""

from __future__ import annotations

from types import ModuleType
from typing import ClassVar, Protocol

from imuarray.facts.registers import Register

Triple = tuple[float, float, float]
NEVER_NS = 1 << 62
"""Later than every time of the emulated clock."""


class Target(Protocol):
    """A device as it acts on the two wires of the bus."""

    address: int

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Receive `data`, whose first byte is complete at `at_ns` and every further one `byte_ns` later; return the
        number of acknowledged bytes.
        """

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Send `count` bytes, the first of which is fetched at `at_ns` and every further one `byte_ns` later."""

    def stop(self, at_ns: int) -> None:
        """Note the STOP that ends a transaction in which this device was addressed."""


class TargetProxy:
    """A device in front of another one; it passes everything on that a subclass does not override."""

    def __init__(self, device: Target) -> None:
        self.device = device

    @property
    def address(self) -> int:
        """The address of the other device."""
        return self.device.address

    @address.setter
    def address(self, value: int) -> None:
        self.device.address = value

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """See `Target`."""
        return self.device.write(data, at_ns, byte_ns)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """See `Target`."""
        return self.device.read(count, at_ns, byte_ns)

    def stop(self, at_ns: int) -> None:
        """See `Target`."""
        self.device.stop(at_ns)


class Element(Protocol):
    """The sensing element in front of a chip's converter: its response to the world, including its imperfections."""

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        """Return the input of the converter along the sensor's x, y, z at `at_ns`, in the data sheet's unit (g, dps,
        gauss), including noise.

        `full_scale` (same unit) and `bandwidth_hz` are the settings in force: noise depends on them.
        """

    def temperature(self, at_ns: int) -> float:
        """Return the temperature of the chip in degC."""

    def pressure(self, at_ns: int) -> float:
        """Return the air pressure in Pa."""


def registers_of(facts: ModuleType, bank: int = 0) -> dict[int, Register]:
    """Return every register that a module of facts declares in this bank, by address."""
    return {fact.address: fact for fact in vars(facts).values() if isinstance(fact, Register) and fact.bank == bank}


class Chip:
    """A page of 256 bytes behind a pointer that increments after each byte; unmapped registers read 0 and store nothing
    (DEC-01). `table` has its registers.
    """

    table: ClassVar[ModuleType]
    who_am_i: ClassVar[Register | None] = None
    """The register that identifies the chip, of a chip whose content of this register can be chosen."""

    def __init__(self, address: int, element: Element, powered_on_ns: int = 0, *, identity: int | None = None) -> None:
        """Create the chip; `identity` is the content of `who_am_i` (None: that of the data sheet)."""
        self.address = address
        self.element = element
        self.registers = registers_of(self.table)
        self._identity = identity
        self.page = bytearray(256)
        self.pointer = 0
        self.power_on(powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Set the state after the supply was switched on at `at_ns`: reset values in every register, pointer at 0."""
        self.powered_on_ns = at_ns
        self.page[:] = bytes(256)
        self.pointer = 0
        for address, register in self.registers.items():
            self.page[address] = register.reset
        if self.who_am_i is not None and self._identity is not None:
            self.page[self.who_am_i.address] = self._identity

    def reset(self, at_ns: int) -> None:
        """Power on again within a transaction: the pointer stays."""
        pointer = self.pointer
        self.power_on(at_ns)
        self.pointer = pointer

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Set the pointer to the first byte; store the others one after the other. Every byte is acknowledged."""
        if data:
            self.pointer = data[0]
        count = len(data)
        if count > 1:
            for index in range(1, count):
                self.store(self.pointer, data[index], at_ns + index * byte_ns)
                self.pointer = self.advance(self.pointer, reading=False)
        return count

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Return `count` bytes from the pointer on, each with its value at the instant at which it is fetched."""
        if count == 1:  # a setting that is read back
            pointer = self.pointer
            value = self.load(pointer, at_ns)
            self.pointer = self.advance(pointer, True)
            return bytes((value,))
        answer = []
        for _ in range(count):
            pointer = self.pointer
            answer.append(self.load(pointer, at_ns))
            self.pointer = self.advance(pointer, True)
            at_ns += byte_ns
        return bytes(answer)

    def stop(self, at_ns: int) -> None:
        """Do nothing at STOP, unless a chip overrides this."""

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the pointer after a byte: the next register (the pointer survives STOP, DEC-03)."""
        return pointer + 1 & 0xFF

    def load(self, address: int, at_ns: int) -> int:
        """Return the byte that a read of register `address` fetches at `at_ns`."""
        return self.page[address]

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Store a byte written to register `address` if the register exists and can be written; ignore it otherwise."""
        register = self.registers.get(address)
        if register is not None and register.access != "r":
            self.page[address] = value & ~register.reserved & 0xFF
