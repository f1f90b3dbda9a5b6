"""A USB adapter that Linux drives with its own module i2c-tiny-usb, on the emulated wire.

The commands are those of drivers/i2c/busses/i2c-tiny-usb.c; where that file leaves something open, the device does
as the adapter's published firmware (Till Harbaum, 2006). Descriptors: USB 2.0, 9.6. What we decided ourselves:

* A data byte that is not acknowledged gives the same status as an address; the firmware says nothing of it, and Linux
  would take the write for done.
* BEGIN on a bus that was never released sends the missing STOP first.
* The delay that Linux sets (10 us, about 50 kHz on the real adapter) is kept but not obeyed: the wire's bit rate holds.
"""

from __future__ import annotations

import struct

from firmware_emulator.usbip import Identity, Setup
from firmware_emulator.wire import Wire

ECHO, GET_FUNCTIONALITY, SET_DELAY, GET_STATUS, I2C_IO = 0, 1, 2, 3, 4
BEGIN, END = 1, 2
COMMANDS_OF_IO = (I2C_IO, I2C_IO | BEGIN, I2C_IO | END, I2C_IO | BEGIN | END)
READ = 0x0001
"""I2C_M_RD; the other message flags are not looked at, none of them is advertised."""
IDLE, ACKNOWLEDGED, NOT_ACKNOWLEDGED = 0, 1, 2
FUNCTIONALITY = 0x0EFF0009
"""I2C_FUNC_I2C | I2C_FUNC_SMBUS_EMUL."""

DIRECTION_IN, KIND = 0x80, 0x60
STANDARD, CLASS, VENDOR = 0x00, 0x20, 0x40
IDENTITY = Identity(0x0403, 0xC631, 0x0201, (0xFF, 0, 0), (0xFF, 0, 0))
DEVICE_DESCRIPTOR = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0110, 0xFF, 0, 0, 64, *IDENTITY[:3], 1, 2, 3, 1)
CONFIGURATION_DESCRIPTOR = struct.pack("<BBHBBBBB", 9, 2, 18, 1, 1, 0, 0x80, 50)  # bus powered, 100 mA
INTERFACE_DESCRIPTOR = bytes([9, 4, 0, 0, 0, 0xFF, 0, 0, 0])
LANGUAGES = b"\x04\x03\x09\x04"  # English (United States)
LONGEST_STRING = 252


class TinyUsb:
    """The adapter: `control` is its endpoint 0. `title` is its serial number, so that several can be told apart."""

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
        """One control transfer; None stalls (see `UsbDevice.control`)."""
        kind = setup.request_type & KIND
        if kind == STANDARD:
            return self._standard(setup)
        # Linux sends its commands as vendor requests, programs from the adapter's own distribution as class requests.
        return self._adapter(setup, data) if kind in (CLASS, VENDOR) else None

    def reset(self) -> None:
        """Release the bus."""
        self._finish()
        self.status, self.configuration = IDLE, 0

    def _standard(self, setup: Setup) -> bytes | None:
        """USB 2.0, table 9-3: neither remote wake-up nor a halted endpoint exists, so that no feature can be set."""
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
        """One I2C message. The host asks for the status afterwards: not acknowledged, it reads zeros (the firmware)."""
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
        """STOP, and wait until a real bus would be free: the next transaction must not begin before this one is over.

        START or repeated START takes less than one clock, STOP and the pause after it less than two (BUS-06).
        """
        if not self._busy:
            return
        self._busy = False
        self.wire.stop()
        clocks = self.wire.scl_clocks - self._begun_clocks + self._messages + 2
        self.wire.clock.sleep_until(self._begun_ns + clocks * 10**9 // self.wire.bit_rate_hz)


def string_descriptor(text: str) -> bytes:
    """USB 2.0, 9.6.7: length, type 3, UTF-16LE; cut where the length byte ends."""
    encoded = text.encode("utf-16-le", "replace")[:LONGEST_STRING]
    return bytes([2 + len(encoded), 3]) + encoded
