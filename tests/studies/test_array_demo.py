"""`imuarray demo --array`: the path of a shipped array from the bus to the page, with known truth."""

from __future__ import annotations

import json
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from imuarray.array import parse_array
from imuarray.cli import main
from imuarray.log import open_log
from imuarray.shipped import find_config
from imuarray.studies.array_demo import ArrayError, one_of_each, polled_text, summary
from tests.json_page import documented

pytest.importorskip("matplotlib")


def test_only_queues_are_removed_from_the_configuration() -> None:
    text = find_config(Path("icm42688x8")).read_text()
    array = parse_array(text)
    polled = parse_array(polled_text(array))
    assert all(sensor.fifo for sensor in array.sensors)
    assert not any(sensor.fifo for sensor in polled.sensors)
    keys = [{**sensor.model_dump(), "fifo": None} for sensor in array.sensors]
    assert [{**sensor.model_dump(), "fifo": None} for sensor in polled.sensors] == keys


@pytest.mark.parametrize("line", ["fifo=true", "fifo  =  true", "fifo = true  # drained every 10 ms"])
def test_queues_are_removed_from_any_layout_of_the_configuration(line: str) -> None:
    text = find_config(Path("icm42688x8")).read_text().replace("fifo = true", line)
    polled = parse_array(polled_text(parse_array(text)))
    assert not any(sensor.fifo for sensor in polled.sensors)


def test_one_sensor_of_each_chip_and_quantity_is_diagnosed() -> None:
    assert one_of_each(parse_array(find_config(Path("icm42688x8")).read_text())) == ("IMU1_acc", "IMU1_gyro")


def test_the_summary_states_the_gain_by_averaging() -> None:
    single = {"G1": 0.01, "G2": 0.03, "G3": 0.02, "G4": 0.02}
    error = ArrayError("static", "angular_rate", single, {"mean": 0.01, "opposed": 0.012, "optimal": 0.008})
    line, _ = summary([error])
    assert line == (
        "4 gyroscopes at rest: 1.15 dps each (median), 0.573 dps averaged (0.50 times; 1/√4 is 0.50),"
        " least with optimal: 0.458 dps"
    )


def test_an_array_without_gyroscopes_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "one.toml"
    path.write_text('[array]\nname = "one"\n[[sensor]]\nname = "A"\nchip = "adxl345"\naddress = 0x53\nrange = 4\n')
    assert main(["demo", "--array", str(path), "-o", str(tmp_path / "demo")]) == 2
    assert "no sensor of angular rate; the demonstration needs both" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()


@pytest.mark.slow
def test_four_sensors_have_half_the_error_of_one(tmp_path: Path) -> None:
    """Four MPU-9250 with the independent noise of their data sheet: at rest a ratio of 1/√4 except for the residual of
    the calibration, whose share of the variance is a tenth here.
    """
    folder = tmp_path / "demo"
    words = ["demo", "--array", "mpu9250x4", "-o", str(folder), "--seconds", "300", "--seed", "3", "--json"]
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()):
        assert main(words) == 0
    result: dict[str, Any] = json.loads(out.getvalue())
    at_rest = [error for error in result["errors"] if error["run"] == "static"]
    assert {error["quantity"] for error in at_rest} == {"specific_force", "angular_rate"}
    for error in at_rest:
        median = sorted(error["single"].values())[1:3]
        assert error["fused"]["mean"] / (sum(median) / 2) == pytest.approx(0.5, abs=0.05)
    assert max(result["residual_mg"].values()) < 1.0
    assert result.keys() == (documented()["demo"][0] - {"gains"}) | {"errors"}
    with open_log(folder / "static.h5") as log:
        assert len(log.sensors) == 8
    page = (folder / "report.html").read_text()
    assert all(title in page for title in ("What the array gains", "Heated", "Calibration", "Noise", "mpu9250x4"))
    assert main(words[:-1]) == 2  # no file is overwritten
