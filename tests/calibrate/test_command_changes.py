"""`imuarray calibrate thermal` and `calibrate turn-on` through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import load_calibration
from imuarray.cli import main
from imuarray.log import Block, LogWriter
from imuarray.log.format import Phase, SensorHeader
from tests.calibrate.conftest import EPOCH, gyroscope

BMA = SensorHeader("BMA1", "bma180", "specific_force", "g", 16.0, 512.0, has_temperature=True)
STATES = np.array([[0.0, 70.0, 2.0], [-12.6, 75.0, 0.7]])
SECOND = [k in (2, 3, 5, 8, 9) for k in range(12)]


@pytest.fixture
def runs(tmp_path: Path) -> list[str]:
    """Twelve runs of a minute: the accelerometer started in the 2 g range in run 7, the gyroscope in
    one of two states.
    """
    rng = np.random.default_rng(21)
    time, sound = np.arange(1200, dtype=np.int64) * 50_000_000, np.zeros(1200, np.uint16)
    paths = [tmp_path / f"{k}.h5" for k in range(1, 13)]
    for k, path in enumerate(paths):
        scale = 4096.0 if k == 6 else 512.0
        with LogWriter(path, [BMA, gyroscope("Gyro3")], source="simulated", epoch=EPOCH) as log:
            for name, bias in (("BMA1", [0.0, 0.0, scale]), ("Gyro3", STATES[int(SECOND[k])])):
                counts = np.rint(bias + rng.normal(0, 0.5, 3) + rng.normal(0, 3, (1200, 3))).astype(np.int16)
                warm = np.zeros(1200, np.int16) if name == "BMA1" else None
                log.append(name, Block(time, counts, sound, warm))
    return list(map(str, paths))


@pytest.fixture
def heating(tmp_path: Path) -> str:
    """20 minutes at rest: 24 to 50 to 30 degC by the accelerometer's own thermometer; gyroscopes G1 and G2 oppose each
    other along box Z and drift by 0.5 and 0.3 counts/degC.
    """
    rng = np.random.default_rng(1)
    time = np.arange(6000, dtype=np.int64) * 200_000_000
    warm, sound = np.interp(time * 1e-9, [0, 200, 500, 1200], [24.0, 24.0, 50.0, 30.0]), np.zeros(6000, np.uint16)
    sensors = ((BMA, (0.2, 0.0, 0.5)), (gyroscope("G1"), (0.1, 0.2, 0.5)), (gyroscope("G2", "+Y+X-Z"), (0.0, 0.4, 0.3)))
    path = tmp_path / "heat.h5"
    with LogWriter(path, [header for header, _ in sensors], source="simulated", epoch=EPOCH) as log:
        for header, slopes in sensors:
            still = np.array([0.0, 0.0, 512.0]) * (header is BMA)
            counts = still + np.outer(warm - 25, slopes) + rng.normal(0, 2, (6000, 3))
            own = np.rint(2 * (warm - 24)).astype(np.int16) if header is BMA else None
            log.append(header.name, Block(time, np.rint(counts).astype(np.int16), sound, own))
        log.phase(Phase(0, 10**13, "heat", "+Z"))
    return str(path)


def report_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert main([*arguments, "--json"]) == 0
    result: dict[str, object] = json.loads(capsys.readouterr().out)
    return result


def test_turn_on_reports_changes_states_and_faults(
    runs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "cal.toml")
    report = report_of(["calibrate", "turn-on", *runs, "-o", output], capsys)
    box, gyro = report["sensors"]  # type: ignore[misc]
    assert [(fault["run"], fault["range"]) for fault in box["apart"]] == [(7, 2.0)]
    assert [state["runs"] for state in gyro["states"]] == [[1, 2, 5, 7, 8, 11, 12], [3, 4, 6, 9, 10]]
    assert gyro["p_states"] < 0.01
    # Six axes are looked at: each p-value is at least that of its axis, and the largest is not raised.
    assert max(box["p_value"] + gyro["p_value"]) < 0.05
    assert np.array(gyro["rms_lsb"]) == pytest.approx(0.5, abs=0.4)
    known = load_calibration(output).sensors["Gyro3"]
    assert known.turn_on is not None and known.turn_on.runs == 12
    assert known.provenance["turn_on"].logs == tuple(runs)


@pytest.mark.slow
def test_turn_on_prints_a_table(runs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "turn-on", *runs, "-o", str(tmp_path / "cal.toml"), "--seed", "5"]) == 0
    out = capsys.readouterr().out
    assert "BMA1: run 7: 8.00 times the usual reading: started at 2 g" in out
    assert "Gyro3: starts in one of 2 states" in out
    assert "  58 % of the runs: bias " in out
    assert [line.split()[:3] for line in out.splitlines() if line.startswith("Gyro3 ")] == [
        ["Gyro3", axis, "12"] for axis in "xyz"
    ]


@pytest.mark.slow
def test_turn_on_with_two_runs_is_refused(runs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "turn-on", *runs[:2], "-o", str(tmp_path / "cal.toml")]) == 2
    assert "at least 3 are required" in capsys.readouterr().err
    assert not (tmp_path / "cal.toml").exists()


def test_thermal_reports_slopes_meanings_and_pairs(
    heating: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "cal.toml")
    report = report_of(["calibrate", "thermal", heating, "-o", output], capsys)
    box, first, second = report["sensors"]  # type: ignore[misc]
    assert box["meaning"] == ["bias", "bias", "bias or scale"]
    assert first["slope_lsb_per_degc"] == pytest.approx([0.1, 0.2, 0.5], abs=0.02)
    assert second["slope_lsb_per_degc"] == pytest.approx([0.0, 0.4, 0.3], abs=0.02)
    assert {heating["sensor"] for heating in report["heatings"]} == {"BMA1", "G1", "G2"}  # type: ignore[attr-defined]
    (pair,) = report["pairs"]  # type: ignore[misc]
    assert (pair["first"], pair["second"], pair["box_axis"]) == ("G1 z", "G2 z", "Z")
    assert pair["half_difference"] == pytest.approx(0.1, abs=0.02)
    assert pair["reduction"] == pytest.approx(0.4 / 0.1, rel=0.3)
    assert pair["p_cancels"] < 0.01
    known = load_calibration(output).sensors["G1"]
    assert known.thermal is not None and known.provenance["thermal"].logs == (heating,)


@pytest.mark.slow
def test_thermal_prints_a_table(heating: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "thermal", heating, "-o", str(tmp_path / "cal.toml")]) == 0
    out = capsys.readouterr().out
    assert "24.0 to 50.0 degC by chip" in out
    lines = {line[:14].strip(): line for line in out.splitlines()}
    assert lines["BMA1 z"].endswith("bias or scale") and lines["G1 z"].endswith("bias")
    assert "  G1 z and G2 z" in out


@pytest.mark.slow
def test_thermal_adds_to_a_turn_on_calibration(
    runs: list[str], heating: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "cal.toml")
    assert main(["calibrate", "turn-on", *runs, "-o", output]) == 0
    assert main(["calibrate", "thermal", heating, "-o", output, "--update"]) == 0
    capsys.readouterr()
    assert load_calibration(output).sensors["BMA1"].measured() == ("thermal", "turn_on")
