"""`imuarray calibrate` through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import load_calibration
from imuarray.cli import main
from imuarray.log import open_log
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Scale
from tests.calibrate.conftest import FACES, Part, WriteLog, accelerometer, directions, gyroscope, ideal
from tests.calibrate.hand_tumble import HandTumble, attitudes, record

PARTS = (
    Part(accelerometer("A1"), ideal("+X+Y+Z", 2100), np.array([50.0, -60.0, 70.0]), 20.0),
    Part(accelerometer("A2", "-Y-X-Z"), ideal("-Y-X-Z", 2000), np.array([10.0, 20.0, 30.0]), 20.0),
    Part(gyroscope("G1"), 2.0 * np.eye(3), np.array([40.0, 41.0, 42.0]), 5.0),
)


@pytest.fixture
def run(write_log: WriteLog) -> Path:
    return write_log.faces(PARTS, rows=400)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Exit code 2, one line on standard error, nothing on standard output; the line."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("imuarray: ") and err.count("\n") == 1
    return err


def test_tumble_writes_the_calibration_that_it_reports(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "cal.toml"
    assert main(["calibrate", "tumble", str(run), "-o", str(output), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["method"], report["poses"], report["calibration"]) == ("faces", 7, str(output))
    rows = {row["name"]: row for row in report["sensors"]}
    assert list(rows) == ["A1", "A2", "G1"]
    # Six faces of 400 rows: the bias is known to 20 / sqrt(2400) = 0.41 counts, a scale to 20 / sqrt(800) = 0.71.
    assert rows["A1"]["bias_lsb"] == pytest.approx([50, -60, 70], abs=2.0)
    assert rows["A1"]["scale_lsb_per_g"] == pytest.approx([2100] * 3, abs=3.5)
    assert rows["A2"]["azimuth_deg"][0] == pytest.approx(-90, abs=0.1)
    assert rows["G1"]["bias_lsb"] == pytest.approx(
        [40 + 2 / 7 * (axis == 2) for axis in range(3)] + np.arange(3), abs=0.5
    )
    assert rows["G1"]["g_sensitivity_lsb_per_g"] == pytest.approx(2 * np.eye(3), abs=1.0)
    assert max(report["residual_mg"].values()) < 5
    saved = load_calibration(output)
    assert saved.sensors["A1"].bias_lsb == pytest.approx(rows["A1"]["bias_lsb"], rel=1e-8)
    assert saved.sources == (str(run),)


def test_tumble_prints_a_table(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "tumble", str(run), "-o", str(tmp_path / "cal.toml")]) == 0
    out = capsys.readouterr().out
    lines = {line[:14].strip(): line for line in reversed(out.splitlines())}  # the first table
    assert "7 named faces" in out
    assert " mg " in lines["A1 x"] and lines["G1 z"].rstrip().endswith("dps")
    assert f"wrote {tmp_path / 'cal.toml'}" in out


@pytest.mark.slow
def test_tumble_of_unnamed_poses(write_log: WriteLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ups = directions(14, np.random.default_rng(3))
    path = write_log(PARTS, ups, rows=400, moving_rows=50)
    assert main(["calibrate", "tumble", str(path), "-o", str(tmp_path / "cal.toml"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["method"], report["poses"]) == ("gravity", 14)
    for row, part in zip(report["sensors"], PARTS, strict=True):
        # 14 poses of some 250 rows; nine parameters share them.
        pull = part.response @ ups.mean(axis=0) if row["name"] == "G1" else np.zeros(3)
        assert row["bias_lsb"] == pytest.approx(part.bias + pull, abs=6.0)


@pytest.mark.slow
def test_tumble_reports_gyroscopes_residuals_and_excluded_poses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A hand-tumbled log; the table and the JSON object agree."""
    motion = HandTumble(attitudes(14, np.random.default_rng(2)))
    still = {name: (WhiteNoise((0.002,) * 3),) for name in ("BMA1", "BMA2")}
    effects = {**still, "Gyro1": (WhiteNoise((0.1,) * 3), Scale((0.02,) * 3))}
    path, output = record(tmp_path / "run.h5", motion, effects, only=tuple(effects)), str(tmp_path / "cal.toml")
    assert main(["calibrate", "tumble", str(path), "-o", output, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    gyro = next(row for row in report["sensors"] if row["name"] == "Gyro1")
    assert (gyro["turns"]["used"], gyro["turns"]["untold"], gyro["turns"]["left_out"]) == (13, "", [])
    assert np.abs(gyro["turns"]["response_lsb_per_dps"]).max() == pytest.approx(1.02 / 0.07, rel=0.005)
    assert report["left_out"] == []
    assert list(report["pose_residuals_mg"]["BMA1"]) == [f"pose {k}" for k in range(1, 15)]
    for name, residual in report["residual_mg"].items():
        by_pose = list(report["pose_residuals_mg"][name].values())
        assert residual == pytest.approx(np.sqrt(np.mean(np.square(by_pose))))
        assert residual < report["residual_apart_mg"][name] < 4 * residual
        assert report["residual_steady_mg"][name] == pytest.approx(residual)  # nothing drifts
    assert main(["calibrate", "tumble", str(path), "-o", output, "--force"]) == 0
    out = capsys.readouterr().out
    assert "13 turns, which end within" in out and "g-sensitivity (LSB/g)" in out and "over noise" in out
    known = load_calibration(output).sensors["Gyro1"]
    assert known.provenance["response"].logs == (str(path),)


def test_tumble_prints_excluded_poses(write_log: WriteLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One face of six leans by 5 degrees."""
    ups = np.array([up for _, _, up in FACES], float)
    ups[2] = (0.0, np.cos(np.radians(5)), np.sin(np.radians(5)))
    run = write_log(PARTS, ups, names=[(name, up) for name, up, _ in FACES], rows=400)
    assert main(["calibrate", "tumble", str(run), "-o", str(tmp_path / "cal.toml")]) == 0
    out = capsys.readouterr().out
    assert "excluded: y_up: 87 mg off the straight line through the other faces" in out
    assert "6 named faces" in out


def test_an_existing_output_is_not_overwritten(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "cal.toml"
    output.write_text("mine")
    for kind in ("tumble", "noise"):
        assert "exists already" in refused(["calibrate", kind, str(run), "-o", str(output)], capsys)
        assert output.read_text() == "mine"
    assert main(["calibrate", "noise", str(run), "-o", str(output), "--force"]) == 0
    assert "A1" in load_calibration(output).sensors


@pytest.mark.slow
def test_update_adds_to_an_existing_calibration(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "cal.toml"
    assert main(["calibrate", "tumble", str(run), "-o", str(output), "--update"]) == 0
    before = load_calibration(output).sensors["A1"]
    capsys.readouterr()
    assert main(["calibrate", "noise", str(run), "-o", str(output), "--update", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["sensors"]}
    after = load_calibration(output).sensors["A1"]
    assert after.bias_lsb.tolist() == before.bias_lsb.tolist()
    assert after.response_lsb_per_unit.tolist() == before.response_lsb_per_unit.tolist()
    assert after.noise_lsb == pytest.approx([20.0] * 3, rel=5 / np.sqrt(2 * 2800))
    assert rows["A1"]["noise"] == pytest.approx(1e3 * np.array(rows["A1"]["noise_lsb"]) / 2048)
    assert rows["G1"]["noise_unit"] == "dps"


def test_update_of_another_kind_of_file_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "cal.toml"
    output.write_text("mine")
    assert str(output) in refused(["calibrate", "noise", str(run), "-o", str(output), "--update"], capsys)
    assert output.read_text() == "mine"


def test_noise_prints_a_table(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "noise", str(run), "-o", str(tmp_path / "cal.toml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [
        "axis",
        *["A1"] * 3,
        *["A2"] * 3,
        *["G1"] * 3,
        "lag-1:",
        "drift:",
        "wrote",
        "cal.toml",
    ]
    assert "mg rms" in lines[1] and "dps rms" in lines[7] and " +- " in lines[1]


def test_logs_that_cannot_be_calibrated_are_refused(
    write_log: WriteLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "cal.toml")
    gyro_only = write_log(PARTS[2:], np.eye(3), name="gyro.h5")
    still = write_log(PARTS, np.eye(3)[2:], rows=1000, name="still.h5")
    assert "no such file" in refused(["calibrate", "tumble", str(tmp_path / "no.h5"), "-o", output], capsys)
    assert "no accelerometer" in refused(["calibrate", "tumble", str(gyro_only), "-o", output], capsys)
    error = refused(["calibrate", "tumble", str(still), "-o", output], capsys)
    assert "1 static pose (no pose with " in error and "at least 9" in error
    assert error.count("still.h5") == 1
    assert not (tmp_path / "cal.toml").exists()


def test_an_output_in_a_missing_folder_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(["calibrate", "noise", str(run), "-o", str(tmp_path / "no" / "cal.toml")], capsys)


def test_the_log_as_output_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["calibrate", "noise", str(run), "-o", str(run), "--force"])
    with open_log(run) as log:
        assert len(log["A1"]) == 2800
