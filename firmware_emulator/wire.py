"""The two wires of one adapter: the devices that answer, the bytes that they send, and the duration of a transaction.

A transaction is START, one or more messages joined by repeated STARTs (`send`, `receive`), STOP (`stop`); `transfer` is
the usual transaction, which writes a register address and reads bytes. Every byte takes 9 clocks (BUS-01); START,
repeated START and STOP take their minimum times (BUS-05, BUS-06). SDA and SCL are open-drain: if several devices
answer, a 0 from any of them is read (DEC-02).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import reduce
from operator import and_
from typing import NamedTuple, NoReturn, Protocol

from firmware_emulator.chip import Target
from firmware_emulator.clock import WireClock


class Router(Target, Protocol):
    """A device that connects others to the trunk; `route` is the connected channel and changes only in `stop`."""

    route: int

    def branch(self) -> Sequence[Target]:
        """Return the devices that are joined to the trunk now."""


class Overhead(NamedTuple):
    """Nanoseconds outside the data clocks: after START, around a repeated START, around STOP (BUS-06)."""

    start_ns: int
    repeated_start_ns: int
    stop_ns: int


STANDARD_MODE = Overhead(start_ns=4000, repeated_start_ns=4700 + 4000, stop_ns=4000 + 4700)
FAST_MODE = Overhead(start_ns=600, repeated_start_ns=600 + 600, stop_ns=600 + 1300)
STANDARD_MODE_MAX_HZ = 100_000

Responders = dict[int, tuple[Target, ...]]
Interference = Callable[["Wire", Sequence[Target]], None]
"""Function called at every START with the wire and the addressed devices; may raise OSError or advance the time."""


class Wire:
    """One adapter and the devices that are connected to it. An address that no device acknowledges raises
    OSError(`nack_errno`) after a STOP.

    `host_ns` is software time before every START. `scl_clocks` and `transactions` count the traffic.
    """

    def __init__(self, clock: WireClock, bit_rate_hz: int = 400_000, nack_errno: int = 121, host_ns: int = 0) -> None:
        if bit_rate_hz <= 0:
            raise ValueError(f"bit_rate_hz: {bit_rate_hz} is not a speed")
        self.clock = clock
        self.bit_rate_hz = bit_rate_hz
        self.nack_errno = nack_errno
        self.scl_clocks = 0
        self.transactions = 0
        self._byte_ns = round(9e9 / bit_rate_hz)
        overhead = STANDARD_MODE if bit_rate_hz <= STANDARD_MODE_MAX_HZ else FAST_MODE
        self._repeated_start_ns, self._stop_ns = overhead.repeated_start_ns, overhead.stop_ns
        self._trunk: list[Target] = []
        self._routers: list[Router] = []
        self._by_routes: dict[tuple[int, ...], Responders] = {}
        self._responders: Responders = {}
        self._router_addresses: set[int] = set()
        self.host_ns = host_ns
        self._start_ns = host_ns + overhead.start_ns
        self._open = False
        self._begun_ns = 0
        self._at_ns = 0  # within a transaction the wire counts its own time; the clock is advanced at STOP
        self._addressed: Responders = {}
        self.interference: Interference | None = None

    def delay(self) -> None:
        """Advance by the latency of the program before a transaction: none, unless overridden."""

    def connect(self, *devices: Target) -> None:
        """Connect devices to the trunk."""
        self._trunk += devices
        self.reroute()

    def connect_router(self, router: Router) -> None:
        """Connect a multiplexer to the trunk."""
        self._routers.append(router)
        self._router_addresses.add(router.address)
        self.connect(router)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Transfer START, `write`, repeated START, `read` bytes, STOP; with neither, only the address, which tests for
        an acknowledge.

        OSError(`nack_errno`) if address or data are not acknowledged, ValueError for a transfer that no adapter can
        send.
        """
        if self.interference is not None:
            self._interfere(address)
        responders = self._responders.get(address, ())
        if len(responders) != 1 or self._open or not write or read < 0:
            return self._transfer_by_messages(address, write, read)
        # A faster path for the usual case, four times a sample and chip: one device, a register address, and bytes.
        device, byte_ns, count = responders[0], self._byte_ns, len(write)
        begun_ns = self.clock.now_ns()
        at_ns = begun_ns + self._start_ns + byte_ns
        acknowledged = device.write(write, at_ns + byte_ns, byte_ns)
        if acknowledged < count:
            self._resume(address, begun_ns, at_ns)
            self._bytes(acknowledged + 1)
            self._give_up(address)
        at_ns += count * byte_ns
        received = b""
        if read:
            at_ns += self._repeated_start_ns + byte_ns
            received = device.read(read, at_ns, byte_ns)
            at_ns += read * byte_ns
            count += 1 + read
        self.scl_clocks += 9 + 9 * count
        self.transactions += 1
        device.stop(at_ns)
        self.clock.advance(at_ns + self._stop_ns - begun_ns)
        if device.address != address:
            self.reroute()
        elif address in self._router_addresses:
            self._follow_routes()
        return received

    def send(self, address: int, data: bytes) -> None:
        """Send a writing message: (repeated) START, address, `data`. OSError, after a STOP, if it is unacknowledged."""
        self._interfere(address)
        self._send(address, data)

    def _send(self, address: int, data: bytes) -> None:
        responders = self._address(address)
        first_ns, byte_ns, count = self._at_ns + self._byte_ns, self._byte_ns, len(data)
        acknowledged = max([device.write(data, first_ns, byte_ns) for device in responders])
        if acknowledged < count:
            self._bytes(acknowledged + 1)
            self._give_up(address)
        self._bytes(count)

    def receive(self, address: int, count: int) -> bytes:
        """Send one reading message: (repeated) START, address, `count` bytes. OSError, after a STOP, if no chip
        acknowledges.
        """
        self._interfere(address)
        return self._receive(address, count)

    def _receive(self, address: int, count: int) -> bytes:
        responders = self._address(address)
        begun_ns, byte_ns = self._at_ns, self._byte_ns
        answers = [device.read(count, begun_ns, byte_ns) for device in responders]
        self._bytes(count)
        if len(answers) == 1:
            return answers[0]
        return bytes([reduce(and_, column) for column in zip(*answers, strict=True)])

    def stop(self) -> None:
        """Send a STOP: every addressed device receives it; an addressed multiplexer switches. No
        effect on a free bus.
        """
        if not self._open:
            return
        self._open = False
        self.transactions += 1
        at_ns, moved = self._at_ns, False
        for address, responders in self._addressed.items():
            for device in responders:
                device.stop(at_ns)
                moved |= device.address != address
        self.clock.advance(at_ns + self._stop_ns - self._begun_ns)
        if moved:
            self.reroute()
        elif not self._router_addresses.isdisjoint(self._addressed):
            self._follow_routes()
        self._addressed.clear()

    def reroute(self) -> None:
        """Update the addresses; this is necessary if a device was switched off and on outside a transaction."""
        self._by_routes.clear()
        self._follow_routes()

    def _transfer_by_messages(self, address: int, write: bytes, read: int) -> bytes:
        if read < 0 or not 0 <= address <= 0x7F:
            raise ValueError(f"transfer({address:#x}, read={read}): allowed are addresses of 7 bits and counts from 0")
        if write or not read:
            self._send(address, write)
        received = self._receive(address, read) if read else b""
        self.stop()
        return received

    def _resume(self, address: int, begun_ns: int, at_ns: int) -> None:
        """Continue a transaction that messages began at `begun_ns`, after the acknowledge of the address at `at_ns`."""
        self._open = True
        self._begun_ns, self._at_ns = begun_ns, at_ns
        self._addressed[address] = self._responders[address]
        self.scl_clocks += 9

    def _interfere(self, address: int) -> None:
        if self.interference is not None and not self._open:
            self.interference(self, self._responders.get(address, ()))

    def _address(self, address: int) -> tuple[Target, ...]:
        """Send a (repeated) START and the address; return the devices that answer."""
        if self._open:
            self._at_ns += self._repeated_start_ns
        else:
            self._open = True
            self._begun_ns = self.clock.now_ns()
            self._at_ns = self._begun_ns + self._start_ns
        self.scl_clocks += 9
        self._at_ns += self._byte_ns
        responders = self._responders.get(address)
        if responders is None:
            self._give_up(address)
        self._addressed[address] = responders
        return responders

    def _bytes(self, count: int) -> None:
        self.scl_clocks += 9 * count
        self._at_ns += count * self._byte_ns

    def _give_up(self, address: int) -> NoReturn:
        self.stop()
        raise OSError(self.nack_errno, f"{os.strerror(self.nack_errno)}: no acknowledge from {address:#04x}")

    def _follow_routes(self) -> None:
        routes = tuple([router.route for router in self._routers])
        responders = self._by_routes.get(routes)
        if responders is None:
            responders = self._by_routes[routes] = self._reachable()
        self._responders = responders

    def _reachable(self) -> Responders:
        responders: Responders = {}
        for device in (*self._trunk, *(device for router in self._routers for device in router.branch())):
            responders[device.address] = (*responders.get(device.address, ()), device)
        return responders
