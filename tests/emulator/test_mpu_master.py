"""The master of an MPU-9250's auxiliary bus beyond its golden conversation: byte order, devices that appear
and disappear, and the array.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.chips.mpu_queue import AuxiliaryMaster, swapped
from firmware_emulator.world import StillWorld
from imuarray.acquire.bus_segment import connect
from imuarray.array import parse_array

MS = 1_000_000
BOARD = """
[array]
name = "a"
[[sensor]]
name = "A"
chip = "mpu9250"
address = 0x68
range = 2
[[sensor]]
name = "M"
chip = "ak8963"
address = 0x0C
range = 49.12
"""


class Device:
    """Records writes; answers with register numbers from its pointer on."""

    def __init__(self, address: int) -> None:
        self.address = address
        self.pointer = 0
        self.written: list[tuple[int, int]] = []

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        self.pointer = data[0]
        self.written += [(data[0], byte) for byte in data[1:]]
        return len(data)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        return bytes(self.pointer + index & 0xFF for index in range(count))

    def stop(self, at_ns: int) -> None:
        pass


def page(**registers: str) -> bytearray:
    made = bytearray(256)
    for name, text in registers.items():
        data = bytes.fromhex(text)
        made[int(name[1:], 16) : int(name[1:], 16) + len(data)] = data
    return made


@given(st.binary(max_size=15), st.booleans())
def test_swapping_twice_changes_nothing(data: bytes, alone: bool) -> None:
    once = swapped(data, alone)
    assert sorted(once) == sorted(data)
    assert swapped(once, alone) == data
    assert not alone or once[:1] == data[:1]


@pytest.mark.parametrize(
    ("control", "register", "expected"),
    [
        (0x87, 0x03, "03040506070809"),
        (0xD7, 0x03, "04030605080709"),  # bytes of odd and even registers: 3 and 4, 5 and 6, 7 and 8
        (0xC7, 0x03, "03050407060908"),  # 3 alone, 4 and 5, ...
        (0xC4, 0x02, "03020504"),
        (0xD4, 0x02, "02040305"),
        (0x80, 0x02, ""),
    ],
)
def test_the_bytes_of_pairs_are_swapped(control: int, register: int, expected: str) -> None:
    """INV-111."""
    master = AuxiliaryMaster()
    master.devices = [Device(0x0C)]
    registers = page(x25=f"8c{register:02x}{control:02x}")
    master.transfer(registers, 0, 0)
    assert registers[0x49 : 0x49 + 8] == bytes.fromhex(expected).ljust(8, b"\0")
    assert registers[0x36] == 0


def test_slots_are_read_in_order_and_a_missing_device_keeps_its_bytes() -> None:
    """INV-113, INV-114: bytes read before stay where no device answers."""
    near, far = Device(0x0C), Device(0x1E)
    master = AuxiliaryMaster()
    master.devices = [near, far]
    registers = page(x25="8c1082", x28="1e0781", x2b="9e2083", x2e="8c3084", x63="00550000")
    master.transfer(registers, 0, 0)
    assert far.written == [(0x07, 0x55)]
    assert registers[0x49:0x53] == bytes.fromhex("1011 202122 30313233 00")
    assert AuxiliaryMaster.recorded(registers, 0b1001) == bytes.fromhex("101130313233")
    master.devices = [near]
    registers[0x26] = 0x40
    master.transfer(registers, 1, 0)
    assert registers[0x36] == 0b0110
    assert registers[0x49:0x53] == bytes.fromhex("4041 202122 30313233 00")


def test_a_slot_beyond_24_bytes_is_cut() -> None:
    """INV-113: 24 bytes."""
    master = AuxiliaryMaster()
    master.devices = [Device(0x0C)]
    registers = page(x25="8c108f", x28="8c208f")
    master.transfer(registers, 0, 0)
    assert registers[0x49:0x61] == bytes(range(0x10, 0x1F)) + bytes(range(0x20, 0x29))
    assert registers[0x61:0x63] == b"\0\0"


def test_a_slot_without_a_register_reads_at_the_devices_pointer() -> None:
    device = Device(0x0C)
    device.pointer = 0x77
    master = AuxiliaryMaster()
    master.devices = [device]
    registers = page(x25="8c10a2")
    master.transfer(registers, 0, 0)
    assert registers[0x49:0x4B] == b"\x77\x78"


@pytest.mark.parametrize("delay", [0, 1, 4, 31])
def test_a_delayed_slot_runs_at_every_nth_sample(delay: int) -> None:
    """INV-115: every 1 + n samples; a slot whose bit is not set is not."""
    device = Device(0x0C)
    master = AuxiliaryMaster()
    master.devices = [device]
    registers = page(x25="0c0181", x28="0c0281", x34=f"{delay:02x}", x67="02")
    for index in range(64):
        master.transfer(registers, index, index * MS)
    assert sum(register == 1 for register, _ in device.written) == 64
    assert sum(register == 2 for register, _ in device.written) == -(-64 // (1 + delay))


def opened(text: str = BOARD) -> EmulatedBus:
    return open_array(parse_array(text), world=StillWorld())


def say(bus: EmulatedBus, *texts: str) -> None:
    for text in texts:
        bus.transfer(0x68, bytes.fromhex(text))


def test_the_magnetometer_of_an_array_is_on_the_auxiliary_bus() -> None:
    """Read through the master while the bypass is closed, and by the array while it is open; not both at once."""
    bus = opened()
    say(bus, "1a01", "1909", "258c", "2600", "2781", "6a20")
    with pytest.raises(OSError, match="Remote"):
        bus.transfer(0x0C, b"\0", 1)
    bus.clock.sleep_until(50 * MS)
    assert bus.transfer(0x68, b"\x49", 1) == b"\x48"
    say(bus, "3702")
    with pytest.raises(OSError, match="Remote"):
        bus.transfer(0x0C, b"\0", 1)  # the master is on: INV-97
    say(bus, "6a00")
    assert bus.transfer(0x0C, b"\0", 1) == b"\x48"


def test_an_mpu_without_magnetometer_gets_no_acknowledgement() -> None:
    bus = opened(BOARD[: BOARD.index('[[sensor]]\nname = "M"')])
    say(bus, "1a01", "1909", "258c", "2600", "2781", "6a20")
    bus.clock.sleep_until(50 * MS)
    assert bus.transfer(0x68, b"\x36", 1) == b"\x01"


def test_the_master_measures_without_host_traffic() -> None:
    """Single measurements that slot 1 asks for at each sample are available after a second without a transaction."""
    bus = opened()
    say(bus, "1a01", "1909", "258c", "2602", "2788", "280c", "290a", "6411", "2a81", "6a20")
    bus.clock.sleep_until(1000 * MS)
    data = bus.transfer(0x68, b"\x49", 8)
    assert data[0] & 1  # ready
    assert data[7] == 0x10  # 16 bits, no overflow
    assert any(data[1:7])


def test_our_driver_opens_the_bypass_after_another_program_used_the_master() -> None:
    bus = opened()
    say(bus, "1a01", "1909", "258c", "2600", "2781", "6a20")
    routes = connect(parse_array(BOARD), bus)
    assert bus.transfer(0x0C, b"\0", 1) == b"\x48"
    bus.clock.sleep_until(bus.clock.now_ns() + 100 * MS)
    assert all(len(route.driver.fetch()) for route in routes)
