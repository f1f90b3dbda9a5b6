"""Variances and covariances of Allan variances against pair sums, degrees of freedom and simulation."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.characterise import allan_deviation
from imuarray.characterise.allan_curve import Noise, degrees_of_freedom
from imuarray.characterise.allan_fit import TERMS, Term, covariance, variances
from tests.selection import some

FACTORS = (1, 2, 5, 16, 60, 200)


def theta(**squares: float) -> np.ndarray:
    return np.array([squares.get(term.replace(" ", "_"), 0.0) for term in TERMS])


def of_phase(term: Term, apart: np.ndarray) -> np.ndarray:
    """Generalised autocovariance of the integrated noise."""
    if term == "quantisation":
        return (apart == 0).astype(float)
    if term == "white":
        return -apart / 2
    if term == "flicker":
        return apart**2 * np.log(np.maximum(apart, 1)) / (2 * np.pi)
    return (apart**3 - apart) / 12


@pytest.mark.parametrize("term", ["quantisation", "white", "flicker", "random walk"])
@pytest.mark.parametrize("ramp", [0.0, 0.3])
@pytest.mark.parametrize(
    "pair", some([((1, 1),), ((1, 2),), ((2, 16),), ((16, 16),), ((1, 60),), ((5, 60),), ((40, 60),)], 3)
)
def test_covariances_equal_sums_over_all_pairs(term: Term, ramp: float, pair: tuple[int, int]) -> None:
    """All pairs of second differences of 150 rows are summed; grouped lags change a correlation by up to 1 %."""
    rows, binomial = 150, np.array([1.0, -2.0, 1.0])
    points = [np.arange(rows + 1 - 2 * m)[:, None] + m * np.arange(3) for m in pair]

    def cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        apart = np.abs(one[:, None, :, None] - other[None, :, None, :]).astype(float)
        return np.einsum("ijab,a,b->ij", of_phase(term, apart), binomial, binomial)

    def by_pairs(a: int, b: int) -> float:
        r, means = cross(points[a], points[b]), ramp**2 * pair[a] ** 2 * pair[b] ** 2
        return float((2 * r**2 + 4 * means * r).mean()) / (4.0 * pair[a] ** 2 * pair[b] ** 2)

    result = covariance(pair, rows, theta(**{term.replace(" ", "_"): 1.0, "ramp": ramp**2}))
    scale = (by_pairs(0, 0) * by_pairs(1, 1)) ** 0.5
    assert result[0, 1] == pytest.approx(by_pairs(0, 1), abs=0.01 * scale)
    assert np.diag(result) == pytest.approx([by_pairs(0, 0), by_pairs(1, 1)], rel=0.02)


@pytest.mark.parametrize(("noise", "rows"), [("white", 10**7), ("flicker", 10**7), ("random walk", 10**7)])
def test_variances_of_long_series_agree_with_degrees_of_freedom(noise: Noise, rows: int) -> None:
    """2 avar^2 / variance at octaves of 1e7 rows; grouped lags change it by up to 1 %."""
    factors = tuple(1 << power for power in range(22))
    result = 2 * variances(noise, np.array(factors)) ** 2 / np.diag(covariance(factors, rows, theta_of(noise)))
    expected = [degrees_of_freedom(noise, m, rows + 1 - 2 * m) for m in factors]
    np.testing.assert_allclose(result, expected, rtol=0.012)


def theta_of(noise: Noise) -> np.ndarray:
    return theta(**{noise.replace(" ", "_"): 1.0})


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "sums"), [("white", 0), ("random walk", 1)])
def test_correlations_equal_those_of_replicates(noise: Noise, sums: int) -> None:
    """Correlations of 4000 replicates: standard error below 0.016, so that 0.07 is over four of them."""
    series = np.random.default_rng(6).normal(size=(600, 4000))
    squares = allan_deviation(np.cumsum(series, axis=0) if sums else series, 1.0, FACTORS).deviation ** 2
    expected = covariance(FACTORS, 600, theta_of(noise))
    spread = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(np.corrcoef(squares), expected / np.outer(spread, spread), atol=0.07)


def test_variances_of_a_ramp_and_differenced_noise() -> None:
    """A ramp of 1 a row has m / sqrt(2); white noise that is differenced has 3 / m^2 (IEEE Std 952, annex C)."""
    m = np.array([1, 7, 100])
    ramp = allan_deviation(np.arange(1000), 1.0, [1, 7, 100]).deviation
    np.testing.assert_allclose(np.sqrt(variances("ramp", m)), ramp, rtol=1e-14)
    rounding = np.diff(np.random.default_rng(2).normal(size=400_001))
    result = allan_deviation(rounding, 1.0, [1, 7, 100]).deviation ** 2
    np.testing.assert_allclose(result, variances("quantisation", m), rtol=0.05)
