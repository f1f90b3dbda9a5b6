"""An array that mixes old chips with chips that can be bought today is detected, logged, exported, calibrated, fused,
reported and diagnosed as any other.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import imuarray
from firmware_emulator.units import unit_of
from firmware_emulator.world import StillWorld
from imuarray.array import parse_array
from imuarray.cli import main
from imuarray.fuse import read_fused, read_fused_head
from imuarray.log import open_log
from imuarray.log.datasets import physical_values

pytestmark = pytest.mark.slow

MIXED = """
[array]
name = "mixed"
mux = { chip = "pca9544a", address = 0x70 }
"""
PLACES = {
    "BMA1": 'chip = "bma180"\nchannel = 0\naddress = 0x40\nrange = 4\nbandwidth_hz = 150\naxes = "+X+Y+Z"',
    "ADXL1": 'chip = "adxl345"\nchannel = 0\naddress = 0x53\nrange = 4\nrate_hz = 400\naxes = "-X-Y+Z"',
    "Gyro1": 'chip = "l3g4200d"\nchannel = 0\naddress = 0x69\nrange = 250\nrate_hz = 400\naxes = "+X+Y+Z"',
    "HMC1": 'chip = "hmc5883l"\nchannel = 0\naddress = 0x1E\nrange = 1.3\nrate_hz = 75',
    "BMP180": 'chip = "bmp180"\nchannel = 0\naddress = 0x77\nrate_hz = 8',
    "IMU1_acc": 'chip = "lsm6dso"\nchannel = 1\naddress = 0x6A\nrange = 4\nrate_hz = 416\naxes = "+X-Y-Z"',
    "IMU1_gyro": 'chip = "lsm6dso"\nchannel = 1\naddress = 0x6A\nrange = 250\nrate_hz = 416\naxes = "+X-Y-Z"',
    "LIS1": 'chip = "lis3mdl"\nchannel = 1\naddress = 0x1C\nrange = 4',
    "MMC1": 'chip = "mmc5983"\nchannel = 1\naddress = 0x30\nrange = 8',
    "BMP280": 'chip = "bmp280"\nchannel = 1\naddress = 0x76\nrate_hz = 8',
    "BMP388": 'chip = "bmp388"\nchannel = 1\naddress = 0x77\nrate_hz = 8',
    "IMU2_acc": 'chip = "mpu9250"\nchannel = 2\naddress = 0x68\nrange = 4',
    "AK1": 'chip = "ak8963"\nchannel = 2\naddress = 0x0C\nrange = 49.12\naxes = "+Y+X-Z"',
}
TEXT = MIXED + "".join(f'[[sensor]]\nname = "{name}"\n{text}\n' for name, text in PLACES.items())
PRESSURE_PA = {"BMP180": 400.0, "BMP280": 100.0, "BMP388": 50.0}  # BMP-70, BMP-124, BMP-222: the tolerance of a part
DEGC = {"BMP180": 1.5, "BMP280": 0.5, "BMP388": 0.5}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: Any) -> Path:
    """The configuration, a log at rest and one of six faces."""
    place: Path = tmp_path_factory.mktemp("mixed")
    (place / "mixed.toml").write_text(TEXT)
    words = ["log", str(place / "mixed.toml"), "--bus"]
    assert main([*words, "emulated:", "--seconds", "20", "-o", str(place / "still.h5")]) == 0
    tumble = "emulated:?world=tumble&face_s=4"
    assert main([*words, tumble, "--seconds", "30", "-o", str(place / "tumble.h5")]) == 0
    return place


def test_every_chip_is_detected_and_passes_its_self_test(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["detect", str(folder / "mixed.toml"), "--bus", "emulated:", "--self-test"]) == 0
    output = capsys.readouterr().out
    assert "14 of 14 as configured, 0 not" in output
    assert output.count("self-test passed") == 13


def test_every_sensor_is_logged_without_a_fault(folder: Path) -> None:
    with open_log(folder / "still.h5") as log:
        assert not [event for event in log.events if event.kind != "stale"]
        for name, sensor in log.sensors.items():
            assert len(sensor) == pytest.approx(160 if name.startswith("BMP") else 1000, abs=2), name
        assert {name: str(log[name].counts.dtype) for name in ("LIS1", "MMC1", "AK1", "BMP388")} == {
            "LIS1": "int16",
            "MMC1": "int32",
            "AK1": "int16",
            "BMP388": "int32",
        }


def test_barometers_measure_within_their_tolerances(folder: Path) -> None:
    """101325 Pa and 25 degC; noise of the mean of 160 readings is a part of a pascal."""
    with open_log(folder / "still.h5") as log:
        for name, pascal in PRESSURE_PA.items():
            assert log[name].compensated("pressure")[:].mean() == pytest.approx(101325.0, abs=pascal + 2)
            assert log[name].compensated("temperature")[:].mean() == pytest.approx(25.0, abs=DEGC[name] + 0.1)


def test_magnetometers_measure_the_same_field(folder: Path) -> None:
    """Of each part's bias and scale, the AK8963 adjusted and the MMC5983MA less the offset of its bridges, the field is
    that of the box; six sigma of the mean of 1000 readings and a count.
    """
    array = parse_array(TEXT)
    true = np.array(StillWorld()(0).field_box)
    with open_log(folder / "still.h5") as log:
        for name, noise in (("LIS1", 4.1e-3), ("MMC1", 0.4e-3), ("AK1", 3e-3)):
            sensor, attributes = log[name], log[name].attributes
            counts = sensor.counts[:].mean(axis=0)
            if name == "MMC1":
                counts = counts - [attributes[f"bridge_{axis}"] for axis in "xyz"]
            if name == "AK1":
                counts = counts * (np.array([attributes[f"asa_{axis}"] for axis in "xyz"]) + 128) / 256
                physical = physical_values(sensor)
                assert physical is not None
                box_gauss = 1e4 * physical.mean(axis=0)
                np.testing.assert_allclose(box_gauss, sensor.orientation @ counts / sensor.sensitivity, rtol=1e-12)
            unit = unit_of("mixed", name, array[name].chip, array[name].range or 0.0)
            felt = np.array(unit.response) @ (np.array(array[name].orientation).T @ true) + unit.bias
            once = noise if name == "MMC1" else 0.0  # its bridges are known by one reading after each of SET and RESET
            allowed = 6 * noise / np.sqrt(1000) + 4.4 * once + 1 / sensor.sensitivity
            assert counts / sensor.sensitivity == pytest.approx(felt, abs=allowed), name


@pytest.mark.slow
@pytest.mark.parametrize(
    "only", [("IMU1_acc", "IMU2_acc", "AK1"), pytest.param((), marks=pytest.mark.campaign, id="all")]
)
def test_a_mixed_array_is_diagnosed(folder: Path, only: tuple[str, ...]) -> None:
    """An emulated array whose parts keep to their data sheets has no gap: the AK8963's factory took away 16 % of its
    counts.
    """
    with open_log(folder / "still.h5") as still, open_log(folder / "tumble.h5") as tumble:
        diagnosis = imuarray.diagnose([still, tumble], only=only, replicates=40)
    assert diagnosis.verdict == "no gap"
    assert {where.sensor for where in diagnosis.where} == set()


@pytest.mark.parametrize("suffix", ["csv", "npz", "mcap", "parquet"])
def test_a_mixed_array_is_exported(folder: Path, tmp_path: Path, suffix: str) -> None:
    assert main(["export", str(folder / "still.h5"), "-o", str(tmp_path / f"run.{suffix}")]) == 0


def test_exported_values_are_those_of_the_log(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    assert main(["export", str(folder / "still.h5"), "-o", str(path)]) == 0
    with np.load(path) as columns, open_log(folder / "still.h5") as log:
        names = set(columns.files)
        for name in ("MMC1", "LIS1", "AK1", "BMP280", "BMP388"):
            keys = [key for key in names if key.startswith(name) and key.endswith("counts")]
            (key,) = [key for key in keys if not key.endswith("temperature_counts")]
            np.testing.assert_array_equal(columns[key], log[name].counts[:])


def test_a_mixed_array_is_characterised_and_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["characterise", str(folder / "still.h5"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert {"LIS1", "MMC1", "AK1"} <= set(json.dumps(report).replace('"', " ").split())
    page = tmp_path / "report.html"
    assert main(["report", str(folder / "still.h5"), "-o", str(page)]) == 0
    text = page.read_text()
    assert all(name in text for name in PLACES)


def test_a_mixed_array_is_calibrated_and_fused(folder: Path, tmp_path: Path) -> None:
    calibration, fused = tmp_path / "cal.toml", tmp_path / "fused.h5"
    assert main(["calibrate", "tumble", str(folder / "tumble.h5"), "-o", str(calibration)]) == 0
    words = ["fuse", str(folder / "tumble.h5"), "--calibration", str(calibration), "-o", str(fused)]
    assert main([*words, "--technique", "optimal"]) == 0
    head = read_fused_head(fused)
    assert set(head.sensors["specific_force"]) == {"BMA1", "ADXL1", "IMU1_acc", "IMU2_acc"}
    assert set(head.sensors["angular_rate"]) == {"Gyro1", "IMU1_gyro"}
    forces = np.concatenate([block.triads["specific_force"] for block in read_fused(fused)])
    assert np.nanmedian(np.linalg.norm(forces, axis=1)) == pytest.approx(9.80665, rel=5e-3)  # at rest on its faces
