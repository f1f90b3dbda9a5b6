"""Fitted noise coefficients: exact curves, intervals and p-values in simulations, curves that the model does not fit.

Flicker noise is drawn exactly (its differences are stationary) at four times the rate and averaged by fours.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.signal import lfilter
from scipy.stats import binom, kstest

from imuarray.characterise import allan_deviation, allan_fit
from imuarray.characterise.allan_fit import TERMS, UNITS, USUAL, AllanEstimate, NoiseFit, Term, fit_noise, merge_similar
from tests.selection import examples, some

INTERVAL_S = 0.0025
ROWS, REPEATS = 8192, 250


def white(seed: int, rows: int = ROWS, repeats: int = REPEATS) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(rows, repeats))


def flicker(seed: int) -> np.ndarray:
    """Continuous flicker noise with B = 1 averaged over rows (n, r): spectrum 1 / (2 pi f)."""
    fine = 4 * ROWS
    covariance = 4 / (np.pi * (1 - 4 * np.arange(fine + 1.0) ** 2))
    power = np.fft.rfft(np.concatenate([covariance, covariance[-2:0:-1]])).real
    drawn = np.fft.rfft(np.random.default_rng(seed).normal(size=(REPEATS, 2 * fine))) * np.sqrt(power)
    return np.cumsum(np.fft.irfft(drawn)[:, :fine], axis=1).reshape(REPEATS, ROWS, 4).mean(axis=2).T


def fitted(series: np.ndarray, **options: Any) -> NoiseFit:
    result = fit_noise(allan_deviation(series, INTERVAL_S), **options)
    assert result is not None
    return result


def all_fitted(series: np.ndarray) -> list[NoiseFit]:
    curve = allan_deviation(series, INTERVAL_S)
    return [result for column in range(series.shape[1]) if (result := fit_noise(curve, column))]


def covered(fits: list[NoiseFit], term: Term, truth: float) -> int:
    return sum(result[term].low <= truth <= result[term].high for result in fits)


@pytest.mark.slow
def test_intervals_cover_and_p_values_are_uniform() -> None:
    """White, flicker and random walk together, 250 times: terms, 95 % intervals, and p-values.

    Intervals span two models and cover in 92 % to 99 %: each fails with a chance below 1e-4 if coverage is 93 % or
    more. The largest distance of p-values from uniform fails with a chance of 1e-3.
    """
    series = white(1) + 0.2 * flicker(2) + 0.02 * np.cumsum(white(3), axis=0)
    fits = all_fitted(series)
    assert len(fits) == REPEATS
    for term, truth in (("white", INTERVAL_S**0.5), ("flicker", 0.2), ("random walk", 0.02 / INTERVAL_S**0.5)):
        assert covered(fits, term, truth) >= binom.ppf(1e-4, REPEATS, 0.93)
    assert sum(result["random walk"].significant for result in fits) > 0.9 * REPEATS
    assert kstest([result.p_value for result in fits], "uniform").pvalue > 1e-3
    assert sum(bool(result.verdict) for result in fits) <= binom.isf(1e-4, REPEATS, 0.015)


def normal(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return rng.normal(size=shape)


def rounded(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.rint(rng.normal(0.3, 0.4, shape))


def clipped(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.minimum(rng.normal(size=shape), 0.8)


def heavy(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return rng.standard_t(6, shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draw", "walk"), some([(rounded, 0.0), (clipped, 0.0), (heavy, 0.0), (normal, 0.0), (normal, 0.004)], 2, 0)
)
def test_white_intervals_cover_for_every_distribution(draw: Any, walk: float) -> None:
    """White noise of 1500 rows, 500 times, alone or with a random walk: the interval of its density covers the truth.
    The truth is the standard deviation of two million draws. 93 to 97 % are required, less three standard errors of the
    count (0.97 %).
    """
    rng = np.random.default_rng(11)
    shape = (1500, 500)
    truth = float(np.std(draw(rng, (2_000_000, 1)))) * np.sqrt(INTERVAL_S)
    series = draw(rng, shape) + walk * np.cumsum(rng.normal(size=shape), axis=0)
    fits = all_fitted(series)
    assert 0.93 - 0.029 <= covered(fits, "white", truth) / len(fits) <= 0.97 + 0.023


def test_kurtosis_of_white_noise_of_known_distributions() -> None:
    """Uniform readings have an excess kurtosis of -6/5, Laplace's 3, coin tosses -2, and a drift changes nothing."""
    rng, rows = np.random.default_rng(4), 400_000
    drift = np.linspace(0, 50, rows)
    series = [rng.uniform(size=rows), rng.laplace(size=rows), rng.integers(0, 2, rows), rng.normal(size=rows) + drift]
    for estimator in ("overlapping", "decimated"):
        result = allan_deviation(np.stack(series, axis=1), 1.0, (1, 2, 4), estimator=estimator).kurtosis
        np.testing.assert_allclose(result, [-1.2, 3.0, -2.0, 0.0], atol=0.15)


