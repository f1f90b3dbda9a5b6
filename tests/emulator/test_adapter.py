"""The emulated Linux adapter, driven by unmodified programs: smbus2 and plain `fcntl.ioctl`.

Expected messages are those of the kernel's SMBus protocol page; expected errnos are facts LNX-04 ... LNX-49.
"""

from __future__ import annotations

import array
import ctypes
import errno
import fcntl
import os
import struct
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from smbus2 import I2cFunc, SMBus, i2c_msg

from firmware_emulator.array import open_array
from firmware_emulator.chips import CHIPS
from firmware_emulator.clock import VirtualClock
from firmware_emulator.device_file import Adapter, device_files
from firmware_emulator.element import IDENTITY, SensingElement, UnitDeviations
from firmware_emulator.wire import Wire
from firmware_emulator.world import StillWorld
from imuarray.array import load_array

PATH = "/dev/i2c-1"
MARTIN2013 = Path(__file__).parents[2] / "configs" / "martin2013.toml"
I2C_TIMEOUT, I2C_SLAVE, I2C_RDWR, I2C_PEC, I2C_SMBUS = 0x0702, 0x0703, 0x0707, 0x0708, 0x0720  # LNX-03
READ, STOP = 1, 0x8000


class Tape:
    """A wire that records each message and sends 1, 2, 3, ..."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.log: list[Any] = []

    def send(self, address: int, data: bytes) -> None:
        self.log.append((address, data))

    def receive(self, address: int, count: int) -> bytes:
        self.log.append((address, count))
        return bytes(index & 0xFF for index in range(1, count + 1))

    def stop(self) -> None:
        self.log.append("P")


def adxl345(nack_errno: int = 121) -> Wire:
    """One perfect accelerometer on a wire: DEVID 0xE5 (ADX-10), BW_RATE 0x0A after power-on (ADX-30)."""
    wire = Wire(VirtualClock(), nack_errno=nack_errno)
    wire.connect(CHIPS["adxl345"](0x53, SensingElement(StillWorld(), "adxl345", "A", IDENTITY, UnitDeviations())))
    return wire


@contextmanager
def bus_on(wire: Any, kind: str = "plain", **settings: Any) -> Iterator[SMBus]:
    with device_files({PATH: Adapter(wire, kind, **settings)}), SMBus(1) as bus:
        yield bus


def refusal(call: Any, *arguments: Any) -> int:
    with pytest.raises(OSError, match=r"^\[Errno") as refused:
        call(*arguments)
    assert refused.value.errno is not None
    return refused.value.errno


class TestSmbus:
    @pytest.mark.parametrize(
        ("name", "arguments", "result", "sent"),
        [
            ("write_quick", (), None, [(0x53, b"")]),
            ("read_byte", (), 1, [(0x53, 1)]),
            ("write_byte", (0x2D,), None, [(0x53, b"\x2d")]),
            ("read_byte_data", (0x32,), 1, [(0x53, b"\x32"), (0x53, 1)]),
            ("write_byte_data", (0x2D, 8), None, [(0x53, b"\x2d\x08")]),
            ("read_word_data", (0x32,), 0x0201, [(0x53, b"\x32"), (0x53, 2)]),  # low byte first: LNX-16
            ("write_word_data", (0x1E, 0x1234), None, [(0x53, b"\x1e\x34\x12")]),
            ("process_call", (0x1E, 0x1234), 0x0201, [(0x53, b"\x1e\x34\x12"), (0x53, 2)]),
            ("read_i2c_block_data", (0x32, 6), [1, 2, 3, 4, 5, 6], [(0x53, b"\x32"), (0x53, 6)]),  # LNX-15
            ("read_i2c_block_data", (0x32, 32), list(range(1, 33)), [(0x53, b"\x32"), (0x53, 32)]),
            ("write_i2c_block_data", (0x1E, [7, 8, 9]), None, [(0x53, b"\x1e\x07\x08\x09")]),
            ("write_block_data", (0x1E, [7, 8, 9]), None, [(0x53, b"\x1e\x03\x07\x08\x09")]),
        ],
    )
    def test_smbus_calls_become_the_messages_of_the_kernel(
        self, name: str, arguments: tuple[Any, ...], result: Any, sent: list[Any]
    ) -> None:
        tape = Tape()
        with bus_on(tape, "bcm2835") as bus:
            assert getattr(bus, name)(0x53, *arguments) == result
        assert tape.log == [*sent, "P"]

    def test_block_reads_of_smbus_are_refused(self) -> None:
        with bus_on(Tape()) as bus:  # LNX-35
            assert refusal(bus.read_block_data, 0x53, 0) == errno.EOPNOTSUPP
            assert refusal(bus.block_process_call, 0x53, 0, [1]) == errno.EOPNOTSUPP
            assert not bus.funcs & I2cFunc.SMBUS_READ_BLOCK_DATA

    def test_a_chip_is_read_and_written(self) -> None:
        with bus_on(adxl345()) as bus:
            assert bus.read_byte_data(0x53, 0x00) == 0xE5
            bus.write_i2c_block_data(0x53, 0x1E, [0x12, 0x34, 0x56])
            assert bus.read_i2c_block_data(0x53, 0x1E, 3) == [0x12, 0x34, 0x56]
            assert bus.read_word_data(0x53, 0x1E) == 0x3412

    def test_the_old_block_read_returns_32_bytes(self) -> None:
        tape, data = Tape(), (ctypes.c_uint8 * 34)()
        call = struct.pack("BBIP", 1, 0x32, 6, ctypes.addressof(data))
        with bus_on(tape) as bus:
            bus._set_address(0x53)
            fcntl.ioctl(bus.fd, I2C_SMBUS, call)
        assert bytes(data[:33]) == bytes([32, *range(1, 33)])

    @pytest.mark.parametrize(("read_write", "size"), [(2, 2), (0, 9), (1, 0xFFFFFFFF)])
    def test_calls_that_do_not_exist_are_refused(self, read_write: int, size: int) -> None:
        data = (ctypes.c_uint8 * 34)()
        with bus_on(Tape()) as bus:
            call = struct.pack("BBIP", read_write, 0, size, ctypes.addressof(data))
            assert refusal(fcntl.ioctl, bus.fd, I2C_SMBUS, call) == errno.EINVAL
            assert refusal(fcntl.ioctl, bus.fd, I2C_SMBUS, struct.pack("BBIP", 1, 0, 2, 0)) == errno.EINVAL

    @pytest.mark.parametrize("read_write", [0, 1])
    def test_a_block_longer_than_32_bytes_is_refused(self, read_write: int) -> None:
        data = (ctypes.c_uint8 * 34)(33)
        call = struct.pack("BBIP", read_write, 0, 8, ctypes.addressof(data))
        with bus_on(Tape()) as bus:
            assert refusal(fcntl.ioctl, bus.fd, I2C_SMBUS, call) == errno.EINVAL


class TestRdwr:
    def test_messages_are_joined_and_stopped_once(self) -> None:
        tape = Tape()
        read = i2c_msg.read(0x53, 6)
        with bus_on(tape, "bcm2835") as bus:
            bus.i2c_rdwr(i2c_msg.write(0x53, [0x1E, 1]), i2c_msg.write(0x1D, [0x32]), read)
        assert tape.log == [(0x53, b"\x1e\x01"), (0x1D, b"\x32"), (0x53, 6), "P"]  # LNX-06
        assert bytes(read) == b"\x01\x02\x03\x04\x05\x06"

    def test_42_messages_of_8192_bytes_are_the_limit(self) -> None:
        with bus_on(Tape()) as bus:
            bus.i2c_rdwr(*[i2c_msg.read(0x53, 1)] * 42)
            assert refusal(bus.i2c_rdwr, *[i2c_msg.read(0x53, 1)] * 43) == errno.EINVAL  # LNX-04
            assert refusal(bus.i2c_rdwr) == errno.EINVAL
            bus.i2c_rdwr(i2c_msg.write(0x53, bytes(8192)), i2c_msg.read(0x53, 8192))
            assert refusal(bus.i2c_rdwr, i2c_msg.write(0x53, bytes(8193))) == errno.EINVAL  # LNX-05
            assert refusal(bus.i2c_rdwr, i2c_msg.read(0x53, 8193)) == errno.EINVAL
            assert refusal(bus.i2c_rdwr, i2c_msg.read(0x80, 1)) == errno.EINVAL

    def test_the_length_of_a_message_has_16_bits(self) -> None:
        tape = Tape()
        with bus_on(tape) as bus:
            bus.i2c_rdwr(i2c_msg.read(0x53, 70000))
        assert tape.log == [(0x53, 4464), "P"]  # LNX-33

    def test_only_the_last_message_may_read_on_a_raspberry_pi(self) -> None:
        for kind, code in (("bcm2835", errno.EOPNOTSUPP), ("plain", 0), ("gpio", 0)):  # LNX-10
            wire = adxl345()
            messages = [
                i2c_msg.write(0x53, [0]),
                i2c_msg.read(0x53, 1),
                i2c_msg.write(0x53, [0x2C]),
                i2c_msg.read(0x53, 1),
            ]
            with bus_on(wire, kind) as bus:
                if code:
                    assert refusal(bus.i2c_rdwr, *messages) == code
                    assert wire.transactions == 0
                else:
                    bus.i2c_rdwr(*messages)
                    assert (bytes(messages[1]), bytes(messages[3])) == (b"\xe5", b"\x0a")
                    assert wire.transactions == 1

    @pytest.mark.parametrize(("kind", "transactions"), [("gpio", 2), ("plain", 1), ("bcm2835", 1)])
    def test_a_stop_between_messages_needs_mangling(self, kind: str, transactions: int) -> None:
        # LNX-08; the multiplexer's channel changes at a STOP alone: without one the sensor is out of reach (LNX-07).
        board = open_array(load_array(MARTIN2013))
        select, pointer, identity = i2c_msg.write(0x70, [0x04]), i2c_msg.write(0x53, [0x00]), i2c_msg.read(0x53, 1)
        select.flags |= STOP
        with bus_on(board.wire, kind) as bus:
            assert bool(bus.funcs & I2cFunc.PROTOCOL_MANGLING) == (kind == "gpio")
            if transactions == 2:
                bus.i2c_rdwr(select, pointer, identity)
                assert bytes(identity) == b"\xe5"
            else:
                assert refusal(bus.i2c_rdwr, select, pointer, identity) == 121
        assert board.wire.transactions == transactions

    def test_flags_that_are_not_emulated_are_refused(self) -> None:
        with bus_on(Tape(), "gpio") as bus:
            for flag in (0x0010, 0x0400, 0x0800, 0x1000, 0x2000, 0x4000):
                message = i2c_msg.write(0x53, [0])
                message.flags |= flag
                assert refusal(bus.i2c_rdwr, message) == errno.EOPNOTSUPP

    @pytest.mark.parametrize("number", [6, 121])
    def test_a_missing_acknowledgement_has_the_errno_of_the_adapter(self, number: int) -> None:
        answer, lost = i2c_msg.read(0x53, 1), i2c_msg.read(0x1D, 1)
        with bus_on(adxl345(number)) as bus:
            assert refusal(bus.i2c_rdwr, i2c_msg.write(0x53, [0]), answer, i2c_msg.write(0x1D, [0]), lost) == number
            assert bytes(answer) == b"\x00"  # nothing is copied back on error: LNX-13
            assert refusal(bus.read_byte_data, 0x1D, 0) == number
            bus.i2c_rdwr(i2c_msg.write(0x53, [0]), answer)
            assert bytes(answer) == b"\xe5"

    def test_structures_packed_by_hand_are_accepted(self) -> None:
        # 64-bit layouts of linux/i2c.h and linux/i2c-dev.h, without ctypes classes of a library.
        write, read = ctypes.create_string_buffer(b"\x00", 1), ctypes.create_string_buffer(1)
        messages = struct.pack(
            "HHHxxPHHHxxP", 0x53, 0, 1, ctypes.addressof(write), 0x53, READ, 1, ctypes.addressof(read)
        )
        memory = ctypes.create_string_buffer(messages, len(messages))
        request = struct.pack("PI4x", ctypes.addressof(memory), 2)
        with device_files({PATH: Adapter(adxl345())}):
            number = os.open(PATH, os.O_RDWR)
            assert fcntl.ioctl(number, I2C_RDWR, request) == request  # bytes come back as bytes
            assert read.raw == b"\xe5"
            for kept in (bytearray(request), array.array("B", request)):
                read[0] = b"\x00"
                assert fcntl.ioctl(number, I2C_RDWR, kept) == 2
                assert read.raw == b"\xe5"
            assert fcntl.ioctl(number, I2C_RDWR, ctypes.addressof(ctypes.c_char.from_buffer(kept))) == 2
            os.close(number)

    def test_invalid_pointers_are_refused(self) -> None:
        memory = ctypes.create_string_buffer(struct.pack("HHHxxP", 0x53, READ, 1, 0))
        with bus_on(adxl345()) as bus:
            assert refusal(fcntl.ioctl, bus.fd, I2C_RDWR, 0) == errno.EFAULT
            assert refusal(fcntl.ioctl, bus.fd, I2C_RDWR, struct.pack("PI4x", 0, 1)) == errno.EINVAL
            request = struct.pack("PI4x", ctypes.addressof(memory), 1)
            assert refusal(fcntl.ioctl, bus.fd, I2C_RDWR, request) == errno.EFAULT


class TestFile:
    def test_an_address_with_a_driver_is_busy_unless_forced(self) -> None:
        with bus_on(adxl345(), owned={0x53: "adxl345_i2c"}) as bus:
            assert refusal(bus.read_byte_data, 0x53, 0) == errno.EBUSY  # LNX-12, LNX-36
            assert bus.read_byte_data(0x53, 0, force=True) == 0xE5
            read = i2c_msg.read(0x53, 1)
            bus.i2c_rdwr(i2c_msg.write(0x53, [0]), read)
            assert bytes(read) == b"\xe5"
            assert refusal(bus.read_byte_data, 0x80, 0) == errno.EINVAL
            assert refusal(bus.read_byte_data, 0x1D, 0) == 121

    def test_each_open_file_has_its_own_address(self) -> None:
        tape = Tape()
        with bus_on(tape) as first, SMBus(PATH) as second:
            first.read_byte(0x10)
            second.read_byte(0x20)
            first.read_byte(0x10)
        assert [entry for entry in tape.log if entry != "P"] == [(0x10, 1), (0x20, 1), (0x10, 1)]

    def test_a_reopened_device_has_no_address(self) -> None:
        tape = Tape()
        with device_files({PATH: Adapter(tape)}):
            with SMBus(1) as bus:
                bus.read_byte(0x10)
                number = bus.fd
            again = os.open(PATH, os.O_RDWR)
            assert again == number
            fcntl.ioctl(again, I2C_SMBUS, struct.pack("BBIP", 0, 7, 1, 0))
            os.close(again)
        assert tape.log[-2:] == [(0, b"\x07"), "P"]

    def test_each_kind_of_adapter_has_its_functionality(self) -> None:
        # I2C_FUNC_I2C | I2C_FUNC_SMBUS_EMUL of linux/i2c.h (0x0EFF0008) without packet error codes (0x08).
        for kind, expected in (("plain", 0x0EFF0001), ("bcm2835", 0x0EFF0001), ("gpio", 0x0EFF0005)):
            with bus_on(Tape(), kind) as bus:
                assert int(bus.funcs) == expected

    def test_a_stuck_bus_costs_the_timeout(self) -> None:
        tape: Any = Tape()
        adapter = Adapter(tape)
        adapter.stuck = True
        with device_files({PATH: adapter}), SMBus(1) as bus:
            with pytest.raises(TimeoutError):  # LNX-43
                bus.read_byte(0x53)
            assert tape.clock.now_ns() == 10**9
            fcntl.ioctl(bus.fd, I2C_TIMEOUT, 3)
            with pytest.raises(TimeoutError):
                bus.read_byte(0x53)
            assert tape.clock.now_ns() == 1_030_000_000
            fcntl.ioctl(bus.fd, 0x0701, 5)
            assert adapter.retries == 5
            assert refusal(fcntl.ioctl, bus.fd, I2C_TIMEOUT, 1 << 31) == errno.EINVAL
        assert tape.log == []

    def test_other_requests_are_refused_or_ignored(self) -> None:
        with bus_on(Tape()) as bus:
            assert refusal(fcntl.ioctl, bus.fd, 0x0799) == errno.ENOTTY
            assert fcntl.ioctl(bus.fd, I2C_PEC, 0) == 0
            assert refusal(fcntl.ioctl, bus.fd, I2C_PEC, 1) == errno.EOPNOTSUPP
            assert fcntl.ioctl(bus.fd, 0x0704, 0) == 0

    def test_an_adapter_of_unknown_kind_is_refused(self) -> None:
        with pytest.raises(ValueError, match="adapter 'pi'; allowed are plain, bcm2835, gpio"):
            Adapter(adxl345(), "pi")


class TestDeviceFiles:
    def test_other_files_are_not_affected(self) -> None:
        with device_files({PATH: Adapter(adxl345())}):
            reading, writing = os.pipe()
            os.write(writing, b"abc")
            waiting = array.array("i", [0])
            fcntl.ioctl(reading, termios.FIONREAD, waiting)
            assert waiting[0] == 3
            os.close(reading)
            os.close(writing)
            with pytest.raises(FileNotFoundError):
                SMBus(2)

    def test_the_patched_functions_are_restored(self) -> None:
        before = fcntl.ioctl, os.open
        late = ModuleType("late")
        sys.modules["late"] = late
        try:
            with device_files({PATH: Adapter(adxl345())}):
                vars(late)["ioctl"] = fcntl.ioctl  # as "from fcntl import ioctl" of a module loaded only now
                assert late.ioctl is not before[0]
            assert (fcntl.ioctl, os.open) == before
            assert late.ioctl is before[0]
        finally:
            del sys.modules["late"]
        with pytest.raises(FileNotFoundError):
            SMBus(PATH)

    def test_two_wires_are_two_devices(self) -> None:
        first: Any = Tape()
        two: Any = Tape()
        with device_files({PATH: Adapter(first), "/dev/i2c-11": Adapter(two)}), SMBus(11) as bus:
            bus.read_byte(0x53)
        assert (len(first.log), len(two.log)) == (0, 2)
