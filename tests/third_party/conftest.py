"""Perfect chips on an emulated wire, and the environment that other people's drivers expect.

The drivers come from the package index and run unmodified. Their chips are ideal units: any error of a reading is one
of the driver.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from types import ModuleType
from typing import Any, NamedTuple

import pytest
import smbus2

from firmware_emulator.chip import Chip
from firmware_emulator.chips import CHIPS
from firmware_emulator.clock import RealClock, VirtualClock
from firmware_emulator.device_file import Adapter, device_files
from firmware_emulator.element import IDENTITY, SensingElement, UnitDeviations
from firmware_emulator.wire import Wire
from firmware_emulator.world import WorldStimulus


class Board(NamedTuple):
    """One chip on one wire; `stimulus` is its input."""

    wire: Wire
    chip: Chip
    stimulus: list[WorldStimulus]

    def feel(self, stimulus: WorldStimulus, settle_ns: int = 100_000_000) -> None:
        """Change the world and let the chip see it."""
        self.stimulus[0] = stimulus
        self.wire.clock.sleep_until(self.wire.clock.now_ns() + settle_ns)

    def sleep(self, seconds: float) -> None:
        """The replacement of a driver's sleep: it advances the clock of the chip."""
        self.wire.clock.sleep_until(self.wire.clock.now_ns() + round(1e9 * seconds))


def board_with(chip: str, address: int, clock: VirtualClock | RealClock | None = None) -> Board:
    """An ideal, noiseless `chip` that was powered up a second ago."""
    stimulus = [WorldStimulus()]
    clock = clock or VirtualClock(10**9)
    wire = Wire(clock)
    element = SensingElement(lambda at_ns: stimulus[0], chip, "A", IDENTITY, UnitDeviations())
    soldered = CHIPS[chip](address, element, clock.now_ns() - 10**9)
    wire.connect(soldered)
    return Board(wire, soldered, stimulus)


@pytest.fixture
def boards() -> Any:
    """`board_with`."""
    return board_with


@pytest.fixture
def serve() -> Iterator[Any]:
    """A function that serves a board as /dev/i2c-1, by an adapter as particular as the Raspberry Pi's."""
    with ExitStack() as stack:

        def as_device(board: Board) -> None:
            stack.enter_context(device_files({"/dev/i2c-1": Adapter(board.wire, "bcm2835")}))

        yield as_device


@pytest.fixture
def smbus(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The C extension smbus, of which smbus2 is a replacement."""
    monkeypatch.setitem(sys.modules, "smbus", smbus2)
    return smbus2


class I2C:
    """CircuitPython's busio.I2C over a wire; a write and a read are two transactions, as that interface has it."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.locked = False

    def try_lock(self) -> bool:
        if self.locked:
            return False
        self.locked = True
        return True

    def unlock(self) -> None:
        self.locked = False

    def writeto(self, address: int, buffer: bytes, *, start: int = 0, end: int | None = None) -> None:
        self.wire.transfer(address, bytes(buffer[start:end]))

    def readfrom_into(self, address: int, buffer: bytearray, *, start: int = 0, end: int | None = None) -> None:
        wanted = len(buffer[start:end])
        buffer[start : start + wanted] = self.wire.transfer(address, read=wanted)

    def writeto_then_readfrom(
        self,
        address: int,
        out_buffer: bytes,
        in_buffer: bytearray,
        *,
        out_start: int = 0,
        out_end: int | None = None,
        in_start: int = 0,
        in_end: int | None = None,
    ) -> None:
        wanted = len(in_buffer[in_start:in_end])
        answer = self.wire.transfer(address, bytes(out_buffer[out_start:out_end]), wanted)
        in_buffer[in_start : in_start + wanted] = answer


@pytest.fixture
def busio(monkeypatch: pytest.MonkeyPatch) -> type[I2C]:
    """The part of CircuitPython that its drivers import, so that its whole layer for hardware is not needed."""
    offered = {
        "busio": {"I2C": I2C, "SPI": Any},
        "digitalio": {"DigitalInOut": Any},
        "micropython": {"const": lambda value: value},
        "circuitpython_typing": {"ReadableBuffer": Any, "WriteableBuffer": Any},
        "circuitpython_typing.device_drivers": {"I2CDeviceDriver": Any},
    }
    for name, names in offered.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    return I2C
