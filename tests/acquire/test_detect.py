"""What answers, and is it what the configuration says: right, wrong, missing, and strangers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from imuarray.acquire import Found, detect, explore
from imuarray.array import load_array, parse_array
from imuarray.bus import open_bus

SHIPPED = Path(__file__).parents[2] / "configs" / "martin2013.toml"


def found(array: Any, board: Any, folder: Path, number: int = 121) -> list[Found]:
    (folder / "board.toml").write_text(board.text)
    with open_bus(f"emulated:?errno={number}&board={folder / 'board.toml'}", array) as bus:
        return detect(array, bus)


def test_the_papers_array() -> None:
    array = load_array(SHIPPED)
    with open_bus("emulated:", array) as bus:
        lines = detect(array, bus)
    assert [line.sensor for line in lines] == ["mux", *(sensor.name for sensor in array.sensors)]
    assert all(line.ok and line.found.startswith(line.expected) for line in lines)


@pytest.mark.parametrize("number", [6, 121])
def test_missing(an_array: Callable[..., Any], tmp_path: Path, number: int) -> None:
    lines = found(an_array(A=0, B=1), an_array(A=0), tmp_path, number)
    assert [(line.sensor, line.ok) for line in lines] == [("mux", True), ("A", True), ("B", False)]
    assert lines[2] == Found("channel 1 address 0x40", "B", "bma180", "nobody acknowledges this address", False)


def test_wrong(an_array: Callable[..., Any], tapped: Callable[..., Any]) -> None:
    array = an_array(A=0, G=2)
    bus = tapped(array)
    bus.chips["G"].page[0x0F] = 0xD4
    assert detect(array, bus)[-1] == Found("channel 2 address 0x68", "G", "l3g4200d", "identity d4, expected d3", False)


def test_strangers(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = found(an_array(A=0), an_array(A=0, B=3, M=1, P=0), tmp_path)
    assert all(line.ok for line in lines)
    assert {(line.place, line.found) for line in lines if not line.sensor} == {
        ("channel 0 address 0x77", "bmp180"),
        ("channel 1 address 0x1e", "hmc5883 or hmc5883l"),
        ("channel 3 address 0x40", "bma180"),
    }


def test_a_sensor_in_another_place_is_missing_and_a_stranger(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = found(an_array(A=0), an_array(A=2), tmp_path)
    assert [(line.place, line.ok, line.expected) for line in lines[1:]] == [
        ("channel 0 address 0x53", False, "adxl345"),
        ("channel 2 address 0x53", True, ""),
    ]


def test_a_missing_mux(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = found(an_array(A=0), an_array(0x74, A=0), tmp_path)
    assert [(line.sensor, line.ok) for line in lines] == [("mux", False), ("A", False)]
    assert lines[0].found.startswith("nobody")


def test_without_a_mux(tmp_path: Path) -> None:
    text = '[array]\nname="x"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\n'
    stranger = text + '[[sensor]]\nname="P"\nchip="bmp180"\naddress=0x77\n'
    lines = found(parse_array(text), parse_array(stranger), tmp_path)
    assert [(line.place, line.sensor, line.found) for line in lines] == [
        ("trunk address 0x53", "A", "adxl345"),
        ("trunk address 0x77", "", "bmp180"),
    ]


def test_no_chip_is_changed(an_array: Callable[..., Any], tapped: Callable[..., Any]) -> None:
    array = an_array(A=0, B=1, G=2, M=3, P=0)
    bus = tapped(array)
    detect(array, bus)
    assert {call.address for call in bus.calls if len(call.write) > 1} == set()
    assert {len(call.write) for call in bus.calls if call.address == 0x70} <= {0, 1}


def test_strangers_behind_a_mux_at_0x77(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = found(an_array(0x77, A=0), an_array(0x77, A=0, M=1), tmp_path)
    assert [(line.place, line.found) for line in lines if not line.sensor] == [
        ("channel 1 address 0x1e", "hmc5883 or hmc5883l")
    ]


def test_a_stranger_on_the_trunk_is_told_once(an_array: Callable[..., Any], tmp_path: Path) -> None:
    lines = found(an_array(A=0), an_array(A=0, B=None), tmp_path)
    assert [line.found for line in lines if not line.sensor] == ["bma180"]


def test_a_bus_of_which_nobody_has_written_yet() -> None:
    """Every chip of the paper's array is found behind its multiplexer, without a configuration."""
    array = load_array(Path(__file__).parents[2] / "configs" / "martin2013.toml")
    with open_bus("emulated:", array) as bus:
        lines = explore(bus)
    assert lines[0].found == "pca9544a"
    assert sorted(line.found for line in lines[1:]) == sorted(
        4 * ["bma180"] + 2 * ["adxl345"] + 3 * ["l3g4200d"] + ["bmp180"] + 2 * ["hmc5883 or hmc5883l"]
    )


def test_a_lone_barometer_is_not_taken_for_a_multiplexer() -> None:
    lone = parse_array('[array]\nname = "x"\n[[sensor]]\nname = "P"\nchip = "bmp180"\naddress = 0x77\n')
    with open_bus("emulated:", lone) as bus:
        assert [(line.place, line.found) for line in explore(bus)] == [("trunk address 0x77", "bmp180")]