@pytest.mark.slow
def test_absent_terms_are_omitted() -> None:
    """White noise alone: each other term stays in 1 % to 3 %, and its upper limit is stated."""
    fits = all_fitted(white(4))
    for term in ("flicker", "random walk"):
        assert sum(result[term].significant for result in fits) <= binom.isf(1e-4, REPEATS, 0.03)
        assert all(result[term].value == result[term].low == 0 for result in fits if not result[term].significant)
    assert covered(fits, "white", INTERVAL_S**0.5) >= binom.ppf(1e-4, REPEATS, 0.94)
    bound = np.median([result["flicker"].high for result in fits])
    assert 0.02 < bound < 0.2
    assert kstest([result.p_value for result in fits], "uniform").pvalue > 1e-3


@pytest.mark.slow
def test_a_random_walk_alone_is_fitted() -> None:
    fits = all_fitted(np.cumsum(white(5), axis=0))
    assert covered(fits, "random walk", INTERVAL_S**-0.5) >= binom.ppf(1e-4, REPEATS, 0.94)
    assert all(result["random walk"].significant for result in fits)


COEFFICIENTS: dict[Term, float] = {
    "quantisation": 2e-4,
    "white": 0.003,
    "flicker": 0.02,
    "random walk": 0.05,
    "ramp": 0.02,
}


@pytest.mark.parametrize(
    "left_out",
    [(), *(pytest.param(terms, marks=pytest.mark.slow) for terms in (("flicker",), ("quantisation", "ramp")))],
)
def test_an_exact_curve_gives_its_coefficients(left_out: tuple[Term, ...]) -> None:
    """The variance of IEEE Std 952, annex C, without scatter; a random walk of readings differs at first."""
    curve = allan_deviation(white(6, 1_000_000, 1)[:, 0], INTERVAL_S)
    given = {term: 0.0 if term in left_out else value for term, value in COEFFICIENTS.items()}
    Q, N, B, K, R = (given[term] for term in TERMS)
    tau_s = curve.tau_s
    steps = 1 + 1 / (2 * (tau_s / INTERVAL_S) ** 2)
    variance = 3 * Q**2 / tau_s**2 + N**2 / tau_s + 2 * np.log(2) / np.pi * B**2 + K**2 * tau_s * steps / 3
    exact = replace(curve, deviation=np.sqrt(variance + R**2 * tau_s**2 / 2))
    result = fit_noise(exact, terms=[term for term in TERMS if term not in left_out], unit="dps")
    assert result is not None
    assert {item.term for item in result.coefficients} == set(TERMS) - set(left_out)
    for item in result.coefficients:
        assert item.low <= given[item.term] <= item.high
        if item.significant:
            assert item.unit == UNITS[item.term].format(unit="dps")
    assert result["white"].value == pytest.approx(N, rel=1e-3)
    assert result.p_value > 0.99
    assert result.verdict == ""


ROWS_ONE = 100_000
TIME = np.arange(ROWS_ONE)
ONE = np.random.default_rng(7).normal(size=ROWS_ONE)


@pytest.mark.parametrize(
    "series",
    [
        ONE + 0.5 * np.sin(2 * np.pi * 0.05 * TIME),
        ONE + 0.05 * np.sin(2 * np.pi * 0.001 * TIME),
        ONE + 3e-5 * TIME,
        lfilter([0.5], [1, -0.5], ONE),
        np.diff(np.append(ONE, 0.0)),
    ],
    ids=["strong tone", "weak tone", "ramp", "low-pass filter", "quantised angle"],
)
def test_a_bad_fit_is_reported(series: np.ndarray) -> None:
    result = fitted(series)
    assert result.p_value < 1e-4
    assert "no sum of white, flicker and random walk fits this curve" in result.verdict
    assert f"at tau = {result.worst_tau_s:.3g} s" in result.verdict
    assert abs(np.log(result.worst_ratio)) > 0.05


def test_ramp_and_quantisation_terms_fit() -> None:
    """The same ramp and the same quantised angle with their terms; 3e-5 a row is 0.012 a second."""
    ramp = fitted(ONE + 3e-5 * TIME, terms=(*USUAL, "ramp"))
    assert ramp.verdict == ""
    assert ramp["ramp"].low < 3e-5 / INTERVAL_S < ramp["ramp"].high
    assert ramp["ramp"].value == pytest.approx(3e-5 / INTERVAL_S, rel=0.05)
    angle = fitted(np.diff(np.append(ONE, 0.0)), terms=TERMS)
    assert angle.verdict == ""
    assert angle["quantisation"].value == pytest.approx(INTERVAL_S, rel=0.02)


