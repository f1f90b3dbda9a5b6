"""A configuration proposed from the chips that answered: it loads, and names every chip at its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from firmware_emulator.clock import VirtualClock
from imuarray.acquire import Detection, explore
from imuarray.acquire.detection import distinguish_alike, propose
from imuarray.array import load_array, parse_array
from imuarray.bus import open_bus
from imuarray.cli import main
from imuarray.errors import SensorError

SHIPPED = Path(__file__).parents[2] / "configs" / "martin2013.toml"


def test_the_proposal_for_the_papers_array_matches_its_wiring() -> None:
    array = load_array(SHIPPED)
    with open_bus("emulated:", array) as bus:
        proposed = parse_array(propose(explore(bus), "i2c:/dev/i2c-1", "mine"))
    assert (proposed.name, proposed.bus) == ("mine", "i2c:/dev/i2c-1")
    assert proposed.mux == array.mux
    # An HMC5883 and an HMC5883L identify themselves alike.
    wired = {(sensor.chip.removesuffix("l"), sensor.channel, sensor.address) for sensor in array.sensors}
    assert {(sensor.chip.removesuffix("l"), sensor.channel, sensor.address) for sensor in proposed.sensors} == wired


def test_a_bus_without_a_multiplexer_is_proposed_without_one() -> None:
    detections = [Detection("trunk address 0x53", "", "", "adxl345", True, "", None, 0x53)]
    array = parse_array(propose(detections, "i2c:/dev/i2c-1"))
    assert array.mux is None
    assert [(sensor.name, sensor.channel, sensor.address) for sensor in array.sensors] == [("ADXL1", None, 0x53)]


@pytest.mark.parametrize(
    ("chips", "names"),
    [
        ({0x77: "bmp180"}, ["BMP180"]),
        ({0x76: "bmp280", 0x77: "bmp180"}, ["BMP280", "BMP180"]),
        ({0x76: "bmp280", 0x77: "bmp280"}, ["BMP1", "BMP2"]),
    ],
)
def test_a_barometer_is_numbered_where_there_are_two_of_its_type(chips: dict[int, str], names: list[str]) -> None:
    detections = [
        Detection(f"trunk address {address:#04x}", "", "", chip, True, "", None, address)
        for address, chip in chips.items()
    ]
    assert [sensor.name for sensor in parse_array(propose(detections, "i2c:/dev/i2c-1")).sensors] == names


def test_an_unknown_chip_is_not_taken_for_a_multiplexer() -> None:
    """A BME280 at 0x76, which is an address of the multiplexer too, and an ADXL345."""
    bus = Chips({0x76: {0x00: 0x00, 0x05: 0x00, 0xD0: 0x60}, 0x53: {0x00: 0xE5}})
    detections = explore(bus)
    assert [(line.found, line.channel, line.address) for line in detections] == [("adxl345", None, 0x53)]


class Chips:
    """Chips by address, each with its registers behind an address pointer; a bus."""

    source = "i2c"
    clock = VirtualClock()

    def __init__(self, registers: dict[int, dict[int, int]]) -> None:
        self.registers, self.pointers = registers, dict.fromkeys(registers, 0)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        if address not in self.registers:
            raise OSError(121, "no chip acknowledges this address")
        if write:
            self.pointers[address] = write[0]
        first = self.pointers[address]
        return bytes(self.registers[address].get(first + step, 0xFF) for step in range(read))

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("bus", "name"), [('i2c:/dev/"x"', 'a"b\\c'), ("x\ny = 1", "a\nb"), ("serial:/µ", "Größe 🎈")])
def test_names_are_quoted(bus: str, name: str) -> None:
    detections = [Detection("trunk address 0x77", "", "", "bmp180", True, "", None, 0x77)]
    array = parse_array(propose(detections, bus, name))
    assert (array.bus, array.name) == (bus, name)


def test_a_bus_where_no_chip_answers_is_refused() -> None:
    with pytest.raises(SensorError, match="no chip answered"):
        propose([], "i2c:/dev/i2c-1")


def test_hmc5883_and_hmc5883l_are_distinguished_by_their_self_test(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The paper's HMC5883 answer like HMC5883L until they test themselves."""
    new = tmp_path / "new.toml"
    assert main(["detect", "--bus", "emulated:", "-o", str(new)]) == 0
    text = new.read_text()
    assert text.count('chip = "hmc5883"\n') == text.count("range = 1.2\n") == 2
    url = f"emulated:?board={SHIPPED}"
    assert main(["detect", str(new), "--bus", url, "--self-test"]) == 0
    capsys.readouterr()
    new.write_text(text.replace('"hmc5883"', '"hmc5883l"').replace("range = 1.2", "range = 1.3"))
    assert main(["detect", str(new), "--bus", url, "--self-test"]) == 2
    failed = [line for line in capsys.readouterr().out.splitlines() if "FAILED" in line]
    assert len(failed) == 2
    assert all(line.endswith("; fits an hmc5883: is it one?") for line in failed)


