"""Gyroscopes from the turns between poses: true responses are within their covariance, and some are not determined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imuarray.calibrate import TumbleResult, calibrate_tumble
from imuarray.calibrate.turns import TOLERANCE, _integrate_turn, _Turn
from imuarray.log import open_log
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Misalignment, Scale
from tests.calibrate.conftest import Floats, Part, WriteLog, accelerometer, directions, gyroscope, ideal
from tests.calibrate.hand_tumble import HandTumble, attitudes, record
from tests.calibrate.true_responses import true_response
from tests.calibrate.turn_effects import ACCELEROMETERS, G_SENSITIVITY, GYROSCOPES, SCALE, about, effects


def tumble(
    path: Path,
    motion: HandTumble,
    noise_g: float,
    noise_dps: float,
    seed: int,
    gyroscopes: tuple[str, ...] = GYROSCOPES,
) -> tuple[TumbleResult, dict[str, Floats]]:
    """The result of a calibration of a simulated log, and the true responses."""
    record(path, motion, effects(noise_g, noise_dps), seed=seed, only=(*ACCELEROMETERS, *gyroscopes))
    with open_log(path) as log:
        truth = {name: true_response(log[name].sensitivity, log[name].orientation) for name in gyroscopes}
        return calibrate_tumble(log), truth


@pytest.mark.slow
def test_responses_are_within_their_covariance(tmp_path: Path) -> None:
    """Noise of the paper's chips; the mean over 12 draws of a normalised error squared with nine parameters is
    chi-square with 108 degrees of freedom over 12; two-sided error rate 1e-3. Bias and g-sensitivity, within six
    standard errors each.
    """
    squares = []
    for seed in range(6):
        motion = HandTumble(attitudes(12, np.random.default_rng(seed)))
        result, truth = tumble(tmp_path / f"{seed}.h5", motion, 0.017, 0.18, seed)
        for name, true in truth.items():
            fit, known = result.turns[name], result.calibration.sensors[name]
            error = (fit.response - true).ravel()
            squares.append(error @ np.linalg.solve(fit.covariance, error))
            assert fit.uncertain_axes == "" and fit.turns == 11 and fit.left_out == ()
            assert known.response_lsb_per_unit == pytest.approx(fit.response)
            per_dps = np.linalg.norm(true, axis=1).mean() / (1 + np.mean(SCALE))
            assert known.bias_sem_lsb is not None and known.g_sensitivity_lsb_per_g is not None
            assert known.g_sensitivity_sem_lsb_per_g is not None
            assert np.abs(known.bias_lsb - per_dps * np.array([0.5, -0.7, 0.3])).max() < 6 * known.bias_sem_lsb.max()
            with open_log(tmp_path / f"{seed}.h5") as log:
                pull = per_dps * np.array(G_SENSITIVITY).reshape(3, 3) @ log[name].orientation.T
            off = np.abs(known.g_sensitivity_lsb_per_g - pull) / known.g_sensitivity_sem_lsb_per_g
            assert off.max() < 6
    low, high = chi2.ppf((0.0005, 0.9995), 9 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


@pytest.mark.slow
def test_turns_about_one_axis_do_not_determine_the_others(tmp_path: Path) -> None:
    """Ten poses on a cone determine the accelerometers' parameters, but every turn is about one box axis: its column is
    known by the turns, the others within the data sheet's tolerance.
    """
    still = Rotation.from_euler("xy", [[0, 0], [0, 40], [0, 80]], degrees=True)
    steps = Rotation.from_rotvec(np.outer(np.arange(14) * np.radians(55), (1.0, 0.0, 0.0)))
    # Rows about box X; two changes of the cone about other axes are too few turns to determine Y and Z.
    made = Rotation.concatenate([still[0] * steps[:6], still[1] * steps[6:10], still[2] * steps[10:]])
    result, truth = tumble(tmp_path / "run.h5", HandTumble(made), 0.017, 0.18, 1, ("Gyro3",))
    fit, known = result.turns["Gyro3"], result.calibration.sensors["Gyro3"]
    assert "X" not in fit.uncertain_axes
    assert fit.uncertain_axes
    # 0.18 dps at 100 Hz over two seconds is 0.025 deg an axis, 17 mg in the means at both ends as much again.
    assert 0.02 < fit.residual_deg < 0.15
    sensitivity = 1 / 0.00875
    assert known.response_sem_lsb_per_unit is not None
    assert (known.response_sem_lsb_per_unit < 1.1 * TOLERANCE * sensitivity).all()
    assert np.abs(known.response_lsb_per_unit - truth["Gyro3"])[:, 0].max() < 0.002 * sensitivity


@pytest.mark.slow
def test_the_columns_of_two_turned_axes_are_determined(tmp_path: Path) -> None:
    """Turns about box X and Z alone: those columns to a thousandth, that of Y to the two per cent of the data sheet;
    over six draws of a world whose gyroscopes have errors of that size, the normalised error squared is chi-square with
    nine degrees of freedom each, error rate 1e-3.
    """
    squares, sensitivity = [], 1 / 0.00875
    for seed in range(6):
        rng = np.random.default_rng(seed)
        off = TOLERANCE * rng.normal(size=(3, 3))
        scale, leaning = tuple(np.diag(off).tolist()), Misalignment(tuple(np.degrees(off[~np.eye(3, dtype=bool)])))
        planted_by = {"Gyro3": (WhiteNoise((0.18,) * 3), Scale(scale), leaning)}
        motion = HandTumble(about("XZ", 13, rng), rest_s=4.0, turn_s=1.5)
        path = tmp_path / f"{seed}.h5"
        still = {name: effects(0.017, 0.18)[name] for name in ACCELEROMETERS}
        record(path, motion, {**still, **planted_by}, seed=seed, only=(*ACCELEROMETERS, "Gyro3"))
        with open_log(path) as log:
            fit = calibrate_tumble(log).turns["Gyro3"]
            rows = np.eye(3) + off - np.diag(np.diag(off))
            rows /= np.linalg.norm(rows, axis=1, keepdims=True)
            true = sensitivity * np.diag(1 + np.diag(off)) @ rows @ log["Gyro3"].orientation.T
        assert fit.uncertain_axes == "Y"
        errors, unknown_sem = np.abs(fit.response - true)[:, [0, 2]], fit.sem[:, 1]
        assert errors.max() < 0.002 * sensitivity
        assert unknown_sem == pytest.approx(TOLERANCE * sensitivity, rel=0.1)
        error = (fit.response - true).ravel()
        squares.append(error @ np.linalg.solve(fit.covariance, error))
    low, high = chi2.ppf((0.0005, 0.9995), 9 * len(squares))
    assert low < np.sum(squares) < high


@pytest.mark.slow
def test_turns_that_clip_are_excluded_and_named(tmp_path: Path) -> None:
    """A turn's rate is 2.19 times the mean one at its peak (35 / 16, the smooth step's slope): within 1 s those of more
    than 114 degrees may clip at 250 dps, and only those.
    """
    motion = HandTumble(attitudes(16, np.random.default_rng(5), 60, 170), turn_s=1.0)
    result, _ = tumble(tmp_path / "run.h5", motion, 0.002, 0.03, 1)
    angles = np.degrees(np.linalg.norm(motion.turns[:-1], axis=1))
    fast = result.turns["Gyro3"]
    assert fast.left_out and all("clip" in each.reason for each in fast.left_out)
    assert fast.turns + len(fast.left_out) == 15
    assert 0 < len(fast.left_out) <= np.count_nonzero(angles > 250 * 16 / 35 / 1.05)
    assert result.turns["Gyro1"].turns == 15


def test_rates_are_integrated_as_linear_between_readings() -> None:
    """Against a product of fifty times as many small turns; without the coning term the error would be 100 times
    larger.

    Random rates of some 100 dps that change direction from reading to reading, 20 ms apart.
    """
    rng = np.random.default_rng(6)
    rates = np.radians(rng.normal(0, 60, (40, 3)))
    fine = (np.arange(39 * 50) + 0.5) / 50
    small = np.stack([np.interp(fine, np.arange(40), column) for column in rates.T], axis=1)
    attitude = Rotation.identity()
    for rate in small:
        attitude = attitude * Rotation.from_rotvec(rate * 0.02 / 50)
    for up in np.eye(3):
        turn = _Turn("a to b", "", 0, np.full(39, 0.02), rates, up, attitude.inv().apply(up), 1.0)
        assert np.abs(_integrate_turn(turn, np.eye(3)).missed).max() < 3e-6


def test_coning_motion_is_integrated() -> None:
    """Attitude Rz(a) Ry(30 degrees) Rz(-a), whose rate is a' (z in the box frame minus z), in 400 steps a cone. The
    rate between readings is unknown: trapezoids have an error of (2 pi / 400)^2 / 12 of what they integrate.
    """
    around = 2 * np.pi * np.linspace(0, 0.7, 281)
    made = Rotation.from_euler("z", around[:, None]) * Rotation.from_rotvec([0.0, np.radians(30.0), 0.0])
    made = made * Rotation.from_euler("z", -around[:, None])
    rates = 2 * np.pi * (made.inv().apply([0.0, 0.0, 1.0]) - [0.0, 0.0, 1.0])
    for up in np.eye(3):
        turn = _Turn("", "", 0, np.full(280, 1 / 400), rates, made[0].inv().apply(up), made[-1].inv().apply(up), 1.0)
        assert np.abs(_integrate_turn(turn, np.eye(3)).missed).max() < 2 * (2 * np.pi / 400) ** 2 / 12 * around[-1] / 2


def test_too_few_turns_keep_the_data_sheet_response(write_log: WriteLog) -> None:
    """Readings are missing in all turns but one: the response stays the data sheet's."""
    ups = directions(14, np.random.default_rng(3))
    parts = [
        Part(accelerometer("A"), ideal("+X+Y+Z", 2048), np.zeros(3), 5.0),
        Part(gyroscope("G"), np.zeros((3, 3)), np.zeros(3), 2.0),
    ]
    keep = lambda name, time: np.asarray((name == "A") | (time * 1e-7 % 350 < 300) | (time < 4 * 10**9))  # noqa: E731
    with open_log(write_log(parts, ups, rows=300, moving_rows=50, keep=keep)) as log:
        result = calibrate_tumble(log)
    assert result.poses == 14
    assert result.turns == {}
    assert result.calibration.sensors["G"].response_sem_lsb_per_unit is None
