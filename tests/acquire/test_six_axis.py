"""Two sensors that are one chip: configuration, clones, a chip that falls asleep, a mixed array from log to gap."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_array
from imuarray.acquire import connect
from imuarray.acquire.bus_segment import routes_of, witnesses_of
from imuarray.acquire.detection import detect, explore, propose
from imuarray.array import load_array, parse_array
from imuarray.cli import main
from imuarray.errors import ConfigError, SensorError
from imuarray.log import open_log

HEAD = '[array]\nname = "six"\nmux = { chip = "pca9544a", address = 0x70 }\n'
SHIPPED = Path(__file__).parents[2] / "configs" / "mpu6050x4.toml"
STALE, SUSPECT = 1, 32


def half(name: str, channel: int = 0, **settings: Any) -> str:
    """One [[sensor]] table."""
    wanted = {"chip": "mpu6050", "channel": channel, "address": 0x68, "rate_hz": 500.0, **settings}
    return f'[[sensor]]\nname = "{name}"\n' + "".join(f"{key} = {json.dumps(value)}\n" for key, value in wanted.items())


def test_the_range_selects_the_half_of_a_chip() -> None:
    array = parse_array(HEAD + half("A", range=4.0) + half("G", range=500.0))
    assert [sensor.spec.quantity for sensor in array.sensors] == ["specific_force", "angular_rate"]
    assert [sensor.sensitivity for sensor in array.sensors] == [8192.0, 65.5]  # INV-40, INV-41
    named = parse_array(HEAD + half("A", chip="mpu6050_acc", range=4.0))
    assert named.sensors[0] == array.sensors[0]


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (half("G", range=500.0, rate_hz=250.0), "'A' and 'G' are one mpu6050: rate_hz is the same for both"),
        (half("G", range=500.0, axes="-X-Y+Z"), "'A' and 'G' are one mpu6050: axes is the same for both"),
        (half("G", range=500.0, bandwidth_hz=98.0), "bandwidth_hz 44 of the first requires 42 of the second, not 98"),
        (half("G", range=2.0), "sensors 'A' and 'G' are both at channel 0 address 0x68"),
        (half("G", range=3.0), "range 3: allowed are 2, 4, 8, 16, 250, 500, 1000, 2000"),
    ],
)
def test_halves_that_cannot_be_one_chip_are_refused(second: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_array(HEAD + half("A", range=4.0) + second)


def test_a_third_sensor_at_the_address_of_a_chip_is_refused() -> None:
    with pytest.raises(ConfigError, match="are both at"):
        parse_array(HEAD + half("A", range=4.0) + half("G", range=500.0) + half("H", range=250.0))


@pytest.mark.parametrize(
    ("identity", "message"),
    [
        (0x98, "identity 98, a clone sold as MPU-6050"),  # users' reports; the kernel's ICM-20689
        (0x70, "identity 70, an MPU-6500, expected 68"),  # the kernel's whoami values
        (0x71, "identity 71, an MPU-9250, expected 68"),
        (0x00, "identity 00, expected 68"),
    ],
)
def test_another_chip_is_named_by_its_type(identity: int, message: str) -> None:
    array = load_array(SHIPPED)
    with open_array(array, switches={"IMU3_acc": {"identity": identity}}) as bus:
        with pytest.raises(SensorError, match=message) as refused:
            connect(array, bus)
        assert "\n" not in str(refused.value)
        lines = [line for line in detect(array, bus) if not line.ok]
    assert [line.sensor for line in lines] == ["IMU3_acc", "IMU3_gyro"]


def test_twins_are_marked_and_distinguished() -> None:
    array = load_array(SHIPPED)
    with open_array(array) as bus:
        routes = connect(array, bus)
        registers = [{entry.setting.register.address for entry in witnesses_of(route, routes)} for route in routes]
        marks = [bus.chips[sensor.name].page[0x63] for sensor in array.sensors]
    assert all(0x63 in seen for seen in registers)
    assert marks == [1, 1, 2, 2, 3, 3, 4, 4]  # both halves of a die agree


def test_a_six_axis_chip_is_proposed_as_two_sensors() -> None:
    array = load_array(SHIPPED)
    with open_array(array) as bus:
        text = propose(explore(bus), "emulated:")
    proposed = parse_array(text)
    assert [sensor.name for sensor in proposed.sensors][:4] == ["IMU1_acc", "IMU1_gyro", "IMU2_acc", "IMU2_gyro"]
    assert {sensor.chip for sensor in proposed.sensors} == {"mpu6050_acc", "mpu6050_gyro"}


def test_both_halves_read_the_same_burst_of_one_die() -> None:
    array = parse_array(HEAD + half("A", range=4.0) + half("G", range=500.0))
    with open_array(array) as bus:
        assert bus.chips["A"] is bus.chips["G"]
        first, second = (route.driver for route in routes_of(array, bus))
        first.configure()
        second.configure()
        assert first.fetch() == second.fetch()


def run(*words: str) -> None:
    """Run a command, which must succeed."""
    assert main(list(words)) == 0


@pytest.mark.slow
def test_a_sleeping_chip_is_flagged_within_a_second_and_woken(tmp_path: Path) -> None:
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nkind = "reset"\nsensor = "IMU2_acc"\nat_s = 4.0\n')
    path = tmp_path / "run.h5"
    run("log", str(SHIPPED), "--bus", f"emulated:?faults={faults}", "-o", str(path), "--seconds", "10")
    with open_log(path) as log:
        events = [(event.sensor, event.kind) for event in log.events]
        for name in ("IMU2_acc", "IMU2_gyro"):
            assert (name, "configuration") in events
            assert (name, "reconfigured") in events
            flagged = (np.asarray(log[name].status[:]) & (STALE | SUSPECT)) != 0
            asleep = (log[name].counts[:] == 0).all(axis=1)
            assert asleep.any()
            assert flagged[asleep].all()
            assert (log[name].time[:][flagged].max() - log[name].time[:][flagged].min()) < 1e9
            assert not flagged[-50:].any()
        for name in ("IMU1_acc", "IMU3_gyro"):
            assert not np.asarray(log[name].status[:]).any()


MIXED = (
    HEAD
    + half("ADXL1", chip="adxl345", address=0x53, range=4.0, rate_hz=400.0)
    + half("Gyro1", chip="l3g4200d", address=0x69, range=250.0, rate_hz=400.0, bandwidth_hz=50.0, axes="-X+Y-Z")
    + half("IMU1_acc", range=2.0)
    + half("IMU1_gyro", range=250.0)
    + half("IMU2_acc", 1, range=2.0, axes="+X-Y-Z")
    + half("IMU2_gyro", 1, range=250.0, axes="+X-Y-Z")
)


@pytest.mark.campaign
def test_an_array_of_old_and_new_chips_is_logged_fused_and_diagnosed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No effect is diagnosed that the emulated chips do not have. The slow half diagnoses a part of the array of
    `test_mixed_array`.
    """
    config, tumble, still = tmp_path / "mixed.toml", tmp_path / "tumble.h5", tmp_path / "still.h5"
    calibration, fused = tmp_path / "cal.toml", tmp_path / "fused.h5"
    config.write_text(MIXED)
    run("log", str(config), "--bus", "emulated:?world=tumble&face_s=20", "-o", str(tumble), "--seconds", "130")
    run("log", str(config), "--bus", "emulated:", "-o", str(still), "--seconds", "60", "--phase", "static")
    run("info", str(still))
    run("calibrate", "tumble", str(tumble), "-o", str(calibration))
    run("fuse", str(still), "--calibration", str(calibration), "--technique", "optimal", "-o", str(fused))
    capsys.readouterr()
    run("gap", "diagnose", str(still), str(tumble), "-o", str(tmp_path / "gap"), "--json")
    diagnosis = json.loads(capsys.readouterr().out)
    assert diagnosis["verdict"] in ("no gap", "explained")
    # each part's own bias, scale and g-sensitivity are those of its data sheet: no cause
    assert [cause["effect"] for cause in diagnosis["causes"] if cause["probability"] > 0.9] == []