def test_the_filtered_start_can_be_excluded() -> None:
    """After a first-order filter with a time constant of 1.4 rows the curve is that of white noise from 32 rows on."""
    result = fitted(lfilter([0.5], [1, -0.5], ONE), shortest_s=32 * INTERVAL_S)
    assert result.tau_s[0] == pytest.approx(32 * INTERVAL_S)
    assert result.verdict == ""
    assert result["white"].value == pytest.approx(INTERVAL_S**0.5, rel=0.06)


def test_columns_are_independent_and_coefficients_scale() -> None:
    """Coefficients scale with the series, and each column has its own."""
    two = fit_noise(allan_deviation(np.column_stack([np.cumsum(ONE), 3 * ONE]), INTERVAL_S), 1)
    one = fitted(ONE)
    assert two is not None
    assert two["white"].value == pytest.approx(3 * one["white"].value, rel=1e-6)
    assert two.p_value == pytest.approx(one.p_value, rel=1e-6)
    np.testing.assert_allclose(two.deviation, 3 * one.deviation, rtol=1e-6)


@pytest.mark.parametrize("scale", [1e-120, 1e120])
def test_tiny_and_huge_units_are_fitted(scale: float) -> None:
    """Deviations whose squares underflow or overflow float64."""
    result, one = fitted(scale * ONE), fitted(ONE)
    assert result["white"].value == pytest.approx(scale * one["white"].value, rel=1e-6)
    assert result["flicker"].high == pytest.approx(scale * one["flicker"].high, rel=1e-6)


def test_too_few_points_give_no_fit() -> None:
    assert fit_noise(allan_deviation(np.zeros(100), 1.0)) is None
    assert fit_noise(allan_deviation(ONE[:9], 1.0)) is None
    assert fit_noise(allan_deviation(ONE, 1.0), shortest_s=1e6) is None
    two = fit_noise(allan_deviation(ONE, 1.0, [1, 2]))
    assert two is not None
    assert [item.term for item in two.coefficients] == ["white", "flicker"]
    with pytest.raises(KeyError):
        two["ramp"]


def test_unknown_terms_are_refused() -> None:
    curve = allan_deviation(ONE[:1000], 1.0)
    with pytest.raises(ValueError, match="not none"):
        fit_noise(curve, terms=())
    with pytest.raises(ValueError, match="not pink"):
        fit_noise(curve, terms=("pink",))  # type: ignore[arg-type]


@settings(deadline=None, max_examples=examples(60))
@given(
    hnp.arrays(np.float64, st.integers(20, 200), elements=st.floats(-1e3, 1e3, allow_subnormal=False)),
    st.lists(st.sampled_from(TERMS), min_size=1, unique=True),
)
def test_intervals_of_any_series_are_ordered(values: np.ndarray, terms: list[Term]) -> None:
    result = fit_noise(allan_deviation(values, 0.1), terms=terms)
    if result is None:
        return
    for item in result.coefficients:
        assert 0 <= item.low <= item.value * (1 + 1e-9)
        assert item.value <= item.high * (1 + 1e-9)
    assert np.isnan(result.p_value) if result.freedom == 0 else 0 <= result.p_value <= 1


def nights() -> tuple[tuple[int, int], ...]:
    """(rows, number) of the runs of a night: 200 lengths from 9 to 20,000 rows."""
    lengths = np.unique(np.geomspace(9, 20_000, 260).astype(int))
    return tuple((int(rows), 1 + at % 3) for at, rows in enumerate(lengths))


def test_runs_of_similar_lengths_are_grouped_to_two_dozen() -> None:
    """The number of runs and the number of rows are kept."""
    runs = nights()
    assert len(merge_similar(runs)) <= 24 < 200 < len(runs)
    assert sum(number for _, number in merge_similar(runs)) == sum(number for _, number in runs)
    total = sum(rows * number for rows, number in runs)
    assert sum(rows * number for rows, number in merge_similar(runs)) == pytest.approx(total, rel=1e-3)
    assert merge_similar(runs[:24]) == runs[:24]


@pytest.mark.slow
def test_grouped_lengths_keep_the_standard_deviations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two dozen lengths instead of all change the standard deviations of the variances by less than 2 %."""
    runs = nights()
    total = sum(rows * number for rows, number in runs)
    factors = tuple(2**octave for octave in range(12))
    estimate = AllanEstimate(1 / np.array(factors, float), 1.0, factors, total, INTERVAL_S, runs=runs)
    theta = np.array([0.0, 1.0, 1e-4, 1e-7, 0.0])
    _, spread = estimate._scatter(theta)
    monkeypatch.setattr(allan_fit, "_MOST_LENGTHS", len(runs))
    _, exact = replace(estimate)._scatter(theta)
    np.testing.assert_allclose(spread, exact, rtol=0.02)
