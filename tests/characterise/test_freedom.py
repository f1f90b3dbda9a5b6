"""Degrees of freedom and noise types against printed formulas, another implementation and simulation."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.signal import fftconvolve

from imuarray.characterise.allan_curve import Noise, degrees_of_freedom, identify_noise, interval
from tests.selection import some

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # allantools warns of its own dependencies when it is imported
    from allantools.ci import edf_greenhall


@pytest.mark.parametrize("m", [1, 2, 3, 10, 64, 100, 333])
def test_white_noise_equals_the_printed_formula(m: int) -> None:
    """NIST SP 1065, table of edf formulas for the overlapping estimator, white FM; N counts phase values."""
    N = 2001
    printed = (3 * (N - 1) / (2 * m) - 2 * (N - 2) / N) * 4 * m**2 / (4 * m**2 + 5)
    assert degrees_of_freedom("white", m, N - 2 * m) == pytest.approx(printed, rel=0.01 if m < 100 else 0.04)


@pytest.mark.parametrize(("noise", "alpha"), [("white", 0), ("flicker", -1), ("random walk", -2)])
@pytest.mark.parametrize("m", [128, 1000, 3000])
def test_long_factors_agree_with_greenhall_and_riley(noise: Noise, alpha: int, m: int) -> None:
    """allantools evaluates the same theory from its tables and limits; both agree where m is long."""
    N = 10_001
    assert degrees_of_freedom(noise, m, N - 2 * m) == pytest.approx(
        edf_greenhall(alpha, 2, m, N, overlapping=True), rel=0.01
    )


@pytest.mark.parametrize(("noise", "sums"), [("white", 0), ("random walk", 1)])
@pytest.mark.parametrize("m", [1, 2, 5, 40])
def test_degrees_of_freedom_equal_those_of_replicates(noise: Noise, sums: int, m: int) -> None:
    """2 mean^2 / variance of 4000 replicates: its relative error is below 4 %, so 16 % is four of them."""
    series = np.random.default_rng(m).normal(size=(4000, 100))
    phase = np.pad(series, ((0, 0), (1, 0)))
    for _ in range(1 + sums):
        phase = np.cumsum(phase, axis=1)
    second = phase[:, 2 * m :] - 2 * phase[:, m:-m] + phase[:, : -2 * m]
    variances = (second**2).mean(axis=1)
    simulated = 2 * variances.mean() ** 2 / variances.var()
    assert degrees_of_freedom(noise, m, second.shape[1]) == pytest.approx(simulated, rel=0.16)


def test_shortest_factor_is_exact() -> None:
    """At m = 1 the terms are y[i+1] - y[i]: of a random walk uncorrelated, of white noise with rho(1) = -1/2."""
    assert degrees_of_freedom("random walk", 1, 500) == pytest.approx(500, rel=1e-12)
    assert degrees_of_freedom("white", 1, 500) == pytest.approx(500 / (1 + 2 * (499 / 500) / 4), rel=1e-12)


@pytest.mark.parametrize("noise", ["white", "flicker", "random walk"])
def test_a_single_term_has_one_degree_of_freedom(noise: Noise) -> None:
    assert degrees_of_freedom(noise, 500, 1) == 1


def _power_law(rng: np.random.Generator, exponent: float, rows: int) -> np.ndarray:
    """Noise of spectrum 1 / f^exponent by fractional summation (Kasdin, Proc. IEEE 83, 1995), after a long run-in."""
    lags = np.arange(1, 8 * rows)
    weights = np.concatenate([[1.0], np.cumprod((lags - 1 + exponent / 2) / lags)])
    return fftconvolve(rng.normal(size=8 * rows), weights)[7 * rows : 8 * rows]


@pytest.mark.parametrize(("noise", "exponent"), some([("white", 0.0), ("flicker", 1.0), ("random walk", 2.0)], 1))
def test_the_noise_type_is_identified(noise: Noise, exponent: float) -> None:
    """In 200 series of 1000 values: the next type is over four standard errors away, so that two may fail at most.

    (Standard error of r / (1 + r): 0.03 for white noise, 0.06 for flicker noise; the limits are 0.25 from the middle.)
    """
    rng = np.random.default_rng(17)
    assert sum(identify_noise(_power_law(rng, exponent, 1000)) == noise for _ in range(200)) >= 198


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "exponent"), some([("white", 0.0), ("flicker", 1.0), ("random walk", 2.0)], 1))
def test_the_noise_type_is_identified_in_averages(noise: Noise, exponent: float) -> None:
    """In 100 series of 500 averages over 16: averaging moves the correlations, and the next type is three standard
    errors of them away (0.13 of 0.045), so that three may fail at most."""
    rng = np.random.default_rng(18)
    series = [_power_law(rng, exponent, 8000).reshape(500, 16).mean(axis=1) for _ in range(100)]
    assert sum(identify_noise(averages, 16) == noise for averages in series) >= 97


@pytest.mark.parametrize("noise", ["white", "flicker", "random walk"])
@pytest.mark.parametrize(("factor", "stride"), [(16, 2), (40, 5), (64, 8), (512, 64), (512, 512)])
def test_degrees_of_freedom_with_a_stride_equal_their_definition(noise: Noise, factor: int, stride: int) -> None:
    """2 / variance of the mean of squares, from the covariance of every pair of terms."""
    covariance = {
        "white": lambda t: -t / 2,
        "flicker": lambda t: t**2 * np.log(np.maximum(t, 1)) / (2 * np.pi),
        "random walk": lambda t: (t**3 - t) / 12,
    }[noise]
    starts = np.arange(0, 4 * factor, stride)
    points = starts[:, None] + factor * np.arange(3)
    apart = np.abs(points[:, None, :, None] - points[None, :, None, :]).astype(float)
    r = np.einsum("ijab,a,b->ij", covariance(apart), [1, -2, 1], [1, -2, 1])
    expected = (np.trace(r) ** 2) / (r**2).sum()
    assert degrees_of_freedom(noise, factor, len(starts), stride) == pytest.approx(expected, rel=1e-6)


def test_noise_type_of_odd_series() -> None:
    rng = np.random.default_rng(3)
    white = rng.normal(size=1000)
    assert identify_noise(white[:29]) is None
    assert identify_noise(np.zeros(100)) == "white"
    assert identify_noise(np.diff(white)) == "white"
    assert identify_noise(white + 5 * np.arange(1000)) == "white"
    assert identify_noise(np.cumsum(np.cumsum(white))) == "random walk"


def test_interval_of_ten_degrees() -> None:
    """Chi-squared with 10 degrees of freedom has its 2.5 % points at 3.247 and 20.483 (any table)."""
    low, high = interval(np.array([2.0]), np.array([10.0]), 0.95)
    assert low[0] == pytest.approx(2 * (10 / 20.483) ** 0.5, rel=1e-4)
    assert high[0] == pytest.approx(2 * (10 / 3.247) ** 0.5, rel=1e-4)
