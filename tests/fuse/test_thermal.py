"""Biases that follow the temperature of the log: known slopes are removed, and nothing else changes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.cli import main
from imuarray.fuse import element_temperatures, fuse
from imuarray.log import open_log
from tests.fuse.conftest import Floats, joined
from tests.fuse.warm_runs import BIAS, ELEMENT, SECONDS, SLOPES, WARM, heating, known
from tests.selection import some


def cold(calibration: Calibration) -> Calibration:
    """The same calibration without slopes."""
    return Calibration({name: replace(sensor, thermal=None) for name, sensor in calibration.sensors.items()})


def fused(path: Path, calibration: Calibration, quantity: str, block: int = 1 << 14) -> Floats:
    with open_log(path) as log:
        return joined(list(fuse(log, calibration, "mean", block=block)), quantity)[1]


def drift(values: Floats) -> Floats:
    """Largest minus smallest of sixteen means."""
    return np.asarray(np.ptp([part.mean(axis=0) for part in np.array_split(values, 16)], axis=0))


@pytest.mark.parametrize("thermometer", some(["barometer", "reference", "bma180"], 1))
def test_drift_with_temperature_is_removed(tmp_path: Path, thermometer: str) -> None:
    """From 20 degC times the mean slope to the rounding of the thermometer: a twentieth and less. Sixteen means of 375
    rows of one count of noise span 0.2 counts, the slopes give 30 and more.
    """
    path = heating(tmp_path / "heat.h5", thermometer)
    calibration = known("chip" if thermometer == "bma180" else thermometer)
    for quantity, axes in (("specific_force", [0, 1]), ("angular_rate", [0, 1, 2])):
        before, after = (fused(path, cal, quantity) for cal in (cold(calibration), calibration))
        assert (drift(after)[axes] < drift(before)[axes] / 20).all()


@pytest.mark.slow
def test_a_slope_that_may_be_of_the_scale_factor_is_not_applied(tmp_path: Path) -> None:
    path = heating(tmp_path / "heat.h5", "barometer")
    before, after = (fused(path, calibration, "specific_force") for calibration in (cold(known()), known()))
    assert after[:, 2] == pytest.approx(before[:, 2], abs=1e-12)
    assert drift(after)[2] > 0.9 * 9.80665 * (19 * np.mean([1.5 / 512, 2.0 / 256]))


def test_a_thermometer_without_a_zero_is_used_for_its_own_slopes(tmp_path: Path) -> None:
    """The L3G4200D counts 45 - T here: read as T - 45, so that 25 degC is read as -20."""
    path = heating(tmp_path / "heat.h5", "l3g4200d", ["G1"])
    calibration = known("relative", -20.0, ["G1"])
    before, after = (fused(path, cal, "angular_rate") for cal in (cold(calibration), calibration))
    assert (drift(after) < drift(before) / 20).all()


@pytest.mark.slow
@pytest.mark.parametrize(("inside", "slopes"), [("l3g4200d", "barometer"), ("barometer", "relative")])
def test_slopes_of_another_kind_of_thermometer_are_not_applied(tmp_path: Path, inside: str, slopes: str) -> None:
    path = heating(tmp_path / "heat.h5", inside, ["G1"])
    calibration = known(slopes, names=["G1"])
    with open_log(path) as log:
        assert element_temperatures(log, log.of("angular_rate"), calibration) == {}
    assert (fused(path, calibration, "angular_rate") == fused(path, cold(calibration), "angular_rate")).all()


def test_the_bias_is_exact_at_its_calibration_temperature(tmp_path: Path) -> None:
    """The bias of 35 degC, ten slopes away from that of 25: the fused rate is zero at every temperature. After 225 s,
    when 2 % of the initial error of the lag remain (0.16 degC, 5 counts each).
    """
    gyroscope = known().sensors["G1"]
    there = np.array(BIAS["G1"]) + 10 * np.array(SLOPES["G1"])
    calibration = Calibration({"G1": replace(gyroscope, bias_lsb=there, temperature_degc=35.0)})
    values = fused(heating(tmp_path / "heat.h5", "barometer", ["G1"]), calibration, "angular_rate")
    means_lsb = np.degrees([part.mean(axis=0) for part in np.array_split(values, 16)[3:]]) * 114.0
    # Five standard errors of 375 rows; the barometer's means have errors below 0.01 degC of 5 counts each.
    assert np.abs(means_lsb).max() < 5 / np.sqrt(375) + 0.05


def test_a_lag_that_may_be_zero_is_not_applied(tmp_path: Path) -> None:
    gyroscope = known().sensors["G1"]
    assert gyroscope.thermal is not None
    unsure = replace(gyroscope, thermal=replace(gyroscope.thermal, lag_interval_s=np.array([0.0, 70.0])))
    with open_log(heating(tmp_path / "heat.h5", "barometer", ["G1"])) as log:
        (warm,), (lagged,) = (
            element_temperatures(log, log.of("angular_rate"), Calibration({"G1": unit})).values()
            for unit in (unsure, gyroscope)
        )
    assert warm.at(SECONDS[100:-100]) == pytest.approx(WARM[100:-100], abs=0.05)
    # The lag is assumed to be in balance at the first mid time, 2.4 s: an error of 0.16 degC that decays with the lag.
    assert lagged.at(SECONDS[100:-100]) == pytest.approx(ELEMENT[100:-100], abs=0.2)
    assert np.abs(WARM - ELEMENT).max() > 2.0


@pytest.mark.slow
def test_results_do_not_depend_on_blocks(tmp_path: Path) -> None:
    path = heating(tmp_path / "heat.h5", "barometer")
    one, many = (fused(path, known(), "specific_force", block) for block in (1 << 14, 777))
    assert np.abs(one - many).max() < 1e-9


def test_fuse_names_sensors_whose_bias_follows_temperature(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, calibration = heating(tmp_path / "heat.h5", "barometer"), known(names=["A1", "G1"])
    calibration.save(tmp_path / "cal.toml")
    arguments = ["fuse", str(path), "--calibration", str(tmp_path / "cal.toml"), "-o", str(tmp_path / "fused.h5")]
    assert main([*arguments, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["thermal"] == ["A1", "G1"]
    assert "thermometer" not in err
    assert main([*arguments, "--force", "--only", "G1"]) == 0
    assert "  bias follows the log's temperature: G1\n" in capsys.readouterr().out


@pytest.mark.slow
def test_fuse_reports_a_log_without_thermometer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = heating(tmp_path / "heat.h5", "none")
    known().save(tmp_path / "cal.toml")
    arguments = ["fuse", str(path), "--calibration", str(tmp_path / "cal.toml"), "-o", str(tmp_path / "fused.h5")]
    assert main([*arguments, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["thermal"] == []
    assert [line for line in err.splitlines() if "thermometer" in line] == [
        f"imuarray: {path}: no thermometer for the slopes of A1, A2, G1; calibrated biases are used"
    ]
    assert (fused(path, known(), "angular_rate") == fused(path, cold(known()), "angular_rate")).all()
