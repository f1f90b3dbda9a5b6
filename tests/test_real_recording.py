"""From somebody else's recording to the paper's claim: eight MPU-9150, four on each side of a board.

H. Carlsson, I. Skog, J. Jalden, Self-Calibration of Inertial Sensor Arrays, IEEE Sensors Journal 21(6), 2021; an
extract of their first recording lies in tests/data/mimu4444. All units share a bias in their own frames, above all
along z, so that the two sides err in opposite directions and the paper's section 2.1 applies.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.calibrate import load_calibration
from imuarray.cli import main
from imuarray.fuse import fuse
from imuarray.log import open_log

EXTRACT = Path(__file__).parent / "data" / "mimu4444" / "exp_1_extract.bin"
ACCELEROMETERS = [f"IMU{unit}_acc" for unit in range(1, 9)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extract imported (run.h5) and calibrated (cal.toml, report.json), all by the command line."""
    return tmp_path_factory.mktemp("mimu4444")


@pytest.fixture(scope="module")
def report(folder: Path) -> dict[str, Any]:
    run, output = folder / "run.h5", folder / "cal.toml"
    assert main(["import", str(EXTRACT), "--format", "mimu4444", "-o", str(run)]) == 0
    with pytest.MonkeyPatch.context() as patch:
        printed: list[Any] = []
        patch.setattr("imuarray.commands.calibrate.print_json", printed.append)
        assert main(["calibrate", "tumble", str(run), "-o", str(output), "--json"]) == 0
    found: dict[str, Any] = json.loads(json.dumps(printed[0]))
    return found


def test_the_twenty_orientations_are_found_and_fit(report: dict[str, Any]) -> None:
    assert (report["method"], report["poses"]) == ("gravity", 20)
    assert sorted(report["residual_mg"]) == ACCELEROMETERS
    assert report["left_out"] == []
    assert max(report["residual_mg"].values()) <= 0.5  # hand placed, 8 s each
    # In poses that the calibration has not seen; unit 4's z axis wanders by 0.8 mg from pose to pose.
    apart = report["residual_apart_mg"]
    assert max(value for name, value in apart.items() if name != "IMU4_acc") <= 0.5
    assert apart["IMU4_acc"] < 0.8


def test_only_one_axis_scatters_more_than_its_noise(report: dict[str, Any]) -> None:
    """Once the drift of the warm-up is told, noise explains what is left of the others."""
    rows = {row["name"]: row for row in report["sensors"] if row["quantity"] == "specific_force"}
    beyond = {name: np.array(row["repeatability_lsb"]) / 2.048 for name, row in rows.items()}
    assert [(name, axis) for name in rows for axis in range(3) if beyond[name][axis] > 0] == [("IMU4_acc", 2)]
    assert beyond["IMU4_acc"][2] == pytest.approx(0.85, abs=0.1)


def biases_mg(report: dict[str, Any]) -> np.ndarray:
    """(8, 3) along the sensors' own axes."""
    rows = {row["name"]: row for row in report["sensors"]}
    return 1e3 * np.array([rows[name]["bias"] for name in ACCELEROMETERS])


def test_the_biases_of_all_units_have_one_sign(report: dict[str, Any]) -> None:
    """x -17 to -30, y -5 to -16, z -17 to -66 mg: the recording's known ranges."""
    biases = biases_mg(report)
    assert (biases < 0).all()
    for axis, (low, high) in enumerate(((-30, -16), (-16, -5), (-67, -16))):
        assert low < biases[:, axis].min() and biases[:, axis].max() < high
    assert biases[:, 2].mean() == pytest.approx(-45, abs=2)


def test_opposed_sides_cancel_nine_tenths_of_the_bias_along_z(report: dict[str, Any]) -> None:
    (row,) = (r for r in report["cancellation"] if r["box_axis"] == "Z" and r["unit"] == "g")
    assert 1e3 * row["along"] == pytest.approx(-49, abs=1.0)
    assert 1e3 * row["against"] == pytest.approx(39, abs=1.0)
    assert 1e3 * row["opposed"] == pytest.approx(-5.3, abs=0.3)
    # The same from the biases themselves: odd units along box Z, even ones against it.
    z = biases_mg(report)[:, 2]
    assert 1e3 * row["opposed"] == pytest.approx((z[::2].mean() - z[1::2].mean()) / 2)


def test_scale_factors_and_axes_are_those_of_the_board(report: dict[str, Any]) -> None:
    """2048 counts per g to 3 %; within a degree of where the board's layout puts them."""
    for row in report["sensors"]:
        if row["quantity"] == "specific_force":
            assert row["scale_lsb_per_g"] == pytest.approx([2048] * 3, rel=0.03)
            x = 0.0 if int(row["name"][3]) % 2 else -90.0
            assert row["azimuth_deg"][0] == pytest.approx(x, abs=1.0)
            assert abs(row["elevation_deg"][2]) == pytest.approx(90.0, abs=1.0)


def test_at_rest_the_calibrated_array_feels_one_g(folder: Path, report: dict[str, Any]) -> None:
    """Length of the fused specific force in the first pose; uncalibrated, one side alone errs by its bias."""
    assert report["poses"] == 20
    with open_log(folder / "run.h5") as log:
        block = next(iter(fuse(log, load_calibration(folder / "cal.toml"), "mean", only=ACCELEROMETERS)))
    force_g = block.triads["specific_force"][20:480].mean(axis=0) / 9.80665
    assert np.linalg.norm(force_g) == pytest.approx(1.0, abs=1e-3)
