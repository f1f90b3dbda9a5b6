"""`calibrate tumble` on simulated logs: the paper's array, on faces and tumbled by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.array import load_array
from imuarray.calibrate import TumbleResult, calibrate_tumble
from imuarray.calibrate.gravity import solve, turn_into_box_frame
from imuarray.log import open_log
from imuarray.simulate import Simulation, plan_of, write_log
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Scale
from imuarray.simulate.motion import Tumble as OnFaces
from tests.calibrate.conftest import Floats, directions, ideal
from tests.calibrate.hand_tumble import CONFIG, HandTumble, attitudes, record

SENSORS = ("BMA1", "BMA2", "ADXL1", "Gyro3", "BMP180")
EFFECTS: dict[str, tuple[Effect, ...]] = {
    "BMA1": (WhiteNoise((0.005,) * 3), Bias((-0.18, -0.25, 0.02))),
    "BMA2": (WhiteNoise((0.005,) * 3), Bias((0.05, -0.18, 0.13))),
    "ADXL1": (WhiteNoise((0.005,) * 3), Scale((0.02, 0.03, -0.01))),
    "Gyro3": (WhiteNoise((0.03,) * 3), Scale((0.03, -0.02, 0.01)), Bias((-0.1, 0.7, -0.05))),
}


def on_faces(path: Path, tilts: tuple[tuple[float, float], ...]) -> TumbleResult:
    """Seven faces of 10 s, turns of 3 s, on a table that leans (degrees)."""
    motion = OnFaces(10.0, 3.0, tilts_deg=tilts)
    plan = plan_of(load_array(CONFIG).only(SENSORS), 100.0, motion.seconds)
    write_log(Simulation(plan, motion, EFFECTS, seed=4), path)
    with open_log(path) as log:
        return calibrate_tumble(log)


@pytest.mark.slow
def test_turns_between_faces_calibrate_gyroscopes(tmp_path: Path) -> None:
    """The order of Table 10 has six turns: one of 90 degrees about Y, three about Z, two about X.

    The responses to rates about X and Z are determined, and two of the three to rates about Y; the third is known to
    the two per cent of the data sheet. All are within six standard errors.
    """
    result = on_faces(tmp_path / "run.h5", ((0.0, 0.0),) * 7)
    assert result.method == "faces" and result.left_out == ()
    fit = result.turns["Gyro3"]
    assert (fit.turns, fit.uncertain_axes) == (6, "Y")
    truth = np.diag([1.03, 0.98, 1.01]) @ ideal("-X-Y+Z", 1 / 0.00875)
    assert np.abs((fit.response - truth) / fit.sem).max() < 6
    assert fit.sem[:, [0, 2]].max() < 0.01 / 0.00875
    kept = result.calibration.sensors["Gyro3"]
    assert kept.response_lsb_per_unit == pytest.approx(fit.response)
    assert kept.response_covariance_lsb2_per_unit2 == pytest.approx(fit.covariance)
    of_y = np.sqrt(np.linalg.eigvalsh(fit.covariance.reshape(3, 3, 3, 3)[:, 1, :, 1])) * 0.00875
    assert of_y[1] < 0.002 and of_y[2] == pytest.approx(0.02, rel=0.1)
    known = result.calibration.sensors["BMA1"]
    assert known.bias_sem_lsb is not None
    assert np.abs(known.bias_lsb - 512 * np.array([-0.18, -0.25, 0.02])).max() < 6 * known.bias_sem_lsb.max()
    assert known.temperature_degc == pytest.approx(25.0, abs=0.5)
    assert known.provenance["bias"].temperature_degc == known.temperature_degc
    assert set(known.provenance) == {"bias", "response"}
    assert set(result.calibration.sensors["Gyro3"].provenance) >= {"bias", "g_sensitivity"}


@pytest.mark.slow
def test_a_leaning_table_widens_the_standard_errors_of_faces(tmp_path: Path) -> None:
    """Leaning by 0.3 degrees rms, 5 mg: level standard errors would be 20 times too small."""
    rng = np.random.default_rng(8)
    tilts = tuple((float(a), float(b)) for a, b in rng.normal(0, 0.3, (7, 2)))
    result = on_faces(tmp_path / "run.h5", tilts)
    for name, bias_g, sensitivity in (("BMA1", (-0.18, -0.25, 0.02), 512.0), ("BMA2", (0.05, -0.18, 0.13), 512.0)):
        known = result.calibration.sensors[name]
        assert known.bias_sem_lsb is not None and result.fits[name].reduced_chi_squared > 10
        assert np.abs(known.bias_lsb - sensitivity * np.array(bias_g)).max() < 6 * known.bias_sem_lsb.max()


@pytest.mark.slow
def test_poses_of_several_logs_are_combined(tmp_path: Path) -> None:
    """Two logs of seven poses each, neither sufficient alone; turns are those within each log."""
    made, parts = attitudes(14, np.random.default_rng(4)), []
    for index, part in enumerate((made[:7], made[7:])):
        parts.append(record(tmp_path / f"{index}.h5", HandTumble(part), EFFECTS, seed=index, only=SENSORS))
    with open_log(parts[0]) as one, open_log(parts[1]) as other:
        heard: list[tuple[str, int, int]] = []
        result = calibrate_tumble(one, other, progress=lambda what, done, of: heard.append((what, done, of)))
    assert (result.method, result.poses) == ("gravity", 14)
    assert result.turns["Gyro3"].turns == 12
    assert heard[-1] == ("gyroscopes", 1, 1)
    assert ("leaving out poses in turn", 14, 14) in heard
    truth = {"BMA1": (-0.18, -0.25, 0.02), "BMA2": (0.05, -0.18, 0.13), "ADXL1": (0.0, 0.0, 0.0)}
    for name, bias in truth.items():
        known = result.calibration.sensors[name]
        sensitivity = 256.0 if name == "ADXL1" else 512.0
        assert known.bias_sem_lsb is not None
        assert np.abs(known.bias_lsb - sensitivity * np.array(bias)).max() < 6 * known.bias_sem_lsb.max()
    assert result.calibration.sensors["BMA1"].provenance["bias"].logs == tuple(map(str, parts))


def test_the_box_frame_is_the_mean_of_the_configured_axes() -> None:
    """For every initial rotation of the directions the mean response is symmetric, and nothing else changes. The
    covariance of the coefficients has three null directions: the rotations that the frame fixes.
    """
    rng = np.random.default_rng(5)
    rows = np.concatenate([np.eye(3), np.eye(3)[[1, 0, 2]] * [1, 1, -1]]) + rng.uniform(-0.02, 0.02, (6, 3))
    orientations = np.array([np.eye(3), (np.eye(3)[[1, 0, 2]] * [1, 1, -1]).T])
    up = directions(20, rng)
    readings = rows @ up.T + 0.1 + rng.normal(0, 1e-3, (6, 20))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    result = [
        turn_into_box_frame(solve(readings, np.full((6, 20), 1e6), np.ones((20, 1)), start), orientations)
        for start in (up, up @ turn)
    ]
    for each in result:
        mean = np.mean(orientations @ each.coefficients[:, :3].reshape(2, 3, 3), axis=0)
        assert mean == pytest.approx(mean.T, abs=1e-12)
        values = np.linalg.eigvalsh(each.covariance)
        assert np.count_nonzero(values < 1e-9 * values.max()) == 3
        assert np.linalg.norm(each.up_box, axis=1) == pytest.approx(1.0)
    assert result[0].coefficients == pytest.approx(result[1].coefficients, abs=1e-8)
    assert result[0].covariance == pytest.approx(result[1].covariance, rel=1e-4, abs=1e-12)
    assert result[0].up_covariance == pytest.approx(result[1].up_covariance, rel=1e-4, abs=1e-12)


@pytest.mark.slow
def test_directions_are_within_their_covariance() -> None:
    """Normalised error squared of 12 directions in the box frame, two unknowns each: chi-square with 24 degrees of
    freedom; the mean of 200 draws within 3.3 standard errors, error rate 1e-3.
    """
    rng = np.random.default_rng(6)
    orientations = np.array([np.eye(3), np.diag([-1.0, -1.0, 1.0])])
    rows = np.concatenate([each.T for each in orientations]) @ (np.eye(3) + np.diag([0.01, -0.02, 0.0]))
    squares = []
    for _ in range(200):
        up: Floats = directions(12, rng)
        readings = rows @ up.T + rng.normal(0, 1e-4, (6, 12))
        result = turn_into_box_frame(solve(readings, np.full((6, 12), 1e8), np.ones((12, 1)), up), orientations)
        error = (result.up_box - up).ravel()
        squares.append(error @ np.linalg.pinv(result.up_covariance, rcond=1e-7, hermitian=True) @ error)
    assert np.mean(squares) == pytest.approx(24, abs=3.3 * np.sqrt(2 * 24 / 200))
