"""White noise and floor from curves of known shape."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.characterise import allan_deviation
from imuarray.characterise.allan_curve import floor, white_noise

TAU_S = 0.01 * 2.0 ** np.arange(16)
SURE = np.full(16, 1e6)


def test_density_of_a_white_curve() -> None:
    found = white_noise(TAU_S, 0.3 / np.sqrt(TAU_S), SURE)
    assert found is not None
    assert found.density == pytest.approx(0.3, rel=1e-12)
    assert (found.shortest_s, found.longest_s) == pytest.approx((0.01, 0.08))


def test_the_filtered_start_is_ignored() -> None:
    """Flat up to 0.04 s like the output of a low-pass filter, then white: the density is that of the white part."""
    deviation = 0.3 / np.sqrt(np.maximum(TAU_S, 0.04))
    found = white_noise(TAU_S, deviation, SURE)
    assert found is not None
    assert found.density == pytest.approx(0.3, rel=1e-12)
    assert found.shortest_s == pytest.approx(0.04)


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
    found = [white_noise(curve.tau_s, curve.deviation[:, k], curve.freedom[:, k]) for k in range(60)]
    densities = np.array([white.density for white in found if white])
    assert len(densities) == 60
    assert abs(densities.mean() - 0.2) < 5 * densities.std() / 60**0.5
    assert densities.std() < 0.01 * 0.2


def test_the_floor_is_the_minimum_of_the_curve() -> None:
    """White noise and a random walk that cross at 1.28 s: adev^2 = a / tau + b tau, its minimum is 2 sqrt(a b)."""
    deviation = np.sqrt(0.04 / TAU_S + 0.04 / 1.28**2 * TAU_S)
    found = floor(TAU_S, deviation, 0.9 * deviation, 1.1 * deviation, SURE)
    assert found is not None
    assert found.tau_s == pytest.approx(1.28)
    assert found.instability == pytest.approx(np.sqrt(2 * 0.04 / 1.28) / 0.664, rel=1e-3)
    assert (found.low, found.high) == pytest.approx((0.9 * found.instability, 1.1 * found.instability))
    assert not found.is_bound


def test_a_floor_that_is_not_reached_is_a_bound() -> None:
    deviation = 0.3 / np.sqrt(TAU_S)
    unsure = np.where(TAU_S > 100, 2.0, 1e6)
    found = floor(TAU_S, deviation, deviation, deviation, unsure)
    assert found is not None
    assert found.is_bound
    assert found.tau_s == pytest.approx(TAU_S[TAU_S <= 100][-1])


def test_a_constant_series_has_no_density_and_no_floor() -> None:
    nothing = np.zeros(16)
    assert white_noise(TAU_S, nothing, SURE) is None
    assert floor(TAU_S, nothing, nothing, nothing, SURE) is None