def test_both_kinds_of_compass_on_one_board_have_names_of_their_own(tmp_path: Path) -> None:
    text = '[array]\nname="x"\nmux={chip="pca9544a",address=0x70}\n'
    for channel, chip, range_ in ((0, "hmc5883", 1.2), (1, "hmc5883l", 1.3), (3, "hmc5883", 1.2)):
        sensor = f'name="S{channel}"\nchip="{chip}"\nrange={range_}\n'
        text += f"[[sensor]]\n{sensor}address=0x1E\nchannel={channel}\n"
    board = parse_array(text)
    with open_bus("emulated:", board) as bus:
        detections = distinguish_alike(explore(bus), bus)
    proposed = parse_array(propose(detections, "i2c:/dev/i2c-1"))
    assert [(sensor.name, sensor.chip, sensor.channel) for sensor in proposed.sensors] == [
        ("HMC1", "hmc5883", 0),
        ("HMC2", "hmc5883l", 1),
        ("HMC3", "hmc5883", 3),
    ]


def test_types_that_no_self_test_distinguishes_are_a_remark(tmp_path: Path) -> None:
    """A compass without a self-test result is proposed as the more common type, with a remark."""
    bus = Chips({0x1E: {0x0A: 0x48, 0x0B: 0x34, 0x0C: 0x33}})
    detections = distinguish_alike(explore(bus), bus)  # type: ignore[arg-type]
    text = propose(detections, "i2c:/dev/i2c-1")
    assert 'chip = "hmc5883l"  # or hmc5883, with range = 1.2: they identify themselves alike' in text
    assert parse_array(text).sensors[0].chip == "hmc5883l"


def test_an_address_of_a_kernel_driver_is_not_proposed_as_a_sensor() -> None:
    detections = [
        Detection("trunk address 0x68", "", "", "belongs to a driver", True, "", None, 0x68, owner="a driver"),
        Detection("trunk address 0x53", "", "", "adxl345", True, "", None, 0x53),
    ]
    assert [sensor.chip for sensor in parse_array(propose(detections, "i2c:/dev/i2c-1")).sensors] == ["adxl345"]


@pytest.mark.slow
def test_detect_log_and_axes_give_the_orientations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Detect, log, find the axes: no sign is entered by hand."""
    new, poses = tmp_path / "new.toml", tmp_path / "poses.h5"
    assert main(["detect", "--bus", "emulated:", "-o", str(new)]) == 0
    assert main(["detect", "--bus", "emulated:", "-o", str(new)]) == 2  # nothing is overwritten
    new.write_text(new.read_text() + "# my own remark\n")
    url = f"emulated:?world=tumble&face_s=3&board={SHIPPED}"
    assert main(["log", str(new), "--bus", url, "--seconds", "45", "--rate-hz", "25", "-o", str(poses)]) == 0
    assert main(["calibrate", "axes", str(poses), "-o", str(new), "--force"]) == 0
    assert "Gyro2        +X-Y-Z" in capsys.readouterr().out
    wired = {(sensor.channel, sensor.address): sensor.orientation for sensor in load_array(SHIPPED).sensors}
    for sensor in load_array(new).sensors:
        assert sensor.orientation == wired[sensor.channel, sensor.address], sensor.name
    assert "# my own remark" in new.read_text()
