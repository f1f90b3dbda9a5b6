"""Serves the emulated array on a TCP port to Linux's USB/IP client, with one USB I2C adapter for each bus.

USB/IP has neither passwords nor encryption: any program that reaches the port can use the bus. One thread serves all
clients, so that two requests never use the wire at the same time.

`TinyUsb` is an adapter that Linux drives with its own module i2c-tiny-usb. The commands are those of
drivers/i2c/busses/i2c-tiny-usb.c; behaviour that this file does not determine is that of the adapter's published
firmware (Till Harbaum, 2006). Descriptors: USB 2.0, 9.6. Decisions of our own:

* A data byte that is not acknowledged gives the same status as an address that is not acknowledged. The firmware does
  not report it, and Linux would consider the write successful.
* BEGIN on a bus that was never released sends the missing STOP first.
* The delay that Linux sets (10 us, about 50 kHz on the real adapter) is stored but has no effect; the wire's bit rate
  applies.
"""

from __future__ import annotations

import selectors
import socket
import struct
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Self

from firmware_emulator.usbip import Conversation, Export, ProtocolError, Setup, UsbIdentity
from firmware_emulator.wire import Wire

ECHO, GET_FUNCTIONALITY, SET_DELAY, GET_STATUS, I2C_IO = 0, 1, 2, 3, 4
BEGIN, END = 1, 2
COMMANDS_OF_IO = (I2C_IO, I2C_IO | BEGIN, I2C_IO | END, I2C_IO | BEGIN | END)
READ = 0x0001
"""I2C_M_RD; the other message flags are ignored, because the device does not advertise them."""
IDLE, ACKNOWLEDGED, NOT_ACKNOWLEDGED = 0, 1, 2
FUNCTIONALITY = 0x0EFF0009
"""I2C_FUNC_I2C | I2C_FUNC_SMBUS_EMUL."""

DIRECTION_IN, KIND = 0x80, 0x60
STANDARD, CLASS, VENDOR = 0x00, 0x20, 0x40
IDENTITY = UsbIdentity(0x0403, 0xC631, 0x0201, (0xFF, 0, 0), (0xFF, 0, 0))
DEVICE_DESCRIPTOR = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0110, 0xFF, 0, 0, 64, *IDENTITY[:3], 1, 2, 3, 1)
CONFIGURATION_DESCRIPTOR = struct.pack("<BBHBBBBB", 9, 2, 18, 1, 1, 0, 0x80, 50)  # bus powered, 100 mA
INTERFACE_DESCRIPTOR = bytes([9, 4, 0, 0, 0, 0xFF, 0, 0, 0])
LANGUAGES = b"\x04\x03\x09\x04"  # English (United States)
LONGEST_STRING = 252


