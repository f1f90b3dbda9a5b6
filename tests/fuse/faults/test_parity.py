"""Parity residuals against another derivation: least squares with and without the fault."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.arrays import Floats
from imuarray.fuse.faults.window import Parity, Spaces, parity, slope, slopes
from imuarray.fuse.least_squares import spans
from tests.selection import examples


def drawn(seed: int, sensors: int) -> tuple[Floats, Floats, Floats]:
    """Random triads (turned at random), weights and values."""
    rng = np.random.default_rng(seed)
    rows = np.concatenate([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(sensors)])
    return rows, rng.uniform(0.5, 4.0, 3 * sensors), rng.normal(size=3 * sensors)


def of(rows: Floats, weights: Floats) -> Parity:
    result = parity(rows, weights)
    assert result is not None
    return result


def squares(rows: Floats, weights: Floats, values: Floats) -> float:
    """The residual sum of squares of weighted least squares."""
    root = np.sqrt(weights)
    solved = np.linalg.lstsq(root[:, None] * rows, root * values, rcond=None)[0]
    return float((weights * (values - rows @ solved) ** 2).sum())


@settings(max_examples=examples(25), deadline=None)
@given(seed=st.integers(0, 10**6), sensors=st.integers(2, 5))
def test_gains_are_the_decrease_of_the_squares_by_a_free_error(seed: int, sensors: int) -> None:
    """Twice the log-likelihood ratio of nested normal models is the difference of their weighted sums of squares."""
    rows, weights, values = drawn(seed, sensors)
    space, before = of(rows, weights), squares(rows, weights, values)
    unit = np.eye(len(rows))
    for axis, gain in enumerate(space.axis_gains(values)):
        assert gain == pytest.approx(before - squares(np.c_[rows, unit[:, axis]], weights, values), abs=1e-9)
    for sensor, gain in enumerate(space.sensor_gains(values)):
        freed = np.c_[rows, unit[:, 3 * sensor : 3 * sensor + 3]]
        assert gain == pytest.approx(before - squares(freed, weights, values), rel=1e-6, abs=1e-6)


@settings(max_examples=examples(25), deadline=None)
@given(seed=st.integers(0, 10**6), sensors=st.integers(2, 5))
def test_motion_has_no_parity_residual(seed: int, sensors: int) -> None:
    rows, weights, values = drawn(seed, sensors)
    space = of(rows, weights)
    moved = values + rows @ np.array([30.0, -200.0, 7.0])
    assert space.axis_gains(moved) == pytest.approx(space.axis_gains(values), rel=1e-6, abs=1e-7)


def test_a_deleted_residual_is_the_reading_minus_the_fit_of_the_others() -> None:
    rows, weights, values = drawn(5, 3)
    deleted = of(rows, weights).deleted @ values
    for axis in range(9):
        others = np.delete(np.arange(9), axis)
        root = np.sqrt(weights[others])
        solved = np.linalg.lstsq(root[:, None] * rows[others], root * values[others], rcond=None)[0]
        assert deleted[axis] == pytest.approx(values[axis] - rows[axis] @ solved)


@pytest.mark.slow
def test_without_a_fault_gains_are_chi_square() -> None:
    """Mean 1 and 3 of 4000 draws, within five standard errors (sqrt(2 k / 4000)): 6e-7 per figure."""
    rows, weights, _ = drawn(8, 4)
    noise = np.random.default_rng(8).normal(size=(4000, 12)) / np.sqrt(weights)
    space = of(rows, weights)
    axis = np.mean([space.axis_gains(row) for row in noise], axis=0)
    sensor = np.mean([space.sensor_gains(row) for row in noise], axis=0)
    assert np.abs(axis - 1).max() < 5 * np.sqrt(2 / 4000)
    assert np.abs(sensor - 3).max() < 5 * np.sqrt(6 / 4000)


def test_either_of_two_triads_explains_the_difference() -> None:
    rows, weights, values = drawn(3, 2)
    gains = of(rows, weights).sensor_gains(values)
    assert gains[0] == pytest.approx(gains[1], rel=1e-6)


def test_an_axis_without_redundancy_is_not_observable() -> None:
    """x twice, y and z once: only x can be checked."""
    space = of(np.eye(3)[[0, 1, 2, 0]], np.ones(4))
    assert space.observable.tolist() == [True, False, False, True]
    assert space.axis_gains(np.array([0.0, 5.0, 5.0, 0.0])) == pytest.approx([0.0, 0.0, 0.0, 0.0])


def test_too_few_axes_have_no_parity_space() -> None:
    assert parity(np.eye(3), np.array([1.0, 1.0, 0.0])) is None


def test_slopes_are_central_and_one_sided_at_ends() -> None:
    """Of t^2 at 0, 1, 3 and 4 s: 1 from 0 to 1, 9/3 from 0 to 3, 15/3 from 1 to 4, 7 from 3 to 4."""
    time = np.array([0, 1, 3, 4]) * 1_000_000_000 + 7
    triads = np.array([0.0, 1.0, 9.0, 16.0])[:, None] * [1.0, -2.0, 0.0]
    wanted = np.array([1.0, 3.0, 5.0, 7.0])[:, None] * [1.0, -2.0, 0.0]
    assert slope(time, triads) == pytest.approx(wanted)
    both = slopes(np.stack([time, time]), np.stack([triads, 2 * triads]))
    assert both == pytest.approx(np.stack([wanted, 2 * wanted]))


@settings(max_examples=examples(25), deadline=None)
@given(seed=st.integers(0, 10**6), sensors=st.integers(2, 5))
def test_gains_of_frames_with_gaps_are_least_squares_of_the_valid_readings(seed: int, sensors: int) -> None:
    rng = np.random.default_rng(seed)
    rows, weights, _ = drawn(seed, sensors)
    spaces = Spaces(rows)
    for each in (weights, weights, weights[::-1].copy()):  # the second call reuses the cache, the third replaces it
        valid = np.repeat(rng.random((12, sensors)) < 0.6, 3, axis=1)
        gains, tells = spaces.gains(valid, each)
        assert (tells == valid.any(axis=1)).all()
        values = rng.normal(size=valid.shape)
        for gain, of, value in zip(gains[tells], valid[tells], values[tells], strict=True):
            root = np.sqrt(each[of])
            expected = np.linalg.lstsq(root[:, None] * rows[of], root * value[of], rcond=None)[0]
            np.testing.assert_allclose(gain @ np.where(of, value, 0.0), expected, rtol=1e-9, atol=1e-12)


@settings(max_examples=examples(25), deadline=None)
@given(seed=st.integers(0, 10**6), axes=st.integers(0, 6))
def test_axes_span_space_if_their_rank_is_three(seed: int, axes: int) -> None:
    rows = np.random.default_rng(seed).integers(-1, 2, size=(axes, 3)).astype(float)
    normal = rows.T @ rows
    assert bool(spans(normal)) == (np.linalg.matrix_rank(rows) == 3 if axes else False)
    assert bool(spans(normal)) == bool(spans(normal[None])[0])
