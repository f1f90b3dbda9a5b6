"""The chips that answer are compared with the configuration: as configured, wrong, missing and unexpected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_emulator.array import open_array
from firmware_emulator.device_file import Adapter, device_files
from firmware_emulator.wire import Wire
from imuarray.acquire import Detection, detect, explore
from imuarray.acquire.bus_segment import connect
from imuarray.array import load_array, parse_array
from imuarray.bus import open_bus
from imuarray.bus.linux import LinuxBus
from imuarray.cli import main

SHIPPED = Path(__file__).parents[2] / "configs" / "martin2013.toml"


def detections(array: Any, board: Any, folder: Path, number: int = 121) -> list[Detection]:
    (folder / "board.toml").write_text(board.text)
    with open_bus(f"emulated:?errno={number}&board={folder / 'board.toml'}", array) as bus:
        return detect(array, bus)


def test_the_papers_array_is_detected_as_configured() -> None:
    array = load_array(SHIPPED)
    with open_bus("emulated:", array) as bus:
        lines = detect(array, bus)
    assert [line.sensor for line in lines] == ["mux", *(sensor.name for sensor in array.sensors)]
    assert all(line.ok and line.found.startswith(line.expected) for line in lines)


@pytest.mark.parametrize("number", [6, 121])
def test_a_missing_chip_is_reported(an_array: Callable[..., Any], tmp_path: Path, number: int) -> None:
    lines = detections(an_array(A=0, B=1), an_array(A=0), tmp_path, number)
    assert [(line.sensor, line.ok) for line in lines] == [("mux", True), ("A", True), ("B", False)]
    assert lines[2] == Detection("channel 1 address 0x40", "B", "bma180", "no chip acknowledges this address", False)


def test_a_chip_of_wrong_identity_is_reported(an_array: Callable[..., Any], tapped: Callable[..., Any]) -> None:
    array = an_array(A=0, G=2)
    bus = tapped(array)
    bus.chips["G"].page[0x0F] = 0xD4
    assert detect(array, bus)[-1] == Detection(
        "channel 2 address 0x68", "G", "l3g4200d", "identity d4, expected d3", False
    )


def test_unexpected_chips_are_listed(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = detections(an_array(A=0), an_array(A=0, B=3, M=1, P=0), tmp_path)
    assert all(line.ok for line in lines)
    assert {(line.place, line.found) for line in lines if not line.sensor} == {
        ("channel 0 address 0x77", "bmp180"),
        ("channel 1 address 0x1e", "hmc5883 or hmc5883l"),
        ("channel 3 address 0x40", "bma180"),
    }


def test_a_sensor_in_another_place_is_missing_here_and_unexpected_there(
    an_array: Callable[..., Any], tmp_path: Path
) -> None:
    lines = detections(an_array(A=0), an_array(A=2), tmp_path)
    assert [(line.place, line.ok, line.expected) for line in lines[1:]] == [
        ("channel 0 address 0x53", False, "adxl345"),
        ("channel 2 address 0x53", True, ""),
    ]


def test_a_missing_mux_is_reported(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = detections(an_array(A=0), an_array(0x74, A=0), tmp_path)
    assert [(line.sensor, line.ok) for line in lines] == [("mux", False), ("A", False)]
    assert lines[0].found.startswith("no answer")


@pytest.mark.parametrize(
    ("source", "message"),
    [("emulated", "no chip answers; imuarray detect --doctor --bus emulated:"), ("iio", "the kernel serves no device")],
)
def test_a_bus_without_chips_is_reported(
    source: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("imuarray.acquire.explore", lambda bus: [])
    monkeypatch.setattr("firmware_emulator.array.EmulatedBus.source", source)
    assert main(["detect", "--bus", "emulated:"]) == 0
    assert message in capsys.readouterr().out


def test_detects_chips_without_a_mux(tmp_path: Path) -> None:
    text = '[array]\nname="x"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\n'
    stranger = text + '[[sensor]]\nname="P"\nchip="bmp180"\naddress=0x77\n'
    lines = detections(parse_array(text), parse_array(stranger), tmp_path)
    assert [(line.place, line.sensor, line.found) for line in lines] == [
        ("trunk address 0x53", "A", "adxl345"),
        ("trunk address 0x77", "", "bmp180"),
    ]


def test_detection_changes_no_chip(an_array: Callable[..., Any], tapped: Callable[..., Any]) -> None:
    array = an_array(A=0, B=1, G=2, M=3, P=0)
    bus = tapped(array)
    detect(array, bus)
    assert {call.address for call in bus.calls if len(call.write) > 1} == set()
    assert {len(call.write) for call in bus.calls if call.address == 0x70} <= {0, 1}


def test_unexpected_chips_behind_a_mux_at_0x77_are_listed(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = detections(an_array(0x77, A=0), an_array(0x77, A=0, M=1), tmp_path)
    assert [(line.place, line.found) for line in lines if not line.sensor] == [
        ("channel 1 address 0x1e", "hmc5883 or hmc5883l")
    ]


def test_an_unexpected_chip_on_the_trunk_is_listed_once(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = detections(an_array(A=0), an_array(A=0, B=None), tmp_path)
    assert [line.found for line in lines if not line.sensor] == ["bma180"]


def test_a_bus_without_a_configuration_is_explored() -> None:
    """Every chip of the paper's array is detected behind its multiplexer, without a configuration."""
    array = load_array(Path(__file__).parents[2] / "configs" / "martin2013.toml")
    with open_bus("emulated:", array) as bus:
        lines = explore(bus)
    assert lines[0].found == "pca9544a"
    assert sorted(line.found for line in lines[1:]) == sorted(
        4 * ["bma180"] + 2 * ["adxl345"] + 3 * ["l3g4200d"] + ["bmp180"] + 2 * ["hmc5883 or hmc5883l"]
    )


