"""Any static poses: bias and response within their stated uncertainty, whatever way the array lies."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2, norm, t

from imuarray.calibrate import SensorCalibration
from imuarray.calibrate.gravity import fit_gravity
from imuarray.calibrate.poses import Pose
from imuarray.errors import CalibrationError
from imuarray.log import open_log
from tests.calibrate.conftest import Floats, Part, WriteLog, accelerometer, directions, ideal, skewed

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z")
SIGMA = 40.0
ROWS = 64


def array(count: int, rng: np.random.Generator, sigma: float = SIGMA) -> list[Part]:
    """`count` accelerometers, scale factors and angles off by up to 2 %, biases up to 100 counts of 2048 a g."""
    return [
        Part(
            accelerometer(f"A{index:03}", AXES[index % 4]),
            skewed(AXES[index % 4], 2048, rng),
            rng.uniform(-100, 100, 3),
            sigma,
        )
        for index in range(count)
    ]


def fit(write_log: WriteLog, parts: list[Part], ups: Floats, seed: int = 1) -> tuple[list[SensorCalibration], Floats]:
    names = [(f"pose {index}", "") for index in range(len(ups))]
    with open_log(write_log(parts, ups, names=names, rows=ROWS, seed=seed)) as log:
        return fit_gravity(list(log.sensors.values()), [Pose(phase, None) for phase in log.phases])


class Draws(NamedTuple):
    """Fitted and true parameters of many sensors that saw the same poses."""

    parts: list[Part]
    fitted: list[SensorCalibration]
    residuals: Floats
    poses: int

    def bias_ratios(self) -> Floats:
        """(sensors, 3) error of the bias over its standard error."""
        pairs = zip(self.fitted, self.parts, strict=True)
        return np.array([(found.bias_lsb - part.bias) / sem(found.bias_sem_lsb) for found, part in pairs])

    def scale_ratios(self) -> Floats:
        """(sensors, 3) error of the scale factor over the stated standard error of the response."""
        pairs = zip(self.fitted, self.parts, strict=True)
        return np.array(
            [
                (found.scale_lsb_per_unit - np.linalg.norm(part.response, axis=1))
                / sem(found.response_sem_lsb_per_unit)
                for found, part in pairs
            ]
        )


def sem(value: Floats | None) -> Floats:
    assert value is not None
    return value


@cache
def draws(poses: int) -> Draws:
    """A hundred sensors in `poses` random poses, fitted jointly: a hundred draws."""
    rng = np.random.default_rng(42)
    parts = array(100, rng)
    with TemporaryDirectory() as folder:
        fitted, residuals = fit(WriteLog(Path(folder)), parts, directions(poses, rng), seed=poses)
    return Draws(parts, fitted, residuals, poses)


def sums_of_squares(ratios: Floats, freedom: int) -> Floats:
    """(3,) sums over the draws of the squared normal scores of ratios that are Student t with `freedom`."""
    return np.asarray((norm.ppf(t.cdf(ratios, freedom)) ** 2).sum(axis=0))


@pytest.mark.parametrize("poses", [20, 36])
def test_bias_is_within_its_stated_uncertainty(poses: int) -> None:
    """Chi-square over 100 draws; two-sided error rate 1e-3 for each of three axes and two pose counts."""
    sums = sums_of_squares(draws(poses).bias_ratios(), poses - 9)
    low, high = chi2.ppf((0.0005, 0.9995), 100)
    assert (sums > low).all() and (sums < high).all(), sums


def test_response_is_within_its_stated_uncertainty() -> None:
    """Chi-square over 100 draws; error rate 1e-3 for each axis. (A sem that is too large would pass.)"""
    sums = sums_of_squares(draws(36).scale_ratios(), 36 - 9)
    assert (sums < chi2.ppf(0.999, 100)).all(), sums


def test_response_is_recovered() -> None:
    """Every entry within a bound of its own: six times sqrt(15 / poses), the worst entry of a sphere's ellipsoid fit.

    For directions spread evenly the mean of x^2 y^2 is 1/15, so an off-diagonal shape parameter has the variance
    15 sigma^2 / poses, the largest of all nine; what is left is a rotation that 36 poses tell better.
    """
    found = draws(36)
    worst = 6 * np.sqrt(15 / 36) * SIGMA / np.sqrt(ROWS)
    for fitted, part in zip(found.fitted, found.parts, strict=True):
        assert np.abs(fitted.response_lsb_per_unit - part.response).max() < worst


def test_residuals_are_those_of_the_noise() -> None:
    """Sum of squares over sigma^2 / rows is chi-square with 27 a sensor; error rate 1e-3 over 100 sensors."""
    found = draws(36)
    scale = np.array([np.linalg.norm(part.response, axis=1).mean() for part in found.parts])
    total = np.sum(found.residuals**2 * 36 / (SIGMA / scale) ** 2 * ROWS)
    low, high = chi2.ppf((0.0005, 0.9995), 27 * 100)
    # Rounding adds 1/12 to 1600 counts^2; scale factors differ by up to 2 %.
    assert 0.96 * low < total < 1.04 * high


def test_nine_poses_do_not_claim_to_be_exact(write_log: WriteLog) -> None:
    rng = np.random.default_rng(8)
    parts = array(1, rng)
    (fitted,), _ = fit(write_log, parts, directions(9, rng))
    # No estimate from nine means can be surer than all nine averaged.
    assert (sem(fitted.bias_sem_lsb) > 0.3 * SIGMA / np.sqrt(ROWS * 9)).all()


def test_the_array_keeps_the_orientation_of_its_configuration(write_log: WriteLog) -> None:
    """Poses turned as a whole change nothing: nobody knows how the table lies."""
    rng = np.random.default_rng(9)
    parts = [Part(accelerometer(f"A{i}", AXES[i]), ideal(AXES[i], 2048), np.zeros(3), 0.0) for i in range(4)]
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    ups = directions(18, rng)
    for poses in (ups, ups @ turn.T):
        for fitted, part in zip(fit(write_log, parts, poses)[0], parts, strict=True):
            # Rounding: 1/sqrt(12) counts a pose; six times the worst entry's sqrt(15 / 18).
            assert fitted.response_lsb_per_unit == pytest.approx(part.response, abs=6 * np.sqrt(15 / 18 / 12))
        (write_log.folder / "run.h5").unlink()


def test_a_turned_sensor_is_turned_back_onto_the_others(write_log: WriteLog) -> None:
    """One of eight sensors sits 2 degrees askew: the common orientation moves by an eighth, the rest is found."""
    rng = np.random.default_rng(10)
    angle = np.radians(2.0)
    askew = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    parts = [
        Part(accelerometer(f"A{i}"), 2048.0 * (askew if i == 0 else np.eye(3)), np.zeros(3), 1.0) for i in range(8)
    ]
    fitted, _ = fit(write_log, parts, directions(24, rng))
    azimuth = [calibration.azimuth_elevation_deg()[0, 0] for calibration in fitted]
    assert azimuth[0] - np.mean(azimuth[1:]) == pytest.approx(-2.0, abs=0.02)
    assert np.mean(azimuth) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("count", [0, 1, 8])
def test_fewer_than_nine_poses(write_log: WriteLog, count: int) -> None:
    rng = np.random.default_rng(1)
    parts = array(1, rng)
    with (
        open_log(write_log(parts, directions(8, rng), names=[(f"pose {i}", "") for i in range(8)])) as log,
        pytest.raises(CalibrationError, match=f"{count} static poses, at least 9"),
    ):
        fit_gravity(list(log.sensors.values()), [Pose(phase, None) for phase in log.phases[:count]])


@pytest.mark.parametrize("sigma", [0.0, 5.0, 40.0, 200.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_poses_in_one_plane_are_refused(write_log: WriteLog, sigma: float, seed: int) -> None:
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    ups = np.stack([np.cos(angle), np.sin(angle), np.zeros(20)], axis=1)
    parts = array(1, np.random.default_rng(seed), sigma)
    with pytest.raises(CalibrationError, match="more different sides"):
        fit(write_log, parts, ups, seed)


def test_the_same_pose_nine_times_is_refused(write_log: WriteLog) -> None:
    with pytest.raises(CalibrationError, match="more different sides"):
        fit(write_log, array(1, np.random.default_rng(1)), np.tile([0.0, 0.0, 1.0], (9, 1)))
