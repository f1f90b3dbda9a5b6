"""Arbitrary static poses: bias and response are within their stated uncertainty, in any orientation of the array."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.stats import chi2, norm, t

from imuarray.calibrate import SensorCalibration
from imuarray.calibrate.gravity import GravityFit, fit_gravity, fit_readings
from imuarray.calibrate.pose_readings import Pose, PoseReadings
from imuarray.errors import CalibrationError
from imuarray.log import SensorLog, open_log
from imuarray.log.format import Phase
from tests.calibrate.conftest import Floats, Part, WriteLog, accelerometer, directions, ideal, skewed
from tests.selection import some

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z")
SIGMA = 40.0
ROWS = 64


def array(count: int, rng: np.random.Generator, sigma: float = SIGMA) -> list[Part]:
    """`count` accelerometers with errors of scale factors and angles of up to 2 % and biases up to 100 counts (2048 per
    g).
    """
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
        result = fit_gravity(list(log.sensors.values()), [Pose(phase, None) for phase in log.phases])
        return list(result.calibrations), result.residual_g


class Draws(NamedTuple):
    """Fitted and true parameters of many sensors in the same poses."""

    parts: list[Part]
    fitted: list[SensorCalibration]
    residuals: Floats
    poses: int

    def bias_ratios(self) -> Floats:
        """(sensors, 3) error of the bias over its standard error."""
        pairs = zip(self.fitted, self.parts, strict=True)
        return np.array([(result.bias_lsb - part.bias) / sem(result.bias_sem_lsb) for result, part in pairs])

    def scale_ratios(self) -> Floats:
        """(sensors, 3) error of the scale factor over the stated standard error of the response."""
        pairs = zip(self.fitted, self.parts, strict=True)
        return np.array(
            [
                (result.scale_lsb_per_unit - np.linalg.norm(part.response, axis=1))
                / sem(result.response_sem_lsb_per_unit)
                for result, part in pairs
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
    """(3,) sums over the draws of the squared normal scores of ratios that are Student t with `freedom`: the scatter
    within poses is known from 15 batches of each.
    """
    return np.asarray((norm.ppf(t.cdf(ratios, freedom)) ** 2).sum(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("poses", [pytest.param(20, marks=pytest.mark.campaign), 36])
def test_bias_is_within_its_stated_uncertainty(poses: int) -> None:
    """Chi-square over 100 draws; two-sided error rate 1e-3 for each of three axes and two pose counts."""
    sums = sums_of_squares(draws(poses).bias_ratios(), 15 * poses)
    low, high = chi2.ppf((0.0005, 0.9995), 100)
    assert (sums > low).all() and (sums < high).all(), sums


@pytest.mark.slow
def test_response_is_within_its_stated_uncertainty() -> None:
    """Chi-square over 100 draws; error rate 1e-3 for each axis. (A sem that is too large would pass.)"""
    sums = sums_of_squares(draws(36).scale_ratios(), 15 * 36)
    assert (sums < chi2.ppf(0.999, 100)).all(), sums


@pytest.mark.slow
def test_response_is_within_the_bound_of_an_ellipsoid_fit() -> None:
    """Every entry within a bound of its own: six times sqrt(15 / poses), the worst entry of a sphere's ellipsoid fit.

    For directions spread evenly the mean of x^2 y^2 is 1/15, so an off-diagonal shape parameter has the variance 15
    sigma^2 / poses, the largest of all nine; the remainder is a rotation, which 36 poses determine better.
    """
    result = draws(36)
    worst = 6 * np.sqrt(15 / 36) * SIGMA / np.sqrt(ROWS)
    for fitted, part in zip(result.fitted, result.parts, strict=True):
        assert np.abs(fitted.response_lsb_per_unit - part.response).max() < worst


@pytest.mark.slow
def test_residuals_have_the_variance_of_the_noise() -> None:
    """Sum of squares over sigma^2 / rows is chi-square with 32 degrees of freedom for each sensor: a hundred sensors
    determine the vertical, and a straight line along it has four unknowns for 36 readings. Error rate 1e-3 over 100
    sensors.
    """
    result = draws(36)
    scale = np.array([np.linalg.norm(part.response, axis=1).mean() for part in result.parts])
    total = np.sum(result.residuals**2 * 36 / (SIGMA / scale) ** 2 * ROWS)
    low, high = chi2.ppf((0.0005, 0.9995), 32 * 100)
    # Rounding adds 1/12 to 1600 counts^2; scale factors differ by up to 2 %.
    assert 0.96 * low < total < 1.04 * high


def test_nine_poses_have_a_realistic_standard_error(write_log: WriteLog) -> None:
    rng = np.random.default_rng(8)
    parts = array(1, rng)
    (fitted,), _ = fit(write_log, parts, directions(9, rng))
    # No estimate from nine means has a smaller error than the mean of all nine.
    assert (sem(fitted.bias_sem_lsb) > 0.3 * SIGMA / np.sqrt(ROWS * 9)).all()


@pytest.mark.slow
def test_the_array_keeps_the_orientation_of_its_configuration(write_log: WriteLog) -> None:
    """A common rotation of all poses changes nothing, since the orientation of the table is unknown."""
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


@pytest.mark.slow
def test_a_misaligned_sensor_is_aligned_to_the_others(write_log: WriteLog) -> None:
    """One of eight sensors is misaligned by 2 degrees: the common orientation moves by an eighth of it, seven eighths
    are estimated.
    """
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


NEES_POSES = 12
NEES_PARTS = 2


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[SensorLog, ...]]:
    """Two accelerometers of different orientation; their readings are drawn, not recorded."""
    parts = array(NEES_PARTS, np.random.default_rng(30))
    with open_log(WriteLog(tmp_path_factory.mktemp("pair"))(parts, np.eye(3), rows=2)) as log:
        yield tuple(log.sensors.values())


def drawn(
    sensors: Sequence[SensorLog],
    rng: np.random.Generator,
    poses: int,
    *,
    wander: float | Floats = 0.0,
    drift: float = 0.0,
    strange: float = 0.0,
) -> tuple[PoseReadings, Floats]:
    """Readings of `poses` random directions and the true coefficients (6, 4), turned so that no common rotation
    remains.

    Noise of SIGMA over ROWS rows, known from 15 batches a pose; biases that `wander` (counts) from pose to pose or
    `drift` (counts from first to last); in the last pose `strange` g more than gravity.
    """
    parts = array(len(sensors), np.random.default_rng(30))
    rows = np.concatenate([np.column_stack([part.response, part.bias]) for part in parts])
    turned = [part.header.sensitivity * sensor.orientation.T for part, sensor in zip(parts, sensors, strict=True)]
    # The turn that makes the mean response symmetric in the box frame, by the polar decomposition.
    mean = np.sum([n.T @ part.response for n, part in zip(turned, parts, strict=True)], axis=0)
    rows[:, :3] = rows[:, :3] @ polar(mean)[0].T
    ups = directions(poses, rng)
    ups[-1] *= 1 + strange
    noise = SIGMA / np.sqrt(ROWS)
    exact = np.column_stack([ups, np.ones(poses)]) @ rows.T + drift * np.linspace(-0.5, 0.5, poses)[:, None]
    means = exact + rng.normal(0, np.hypot(noise, wander), exact.shape)
    shape = (len(sensors), poses, 3)
    variance = np.repeat(noise**2 * rng.chisquare(15 * poses, (len(sensors), 1, 3)) / (15 * poses), poses, axis=1)
    second = 1_000_000_000
    phases = [Phase(10 * k * second, (10 * k + 8) * second, f"pose {k + 1}") for k in range(poses)]
    readings = PoseReadings(
        tuple(sensors),
        tuple(Pose(phase, None) for phase in phases),
        means.reshape(poses, len(sensors), 3).transpose(1, 0, 2),
        variance,
        rng.normal(0, 2 * noise, shape),
        np.full(shape, 2 * noise),
    )
    return readings, rows


def squared_errors(found: GravityFit, truth: Floats) -> float:
    """Normalised error squared of all parameters of all sensors; chi-square, three degrees of freedom less than
    parameters.
    """
    error = np.concatenate([fitted.coefficients[:, :4] for fitted in found.fits]) - truth
    inverse = np.linalg.pinv(found.covariance, rcond=1e-9, hermitian=True)
    return float(error.ravel() @ inverse @ error.ravel())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drift", "poses", "count"), some([(0.0, NEES_POSES, 50), (0.0, NEES_POSES, 120), (40.0, 20, 50)], 2, 0)
)
def test_parameters_of_many_draws_are_within_their_covariance(
    pair: tuple[SensorLog, ...], drift: float, poses: int, count: int
) -> None:
    """Mean of the normalised error squared, chi-square with 21 degrees of freedom a draw; two-sided error rate 1e-3 for
    each of three cases. Noise known from 15 degrees of freedom a pose makes it larger by 2 / (15 poses - 2).
    """
    rng = np.random.default_rng(31)
    result = [fit_drawn(pair, rng, poses, drift=drift) for _ in range(count)]
    drifting = [fitted.drift_terms > 0 for fitted, _ in result]
    assert sum(bool(fitted.left_out) for fitted, _ in result) <= 2  # one in a thousand
    assert np.mean(drifting) > 0.9 if drift else np.mean(drifting) < 0.02
    total = np.mean([squared_errors(*each) for each in result])
    low, high = chi2.ppf((0.0005, 0.9995), 21 * count) / count
    assert low < total < high * (1 + 2 / (15 * poses - 2))


def fit_drawn(
    pair: tuple[SensorLog, ...], rng: np.random.Generator, poses: int, **options: float
) -> tuple[GravityFit, Floats]:
    readings, truth = drawn(pair, rng, poses, **options)
    return fit_readings(readings), truth


@pytest.mark.slow
def test_scatter_of_biases_between_poses_widens_the_covariance(pair: tuple[SensorLog, ...]) -> None:
    """Biases that scatter by three times the noise: chi-squared by noise alone is 10; with each axis's own scatter,
    known from some 24 - 4 - 48 / 6 = 12 degrees of freedom, the error squared is larger by 12 / 10 than chi-square.
    Over 30 draws its mean is within 3.3 standard errors of that.
    """
    rng = np.random.default_rng(32)
    totals, reduced, wander = [], [], []
    for _ in range(30):
        result, truth = fit_drawn(pair, rng, 24, wander=15.0)
        totals.append(squared_errors(result, truth))
        reduced += [fitted.reduced_chi_squared for fitted in result.fits]
        wander += [fitted.repeatability_lsb for fitted in result.fits]
    assert np.mean(reduced) == pytest.approx(1 + 15**2 / 5**2, rel=0.1)
    assert np.sqrt(np.mean(np.square(wander))) == pytest.approx(15.0, rel=0.1)
    assert np.mean(totals) / 21 == pytest.approx(1.2, abs=3.3 * np.std(totals) / 21 / 30**0.5)


@pytest.mark.slow
def test_only_the_wandering_axis_has_a_scatter_term(pair: tuple[SensorLog, ...]) -> None:
    """The y axis of the second sensor wanders by 30 counts, six times the noise, known from some 54 degrees of freedom
    to a tenth. It turns the fitted directions a little, so its triad scatters too, but by less than the noise of 5.
    Where nothing wanders, chi-squared of 1.06 and 1.1 is chance (one draw in ten has both above 1.05).
    """
    wander = np.array([0.0, 0.0, 0.0, 0.0, 30.0, 0.0])
    readings, _ = drawn(pair, np.random.default_rng(37), 60, wander=wander)
    first, second = fit_readings(readings).fits
    assert first.repeatability_lsb.tolist() == [0.0, 0.0, 0.0]
    assert second.repeatability_lsb[1] == pytest.approx(30.0, rel=0.4) and second.repeatability_lsb[[0, 2]].max() < 5
    calm, _ = drawn(pair, np.random.default_rng(42), 60)
    fits = fit_readings(calm).fits
    assert min(fitted.reduced_chi_squared for fitted in fits) > 1.05
    assert all(fitted.repeatability_lsb.tolist() == [0.0, 0.0, 0.0] for fitted in fits)


def test_a_drift_term_is_estimated_and_removed_from_the_residuals(pair: tuple[SensorLog, ...]) -> None:
    result, _ = fit_drawn(pair, np.random.default_rng(33), 20, drift=80.0)
    assert result.drift_terms == 1
    # First minus last; a slope over 20 poses is known to 5 sqrt(12 / 20) of a noise of 5 counts.
    assert result.drift_lsb == pytest.approx(np.full((2, 3), -80.0), abs=6 * 5 * np.sqrt(12 / 20))
    assert result.residual_g.max() < 4 * 5 / 2048
    assert result.held_out_residual_g.max() < 8 * 5 / 2048


def test_a_disturbed_pose_is_excluded_and_named(pair: tuple[SensorLog, ...]) -> None:
    result, truth = fit_drawn(pair, np.random.default_rng(34), 20, strange=0.05)
    assert [each.phase for each in result.left_out] == ["pose 20"]
    assert float(result.left_out[0].reason.split()[0]) == pytest.approx(50.0, abs=20.0)  # mg
    assert "not at rest" in result.left_out[0].reason
    low, high = chi2.ppf((0.0005, 0.9995), 21)
    assert low < squared_errors(result, truth) < high


def test_disturbed_poses_are_named_where_too_few_remain(pair: tuple[SensorLog, ...]) -> None:
    readings, _ = drawn(pair, np.random.default_rng(35), 9)
    readings.change_lsb[:, 3] = 100.0 * np.array([sensor.orientation.T @ (1.0, 0.0, 0.0) for sensor in pair])
    with pytest.raises(
        CalibrationError, match=r"8 undisturbed poses, at least 9 .* pose 4: the box moved: .* 48\.8 mg"
    ):
        fit_readings(readings)


def test_poses_of_a_separate_session_are_excluded(pair: tuple[SensorLog, ...]) -> None:
    readings, _ = drawn(pair, np.random.default_rng(36), 12)
    late = [pose.phase._replace(start_ns=10**12, end_ns=10**12 + 10**10) for pose in readings.poses[-1:]]
    poses = (*readings.poses[:-1], *(Pose(phase, None) for phase in late))
    result = fit_readings(replace(readings, poses=poses))
    assert [each.phase for each in result.left_out] == ["pose 12"]
    assert "11 poses that were recorded together" in result.left_out[0].reason


@pytest.mark.parametrize("count", [0, 1, 8])
def test_fewer_than_nine_poses_are_refused(write_log: WriteLog, count: int) -> None:
    rng = np.random.default_rng(1)
    parts = array(1, rng)
    with (
        open_log(write_log(parts, directions(8, rng), names=[(f"pose {i}", "") for i in range(8)])) as log,
        pytest.raises(CalibrationError, match=f"{count} static poses, at least 9"),
    ):
        fit_gravity(list(log.sensors.values()), [Pose(phase, None) for phase in log.phases[:count]])


@pytest.mark.slow
@pytest.mark.parametrize("sigma", some([0.0, 5.0, 40.0, 200.0], 1))
@pytest.mark.parametrize("seed", some([1, 2], 1, 0))
def test_poses_in_one_plane_are_refused(write_log: WriteLog, sigma: float, seed: int) -> None:
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    ups = np.stack([np.cos(angle), np.sin(angle), np.zeros(20)], axis=1)
    parts = array(1, np.random.default_rng(seed), sigma)
    with pytest.raises(CalibrationError, match="add poses on other sides"):
        fit(write_log, parts, ups, seed)


def test_unnamed_poses_on_the_six_faces_are_refused_with_advice(write_log: WriteLog) -> None:
    """Twelve poses on the unnamed faces of a box: the magnitude of gravity along the axes does not determine the angles
    between them.
    """
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    with pytest.raises(CalibrationError, match=r"poses lie on the six faces.* edges and corners, or name the faces"):
        fit(write_log, array(1, np.random.default_rng(1), 0.0), np.concatenate([faces, faces]), 1)


@pytest.mark.slow
def test_nine_equal_poses_are_refused(write_log: WriteLog) -> None:
    with pytest.raises(CalibrationError, match="add poses on other sides"):
        fit(write_log, array(1, np.random.default_rng(1)), np.tile([0.0, 0.0, 1.0], (9, 1)))
