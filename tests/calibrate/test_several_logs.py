"""One log per face is as good as one log of six faces, and different settings of the logs are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray import load_calibration, open_log
from imuarray.calibrate import calibrate_noise, calibrate_tumble
from imuarray.cli import main
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter
from imuarray.log.format import Phase, SensorHeader

FACES = {
    "z_up": (0, 0, 1),
    "x_up": (1, 0, 0),
    "y_up": (0, 1, 0),
    "x_down": (-1, 0, 0),
    "y_down": (0, -1, 0),
    "z_down": (0, 0, -1),
}
UP = {"z_up": "+Z", "x_up": "+X", "y_up": "+Y", "x_down": "-X", "y_down": "-Y", "z_down": "-Z"}
BIAS = np.array([30.0, -20.0, 55.0])
SCALE = np.array([2000.0, 2050.0, 2100.0])


def write(path: Path, faces: list[str], range_g: float = 16.0) -> Path:
    """A sensor of known bias and scale, 400 rows per face, noise of 10 counts."""
    rng = np.random.default_rng(len(faces) + ord(faces[0][0]))
    header = SensorHeader("A", "bma180", "specific_force", "g", range_g, 2048.0)
    with LogWriter(path, [header], source="simulated", epoch="2026-01-01T00:00:00Z") as log:
        for index, face in enumerate(faces):
            start_ns = index * 5_000_000_000
            counts = np.rint(BIAS + SCALE * FACES[face] + rng.normal(0, 10, (400, 3))).astype(np.int16)
            log.append("A", Block(start_ns + np.arange(400) * 10_000_000, counts, np.zeros(400, np.uint16)))
            log.phase(Phase(start_ns, start_ns + 4_000_000_000, face, UP[face]))
    return path


@pytest.mark.slow
def test_one_log_per_face_calibrates_like_one_log(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"{face}.h5", [face]) for face in FACES]
    calibration = tmp_path / "cal.toml"
    assert main(["calibrate", "tumble", *map(str, paths), "-o", str(calibration)]) == 0
    result = load_calibration(calibration)
    assert result.sources == tuple(map(str, paths))
    # Standard error of a face's mean: 10 / sqrt(400) = 0.5 counts; five of the errors of mean and half difference.
    assert result.sensors["A"].bias_lsb == pytest.approx(BIAS, abs=5 * 0.5 / np.sqrt(6))
    assert result.sensors["A"].scale_lsb_per_unit == pytest.approx(SCALE, abs=5 * 0.5 / np.sqrt(2))


def test_noise_is_pooled_over_logs(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"{face}.h5", [face]) for face in ("z_up", "x_up")]
    with open_log(paths[0]) as one, open_log(paths[1]) as other:
        noise = calibrate_noise(one, other).sensors["A"].noise_lsb
    assert noise == pytest.approx([10.0] * 3, rel=5 / np.sqrt(2 * 800))


@pytest.mark.slow
def test_another_range_in_one_of_the_logs_is_refused(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"{face}.h5", [face], 16.0 if face != "y_up" else 8.0) for face in FACES]
    logs = [open_log(path) for path in paths]
    with pytest.raises(CalibrationError, match=r"y_up\.h5, sensor A: range or axes differ from .*z_up\.h5"):
        calibrate_tumble(*logs)
    for log in logs:
        log.close()


def test_any_of_the_logs_as_output_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [write(tmp_path / f"{face}.h5", [face]) for face in FACES]
    assert main(["calibrate", "tumble", *map(str, paths), "-o", str(paths[3]), "--force"]) == 2
    assert "is the input; choose another name for the output" in capsys.readouterr().err
