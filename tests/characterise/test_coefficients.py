"""White noise and floor from curves of known shape."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.characterise import allan_deviation
from imuarray.characterise.allan_curve import floor, white_noise

TAU_S = 0.01 * 2.0 ** np.arange(16)
SURE = np.full(16, 1e6)


def test_density_of_a_white_curve() -> None:
    result = white_noise(TAU_S, 0.3 / np.sqrt(TAU_S), SURE)
    assert result is not None
    assert result.density == pytest.approx(0.3, rel=1e-12)
    assert (result.shortest_s, result.longest_s) == pytest.approx((0.01, 0.08))


def test_the_filtered_start_is_ignored() -> None:
    """Flat up to 0.04 s like the output of a low-pass filter, then white: the density is that of the white part."""
    deviation = 0.3 / np.sqrt(np.maximum(TAU_S, 0.04))
    result = white_noise(TAU_S, deviation, SURE)
    assert result is not None
    assert result.density == pytest.approx(0.3, rel=1e-12)
    assert result.shortest_s == pytest.approx(0.04)


@pytest.mark.parametrize("slope", [-1.0, 0.0, 0.5])
def test_a_curve_without_white_part_has_no_density(slope: float) -> None:
    assert white_noise(TAU_S, TAU_S**slope, SURE) is None


def test_too_few_degrees_of_freedom_give_no_result() -> None:
    assert white_noise(TAU_S, 0.3 / np.sqrt(TAU_S), np.full(16, 19.0)) is None
    assert white_noise(TAU_S[:3], 0.3 / np.sqrt(TAU_S[:3]), SURE[:3]) is None
    deviation = 0.3 / np.sqrt(TAU_S)
    assert floor(TAU_S, deviation, deviation, deviation, np.full(16, 4.0)) is None


def test_white_density_of_readings() -> None:
    """Readings of deviation s at a rate f have the two-sided density s / sqrt(f); mean of 60 within 5 errors."""
    noise = np.random.default_rng(5).normal(0, 4.0, (20_000, 60))
    curve = allan_deviation(noise, 1 / 400)
    result = [white_noise(curve.tau_s, curve.deviation[:, k], curve.freedom[:, k]) for k in range(60)]
    densities = np.array([white.density for white in result if white])
    assert len(densities) == 60
    assert abs(densities.mean() - 0.2) < 5 * densities.std() / 60**0.5
    assert densities.std() < 0.01 * 0.2


def test_the_floor_is_the_minimum_of_the_curve() -> None:
    """White noise and a random walk that cross at 1.28 s: adev^2 = a / tau + b tau, its minimum is 2 sqrt(a b)."""
    deviation = np.sqrt(0.04 / TAU_S + 0.04 / 1.28**2 * TAU_S)
    result = floor(TAU_S, deviation, 0.9 * deviation, 1.1 * deviation, SURE)
    assert result is not None
    assert result.tau_s == pytest.approx(1.28)
    assert result.instability == pytest.approx(np.sqrt(2 * 0.04 / 1.28) / 0.664, rel=1e-3)
    assert (result.low, result.high) == pytest.approx((0.9 * result.instability, 1.1 * result.instability))
    assert not result.is_bound


def test_a_floor_that_is_not_reached_is_a_bound() -> None:
    deviation = 0.3 / np.sqrt(TAU_S)
    unsure = np.where(TAU_S > 100, 2.0, 1e6)
    result = floor(TAU_S, deviation, deviation, deviation, unsure)
    assert result is not None
    assert result.is_bound
    assert result.tau_s == pytest.approx(TAU_S[TAU_S <= 100][-1])


def test_a_constant_series_has_no_density_and_no_floor() -> None:
    nothing = np.zeros(16)
    assert white_noise(TAU_S, nothing, SURE) is None
    assert floor(TAU_S, nothing, nothing, nothing, SURE) is None
