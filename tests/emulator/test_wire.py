"""Acknowledgement, answers and durations of transactions; times from the table BUS-07 of minimum bus times."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_emulator.board import Pca9544aChip
from firmware_emulator.clock import RealClock, VirtualClock
from firmware_emulator.wire import Wire


class Memory:
    """Records every call; sends `answer` over and over; acknowledges the first `appetite` bytes of a message."""

    def __init__(self, address: int, answer: bytes = b"\x00", appetite: int = 99) -> None:
        self.address = address
        self.answer = answer
        self.appetite = appetite
        self.calls: list[tuple[object, ...]] = []

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        self.calls.append(("write", data, at_ns, byte_ns))
        return min(len(data), self.appetite)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        self.calls.append(("read", count, at_ns, byte_ns))
        return (self.answer * count)[:count]

    def stop(self, at_ns: int) -> None:
        self.calls.append(("stop", at_ns))


def wire_with(*devices: Memory, bit_rate_hz: int = 400_000) -> Wire:
    wire = Wire(VirtualClock(), bit_rate_hz)
    wire.connect(*devices)
    return wire


BUS_07 = [
    # bytes written, bytes read, SCL clocks, ns at 100 kHz, ns at 400 kHz
    (1, 0, 18, 192_700, 47_500),
    (2, 0, 27, 282_700, 70_000),
    (1, 1, 36, 381_400, 93_700),
    (1, 2, 45, 471_400, 116_200),
    (1, 3, 54, 561_400, 138_700),
    (1, 6, 81, 831_400, 206_200),
    (1, 7, 90, 921_400, 228_700),
    (1, 8, 99, 1_011_400, 251_200),
    (1, 22, 225, 2_271_400, 566_200),
    (1, 32, 315, 3_171_400, 791_200),
    (1, 192, 1755, 17_571_400, 4_391_200),
]


@pytest.mark.parametrize(("written", "read", "clocks", "slow_ns", "fast_ns"), BUS_07)
def test_transfers_take_the_minimum_bus_times(written: int, read: int, clocks: int, slow_ns: int, fast_ns: int) -> None:
    for bit_rate_hz, expected_ns in ((100_000, slow_ns), (400_000, fast_ns)):
        wire = wire_with(Memory(0x53), bit_rate_hz=bit_rate_hz)
        wire.transfer(0x53, bytes(written), read)
        assert (wire.clock.now_ns(), wire.scl_clocks, wire.transactions) == (expected_ns, clocks, 1)


def test_bytes_reach_the_device_at_their_time_on_the_wire() -> None:
    device = Memory(0x53)
    wire_with(device).transfer(0x53, b"\x32", 6)
    # 0.6 us START, 18 clocks of 2.5 us to the end of the first byte; 1.2 us repeated START, 9 clocks of address.
    assert device.calls == [
        ("write", b"\x32", 600 + 45_000, 22_500),
        ("read", 6, 600 + 45_000 + 1_200 + 22_500, 22_500),
        ("stop", 600 + 45_000 + 1_200 + 22_500 + 6 * 22_500),
    ]


def test_an_address_without_a_device_is_not_acknowledged() -> None:
    wire = wire_with(Memory(0x53))
    with pytest.raises(OSError, match="0x1d") as caught:
        wire.transfer(0x1D, b"\x00", 1)
    assert caught.value.errno == 121
    assert wire.scl_clocks == 9  # the address alone
    assert wire.clock.now_ns() == 22_500 + 2_500
    wire.nack_errno = 6
    with pytest.raises(OSError) as caught:
        wire.transfer(0x1D)
    assert caught.value.errno == 6


def test_a_transfer_without_data_sends_only_the_address() -> None:
    device = Memory(0x53)
    wire = wire_with(device)
    assert wire.transfer(0x53) == b""
    assert wire.scl_clocks == 9
    assert [call[0] for call in device.calls] == ["write", "stop"]


def test_a_plain_read_has_no_write() -> None:
    device = Memory(0x53, b"\xa5\x5a")
    wire = wire_with(device)
    assert wire.transfer(0x53, read=3) == b"\xa5\x5a\xa5"
    assert wire.scl_clocks == 36
    assert [call[0] for call in device.calls] == ["read", "stop"]


def test_data_not_acknowledged_ends_in_a_stop() -> None:
    device = Memory(0x53, appetite=1)
    wire = wire_with(device)
    with pytest.raises(OSError):
        wire.transfer(0x53, b"\x00\x01\x02", 1)
    assert [call[0] for call in device.calls] == ["write", "stop"]
    assert wire.scl_clocks == 9 * 3  # address, one byte taken, one refused
    assert wire.transactions == 1
    assert wire.clock.now_ns() == 27 * 2500 + 2500


def test_two_devices_at_one_address_pull_the_wire_low_together() -> None:
    wire = wire_with(Memory(0x40, b"\xf0\x0f"), Memory(0x40, b"\x3c\xff"))
    assert wire.transfer(0x40, b"\x00", 2) == b"\x30\x0f"
    one_full = wire_with(Memory(0x40, appetite=1), Memory(0x40))
    assert one_full.transfer(0x40, b"\x00\x01") == b""  # one acknowledge is enough


def test_messages_to_two_addresses_in_one_transaction() -> None:
    first, second = Memory(0x40), Memory(0x41, b"\x07")
    wire = wire_with(first, second)
    wire.send(0x40, b"\x02")
    assert wire.receive(0x41, 1) == b"\x07"
    assert (wire.transactions, first.calls[-1][0]) == (0, "write")
    wire.stop()
    assert [call[0] for call in first.calls + second.calls] == ["write", "stop", "read", "stop"]
    assert wire.transactions == 1
    assert wire.clock.now_ns() == 36 * 2500 + 3700  # BUS-06, one repeated START
    wire.stop()
    assert wire.transactions == 1  # a STOP on a free bus is none


@given(st.binary(max_size=5), st.integers(0, 8), st.sampled_from([100_000, 400_000, 123_457]), st.integers(0, 6))
def test_a_transfer_equals_its_messages(write: bytes, read: int, bit_rate_hz: int, appetite: int) -> None:
    whole, parts = Memory(0x53, b"\x01\x02\x03", appetite), Memory(0x53, b"\x01\x02\x03", appetite)
    first, other = wire_with(whole, bit_rate_hz=bit_rate_hz), wire_with(parts, bit_rate_hz=bit_rate_hz)
    answers = []
    for step in (lambda: first.transfer(0x53, write, read), lambda: by_messages(other, write, read)):
        try:
            answers.append(step())
        except OSError as error:
            answers.append(str(error).encode())
    assert answers[0] == answers[1]
    assert whole.calls == parts.calls
    assert (first.clock.now_ns(), first.scl_clocks, first.transactions) == (
        other.clock.now_ns(),
        other.scl_clocks,
        other.transactions,
    )


def by_messages(wire: Wire, write: bytes, read: int) -> bytes:
    if write or not read:
        wire.send(0x53, write)
    answer = wire.receive(0x53, read) if read else b""
    wire.stop()
    return answer


def test_host_time_precedes_every_start() -> None:
    device = Memory(0x53)
    wire = Wire(VirtualClock(), host_ns=100_000)
    wire.connect(device)
    wire.transfer(0x53, b"\x00")
    assert device.calls[0][2] == 100_000 + 600 + 45_000
    assert wire.clock.now_ns() == 147_500


@pytest.mark.parametrize(("address", "read"), [(0x80, 0), (-1, 1), (0x53, -1)])
def test_impossible_transfers_are_refused(address: int, read: int) -> None:
    with pytest.raises(ValueError, match="7 bits"):
        wire_with(Memory(0x53)).transfer(address, b"\x00", read)


def test_an_impossible_bit_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="bit_rate_hz"):
        Wire(VirtualClock(), 0)


def test_a_device_without_an_address_stops_answering_after_the_stop() -> None:
    device = Memory(0x40)
    wire = wire_with(device)
    device.address = -1
    wire.transfer(0x40, b"\x00")
    with pytest.raises(OSError):
        wire.transfer(0x40, b"\x00")
    device.address = 0x40
    wire.reroute()
    assert wire.transfer(0x40, b"\x00") == b""


def test_virtual_and_real_clocks_advance() -> None:
    clock = VirtualClock(5)
    clock.advance(10)
    clock.sleep_until(12)
    assert clock.now_ns() == 15
    clock.sleep_until(20)
    assert clock.now_ns() == 20
    with pytest.raises(ValueError, match="back"):
        clock.advance(-1)
    real = RealClock()
    before = real.now_ns()
    real.advance(1_000_000)
    assert real.now_ns() - before >= 1_000_000
    real.sleep_until(before + 3_000_000)
    assert 3_000_000 <= real.now_ns() - before < 10**12
    with pytest.raises(ValueError, match="back"):
        real.advance(-1)


def muxed() -> tuple[Wire, Pca9544aChip, dict[str, Memory]]:
    devices = {
        "trunk": Memory(0x77, b"\x55"),
        "zero": Memory(0x53, b"\x00"),
        "one": Memory(0x53, b"\x11"),
        "three": Memory(0x1D, b"\x33"),
    }
    mux = Pca9544aChip(0x70, {0: [devices["zero"]], 1: [devices["one"]], 3: [devices["three"]]})
    wire = Wire(VirtualClock())
    wire.connect(devices["trunk"])
    wire.connect_router(mux)
    return wire, mux, devices


def test_mux_selects_by_number_and_enable_bit() -> None:
    wire, _, _ = muxed()
    assert wire.transfer(0x70, read=1) == b"\x00"  # PCA-05
    for control, answer in ((0x04, b"\x00"), (0x05, b"\x11"), (0x01, None), (0x06, None), (0x00, None)):
        wire.transfer(0x70, bytes([control]))
        assert wire.transfer(0x70, read=1) == bytes([control])
        assert wire.transfer(0x77, b"\xd0", 1) == b"\x55"  # the trunk stays visible (PCA-10)
        if answer is None:
            with pytest.raises(OSError):
                wire.transfer(0x53, b"\x00", 1)
        else:
            assert wire.transfer(0x53, b"\x00", 1) == answer
    wire.transfer(0x70, b"\x07")
    assert wire.transfer(0x1D, b"\x00", 1) == b"\x33"


def test_mux_keeps_the_last_byte_and_only_three_bits() -> None:
    wire, mux, _ = muxed()
    wire.transfer(0x70, b"\x00\x04")  # PCA-08
    assert wire.transfer(0x53, b"\x00", 1) == b"\x00"
    wire.transfer(0x70, b"\xfd")
    assert wire.transfer(0x70, read=2) == b"\x05\x05"
    mux.interrupts = 0b1010  # INT3 and INT1 pulled low (PCA-12)
    assert wire.transfer(0x70, read=1) == b"\xa5"
    mux.power_on(0)
    wire.reroute()
    with pytest.raises(OSError):
        wire.transfer(0x53)


def test_mux_switches_at_the_stop_and_not_before() -> None:
    wire, _, devices = muxed()
    wire.transfer(0x70, b"\x04")
    wire.send(0x70, b"\x05")
    assert wire.receive(0x70, 1) == b"\x05"  # DEC-40
    wire.send(0x53, b"\x00")
    assert wire.receive(0x53, 1) == b"\x00"  # still the old channel (LNX-07)
    wire.stop()
    assert not devices["one"].calls
    assert wire.transfer(0x53, b"\x00", 1) == b"\x11"


def test_mux_switches_at_the_stop_of_a_broken_transfer() -> None:
    wire, _, _ = muxed()
    wire.send(0x70, b"\x05")
    with pytest.raises(OSError):
        wire.send(0x53, b"\x00")
    assert wire.transfer(0x53, b"\x00", 1) == b"\x11"  # DEC-41


def test_mux_and_a_device_at_one_address_answer_together() -> None:
    wire = Wire(VirtualClock())
    wire.connect(Memory(0x77, b"\x55"))
    wire.connect_router(Pca9544aChip(0x77, {1: [Memory(0x53, b"\x11")]}))
    wire.transfer(0x77, b"\x05")
    assert wire.transfer(0x77, read=1) == b"\x05"  # 0x55 & 0x05 (PCA-11)
    assert wire.transfer(0x53, b"\x00", 1) == b"\x11"