@pytest.mark.parametrize(("chip", "address"), [("bmp180", 0x77), ("bmp280", 0x77), ("bmp280", 0x76), ("bmp388", 0x76)])
def test_a_barometer_alone_is_not_taken_for_a_multiplexer(chip: str, address: int) -> None:
    lone = parse_array(f'[array]\nname = "x"\n[[sensor]]\nname = "P"\nchip = "{chip}"\naddress = {address}\n')
    with open_bus("emulated:", lone) as bus:
        assert [(line.place, line.found) for line in explore(bus)] == [(f"trunk address {address:#04x}", chip)]


def driven(folder: Path, *owned: tuple[str, str]) -> Path:
    """A folder like /sys/bus/i2c/devices: places and the drivers that have them."""
    for place, driver in owned:
        (folder / "drivers" / driver).mkdir(parents=True, exist_ok=True)
        (folder / place).mkdir()
        (folder / place / "driver").symlink_to(folder / "drivers" / driver)
    return folder


def seen_by_linux(
    array: Any, folder: Path, *owned: tuple[int, str], explored: bool = False
) -> tuple[list[Detection], Any]:
    """What is found on an adapter on which drivers of the kernel have these addresses; and the emulated array."""
    board = open_array(array)
    devices = driven(folder, *((f"1-{address:04x}", driver) for address, driver in owned))
    adapters = {"/dev/i2c-1": Adapter(board.wire, owned=dict(owned))}
    with device_files(adapters), LinuxBus("/dev/i2c-1", devices=devices) as bus:
        return (explore(bus) if explored else detect(array, bus)), board


def test_a_kernel_driver_that_owns_an_address_is_named(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines, _ = seen_by_linux(an_array(A=0, B=1), tmp_path, (0x40, "bma180"))
    assert [(line.sensor, line.ok) for line in lines] == [("mux", True), ("A", True), ("B", False)]
    assert "address 0x40 belongs to the kernel's driver 'bma180'; unbind that driver" in lines[2].found


def test_a_multiplexer_that_the_kernel_switches_is_not_accessed(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines, board = seen_by_linux(an_array(A=0, B=1), tmp_path, (0x70, "pca954x"))
    assert [(line.sensor, line.ok) for line in lines] == [("mux", False), ("A", False), ("B", False)]
    assert "belongs to the kernel's driver 'pca954x'" in lines[0].found
    assert "leave out mux" in lines[0].found
    assert lines[1].found == "not checked: its multiplexer belongs to the kernel"
    assert board.wire.transactions == 0


def test_an_address_of_a_kernel_driver_for_another_device_is_listed(
    an_array: Callable[..., Any], tmp_path: Path
) -> None:
    """A real-time clock at 0x68, where an L3G4200D could be: it is listed, not accessed, and no failure."""
    lines, _ = seen_by_linux(an_array(A=0), tmp_path, (0x68, "rtc-ds1307"), (0x71, "at24"), explored=True)
    assert [(line.place, line.ok) for line in lines] == [
        ("trunk address 0x70", True),
        ("trunk address 0x68", True),
        ("trunk address 0x71", True),
        ("channel 0 address 0x53", True),
    ]
    assert "'rtc-ds1307'" in lines[1].found
    assert lines[1].owner


def test_an_emulated_kernel_driver_is_reported(
    an_array: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    array = an_array(A=0, B=None)
    (tmp_path / "a.toml").write_text(array.text)
    (tmp_path / "n.toml").write_text('[[fault]]\nkind="kernel_driver"\nsensor="B"\nfor_s=1000\n')
    url = f"emulated:?faults={tmp_path / 'n.toml'}"
    assert main(["detect", str(tmp_path / "a.toml"), "--bus", url]) == 2
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "B (bma180)" in line]
    assert line.startswith("  NO ")
    assert line.endswith("belongs to a driver of the kernel; unbind that driver")


def test_an_undetermined_self_test_neither_passes_nor_fails(
    an_array: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bus that takes 30 ms a transaction."""
    (tmp_path / "a.toml").write_text(an_array(A=0, B=1).text)
    transfer = Wire.transfer

    def slow(wire: Wire, *arguments: Any, **keywords: Any) -> bytes:
        wire.clock.advance(30_000_000)
        return transfer(wire, *arguments, **keywords)

    monkeypatch.setattr(Wire, "transfer", slow)
    assert main(["detect", str(tmp_path / "a.toml"), "--bus", "emulated:", "--self-test"]) == 1
    output = capsys.readouterr().out
    assert "  ?   channel 1 address 0x40   B (bma180)" in output
    assert "self-test undetermined" in output
    assert output.splitlines()[-1] == "2 of 3 as configured, 0 not, 1 undetermined"


def test_an_active_adaptive_range_is_a_remark_and_no_failure() -> None:
    """TDK-18: on after power-on, off once the driver has set the chip up."""
    array = load_array(SHIPPED.with_name("icm42688x8.toml")).only(("IMU1_acc", "IMU1_gyro"))
    bus = open_array(array)
    acc, gyro = detect(array, bus)
    assert (acc.ok, gyro.ok) == (True, True)
    assert acc.remark == ""
    assert gyro.remark.startswith("its adaptive range is on, as after power-on")
    connect(array, bus)
    assert [line.remark for line in detect(array, bus)] == ["", ""]
    spi = bus.spi_port("/dev/spidev0.0", 3, 24_000_000)
    spi.exchange(bytes([0x76, 0x01]))  # 0x4D is now a register of bank 1
    assert [line.remark for line in detect(array, bus)] == ["", ""]
