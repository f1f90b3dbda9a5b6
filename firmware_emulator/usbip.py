"""The server's side of USB/IP 1.1.1 as a protocol without I/O: it takes received bytes and returns the bytes to send.

Source of every layout here: the Linux kernel's documentation, "USB/IP protocol" (usbip_protocol). All numbers of the
protocol are big-endian, those inside a setup packet little-endian (USB 2.0, 9.3). Only endpoint 0 exists, so that a
transfer is at most 65535 bytes long (wLength) and is answered before the next frame is processed.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

VERSION = 0x0111
REQUEST_DEVICES, REPLY_DEVICES = 0x8005, 0x0005
REQUEST_IMPORT, REPLY_IMPORT = 0x8003, 0x0003
SUBMIT, UNLINK, RETURN_SUBMIT, RETURN_UNLINK = 1, 2, 3, 4
OUT, IN = 0, 1
REFUSED = 1
STALL = -32
"""-EPIPE: the error of Linux when an endpoint refuses a request."""
FULL_SPEED = 2
MAX_TRANSFER = 0xFFFF

OPERATION = struct.Struct(">HHI")
IMPORT = struct.Struct(">HHI32s")
DEVICE = struct.Struct(">256s32sIIIHHH6B")
BASIC = struct.Struct(">5I")
COMMAND_SUBMIT = struct.Struct(">20x5I8s")
ANSWER_SUBMIT = struct.Struct(">5Ii4I8x")
ANSWER_UNLINK = struct.Struct(">5Ii24x")
SETUP = struct.Struct("<BBHHH")


class ProtocolError(Exception):
    """A frame after which the connection can only be closed; one line that states the frame and what is allowed."""


@dataclass(frozen=True)
class Setup:
    """The eight bytes that begin a control transfer."""

    request_type: int
    request: int
    value: int
    index: int
    length: int


class UsbIdentity(NamedTuple):
    """An entry in a list of devices; class triplets are (class, subclass, protocol)."""

    vendor: int
    product: int
    release: int
    device_class: tuple[int, int, int]
    interface_class: tuple[int, int, int]


class UsbDevice(Protocol):
    """A device with one configuration, one interface and endpoint 0."""

    identity: UsbIdentity

    def control(self, setup: Setup, data: bytes) -> bytes | None:
        """Carry out one control transfer: `data` goes to the device, the returned bytes go to the host; None stalls the
        transfer.
        """

    def reset(self) -> None:
        """Note that the client has disconnected, perhaps in the middle of a frame."""


class Export:
    """A device at a port of bus 1, for one client at a time."""

    def __init__(self, port: int, device: UsbDevice) -> None:
        self.device = device
        self.busid = f"1-{port}"
        self.devid = 1 << 16 | port
        self.taken = False

    def description(self) -> bytes:
        """Return the 312 bytes that describe it in both kinds of reply."""
        identity = self.device.identity
        path = f"/sys/devices/platform/imuarray/usb1/{self.busid}"
        place = self.devid >> 16, self.devid & 0xFFFF, FULL_SPEED
        return DEVICE.pack(path.encode(), self.busid.encode(), *place, *identity[:3], *identity.device_class, 1, 1, 1)

    def interfaces(self) -> bytes:
        """Return class, subclass and protocol of the only interface, and a byte of padding."""
        return bytes([*self.device.identity.interface_class, 0])


class Conversation:
    """One connection. `over` is True if the server should close it; `imported` is this client's port, if any."""

    def __init__(self, exports: Sequence[Export]) -> None:
        self.exports = exports
        self.imported: Export | None = None
        self.over = False
        self._pending = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the answer to every frame that `data` completes; each one is computed when it is requested.

        ProtocolError for a frame that no client sends; no memory is reserved for a length that is out of bounds.
        """
        self._pending += data
        while not self.over and (answer := self._answer()) is not None:
            yield answer

    def close(self) -> None:
        """Note that the connection is closed: others may import the device."""
        self.over = True
        if self.imported is not None:
            self.imported.device.reset()
            self.imported.taken = False
            self.imported = None

    def _answer(self) -> bytes | None:
        """Return the answer to the first pending frame; None while that is incomplete."""
        return self._operation() if self.imported is None else self._command(self.imported)

    def _take(self, count: int) -> bytes | None:
        if len(self._pending) < count:
            return None
        frame = bytes(self._pending[:count])
        del self._pending[:count]
        return frame

    def _operation(self) -> bytes | None:
        if len(self._pending) < OPERATION.size:
            return None
        version, code, _ = OPERATION.unpack_from(self._pending)
        if version != VERSION:
            raise ProtocolError(f"version {version:#06x}; allowed is {VERSION:#06x}")
        if code == REQUEST_DEVICES:
            return self._list_devices()
        if code == REQUEST_IMPORT:
            frame = self._take(IMPORT.size)
            return None if frame is None else self._import(IMPORT.unpack(frame)[3])
        raise ProtocolError(f"operation {code:#06x}; allowed are {REQUEST_DEVICES:#06x} and {REQUEST_IMPORT:#06x}")

    def _list_devices(self) -> bytes:
        self.over = True
        records = b"".join(export.description() + export.interfaces() for export in self.exports)
        return OPERATION.pack(VERSION, REPLY_DEVICES, 0) + struct.pack(">I", len(self.exports)) + records

    def _import(self, busid: bytes) -> bytes:
        name = busid.split(b"\0", 1)[0]
        for export in self.exports:
            if export.busid.encode() == name and not export.taken:
                export.taken = True
                self.imported = export
                return OPERATION.pack(VERSION, REPLY_IMPORT, 0) + export.description()
        self.over = True
        return OPERATION.pack(VERSION, REPLY_IMPORT, REFUSED)

    def _command(self, export: Export) -> bytes | None:
        if len(self._pending) < ANSWER_SUBMIT.size:
            return None
        command, seqnum, devid, direction, endpoint = BASIC.unpack_from(self._pending)
        if devid != export.devid:
            raise ProtocolError(f"device {devid:#x}; imported was {export.devid:#x}")
        if command == SUBMIT:
            return self._submit(export.device, seqnum, direction, endpoint)
        if command == UNLINK:
            self._take(ANSWER_UNLINK.size)
            return ANSWER_UNLINK.pack(RETURN_UNLINK, seqnum, 0, 0, 0, 0)  # status 0: the request was already answered
        raise ProtocolError(f"command {command:#x}; allowed are {SUBMIT} and {UNLINK}")

    def _submit(self, device: UsbDevice, seqnum: int, direction: int, endpoint: int) -> bytes | None:
        _, length, start_frame, packets, _, packed = COMMAND_SUBMIT.unpack_from(self._pending)
        setup = Setup(*SETUP.unpack(packed))
        if direction not in (OUT, IN) or length > MAX_TRANSFER:
            raise ProtocolError(f"direction {direction}, {length} bytes; allowed are 0 and 1, {MAX_TRANSFER} bytes")
        if endpoint == 0 and (setup.length != length or (length and setup.request_type >> 7 != direction)):
            raise ProtocolError(f"a buffer of {length} bytes, direction {direction}, does not fit {setup}")
        frame = self._take(ANSWER_SUBMIT.size + (length if direction == OUT else 0))
        if frame is None:
            return None
        answer = None if endpoint else device.control(setup, frame[ANSWER_SUBMIT.size :])
        status, received = (STALL, b"") if answer is None else (0, answer[:length] if direction == IN else b"")
        actual = length if direction == OUT and answer is not None else len(received)
        # The number of packets has no meaning here; the document requires 0xffffffff, Linux sends 0: send it back.
        head = ANSWER_SUBMIT.pack(RETURN_SUBMIT, seqnum, 0, 0, 0, status, actual, start_frame, packets, 0)
        return head + received
