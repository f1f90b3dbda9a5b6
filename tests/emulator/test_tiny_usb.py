"""The USB adapter's endpoint 0: requests as Linux sends them, and their effect on the wire."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_emulator.board import Pca9544aChip
from firmware_emulator.clock import VirtualClock
from firmware_emulator.serve import TinyUsb
from firmware_emulator.usbip import Setup
from firmware_emulator.wire import Wire

# bmRequestType: USB_TYPE_VENDOR | USB_RECIP_INTERFACE, with and without USB_DIR_IN.
VENDOR_OUT, VENDOR_IN = 0x41, 0xC1
ACK, NAK = b"\x01", b"\x02"
BOTH = 0x07  # CMD_I2C_IO | CMD_I2C_IO_BEGIN | CMD_I2C_IO_END


class Device:
    """Records writes; acknowledges `room` bytes a message and sends 0xA0, 0xA1, ..."""

    def __init__(self, address: int, room: int = 99) -> None:
        self.address = address
        self.room = room
        self.heard: list[bytes] = []
        self.stops: list[int] = []

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        self.heard.append(data)
        return min(self.room, len(data))

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        return bytes(0xA0 + index for index in range(count))

    def stop(self, at_ns: int) -> None:
        self.stops.append(at_ns)


def adapter(*devices: Device, bit_rate_hz: int = 400_000) -> TinyUsb:
    wire = Wire(VirtualClock(), bit_rate_hz)
    wire.connect(*devices)
    return TinyUsb(wire, "mine")


def status(usb: TinyUsb) -> bytes | None:
    return usb.control(Setup(VENDOR_IN, 3, 0, 0, 1), b"")


def read(usb: TinyUsb, address: int, count: int, request: int = BOTH) -> bytes | None:
    return usb.control(Setup(VENDOR_IN, request, 0x0001, address, count), b"")


def write(usb: TinyUsb, address: int, data: bytes, request: int = BOTH) -> bytes | None:
    return usb.control(Setup(VENDOR_OUT, request, 0x0000, address, len(data)), data)


def test_the_identity_is_that_expected_by_linux() -> None:
    descriptor = adapter().control(Setup(0x80, 6, 0x0100, 0, 64), b"")
    assert descriptor is not None
    assert len(descriptor) == descriptor[0] == 18
    assert struct.unpack_from("<HH", descriptor, 8) == (0x0403, 0xC631)
    assert descriptor[4] == 0xFF  # vendor specific
    assert descriptor[7] == 64  # a packet of endpoint 0: allowed at full speed
    assert descriptor[17] == 1  # one configuration


def test_the_configuration_descriptor_has_its_length_and_no_endpoint() -> None:
    descriptor = adapter().control(Setup(0x80, 6, 0x0200, 0, 255), b"")
    assert descriptor is not None
    assert descriptor[:5] == bytes([9, 2, len(descriptor), 0, 1])
    assert descriptor[9:14] == bytes([9, 4, 0, 0, 0])


def test_strings_are_returned() -> None:
    usb = adapter()
    assert usb.control(Setup(0x80, 6, 0x0300, 0, 255), b"") == bytes.fromhex("04030904")
    assert usb.control(Setup(0x80, 6, 0x0302, 0x0409, 255), b"") == b"\x1a\x03" + b"".join(
        bytes([letter, 0]) for letter in b"i2c-tiny-usb"
    )
    assert usb.control(Setup(0x80, 6, 0x0303, 0x0409, 255), b"") == b"\x0a\x03m\0i\0n\0e\0"
    assert usb.control(Setup(0x80, 6, 0x0304, 0x0409, 255), b"") is None


def test_a_long_title_fits_its_length_byte() -> None:
    descriptor = TinyUsb(Wire(VirtualClock()), "\N{GREEK SMALL LETTER OMEGA}" * 300).control(
        Setup(0x80, 6, 0x0303, 0x0409, 255), b""
    )
    assert descriptor is not None
    assert descriptor[0] == len(descriptor) <= 255


def test_standard_requests_of_an_enumeration_are_answered() -> None:
    usb = adapter()
    assert usb.control(Setup(0x00, 5, 7, 0, 0), b"") == b""
    assert usb.control(Setup(0x80, 8, 0, 0, 1), b"") == b"\0"
    assert usb.control(Setup(0x00, 9, 1, 0, 0), b"") == b""
    assert usb.control(Setup(0x80, 8, 0, 0, 1), b"") == b"\x01"
    assert usb.control(Setup(0x01, 11, 0, 0, 0), b"") == b""
    assert usb.control(Setup(0x80, 0, 0, 0, 2), b"") == b"\0\0"


@pytest.mark.parametrize(
    "setup",
    [
        Setup(0x00, 9, 2, 0, 0),  # configuration 2 does not exist
        Setup(0x00, 3, 1, 0, 0),  # SET_FEATURE remote wake-up
        Setup(0x80, 6, 0x0600, 0, 10),  # device qualifier: only for high speed
        Setup(0x80, 6, 0x0101, 0, 18),
        Setup(0x80, 12, 0, 0, 2),  # SYNCH_FRAME
        Setup(VENDOR_IN, 8, 0, 0, 1),
        Setup(VENDOR_OUT, 3, 0, 0, 0),  # GET_STATUS, outwards
        Setup(VENDOR_IN, 2, 10, 0, 0),  # SET_DELAY, inwards
        Setup(VENDOR_IN, BOTH, 0x0000, 0x53, 1),  # a writing message, inwards
        Setup(0x60, 0, 0, 0, 0),  # reserved type
    ],
)
def test_unknown_requests_stall(setup: Setup) -> None:
    assert adapter(Device(0x53)).control(setup, b"") is None


def test_echo_functionality_delay_and_status_are_answered() -> None:
    usb = adapter()
    assert usb.control(Setup(VENDOR_IN, 0, 0x1234, 0, 2), b"") == b"\x34\x12"
    quick, byte, byte_data, word_data = 0x00010000, 0x00060000, 0x00180000, 0x00600000  # uapi/linux/i2c.h
    proc_call, write_block, i2c_block, pec = 0x00800000, 0x02000000, 0x0C000000, 0x00000008
    emulated = quick | byte | byte_data | word_data | proc_call | write_block | i2c_block | pec
    assert usb.control(Setup(VENDOR_IN, 1, 0, 0, 4), b"") == struct.pack("<I", 1 | emulated)
    assert usb.control(Setup(VENDOR_OUT, 2, 10, 0, 0), b"") == b""
    assert usb.delay_us == 10
    assert status(usb) == b"\0"


def test_class_requests_are_the_same_commands() -> None:
    assert adapter().control(Setup(0xA1, 0, 0x1234, 0, 2), b"") == b"\x34\x12"


def test_one_message_is_one_transaction() -> None:
    device = Device(0x53)
    usb = adapter(device)
    assert write(usb, 0x53, b"\x2d\x08") == b""
    assert status(usb) == ACK
    assert device.heard == [b"\x2d\x08"]
    assert len(device.stops) == usb.wire.transactions == 1
    assert read(usb, 0x53, 3) == b"\xa0\xa1\xa2"
    assert usb.wire.transactions == 2


def test_messages_between_begin_and_end_are_joined_by_repeated_starts() -> None:
    device = Device(0x53)
    usb = adapter(device)
    write(usb, 0x53, b"\x32", request=4 | 1)
    write(usb, 0x53, b"\x33", request=4)
    assert status(usb) == ACK
    assert device.stops == []
    assert read(usb, 0x53, 2, request=4 | 2) == b"\xa0\xa1"
    assert len(device.stops) == usb.wire.transactions == 1
    assert usb.wire.scl_clocks == 9 * (2 + 2 + 3)


def test_a_missing_acknowledgement_is_a_status() -> None:
    usb = adapter(Device(0x53))
    assert write(usb, 0x54, b"\x00") is not None  # the transfer itself succeeds: Linux asks for the status next
    assert status(usb) == NAK
    assert read(usb, 0x54, 3) == b"\0\0\0"
    assert status(usb) == NAK
    assert write(usb, 0x53, b"\x00") == b""
    assert status(usb) == ACK


def test_an_address_of_more_than_seven_bits_is_not_acknowledged() -> None:
    usb = adapter(Device(0x53))
    write(usb, 0x0153, b"")
    assert status(usb) == NAK


def test_a_data_byte_without_acknowledgement_is_a_status() -> None:
    usb = adapter(Device(0x53, room=1))
    write(usb, 0x53, b"\x00\x01")
    assert status(usb) == NAK


def test_a_quick_write_is_an_address_and_a_stop() -> None:
    device = Device(0x53)
    usb = adapter(device)
    assert write(usb, 0x53, b"") == b""
    assert status(usb) == ACK
    assert usb.wire.scl_clocks == 9
    assert len(device.stops) == 1


def test_begin_releases_a_bus_that_was_never_released() -> None:
    device = Device(0x53)
    usb = adapter(device)
    write(usb, 0x53, b"\x00", request=4 | 1)
    write(usb, 0x53, b"\x01")
    assert len(device.stops) == usb.wire.transactions == 2


def test_reset_releases_the_bus() -> None:
    device = Device(0x53)
    usb = adapter(device)
    write(usb, 0x53, b"\x00", request=4 | 1)
    usb.reset()
    assert len(device.stops) == 1
    assert status(usb) == b"\0"


def test_the_multiplexer_switches_only_at_the_stop() -> None:
    """Mux and sensor in one transaction: the sensor is not there yet (LNX-07)."""
    usb = adapter()
    usb.wire.connect_router(Pca9544aChip(0x70, {0: [Device(0x53)]}))
    write(usb, 0x70, b"\x04", request=4 | 1)
    assert status(usb) == ACK
    write(usb, 0x53, b"\x00", request=4 | 2)
    assert status(usb) == NAK
    write(usb, 0x53, b"\x00")  # the broken transaction has ended in a STOP
    assert status(usb) == ACK


class StandingClock(VirtualClock):
    """Time passes only in sleep, as on a machine much faster than the bus."""

    def advance(self, ns: int) -> None:
        pass


@pytest.mark.parametrize("bit_rate_hz", [10_000, 100_000, 400_000])
def test_a_transaction_takes_the_time_of_its_clocks(bit_rate_hz: int) -> None:
    clock, device = StandingClock(), Device(0x53)
    wire = Wire(clock, bit_rate_hz)
    wire.connect(device)
    usb = TinyUsb(wire, "mine")
    write(usb, 0x53, b"\x32", request=4 | 1)
    read(usb, 0x53, 6, request=4 | 2)
    clocks = 9 * (2 + 7)
    assert clock.now_ns() >= max(device.stops[-1], clocks * 10**9 // bit_rate_hz)
    assert clock.now_ns() <= (clocks + 4) * 10**9 // bit_rate_hz


def test_time_is_not_counted_twice_on_a_clock_that_the_wire_drives() -> None:
    usb, other = adapter(Device(0x53)), Wire(VirtualClock())
    other.connect(Device(0x53))
    write(usb, 0x53, b"\x32", request=4 | 1)
    read(usb, 0x53, 6, request=4 | 2)
    other.transfer(0x53, b"\x32", 6)
    assert 0 <= usb.wire.clock.now_ns() - other.clock.now_ns() < 4 * 10**9 // 400_000


requests = st.builds(
    Setup,
    st.sampled_from([0x00, 0x01, 0x80, 0x81, VENDOR_OUT, VENDOR_IN, 0xFF]),
    st.integers(0, 12),
    st.integers(0, 0xFFFF) | st.sampled_from([0, 1]),
    st.integers(0, 0xFFFF) | st.sampled_from([0x53, 0x54]),
    st.integers(0, 40),
)


@given(st.lists(requests, max_size=30))
def test_any_sequence_of_requests_leaves_the_adapter_usable(setups: list[Setup]) -> None:
    device = Device(0x53, room=20)
    usb = adapter(device)
    for setup in setups:
        usb.control(setup, bytes(0 if setup.request_type >> 7 else setup.length))
    usb.reset()
    assert write(usb, 0x53, b"\x00") == b""
    assert status(usb) == ACK
