"""Timed faults: the effect of each on the emulated bus, and the allowed entries of their file."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_emulator.array import EmulatedBus, open_array, open_bus
from firmware_emulator.board import Board
from firmware_emulator.clock import VirtualClock
from firmware_emulator.faults import FAULTS, faults_from
from firmware_emulator.faulty_board import with_faults
from firmware_emulator.faulty_parts import Times
from imuarray.array import ArrayConfig, parse_array

ROOT = Path(__file__).parents[2]
MS = 1_000_000
TEXT = """
[array]
name = "a"
mux = { chip = "pca9544a", address = 0x70 }
[[sensor]]
name = "A"
chip = "adxl345"
channel = 0
address = 0x53
range = 4
rate_hz = 800
[[sensor]]
name = "B"
chip = "bma180"
channel = 0
address = 0x40
range = 2
[[sensor]]
name = "C"
chip = "bma180"
channel = 1
address = 0x40
range = 16
[[sensor]]
name = "G"
chip = "l3g4200d"
channel = 1
address = 0x68
range = 250
rate_hz = 800
"""
SELECT_0, SELECT_1 = b"\x04", b"\x05"


@pytest.fixture
def array() -> ArrayConfig:
    return parse_array(TEXT)


@pytest.fixture
def bus_with(array: ArrayConfig) -> Callable[..., EmulatedBus]:
    """``bus_with(kind="reset", sensor="B", at_s=1.0)``: the array with that one fault, channel 0 selected."""

    def make(start_ns: int = 0, **table: Any) -> EmulatedBus:
        board = with_faults(Board, faults_from({"fault": [table]}, array))
        bus = open_array(array, board=board, clock=VirtualClock(start_ns))
        bus.transfer(0x70, SELECT_0)
        return bus

    return make


def at(bus: EmulatedBus, seconds: float) -> None:
    bus.clock.sleep_until(round(seconds * 1e9))


def refused(bus: EmulatedBus, address: int = 0x40) -> int | None:
    """The errno with which a read of a register ends."""
    try:
        bus.transfer(address, b"\x00", 1)
    except OSError as error:
        return error.errno
    return None


@pytest.mark.parametrize(
    ("at_ms", "begun", "there", "ended"),
    [(99, 0, False, 0), (100, 1, True, 0), (129, 1, True, 0), (130, 1, False, 1), (250, 2, True, 1), (580, 4, False, 4),
     (700, 4, False, 4)],
)  # fmt: skip
def test_a_fault_is_active_at_its_times(at_ms: int, begun: int, there: bool, ended: int) -> None:
    times = Times(100 * MS, 30 * MS, 150 * MS, 4)
    assert (times.begun(at_ms * MS), times.during(at_ms * MS), times.ended(at_ms * MS)) == (begun, there, ended)


def test_a_fault_can_happen_once_or_for_ever() -> None:
    assert [Times(100, 30, 0, 1).during(instant) for instant in (99, 100, 129, 130, 230)] == [0, 1, 1, 0, 0]
    assert Times(100, 30, 50, 0).begun(100 + 50 * 10_000) == 10_001


def test_a_silent_chip_does_not_acknowledge_until_the_fault_ends(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="no_acknowledge", sensor="B", at_s=1.0, for_s=0.5)
    assert refused(bus) is None
    at(bus, 1.2)
    assert refused(bus) == errno.EREMOTEIO
    assert refused(bus, 0x53) is None
    at(bus, 1.6)
    assert refused(bus) is None


def test_times_count_from_power_on(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(start_ns=50_000_000_000, kind="no_acknowledge", sensor="B", at_s=1.0, for_s=0.5)
    assert refused(bus) is None
    at(bus, 51.2)
    assert refused(bus) == errno.EREMOTEIO


@pytest.mark.parametrize(("kind", "settings"), [("reset", {}), ("unplugged", {"for_s": 0.2})])
def test_a_chip_that_lost_its_supply_has_its_defaults(
    bus_with: Callable[..., EmulatedBus], kind: str, settings: dict[str, float]
) -> None:
    bus = bus_with(kind=kind, sensor="A", at_s=1.0, **settings)
    bus.transfer(0x53, b"\x2d\x08")
    bus.transfer(0x53, b"\x31\x0b")
    at(bus, 0.9)
    assert bus.transfer(0x53, b"\x31", 1) == b"\x0b"
    if kind == "unplugged":
        at(bus, 1.1)
        assert refused(bus, 0x53) == errno.EREMOTEIO
    at(bus, 1.3)
    assert bus.transfer(0x53, b"\x2d", 1) == b"\x00"  # standby, ADX-31
    assert bus.transfer(0x53, b"\x31", 1) == b"\x00"
    bus.transfer(0x53, b"\x31\x0b")
    at(bus, 2.0)
    assert bus.transfer(0x53, b"\x31", 1) == b"\x0b"  # it happened once


def test_a_torn_fault_clears_the_bit_that_keeps_readings_whole(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="torn", sensor="B", at_s=1.0)
    before = bus.transfer(0x40, b"\x33", 1)[0]
    at(bus, 1.1)
    assert bus.transfer(0x40, b"\x33", 1)[0] == before | 0x01  # shadow_dis, BMA-41
    gyro = bus_with(kind="torn", sensor="G", at_s=1.0)
    gyro.transfer(0x70, SELECT_1)
    gyro.transfer(0x68, b"\x23\x80")
    at(gyro, 1.1)
    assert gyro.transfer(0x68, b"\x23", 1) == b"\x00"  # BDU, L3G-50


@pytest.mark.parametrize(("kind", "ready"), [("frozen", 1), ("stale", 0)])
def test_a_frozen_reading_repeats_until_a_set_up(bus_with: Callable[..., EmulatedBus], kind: str, ready: int) -> None:
    bus = bus_with(kind=kind, sensor="B", at_s=1.0, for_s=0.5, until_set_up=True)
    held = set()
    for index in range(10):
        at(bus, 1.01 + index * 0.01)
        burst = bus.transfer(0x40, b"\x02", 6)
        assert [burst[axis] & 1 for axis in (0, 2, 4)] == [ready] * 3  # new_data, BMA-62
        held.add(bytes(byte & 0xFE if index % 2 == 0 else byte for index, byte in enumerate(burst)))
    assert len(held) == 1
    bus.transfer(0x40, b"\x0d\x10")  # a set-up begins
    moving = set()
    for index in range(10):
        at(bus, 1.2 + index * 0.01)
        moving.add(bus.transfer(0x40, b"\x02", 6))
    assert len(moving) > 3


def test_a_stale_adxl345_clears_data_ready(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="stale", sensor="A", at_s=1.0, for_s=0.5)
    bus.transfer(0x53, b"\x2d\x08")
    at(bus, 0.9)
    assert bus.transfer(0x53, b"\x30", 8)[0] & 0x80  # DATA_READY, ADX-50
    at(bus, 1.1)
    assert not bus.transfer(0x53, b"\x30", 8)[0] & 0x80


def test_a_bias_fault_shifts_the_reading(bus_with: Callable[..., EmulatedBus]) -> None:
    readings = []
    for table in ({"at_s": 100.0}, {"at_s": 0.0}):
        bus = bus_with(kind="start_up", sensor="B", bias=[0.5, 0.0, 0.0], **table)
        at(bus, 1.0)
        burst = bus.transfer(0x40, b"\x02", 2)
        readings.append(int.from_bytes(burst, "little", signed=True) >> 2)
    assert readings[1] - readings[0] == pytest.approx(2048, rel=0.05)  # 0.5 g at 4096 counts per g (BMA-72)


def test_a_stuck_bus_times_out(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="stuck_bus", at_s=1.0, for_s=0.2)
    at(bus, 1.0)
    assert refused(bus) == refused(bus, 0x53) == errno.ETIMEDOUT
    assert bus.clock.now_ns() == 1060 * MS
    at(bus, 1.3)
    assert refused(bus) is None


def test_a_chip_holds_the_clock_only_when_it_is_addressed(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="clock_held", sensor="B", at_s=1.0, for_s=0.2)
    at(bus, 1.0)
    assert refused(bus) == errno.ETIMEDOUT
    assert refused(bus, 0x53) is None


def test_a_wrong_channel_fault_ignores_the_selection(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="wrong_channel", at_s=1.0, for_s=0.2)
    at(bus, 1.1)
    bus.transfer(0x70, SELECT_1)
    assert bus.transfer(0x70, read=1) == SELECT_0
    assert refused(bus, 0x53) is None
    at(bus, 1.3)
    bus.transfer(0x70, SELECT_1)
    assert bus.transfer(0x70, read=1) == SELECT_1
    assert refused(bus, 0x53) == errno.EREMOTEIO


def test_a_stuck_switch_can_read_back_as_selected(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="wrong_channel", at_s=1.0, for_s=0.2, reads_right=True)
    at(bus, 1.1)
    bus.transfer(0x70, SELECT_1)
    assert bus.transfer(0x70, read=1) == SELECT_1
    assert refused(bus, 0x53) is None


def test_a_wrong_channel_fault_can_select_a_given_channel(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="wrong_channel", at_s=1.0, for_s=0.2, channel=1)
    at(bus, 1.1)
    bus.transfer(0x70, SELECT_0)
    assert bus.transfer(0x70, read=1) == SELECT_1
    assert refused(bus, 0x68) is None


def test_a_reset_multiplexer_selects_no_channel(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="mux_reset", at_s=1.0)
    at(bus, 1.1)
    assert refused(bus) == errno.EREMOTEIO
    assert bus.transfer(0x70, read=1) == b"\x00"
    bus.transfer(0x70, SELECT_0)
    assert refused(bus) is None


def test_a_stall_delays_the_program(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="stall", at_s=1.0, for_s=0.2)
    at(bus, 1.0)
    assert refused(bus) is None
    assert 1200 * MS < bus.clock.now_ns() < 1201 * MS
    assert refused(bus) is None
    assert bus.clock.now_ns() < 1201 * MS


def test_an_address_of_a_kernel_driver_refuses_claims(bus_with: Callable[..., EmulatedBus]) -> None:
    bus = bus_with(kind="kernel_driver", sensor="B", at_s=1.0, for_s=0.2)
    bus.claim(0x40)
    at(bus, 1.1)
    bus.claim(0x53)
    with pytest.raises(OSError) as refusal:
        bus.claim(0x40)
    assert refusal.value.errno == errno.EBUSY
    assert refused(bus) is None  # I2C_RDWR does not ask (LNX-12)


def test_a_file_of_faults_is_read(array: ArrayConfig, tmp_path: Path) -> None:
    path = tmp_path / "night.toml"
    path.write_text('[[fault]]\nkind = "unplugged"\nsensor = "B"\nat_s = 600\nfor_s = 5.0\nevery_s = 60\ntimes = 10\n')
    bus = open_bus({"faults": str(path)}, array)
    bus.transfer(0x70, SELECT_0)
    at(bus, 603)
    assert refused(bus) == errno.EREMOTEIO
    at(bus, 1142)
    assert refused(bus) == errno.EREMOTEIO
    at(bus, 1202)
    assert refused(bus) is None


def test_faults_and_mechanisms_act_together(array: ArrayConfig, tmp_path: Path) -> None:
    (tmp_path / "n.toml").write_text('[[fault]]\nkind = "no_acknowledge"\nsensor = "B"\nfor_s = 1\n')
    bus = open_bus({"faults": str(tmp_path / "n.toml"), "mechanism": "loose_contact", "sensor": "B"}, array)
    bus.transfer(0x70, SELECT_0)
    assert refused(bus) == errno.EREMOTEIO


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"kind": "earthquake"}, "kind 'earthquake'; allowed are no_acknowledge, unplugged, "),
        ({"kind": "stale", "sensor": "Z", "for_s": 1}, "sensor 'Z' for stale; allowed are A, B, C, G"),
        ({"kind": "torn", "sensor": "A"}, "sensor 'A' for torn; allowed are B, C, G"),
        ({"kind": "stuck_bus", "sensor": "A", "for_s": 1}, "sensor: stuck_bus concerns the whole array"),
        ({"kind": "reset", "sensor": "A", "wen": 1}, "wen: no such key of reset; allowed are kind, sensor, at_s, "),
        ({"kind": "reset", "sensor": "A", "bias": [1, 2, 3]}, "bias: no such key of reset"),
        ({"kind": "stuck_bus"}, "for_s is missing; a number of seconds is required"),
        ({"kind": "stuck_bus", "for_s": -1}, "for_s = -1; a number of seconds is required"),
        ({"kind": "stuck_bus", "for_s": True}, "for_s = True; a number of seconds is required"),
        ({"kind": "stuck_bus", "for_s": float("nan")}, "for_s = nan; a number of seconds is required"),
        ({"kind": "stuck_bus", "for_s": float("inf")}, "for_s = inf; a number of seconds is required"),
        ({"kind": "wrong_channel", "for_s": 1, "channel": 4}, "channel = 4; allowed is a whole number up to 3"),
        ({"kind": "wrong_channel", "for_s": 1, "reads_right": 1}, "reads_right = 1; allowed are true and false"),
        ({"kind": "start_up", "sensor": "G", "bias": [1, 2]}, "three numbers are required"),
    ],
)
def test_invalid_faults_are_refused(array: ArrayConfig, table: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=r"^fault 1: ") as refusal:
        faults_from({"fault": [table]}, array)
    assert message in str(refusal.value)


def test_an_error_names_its_line(array: ArrayConfig, tmp_path: Path) -> None:
    path = tmp_path / "n.toml"
    good = '[[fault]]\nkind = "stuck_bus"\nfor_s = 1\n'
    for wrong, message in (
        ('# two\n[[fault]]\nkind = "stuck_bus"\n# a comment\nfor_s = -1\n', ":8: fault 2: for_s = -1; a number"),
        ("[[ fault ]]\nkind = 'reset'\nsensor = 'A'\nwen = 1\n", ":7: fault 2: wen: no such key of reset"),
        ("[[fault]]\nkind = 'stuck_bus'\n", ":4: fault 2: for_s is missing; a number of seconds is required"),
    ):
        path.write_text(good + wrong)
        with pytest.raises(ValueError, match=r"fault 2") as refusal:
            open_bus({"faults": str(path)}, array)
        assert f"{path}{message}" in str(refusal.value)


def test_invalid_files_are_refused(array: ArrayConfig, tmp_path: Path) -> None:
    for text, message in (("[[fault]", "not TOML"), ("[fault]\nkind=1", "tables"), ("other = 1", "tables")):
        (tmp_path / "n.toml").write_text(text)
        with pytest.raises(ValueError, match=message):
            open_bus({"faults": str(tmp_path / "n.toml")}, array)
    with pytest.raises(ValueError, match="No such file"):
        open_bus({"faults": str(tmp_path / "none.toml")}, array)


def test_a_multiplexer_fault_without_a_multiplexer_is_refused() -> None:
    array = parse_array('[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\n')
    with pytest.raises(ValueError, match="array a has no multiplexer"):
        faults_from({"fault": [{"kind": "mux_reset"}]}, array)


def test_the_guide_describes_every_kind_of_fault() -> None:
    lines = (ROOT / "docs" / "how_to" / "emulate.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split("|")[1].strip() for line in lines if line.startswith("| `")]
    assert [row for row in rows if row.strip("`") in FAULTS] == [f"`{kind}`" for kind in FAULTS]
