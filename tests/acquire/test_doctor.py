"""The checks of a bus by `detect --doctor`, on machines that consist of a few files."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from imuarray.acquire.doctor import Check, Machine, examine, frame_clocks
from imuarray.array import ArrayConfig, parse_array
from imuarray.cli import main
from imuarray.errors import BusUrlError
from imuarray.log.journal import JournalLock, journal_of

PLAIN_I2C = 0x0EFF0009
"""What i2c-bcm2835 says: I2C, 10-bit addresses no, SMBus emulated."""
SMBUS_ONLY = 0x0EFF0008
I2C_GROUP = 998
USER = os.getuid() + 1000

ARRAY = """
[array]
name = "a"
mux = {chip = "pca9544a", address = 0x70}
[[sensor]]
name = "A"
chip = "adxl345"
channel = 0
address = 0x53
range = 4
[[sensor]]
name = "P"
chip = "bmp180"
channel = 1
address = 0x77
rate_hz = 8
"""


@pytest.fixture
def array() -> ArrayConfig:
    return parse_array(ARRAY)


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """A Raspberry Pi with one bus at 400 kHz, and a user who may use it."""
    root = tmp_path / "root"
    bus = root / "sys/bus/i2c/devices/i2c-1"
    (bus / "of_node").mkdir(parents=True)
    (bus / "name").write_text("bcm2835 (i2c@7e804000)\n")
    (bus / "of_node/clock-frequency").write_bytes((400_000).to_bytes(4, "big"))
    (root / "sys/class/i2c-dev").mkdir(parents=True)
    (root / "dev").mkdir()
    (root / "dev/i2c-1").touch()
    (root / "dev/i2c-1").chmod(0o660)
    if os.getuid() == 0:
        os.chown(root / "dev/i2c-1", 0, I2C_GROUP)
    (root / "etc").mkdir()
    group = (root / "dev/i2c-1").stat().st_gid
    (root / "etc/group").write_text(f"daemon:x:1:\ni2c:x:{group}:pi\n")
    return Machine(root, USER, frozenset({USER, group}), lambda device: PLAIN_I2C, lambda folder: 1 << 36)


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    return folder


def failures(checks: list[Check]) -> list[tuple[str, str, str]]:
    assert all(len(check.found.splitlines()) == 1 and check.found.isprintable() for check in checks)
    assert all(check.advice for check in checks if not check.ok)
    return [(check.name, check.found, check.advice) for check in checks if not check.ok]


def only_failure(checks: list[Check]) -> tuple[str, str, str]:
    (result,) = failures(checks)
    return result


URL = "i2c:/dev/i2c-1"


def test_a_working_machine_passes_all_checks(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    checks = examine(array, URL, logs, 50, machine=machine, talk=lambda: [Check("sensors", True, "all 2 answer")])
    assert failures(checks) == []
    results = {check.name: check.found for check in checks}
    assert results["adapter"] == "/dev/i2c-1: bcm2835 (i2c@7e804000)"
    assert "group i2c, mode 0660" in results["permission"]
    assert results["bus clock"].startswith("400 kHz: at most ")
    assert "bcm2835" in results["quirks"]
    assert results["sensors"] == "all 2 answer"


def test_the_scl_clocks_of_a_frame_are_counted(array: ArrayConfig) -> None:
    """BUS-04: 9 (n + 3) clocks for n bytes, 8 and 5 of them; BUS-02: 18 for each of two switches."""
    assert frame_clocks(array) == 9 * 11 + 9 * 8 + 2 * 18


def test_a_machine_without_a_bus_is_reported(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    shutil.rmtree(machine.root / "sys")
    name, result, advice = only_failure(examine(array, URL, logs, 50, machine=machine, talk=pytest.fail))
    assert (name, result) == ("adapter", "this machine has no I2C bus")
    assert "dtparam=i2c_arm=on" in advice


def test_a_module_that_is_not_loaded_is_reported(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    (machine.root / "sys/class/i2c-dev").rmdir()
    (machine.root / "dev/i2c-1").unlink()
    name, _, advice = only_failure(examine(array, URL, logs, 50, machine=machine, talk=pytest.fail))
    assert name == "module i2c-dev"
    assert "modprobe i2c-dev" in advice


def test_other_buses_are_listed_where_the_configured_bus_is_missing(
    array: ArrayConfig, machine: Machine, logs: Path
) -> None:
    name, result, _ = only_failure(examine(array, "i2c:/dev/i2c-7", logs, 50, machine=machine, talk=pytest.fail))
    assert (name, result) == ("adapter", "/dev/i2c-7; there are /dev/i2c-1")


@pytest.mark.parametrize(("mode", "message"), [(0o660, "sudo adduser $USER i2c"), (0o600, "udev rule")])
def test_a_missing_permission_is_reported(
    array: ArrayConfig, machine: Machine, logs: Path, mode: int, message: str
) -> None:
    (machine.root / "dev/i2c-1").chmod(mode)
    stranger = replace(machine, groups=frozenset({USER}))
    name, _, advice = only_failure(examine(array, URL, logs, 50, machine=stranger, talk=pytest.fail))
    assert name == "permission"
    assert message in advice
    assert failures(examine(array, URL, logs, 50, machine=replace(stranger, user=0))) == []


def test_a_bus_that_is_too_slow_is_reported(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    clock = machine.root / "sys/bus/i2c/devices/i2c-1/of_node/clock-frequency"
    clock.write_bytes((10_000).to_bytes(4, "big"))
    name, result, advice = only_failure(examine(array, URL, logs, 50, machine=machine))
    assert (name, result) == ("bus clock", "10 kHz: at most 48 frames of this array a second")  # 10000 / 207
    assert "i2c_arm_baudrate" in advice
    clock.unlink()
    assert failures(examine(array, URL, logs, 50, machine=machine)) == []  # an unknown clock is no failure


def test_an_adapter_of_smbus_alone_is_reported(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    smbus = replace(machine, functionality=lambda device: SMBUS_ONLY)
    name, result, _ = only_failure(examine(array, URL, logs, 50, machine=smbus, talk=pytest.fail))
    assert (name, result) == ("abilities", "/dev/i2c-1: SMBus only")


def bind(machine: Machine, place: str, driver: str) -> Path:
    device = machine.root / "sys/bus/i2c/devices" / place
    device.mkdir()
    (machine.root / "sys/bus/i2c/drivers" / driver).mkdir(parents=True)
    (device / "driver").symlink_to(f"../../drivers/{driver}")
    return device


def test_a_sensor_that_a_kernel_driver_owns_is_reported(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    bind(machine, "1-0053", "adxl34x")
    name, result, advice = only_failure(examine(array, URL, logs, 50, machine=machine, talk=pytest.fail))
    assert (name, result) == ("kernel driver", "/dev/i2c-1 0x53 (A) belongs to adxl34x")
    assert advice == "echo 1-0053 | sudo tee /sys/bus/i2c/drivers/adxl34x/unbind"


def test_a_multiplexer_that_a_kernel_driver_owns_is_reported(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    mux = bind(machine, "1-0070", "pca954x")
    for channel in range(2):
        (mux / f"channel-{channel}").symlink_to(f"../i2c-{11 + channel}")
    name, result, advice = only_failure(examine(array, URL, logs, 50, machine=machine, talk=pytest.fail))
    assert (name, result) == ("kernel driver", "/dev/i2c-1 0x70 (the multiplexer) belongs to pca954x")
    assert "channel-0 is /dev/i2c-11, channel-1 is /dev/i2c-12" in advice


def test_a_multiplexer_at_the_barometers_address_is_reported(machine: Machine, logs: Path) -> None:
    text = (
        ARRAY.replace("0x70", "0x77").replace('chip = "bmp180"', 'chip = "adxl345"').replace("rate_hz = 8", "range = 2")
    )
    array = parse_array(text.replace("address = 0x77\nrange", "address = 0x1D\nrange"))
    name, result, advice = only_failure(examine(array, URL, logs, 50, machine=machine, talk=pytest.fail))
    assert (name, result) == ("address 0x77", "the multiplexer has the BMP180's address")
    assert "0x70 to 0x76" in advice


def test_a_multiplexer_of_the_kernel_at_the_barometers_address_is_reported(machine: Machine, logs: Path) -> None:
    array = parse_array('[array]\nname="a"\n[[sensor]]\nname="P"\nchip="bmp180"\nbus="/dev/i2c-11"\naddress=0x77\n')
    devices = machine.root / "sys/bus/i2c/devices"
    (devices / "i2c-11").mkdir()
    (devices / "i2c-11/mux_device").symlink_to("../1-0077")
    (machine.root / "dev/i2c-11").touch()
    (machine.root / "dev/i2c-11").chmod(0o666)
    name, result, _ = only_failure(examine(array, "i2c:", logs, 5, machine=machine, talk=pytest.fail))
    assert (name, result) == ("address 0x77", "P: the multiplexer before it has its address")


def test_errors_of_opening_and_talking_are_reported(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    def locked() -> list[Check]:
        raise BusUrlError("i2c:/dev/i2c-1: another program has locked this bus")

    def hung() -> list[Check]:
        raise OSError(110, "Connection timed out")

    assert only_failure(examine(array, URL, logs, 50, machine=machine, talk=locked))[0] == "opening"
    name, result, advice = only_failure(examine(array, URL, logs, 50, machine=machine, talk=hung))
    assert (name, result) == ("talking", "Connection timed out (errno 110)")
    assert "holds a wire low" in advice


def test_a_serial_port_is_checked(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    url = "serial:/dev/ttyACM0?baud=921600"
    assert only_failure(examine(array, url, logs, 50, machine=machine, talk=pytest.fail))[:2] == (
        "port",
        "/dev/ttyACM0; there are none",
    )
    shutil.copy2(machine.root / "dev/i2c-1", machine.root / "dev/ttyACM0")
    (machine.root / "dev/ttyACM0").chmod(0o666)
    assert failures(examine(array, url, logs, 50, machine=machine, talk=list)) == []
    (machine.root / "proc/77").mkdir(parents=True)
    (machine.root / "proc/77/comm").write_text("ModemManager\n")
    assert only_failure(examine(array, url, logs, 50, machine=machine))[0] == "ModemManager"


def test_free_space_on_the_disk_is_checked(array: ArrayConfig, machine: Machine, logs: Path) -> None:
    nearly_full = replace(machine, free_bytes=lambda folder: 70 << 20)
    name, result, _ = only_failure(examine(array, URL, logs, 50, machine=nearly_full))
    assert name == "disk"
    # 50 rows of 8 + 6 + 2 bytes and 8 of 8 + 8 + 2 + 16, twice: 2144 bytes/s; 70 - 64 - 1 MiB are for them
    assert result == f"70 MiB free: about {5 * 2**20 / 2144 / 3600:.1f} h at 50 frames a second"
    for gigabytes, about in ((0.2, "19 h"), (9, "52 days")):  # less the 65 MiB, at 2144 bytes/s
        plenty = replace(machine, free_bytes=lambda folder, free=gigabytes: int(free * 2**30))
        result = {check.name: check.found for check in examine(array, URL, logs, 50, machine=plenty)}
        assert f": about {about} at" in result["disk"]
    assert only_failure(examine(array, URL, logs / "none", 50, machine=machine))[0] == "folder"


def test_journals_and_drafts_of_earlier_recordings_are_reported(
    array: ArrayConfig, machine: Machine, logs: Path
) -> None:
    (logs / "old.h5").touch()
    (logs / "old.h5.journal").write_bytes(b"x")
    (logs / ".new.h5.4711.part").touch()
    (logs / f".now.h5.{os.getpid()}.part").touch()
    (machine.root / "proc" / str(os.getpid())).mkdir(parents=True)
    lock = JournalLock(logs / "now.h5", create=True)
    assert [(name, advice) for name, _, advice in failures(examine(array, URL, logs, 50, machine=machine))] == [
        ("journal", f"imuarray recover {logs / 'old.h5'}"),
        ("draft", f"rm {logs / '.new.h5.4711.part'}"),
    ]
    lock.close()
    journal_of(logs / "now.h5").unlink()


def test_the_command_reports_all_checks(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["detect", "martin2013", "--bus", "emulated:", "--doctor", "--logs", str(logs)]
    free = os.statvfs(logs).f_bavail * os.statvfs(logs).f_frsize
    if free < 8 << 30:
        pytest.skip("this disk is nearly full")
    assert main(asked) == 0
    assert "all 13 answer" in capsys.readouterr().out
    (logs / "old.h5.journal").write_bytes(b"x")
    assert main([*asked, "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is False
    assert [check["name"] for check in report["checks"] if not check["ok"]] == ["journal"]


def test_without_a_configuration_owners_and_limits_are_listed_and_not_judged(machine: Machine, logs: Path) -> None:
    """No addresses are known: owners are named but not judged; the clock of the bus and the free space are stated."""
    bind(machine, "1-0068", "rtc-ds1307")
    checks = examine(None, URL, logs, 50, machine=machine, talk=lambda: [Check("chips", True, "2 answer")])
    assert failures(checks) == []
    results = {check.name: check.found for check in checks}
    assert results["kernel driver"] == "/dev/i2c-1 0x68 belongs to rtc-ds1307: no sensor there can be read"
    assert (results["bus clock"], results["disk"], results["chips"]) == ("400 kHz", "65536 MiB free", "2 answer")
    nearly_full = replace(machine, free_bytes=lambda folder: 60 << 20)
    assert only_failure(examine(None, URL, logs, 50, machine=nearly_full))[:2] == ("disk", "60 MiB free")
    shutil.rmtree(machine.root / "sys/bus/i2c/devices/1-0068")
    results = {check.name: check.found for check in examine(None, URL, logs, 50, machine=machine)}
    assert results["kernel driver"] == "/dev/i2c-1: none owns an address"


def test_the_command_needs_a_bus_where_there_is_no_configuration(
    logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["detect", "--doctor", "--logs", str(logs)]
    assert main([*asked, "--bus", "emulated:", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["array"], report["ok"]) == (None, True)
    chips = "1 pca9544a, 2 adxl345, 4 bma180, 3 l3g4200d, 1 bmp180, 2 hmc5883 or hmc5883l"
    (result,) = (check["found"] for check in report["checks"] if check["name"] == "chips")
    assert sorted(result.removeprefix("13 answer: ").split(", ")) == sorted(chips.split(", "))
    assert main(asked) == 1
    assert "NO  bus            none is named -> give --bus i2c:/dev/i2c-1" in capsys.readouterr().out
    assert main([*asked, "--bus", "emulated:", "-o", "new.toml"]) == 2
    assert "-o can't be combined with --doctor" in capsys.readouterr().err


def test_a_bus_where_no_chip_answers_is_reported(
    tmp_path: Path, logs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "far.toml").write_text(
        '[array]\nname="f"\n[[sensor]]\nname="P"\nchip="bmp180"\nbus="/dev/i2c-9"\naddress=0x77\n'
    )
    bus = f"emulated:?board={tmp_path / 'far.toml'}"
    assert main(["detect", "--bus", bus, "--doctor", "--logs", str(logs)]) == 1
    assert "NO  chips          no known chip answers -> check supply" in capsys.readouterr().out


def test_the_doctor_needs_a_named_bus(tmp_path: Path, logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The doctor refuses the emulated bus as a default; plain detect uses it and states that."""
    mine = tmp_path / "mine.toml"
    mine.write_text(ARRAY)
    assert main(["detect", str(mine), "--doctor", "--logs", str(logs)]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  NO  bus")]
    assert len(lines) == 1
    assert "none is named -> give --bus i2c:/dev/i2c-1" in lines[0]
    assert main(["detect", str(mine)]) == 0
    assert capsys.readouterr().err == f"imuarray: {mine}: no bus is configured: using the emulated array, no hardware\n"
    assert main(["detect", str(mine), "--logs", str(logs)]) == 2
    assert "--logs needs --doctor" in capsys.readouterr().err


def test_the_command_names_a_silent_sensor(tmp_path: Path, logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "board.toml").write_text(ARRAY)
    (tmp_path / "mine.toml").write_text(ARRAY.replace("0x53", "0x1D"))
    bus = f"emulated:?board={tmp_path / 'board.toml'}"
    assert main(["detect", str(tmp_path / "mine.toml"), "--bus", bus, "--doctor", "--logs", str(logs)]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  NO ")]
    assert len(lines) == 1
    assert "A (adxl345) at channel 0 address 0x1d" in lines[0]
    assert "address pin" in lines[0]
