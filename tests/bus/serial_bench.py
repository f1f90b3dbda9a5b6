"""An emulated microcontroller on the bench, without a port: its clock runs whenever the host's program waits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from firmware_emulator.array import EmulatedBus
from firmware_emulator.microcontroller_bus import MicrocontrollerBus
from firmware_emulator.serial_firmware import Firmware
from imuarray.array import ArrayConfig
from imuarray.bus import open_bus
from imuarray.bus.serial_bus import SerialBus

READ_NS = 20_000_000


class Tapped(NamedTuple):
    """One transaction of the microcontroller: its start time, its bytes, its answer (None: nobody)."""

    at_ns: int
    address: int
    write: bytes
    answer: bytes | None


class Bench:
    """The microcontroller, and the host's clock (`now_ns`, `sleep_until`).

    `delivered` may change each piece that is sent; `fails(call)` makes a transaction reach no chip; `answered` may
    change what comes back.
    """

    def __init__(self, array: ArrayConfig, url: str = "", **firmware: Any) -> None:
        emulated = open_bus(f"emulated:?{url}", array)
        if not isinstance(emulated, EmulatedBus):
            raise TypeError(url)
        self.emulated = emulated
        self.clock: Any = self.emulated.clock
        self.buses = MicrocontrollerBus(self.emulated)
        self.set_select = self.buses.set_select
        self.taps: list[Tapped] = []
        self.fails: Callable[[int, bytes], bool] = lambda address, write: False
        self.answered: Callable[[int, bytes, bytes], bytes] = lambda address, write, answer: answer
        self.delivered: Callable[[bytes], bytes] = lambda piece: piece
        self.heard: Callable[[bytes], bytes] = lambda piece: piece
        self.unplugged = False
        self.handles: list[Handle] = []
        self.firmware = Firmware(self, self.clock, **firmware)
        self.sent = bytearray()

    def bus(self) -> SerialBus:
        """The host's end."""
        return SerialBus(self.open, self, patience_s=0.5)

    def open(self) -> Handle:
        """Plug in."""
        if self.unplugged:
            raise FileNotFoundError(2, "No such file or directory")
        self.sent.clear()
        self.handles.append(Handle(self))
        return self.handles[-1]

    def unplug(self) -> None:
        """Open handles fail from then on."""
        self.unplugged = True
        for handle in self.handles:
            handle.dead = True

    # The wire of the microcontroller

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        begun_ns = self.clock.now_ns()
        answer = None
        try:
            if self.fails(address, write):
                self.clock.advance(30_000)
                raise OSError(121, "nobody")
            answer = self.answered(address, write, self.buses.transfer(address, write, read))
        finally:
            self.taps.append(Tapped(begun_ns, address, write, answer))
        return answer

    # The clock of the host

    def now_ns(self) -> int:
        now: int = self.clock.now_ns()
        return now

    def sleep_until(self, at_ns: int) -> None:
        while self.firmware.due_ns is not None and self.firmware.due_ns <= at_ns:
            self.clock.sleep_until(self.firmware.due_ns)
            for piece in self.firmware.tick():
                self.sent += self.delivered(piece)
        self.clock.sleep_until(at_ns)


class Handle:
    """The port, opened once."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.dead = self.closed = False

    @property
    def in_waiting(self) -> int:
        return len(self.bench.sent)

    def read(self, size: int = 1, /) -> bytes:
        self.check()
        bench, until_ns = self.bench, self.bench.now_ns() + READ_NS
        while not bench.sent and bench.now_ns() < until_ns:
            due_ns = bench.firmware.due_ns
            bench.sleep_until(until_ns if due_ns is None else min(due_ns, until_ns))
        data = bytes(bench.sent[:size])
        del bench.sent[:size]
        return data

    def write(self, data: bytes, /) -> int:
        self.check()
        bench = self.bench
        bench.sent += bench.delivered(bench.firmware.feed(bench.heard(data)))
        return len(data)

    def check(self) -> None:
        if self.dead or self.closed:
            raise OSError(5, "Input/output error")

    def close(self) -> None:
        self.closed = True
