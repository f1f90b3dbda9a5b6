"""Bus URLs: the bus that each opens; any other text is refused in one line that states the allowed forms."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
import smbus2.smbus2

from firmware_emulator.clock import VirtualClock
from firmware_emulator.device_file import Adapter, device_files
from firmware_emulator.wire import Wire
from imuarray.array import parse_array
from imuarray.bus import open_bus
from imuarray.bus.linux import LinuxBus
from imuarray.bus.replay import ReplayBus
from imuarray.errors import BusUrlError, ConfigError

SENSOR = '[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\n'
ARRAY = parse_array(SENSOR)


def refusal(url: str) -> str:
    with pytest.raises(BusUrlError) as refused:
        open_bus(url, ARRAY)
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("url", ["", ":", "i2c", "/dev/i2c-1", "usb:1", "EMULATED:", "emulated", "SERIAL:/dev/ttyACM0"])
def test_text_that_names_no_bus_is_refused(url: str) -> None:
    assert refusal(url).startswith(f"bus {url!r}: allowed are i2c:/dev/i2c-1, serial:/dev/ttyACM0, replay:T.jsonl")


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("?colour=red", "colour: no such parameter; allowed are clock, world, seed"),
        ("?world=moon", "world 'moon'; allowed are still, tumble, heating, shaking"),
        ("?clock=sundial", "clock 'sundial'; allowed are virtual, real"),
        ("?errno=5", "errno=5; allowed are 6, 121"),
        ("?seed=-1", "seed=-1; allowed is a whole number"),
        ("?bit_rate=0", "bit_rate_hz: 0"),
        ("?world=tumble&face_s=x", "face_s=x; allowed is a number"),
        ("?world=tumble&face_s=0", "face_s: 0"),
        ("?world=still&up=up", "up: "),
        ("colour", "colour: no such parameter"),
        (
            "?colour=red&world=still",
            "colour: no such parameter; allowed are clock, world, seed, bit_rate, errno, oscillators, pulse_hz, up,"
            " temperature_degc, mechanism, severity, sensor, units, run, faults, board",
        ),
    ],
)
def test_invalid_parameters_of_the_emulated_bus_are_refused(query: str, message: str) -> None:
    assert refusal(f"emulated:{query}").startswith(f"bus 'emulated:{query}': {message}")


def test_the_emulated_bus_is_opened() -> None:
    with open_bus("emulated:", ARRAY) as bus:
        assert bus.source == "emulated"
        assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"
        assert bus.clock.now_ns() == 93_700  # 36 clocks at 400 kHz and one repeated START: BUS-07


def test_the_emulated_board_is_read_from_another_file(tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(SENSOR.replace("0x53", "0x1D"))
    with open_bus(f"emulated:?board={other}&seed=3", ARRAY) as bus:
        assert bus.transfer(0x1D, b"\x00", 1) == b"\xe5"
        with pytest.raises(OSError, match="no acknowledge from 0x53"):
            bus.transfer(0x53)
    with pytest.raises(ConfigError, match=r"none\.toml: No such file"):
        open_bus(f"emulated:?board={tmp_path / 'none.toml'}", ARRAY)


def test_a_kernel_bus_that_the_board_lacks_is_refused(tmp_path: Path) -> None:
    with open_bus("emulated:", ARRAY) as bus, pytest.raises((OSError, BusUrlError)):
        bus.channel_bus("/dev/i2c-11")


def test_a_transcript_is_opened(tmp_path: Path) -> None:
    (tmp_path / "t.jsonl").write_text('{"to": "53", "write": "00", "read": "e5"}\n')
    with open_bus(f"replay:{tmp_path / 't.jsonl'}", ARRAY) as bus:
        assert isinstance(bus, ReplayBus)
        assert bus.source == "replay"
        assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"
    assert refusal(f"replay:{tmp_path / 'none.jsonl'}").endswith("none.jsonl: No such file or directory")


def test_a_missing_i2c_bus_is_refused() -> None:
    assert refusal("i2c:/dev/no-such-bus").startswith(
        "i2c:/dev/no-such-bus: No such file or directory; buses are /dev/i2c-*"
    )


def test_a_device_other_than_i2c_is_refused() -> None:
    assert refusal("i2c:/dev/null").startswith("i2c:/dev/null: Inappropriate ioctl for device")


def test_an_i2c_bus_without_permission_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(path: str, flags: int) -> int:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)  # LNX-48

    monkeypatch.setattr(smbus2.smbus2, "os", SimpleNamespace(open=forbidden, close=os.close, O_RDWR=os.O_RDWR))
    assert (
        refusal("i2c:/dev/i2c-1")
        == "i2c:/dev/i2c-1: Permission denied; buses are /dev/i2c-* (enable I2C, join group i2c)"
    )


def test_i2c_without_a_path_takes_the_path_of_a_sensor() -> None:
    assert refusal("i2c:") == "bus 'i2c:': name the device, as in i2c:/dev/i2c-1"
    with (
        device_files({"/dev/i2c-11": Adapter(Wire(VirtualClock()))}),
        open_bus("i2c:", parse_array(SENSOR + 'bus="/dev/i2c-11"\n')) as bus,
    ):
        assert isinstance(bus, LinuxBus)
        assert bus.path == "/dev/i2c-11"
        assert bus.channel_bus("/dev/i2c-11") is bus


def test_the_name_of_an_array_is_no_array() -> None:
    with pytest.raises(
        BusUrlError, match="array: 'martin2013' given; allowed is an ArrayConfig, as load_array returns"
    ):
        open_bus("emulated:", "martin2013")  # type: ignore[arg-type]
