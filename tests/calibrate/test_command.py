"""`imuarray calibrate` as a person types it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import load_calibration
from imuarray.cli import main
from imuarray.log import open_log
from tests.calibrate.conftest import Part, WriteLog, accelerometer, directions, gyroscope, ideal

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


def test_tumble_writes_what_it_found(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
    lines = {line[:14].strip(): line for line in out.splitlines()}
    assert "7 named faces" in out
    assert " mg " in lines["A1 x"] and lines["G1 z"].rstrip().endswith("dps")
    assert f"wrote {tmp_path / 'cal.toml'}" in out


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


def test_nothing_is_overwritten(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "cal.toml"
    output.write_text("mine")
    for kind in ("tumble", "noise"):
        assert "exists already" in refused(["calibrate", kind, str(run), "-o", str(output)], capsys)
        assert output.read_text() == "mine"
    assert main(["calibrate", "noise", str(run), "-o", str(output), "--force"]) == 0
    assert "A1" in load_calibration(output).sensors


def test_update_adds_to_what_is_known(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_update_of_a_file_that_is_no_calibration(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "cal.toml"
    output.write_text("mine")
    assert str(output) in refused(["calibrate", "noise", str(run), "-o", str(output), "--update"], capsys)
    assert output.read_text() == "mine"


def test_noise_prints_a_table(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "noise", str(run), "-o", str(tmp_path / "cal.toml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["sensor", "A1", "A2", "G1", "wrote"]
    assert lines[1].endswith("mg rms") and lines[3].endswith("dps rms")


def test_logs_that_can_not_be_calibrated(
    write_log: WriteLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "cal.toml")
    gyro_only = write_log(PARTS[2:], np.eye(3), name="gyro.h5")
    still = write_log(PARTS, np.eye(3)[2:], rows=1000, name="still.h5")
    assert "no such file" in refused(["calibrate", "tumble", str(tmp_path / "no.h5"), "-o", output], capsys)
    assert "no accelerometer" in refused(["calibrate", "tumble", str(gyro_only), "-o", output], capsys)
    assert "1 static poses, at least 9" in refused(["calibrate", "tumble", str(still), "-o", output], capsys)
    assert not (tmp_path / "cal.toml").exists()


def test_an_output_in_a_missing_folder(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(["calibrate", "noise", str(run), "-o", str(tmp_path / "no" / "cal.toml")], capsys)


def test_the_log_itself_is_never_the_output(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["calibrate", "noise", str(run), "-o", str(run), "--force"])
    with open_log(run) as log:
        assert len(log["A1"]) == 2800