class TinyUsb:
    """The adapter: `control` is its endpoint 0. `title` is its serial number, which distinguishes several adapters."""

    identity = IDENTITY

    def __init__(self, wire: Wire, title: str) -> None:
        self.wire = wire
        self.status = IDLE
        self.delay_us = 0
        self.configuration = 0
        self._strings = (LANGUAGES, *(string_descriptor(text) for text in ("imuarray", "i2c-tiny-usb", title)))
        self._busy = False
        self._begun_ns = self._begun_clocks = self._messages = 0

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        """Carry out one control transfer; None stalls (see `UsbDevice.control`)."""
        kind = setup.request_type & KIND
        if kind == STANDARD:
            return self._standard(setup)
        # Linux sends commands as vendor requests, programs of the adapter's own distribution as class requests.
        return self._adapter(setup, data) if kind in (CLASS, VENDOR) else None

    def reset(self) -> None:
        """Release the bus."""
        self._finish()
        self.status, self.configuration = IDLE, 0

    def _standard(self, setup: Setup) -> bytes | None:
        """Answer a standard request (USB 2.0, table 9-3): remote wake-up and halted endpoints do not exist, so no
        feature can be set.
        """
        match setup.request_type >> 7, setup.request:
            case 1, 0 | 10:  # GET_STATUS, GET_INTERFACE
                return b"\0\0"
            case 0, 1 | 5 | 11:  # CLEAR_FEATURE, SET_ADDRESS, SET_INTERFACE
                return b""
            case 1, 6:  # GET_DESCRIPTOR
                return self._descriptor(setup.value >> 8, setup.value & 0xFF)
            case 1, 8:  # GET_CONFIGURATION
                return bytes([self.configuration])
            case 0, 9 if setup.value in (0, 1):  # SET_CONFIGURATION
                self.configuration = setup.value
                return b""
        return None

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if (kind, index) == (1, 0):
            return DEVICE_DESCRIPTOR
        if (kind, index) == (2, 0):
            return CONFIGURATION_DESCRIPTOR + INTERFACE_DESCRIPTOR
        return self._strings[index] if kind == 3 and index < len(self._strings) else None

    def _adapter(self, setup: Setup, data: bytes) -> bytes | None:
        inwards = bool(setup.request_type & DIRECTION_IN)
        if setup.request in COMMANDS_OF_IO:
            return self._message(setup, data) if bool(setup.value & READ) == inwards else None
        if inwards:
            return self._report(setup)
        if setup.request == SET_DELAY:
            self.delay_us = setup.value
            return b""
        return None

    def _report(self, setup: Setup) -> bytes | None:
        if setup.request == ECHO:
            return struct.pack("<H", setup.value)
        if setup.request == GET_FUNCTIONALITY:
            return struct.pack("<I", FUNCTIONALITY)
        return bytes([self.status]) if setup.request == GET_STATUS else None

    def _message(self, setup: Setup, data: bytes) -> bytes | None:
        """Transfer one I2C message. The host reads the status afterwards; data are zeros without an acknowledge."""
        if setup.request & BEGIN:
            self._finish()
        self._start()
        answer = b""
        try:
            if setup.value & READ:
                answer = self.wire.receive(setup.index, setup.length)
            else:
                self.wire.send(setup.index, data)
        except OSError as error:
            self._finish()
            self.status = NOT_ACKNOWLEDGED
            return bytes(setup.length) if error.errno == self.wire.nack_errno else None
        self.status = ACKNOWLEDGED
        if setup.request & END:
            self._finish()
        return answer

    def _start(self) -> None:
        if not self._busy:
            self._busy = True
            self._begun_ns, self._begun_clocks, self._messages = self.wire.clock.now_ns(), self.wire.scl_clocks, 0
        self._messages += 1

    def _finish(self) -> None:
        """Send a STOP, and wait until a real bus would be free, because the next transaction must not begin earlier.

        START or repeated START takes less than one clock, STOP and the pause after it less than two (BUS-06).
        """
        if not self._busy:
            return
        self._busy = False
        self.wire.stop()
        clocks = self.wire.scl_clocks - self._begun_clocks + self._messages + 2
        self.wire.clock.sleep_until(self._begun_ns + clocks * 10**9 // self.wire.bit_rate_hz)


def string_descriptor(text: str) -> bytes:
    """Return a string descriptor (USB 2.0, 9.6.7): length, type 3, UTF-16LE; cut where the length byte ends."""
    encoded = text.encode("utf-16-le", "replace")[:LONGEST_STRING]
    return bytes([2 + len(encoded), 3]) + encoded


DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 3240
MAX_CONNECTIONS = 16
PATIENCE_S = 10.0
"""Time in s within which a client must import a device or receive the data that it requested."""
CHUNK = 65536


class Client:
    """One connection."""

    def __init__(self, connection: socket.socket, name: str, conversation: Conversation) -> None:
        self.connection = connection
        self.name = name
        self.conversation = conversation
        self.since_s = time.monotonic()

    def serve(self) -> bool:
        """Answer the requests that have arrived; return False at their end. Raises OSError or ProtocolError."""
        data = self.connection.recv(CHUNK)
        for answer in self.conversation.feed(data):
            self.connection.sendall(answer)
        return bool(data) and not self.conversation.over

    def is_overdue(self) -> bool:
        """Return whether it connected more than `PATIENCE_S` ago and has not imported a device yet."""
        return self.conversation.imported is None and time.monotonic() - self.since_s > PATIENCE_S


class UsbipServer:
    """Serves `wires` (by name of the bus, "" for the trunk) as busid 1-1, 1-2, ...; OSError if the port is not
    available.

    `title` is the name of the adapters; `log` receives one line for each event of a client.
    """

    def __init__(
        self,
        wires: Mapping[str, Wire],
        title: str,
        host: str = DEFAULT_HOST,
        port: int = DEFAULT_PORT,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        titles = [f"{title} {name}".strip() for name in wires]
        devices = [TinyUsb(wire, text) for wire, text in zip(wires.values(), titles, strict=True)]
        self.exports = tuple(Export(port, device) for port, device in enumerate(devices, 1))
        self.titles = dict(zip([export.busid for export in self.exports], titles, strict=True))
        self._log = log
        self._listener = socket.create_server((host, port), family=family_of(host))
        self._waker, self._woken = socket.socketpair()
        self._clients: list[Client] = []
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._woken, selectors.EVENT_READ)

    @property
    def address(self) -> tuple[str, int]:
        """The host and the port, which the system has chosen for port 0."""
        host, port = self._listener.getsockname()[:2]
        return host, port

    def serve_forever(self) -> None:
        """Serve until `shutdown`, which another thread may call."""
        while True:
            for key, _ in self._selector.select(PATIENCE_S / 4):
                if key.fileobj is self._woken:
                    return
                key.data()
            for client in [client for client in self._clients if client.is_overdue()]:
                self._drop(client, "sent nothing")

    def shutdown(self) -> None:
        """End `serve_forever`."""
        self._waker.send(b"\0")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for client in list(self._clients):
            self._drop(client, "")
        self._selector.close()
        for endpoint in (self._listener, self._waker, self._woken):
            endpoint.close()

    def _accept(self) -> None:
        try:
            connection, peer = self._listener.accept()
        except OSError:  # the client has closed the connection
            return
        name = f"{peer[0]}:{peer[1]}"
        if len(self._clients) >= MAX_CONNECTIONS:
            connection.close()
            self._log(f"{name}: refused, {MAX_CONNECTIONS} are connected")
            return
        connection.settimeout(PATIENCE_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        client = Client(connection, name, Conversation(self.exports))
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, partial(self._serve, client))

    def _serve(self, client: Client) -> None:
        had = client.conversation.imported
        try:
            goes_on, reason = client.serve(), ""
        except ProtocolError as error:
            goes_on, reason = False, f"not USB/IP: {error}"
        except OSError as error:
            goes_on, reason = False, str(error)
        now = client.conversation.imported
        if now is not had and now is not None:
            self._log(f"{client.name}: attached {now.busid}")
        if not goes_on:
            self._drop(client, reason or (f"detached {now.busid}" if now else ""))

    def _drop(self, client: Client, reason: str) -> None:
        self._selector.unregister(client.connection)
        self._clients.remove(client)
        client.conversation.close()
        client.connection.close()
        if reason:
            self._log(f"{client.name}: {reason}; closed")


def family_of(host: str) -> socket.AddressFamily:
    """Return the address family: IPv6 for an address with colons."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET
