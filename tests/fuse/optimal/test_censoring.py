"""Clipped axes as bounds: compared with scipy's truncated normal and with integrals on a grid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from imuarray.fuse.frames import Axis, Frames, matrices
from imuarray.fuse.optimal import AxisErrors, ErrorModel, Optimal
from imuarray.fuse.optimal.frame_solution import truncate_normal
from tests.fuse.optimal.conftest import FORCE, PERIOD_S, model_of, times, triad

END = 0.98 * 10.0


def pair(bias: float = 0.0) -> tuple[list[Axis], ErrorModel]:
    """A wide range, and a narrow one of +-10 m/s2, both along the box axes; noise 0.5 and 0.2."""
    axes = [*triad("S0", np.eye(3), noise_si=0.5), *triad("S1", np.eye(3), noise_si=0.2, range_si=10.0)]
    return axes, model_of(axes, bias=bias)


def test_the_standard_truncated_normal_equals_scipy() -> None:
    for distance in (-40.0, -5.0, -1.0, 0.0, 0.5, 3.0, 8.0, 30.0):
        mean, variance = truncate_normal(np.array([distance]))
        wanted = truncnorm.stats(distance, np.inf, moments="mv")
        assert mean[0] == pytest.approx(wanted[0], rel=1e-9, abs=1e-9)
        assert variance[0] == pytest.approx(wanted[1], rel=1e-6)


@pytest.mark.parametrize("distance", [100.0, 1e4, 1e8])
def test_the_far_tail_of_the_truncated_normal_is_exponential(distance: float) -> None:
    """Mean d + 1/d and deviation 1/d (Mills's ratio), where scipy's own loses all digits."""
    mean, variance = truncate_normal(np.array([distance]))
    assert mean[0] == pytest.approx(distance + 1 / distance, rel=1e-6)
    assert np.sqrt(variance[0]) == pytest.approx(1 / distance, rel=1e-3)


@pytest.mark.parametrize("end", [1, -1])
@pytest.mark.parametrize("reading", [9.0, 10.1, 13.0])
def test_one_clipped_axis_gives_a_truncated_normal(reading: float, end: int) -> None:
    """In one dimension u given the wide reading is N(reading, 0.5^2), and the narrow one's y = u + 0.2 n is beyond its
    end: y is a truncated normal of variance 0.29, and u follows it by 0.25 / 0.29.
    """
    axes, model = pair()
    values = np.array([[end * reading, 1.0, 2.0, end * 10.0, 0.0, 0.0]])
    clipped = np.array([[0, 0, 0, end, 0, 0]], np.int8)
    frames = Frames(times(1), values, np.array([[True] * 3 + [False] * 3]), clipped)
    estimate = Optimal({FORCE: axes}, model, period_s=PERIOD_S)({FORCE: frames})[FORCE]
    wide = np.sqrt(0.29)
    mean, variance = truncnorm.stats((END - reading) / wide, np.inf, loc=reading, scale=wide, moments="mv")
    assert estimate.triad_box[0] == pytest.approx([end * (reading + 0.25 / 0.29 * (mean - reading)), 1.0, 2.0])
    wanted = 0.25 - (0.25 / 0.29) ** 2 * (0.29 - variance)
    assert matrices(estimate.covariance_box[0]) == pytest.approx(np.diag([wanted, 0.25, 0.25]))


def test_several_clipped_axes_with_common_direction_and_biases() -> None:
    """Mean and covariance by a fine grid over the one unknown: two narrow axes along X, both clipped, biases unknown by
    0.3. Processing them one after the other has an error below 3 % of a standard deviation.
    """
    axes = [
        axis
        for name, wide in (("S0", 1e3), ("S1", 10.0), ("S2", 10.0))
        for axis in triad(name, np.eye(3), range_si=wide)
    ]
    model = ErrorModel({(axis.sensor, axis.index): AxisErrors(0.2, bias=0.3) for axis in axes})
    values = np.array([[9.6, 0, 0, 10.0, 0, 0, 10.0, 0, 0]])
    clipped = np.array([[0, 0, 0, 1, 0, 0, 1, 0, 0]], np.int8)
    frames = Frames(times(1), values, np.array([[True] * 3 + [False, True, True] * 2]), clipped)
    estimate = Optimal({FORCE: axes}, model, period_s=PERIOD_S)({FORCE: frames})[FORCE]
    grid = np.linspace(4.0, 16.0, 20_001)
    weights = norm.pdf(grid, 9.6, np.sqrt(0.13)) * norm.sf(END, grid, np.sqrt(0.13)) ** 2
    mean = np.average(grid, weights=weights)
    spread = np.sqrt(np.average((grid - mean) ** 2, weights=weights))
    assert estimate.triad_box[0, 0] == pytest.approx(mean, abs=0.03 * spread)
    assert np.sqrt(estimate.covariance_box[0, 0]) == pytest.approx(spread, rel=0.03)


def test_a_reading_near_the_end_of_the_range_is_a_bound() -> None:
    """9.9 of 10 without a flag: only the bound that the truth is at 9.8 or beyond is used."""
    axes, model = pair()
    values = np.array([[12.0, 0, 0, 9.9, 0, 0]])
    estimate = Optimal({FORCE: axes}, model, period_s=PERIOD_S)(
        {FORCE: Frames(times(1), values, np.ones((1, 6), bool))}
    )
    assert not estimate[FORCE].used[0, 3]
    assert estimate[FORCE].used[0, [0, 1, 2, 4, 5]].all()
    assert estimate[FORCE].triad_box[0, 0] == pytest.approx(12.0, abs=1e-3)


def test_readings_near_the_end_are_values_if_only_they_determine_a_direction() -> None:
    """Two triads of 0.2 and 0.3, the second turned by 10 mrad about Y, X at 9.9 of 10 on both: the triad is the
    weighted least squares of all six readings (the formula of Gauss and Markov), not the estimate of X from Z of the
    second, whose deviation is 0.36 / 0.01 = 36.
    """
    turned = np.array([[np.cos(0.01), 0, -np.sin(0.01)], [0, 1, 0], [np.sin(0.01), 0, np.cos(0.01)]])
    axes = [*triad("S0", np.eye(3), noise_si=0.2, range_si=10.0), *triad("S1", turned, noise_si=0.3, range_si=10.0)]
    rows = np.concatenate([np.eye(3), turned])
    values = rows @ np.array([9.95, 1.0, 2.0]) + np.array([-0.02, 0.1, -0.1, 0.01, 0.2, 0.3])
    estimate = Optimal({FORCE: axes}, model_of(axes), period_s=PERIOD_S)(
        {FORCE: Frames(times(1), values[None], np.ones((1, 6), bool))}
    )[FORCE]
    weights = np.repeat([1 / 0.2**2, 1 / 0.3**2], 3)
    covariance = np.linalg.inv(rows.T @ (rows * weights[:, None]))
    assert estimate.triad_box[0] == pytest.approx(covariance @ rows.T @ (weights * values), abs=1e-9)
    assert matrices(estimate.covariance_box[0]) == pytest.approx(covariance)
    assert estimate.used.all()


def test_a_reading_near_the_end_is_a_value_if_another_of_its_range_is_below() -> None:
    """9.81 and 9.79 of 10, both of 0.2: their mean, 9.8."""
    axes = [*triad("S0", np.eye(3), noise_si=0.2, range_si=10.0), *triad("S1", np.eye(3), noise_si=0.2, range_si=10.0)]
    values = np.array([[9.81, 0, 0, 9.79, 0, 0]])
    estimate = Optimal({FORCE: axes}, model_of(axes), period_s=PERIOD_S)(
        {FORCE: Frames(times(1), values, np.ones((1, 6), bool))}
    )[FORCE]
    assert estimate.triad_box[0] == pytest.approx([9.8, 0, 0])
    assert matrices(estimate.covariance_box[0]) == pytest.approx(0.02 * np.eye(3))


def test_a_flagged_reading_is_a_bound_in_every_case() -> None:
    """The first triad is flagged, the second reads 9.9: one value and one bound, of one unknown.
    Integrals on a grid.
    """
    axes = [
        *triad("S0", np.eye(3), noise_si=0.5, range_si=10.0),
        *triad("S1", np.eye(3), noise_si=0.2, range_si=10.0),
    ]
    values = np.array([[10.0, 1.0, 2.0, 9.9, 1.0, 2.0]])
    flagged = np.array([[1, 0, 0, 0, 0, 0]], np.int8)
    frames = Frames(times(1), values, np.array([[False] * 3 + [True] * 3]), flagged)
    estimate = Optimal({FORCE: axes}, model_of(axes), period_s=PERIOD_S)({FORCE: frames})[FORCE]
    grid = np.linspace(8.0, 12.0, 20_001)
    weights = norm.pdf(grid, 9.9, 0.2) * norm.sf(END, grid, 0.5)
    mean = np.average(grid, weights=weights)
    spread = np.sqrt(np.average((grid - mean) ** 2, weights=weights))
    assert estimate.triad_box[0, 0] == pytest.approx(mean, abs=1e-6)
    assert np.sqrt(estimate.covariance_box[0, 0]) == pytest.approx(spread, rel=1e-6)


@pytest.mark.slow
def test_errors_agree_with_covariances_beyond_the_range_and_back() -> None:
    """A ramp from 8 to 12 and back, 20 000 readings. Errors agree with their covariances: 3000 to 5000 squares of an
    axis, 99.9 % of the time within 10 %; where the narrow sensor is clipped its bound makes them smaller than those of
    the wide sensor; and the readings below the end by chance do not bias the estimates.
    """
    rng = np.random.default_rng(101)
    axes, model = pair(bias=0.05)
    ramp = np.concatenate([np.linspace(8.0, 12.0, 10_000), np.linspace(12.0, 8.0, 10_000)])
    truth = np.stack([ramp, np.zeros(20_000), np.full(20_000, 9.0)], axis=1)
    values = np.tile(truth, 2) + np.array([axis.noise_si for axis in axes]) * rng.normal(size=(20_000, 6))
    clipped = np.zeros(values.shape, np.int8)
    clipped[:, 3:] = values[:, 3:] >= 10.0
    values[:, 3:] = np.minimum(values[:, 3:], 10.0)
    optimal = Optimal({FORCE: axes}, model, period_s=PERIOD_S)
    estimate = optimal({FORCE: Frames(times(20_000), values, clipped == 0, clipped)})[FORCE]
    assert all(abs(of.bias) < 3.5 * of.sd for of in optimal.learned()[FORCE])
    error = (estimate.triad_box - truth)[:, 0]
    for low, high in ((8.0, 9.0), (9.0, 10.8), (10.8, 12.0)):
        there = (ramp > low) & (ramp < high)
        assert np.mean(error[there] ** 2 / estimate.covariance_box[there, 0]) == pytest.approx(1.0, rel=0.1)
    beyond = (ramp > 10.0) & (ramp < 10.5)
    assert np.mean(error[beyond] ** 2) < 0.75 * np.mean((values[:, 0] - ramp)[beyond] ** 2)


@pytest.mark.slow
def test_sensors_of_one_range_are_as_accurate_as_stated_up_to_its_end() -> None:
    """Eight triads of one range, tilted by some 10 mrad, in a box whose X goes from 9 to 9.85 of 10: in the last 2 %
    the errors are those of the mean of eight (0.05 / sqrt(8)), and agree with their covariances.
    """
    rng = np.random.default_rng(25)
    tilts = np.cross(np.eye(3), rng.normal(0, 0.01, (8, 1, 3)))
    axes = [
        axis for i, tilt in enumerate(tilts) for axis in triad(f"S{i}", np.eye(3) + tilt, noise_si=0.05, range_si=10.0)
    ]
    ramp = np.linspace(9.0, 9.85, 4_000)
    truth = np.stack([ramp, np.zeros(4_000), np.full(4_000, 3.0)], axis=1)
    whole = truth @ np.concatenate([np.eye(3) + tilt for tilt in tilts]).T + rng.normal(0, 0.05, (4_000, 24))
    values = np.clip(whole, -10.0, 10.0)
    clipped = (whole >= 10.0).astype(np.int8)
    valid = ~np.repeat(clipped.reshape(-1, 8, 3).any(axis=2), 3, axis=1)
    estimate = Optimal({FORCE: axes}, model_of(axes), period_s=PERIOD_S)(
        {FORCE: Frames(times(4_000), values, valid, clipped)}
    )[FORCE]
    error = (estimate.triad_box - truth)[:, 0]
    last = (ramp > 9.8) & valid.all(axis=1)
    assert last.sum() > 200
    assert np.sqrt(np.mean(error[last] ** 2)) == pytest.approx(0.05 / np.sqrt(8), rel=0.15)
    assert np.abs(error).max() < 0.15
    assert np.mean(error**2 / estimate.covariance_box[:, 0]) == pytest.approx(1.0, rel=0.1)
