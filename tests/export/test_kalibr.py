"""Kalibr's imu.yaml from a log and from what `characterise` wrote, read by a parser of YAML."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imuarray.characterise import characterise_log
from imuarray.errors import ExportError, OutputExistsError
from imuarray.export import export
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from tests.export.conftest import EPOCH

yaml = pytest.importorskip("yaml")

RATE_HZ, ROWS, SIGMA = 200, 12_000, 12.0
ACC = SensorHeader("A", "bma180", "specific_force", "g", 2.0, 4096.0)
GYRO = SensorHeader("G", "l3g4200d", "angular_rate", "dps", 250.0, 114.3)


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of white noise of 12 counts on every axis of an accelerometer and a gyroscope."""
    path = tmp_path_factory.mktemp("kalibr") / "still.h5"
    rng = np.random.default_rng(8)
    time = np.arange(ROWS) * (1_000_000_000 // RATE_HZ)
    with LogWriter(path, [ACC, GYRO], source="simulated", epoch=EPOCH) as log:
        for header in (ACC, GYRO):
            counts = np.rint(rng.normal(0, SIGMA, (ROWS, 3))).astype(np.int16)
            log.append(header.name, Block(time, counts, np.zeros(ROWS, np.uint16)))
        log.phase(Phase(0, int(time[-1]) + 1, "static"))
    return path


def test_an_accelerometer_and_a_gyroscope_are_one_imu(still: Path, tmp_path: Path) -> None:
    """White noise of sigma at a rate f has the density sigma / sqrt(f); three axes of 12000 rows, the largest: 5 %."""
    written = export(still, tmp_path / "imu.yaml")
    assert written.files == (tmp_path / "imu.yaml",)
    found = yaml.safe_load((tmp_path / "imu.yaml").read_text())
    assert found["update_rate"] == pytest.approx(RATE_HZ)
    density = SIGMA / np.sqrt(RATE_HZ)
    assert found["accelerometer_noise_density"] == pytest.approx(density * 9.80665 / 4096, rel=0.05)
    assert found["gyroscope_noise_density"] == pytest.approx(density * np.radians(1 / 114.3), rel=0.05)
    # White noise alone: of a random walk there is a bound, which is no figure for a program to read.
    text = (tmp_path / "imu.yaml").read_text()
    for name in ("accelerometer", "gyroscope"):
        assert f"{name}_random_walk" not in found
        assert f"# {name}_random_walk: none was seen, at most " in text


def test_a_walk_that_one_axis_shows_is_that_axis_s_and_no_bound(still: Path, tmp_path: Path) -> None:
    """The value of the axis in which it is significant, though another's bound is larger."""
    with open_log(still) as log:
        result = characterise_log(log)
    for sensor in result["sensors"]:
        for index, axis in enumerate(sensor["axes"]):
            seen = {"value": 3.0, "low": 2.0, "high": 4.0, "significant": True}
            unseen = {"value": 1.0, "low": 0.0, "high": 9.0, "significant": False}
            axis["fit"]["terms"]["random walk"] = seen if index == 1 else unseen
    (tmp_path / "c.json").write_text(json.dumps(result))
    export(tmp_path / "c.json", tmp_path / "i.yaml")
    found = yaml.safe_load((tmp_path / "i.yaml").read_text())
    assert found["accelerometer_random_walk"] == pytest.approx(3.0 * 9.80665 / 4096)
    assert found["gyroscope_random_walk"] == pytest.approx(3.0 * np.radians(1 / 114.3), rel=1e-5)


def test_more_sensors_are_a_file_each(still: Path, tmp_path: Path) -> None:
    """From a characterisation in which the accelerometer stands twice."""
    with open_log(still) as log:
        result = characterise_log(log)
    first = result["sensors"][0]
    result["sensors"].append(first | {"name": "B"})
    (tmp_path / "characterise.json").write_text(json.dumps(result))
    written = export(tmp_path / "characterise.json", tmp_path / "i.yaml")
    assert [file.name for file in written.files] == ["i_A.yaml", "i_G.yaml", "i_B.yaml"]
    one = yaml.safe_load((tmp_path / "i_B.yaml").read_text())
    assert one == yaml.safe_load((tmp_path / "i_A.yaml").read_text())
    with pytest.raises(OutputExistsError, match=r"i_A\.yaml"):
        export(tmp_path / "characterise.json", tmp_path / "i.yaml")
    export(tmp_path / "characterise.json", tmp_path / "b.yaml", sensors=["B", "G"])
    assert set(yaml.safe_load((tmp_path / "b.yaml").read_text())) > {"gyroscope_noise_density", "update_rate"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", "no result of `imuarray characterise`"),
        ('{"sensors": [{"name": "A"}]}', "no result of `imuarray characterise`"),
        ("[" * 100_000, "no result of `imuarray characterise`"),
        ('{"sensors": []}', "no inertial sensor whose noise could be fitted"),
    ],
)
def test_a_file_that_is_something_else(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(ExportError, match=said):
        export(tmp_path / "c.json", tmp_path / "i.yaml")
    with pytest.raises(ExportError, match="Kalibr's figures are in SI"):
        export(tmp_path / "c.json", tmp_path / "i.yaml", units="counts")
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]
