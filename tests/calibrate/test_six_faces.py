"""Six unnamed faces: bias and scale are determined, and the result states which angles are not."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.calibrate.tumble import TumbleResult, calibrate_tumble
from imuarray.errors import CalibrationError
from imuarray.log import open_log
from imuarray.report.verdicts import calibration_verdict
from tests.calibrate.conftest import Floats, Part, WriteLog, accelerometer, gyroscope, ideal
from tests.selection import some

PER_G = 2048.0
BIAS = np.array([60.0, -100.0, 160.0])
SCALE = np.array([1.012, 0.985, 1.02])
FACES = np.array([(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)], float)


def leaning(ups: Floats, degrees: float, seed: int) -> Floats:
    """The directions (k, 3), each tilted by some degrees, like a box in the hand or on uneven feet."""
    tilted = ups + np.radians(degrees) * np.random.default_rng(seed).normal(size=ups.shape)
    return np.asarray(tilted / np.linalg.norm(tilted, axis=1, keepdims=True))


def calibrated(write_log: WriteLog, ups: Floats, seed: int = 1) -> TumbleResult:
    """Calibrate an accelerometer whose axes are misaligned by some tenths of a degree, and a gyroscope with a bias."""
    angles = np.eye(3) + np.random.default_rng(seed).normal(0, np.radians(0.3), (3, 3)) * (1 - np.eye(3))
    response = SCALE[:, None] * (ideal("+Y+X-Z", PER_G) @ angles)
    parts = [
        Part(accelerometer("A", "+Y+X-Z", sensitivity=PER_G), response, BIAS, 6.0),
        Part(gyroscope("G"), np.zeros((3, 3)), np.array([40.0, -30.0, 20.0]), 5.0),
    ]
    path = write_log(parts, ups, rows=600, moving_rows=80, seed=seed)
    with open_log(path) as log:
        return calibrate_tumble(log)


@pytest.mark.parametrize("seed", some([1, 2, 3, 4], 1))
@pytest.mark.parametrize("degrees", some([0.0, 1.5, 3.0], 1))
def test_bias_and_scale_of_leaning_faces(degrees: float, seed: int, write_log: WriteLog) -> None:
    """A lean of 3 degrees and angles of 0.3: 0.4 mg; noise of 3 mg over 600 rows: 0.12 mg a pose."""
    result = calibrated(write_log, leaning(FACES, degrees, seed), seed)
    known = result.calibration.sensors["A"]
    assert result.method == "six faces"
    assert known.bias_sem_lsb is not None and known.response_lsb_per_unit is not None
    np.testing.assert_allclose(known.bias_lsb, BIAS, atol=1.5e-3 * PER_G)
    assert (np.abs(known.bias_lsb - BIAS) < 4 * known.bias_sem_lsb).all()
    np.testing.assert_allclose(known.scale_lsb_per_unit, SCALE * PER_G, rtol=1.5e-3)
    np.testing.assert_allclose(result.calibration.sensors["G"].bias_lsb, [40, -30, 20], atol=1.0)


def test_figures_kept_from_the_data_sheet_are_reported(write_log: WriteLog) -> None:
    result = calibrated(write_log, FACES)
    assert any("angles between the axes are the data sheet's (+- 0.5 degrees)" in text for text in result.warnings)
    sentence = calibration_verdict(write_log.folder / "cal.toml", result.calibration).sentence
    assert "the angles between the axes of A are the data sheet's" in sentence and "turns" not in sentence


@pytest.mark.slow
def test_faces_may_have_any_order_and_repeat(write_log: WriteLog) -> None:
    """Twelve poses on the faces: more than nine, but the angles are still not determined."""
    result = calibrated(write_log, leaning(np.concatenate([FACES[::-1], FACES]), 1.0, 5))
    assert (result.method, result.poses) == ("six faces", 12)
    np.testing.assert_allclose(result.calibration.sensors["A"].bias_lsb, BIAS, atol=1e-3 * PER_G)


@pytest.mark.slow
def test_the_missing_face_is_named(write_log: WriteLog) -> None:
    """Box -Y points along the sensor's x, as the axes +Y+X-Z have it, down: no reading has -x up."""
    with pytest.raises(CalibrationError, match=r"5 static poses \(no pose with -x of the sensor up\), at least 9 are"):
        calibrated(write_log, FACES[:5])
