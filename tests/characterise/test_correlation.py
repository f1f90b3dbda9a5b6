"""Autocorrelation against its definition and known processes; rates of errors and of the portmanteau test."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom

from imuarray.characterise.correlation import Autocorrelation, Autocovariance
from tests.selection import examples


def autocorrelation(values: np.ndarray, lags: int = 10, rows: int = 1000) -> Autocorrelation:
    estimate = Autocovariance(lags, 1 if values.ndim == 1 else values.shape[1], rows)
    estimate.update(values)
    return estimate.result()


@settings(deadline=None, max_examples=examples(40))
@given(st.lists(st.integers(0, 60), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_autocorrelation_equals_its_definition(blocks: list[int], seed: int) -> None:
    """With any block sizes: sums by segments of 30 rows, corrected for white noise's -1 / N with its variance."""
    values = np.random.default_rng(seed).integers(-100, 100, sum(blocks), dtype=np.int16)
    estimate = Autocovariance(2, 1, 30)
    for part in np.split(values, np.cumsum(blocks)[:-1]):
        estimate.update(part)
    result = estimate.result()
    segments = [values[start : start + 30].astype(float) for start in range(0, len(values), 30)]
    segments = [segment - segment.mean() for segment in segments if len(segment) >= 6]
    used = sum(map(len, segments))
    assert (result.rows, result.left_over, result.segments) == (used, len(values) - used, len(segments))
    if not segments:
        assert np.isnan(result.correlation).all()
        return
    variance = sum(float(segment @ segment) for segment in segments) / (used - len(segments))
    for lag in (1, 2):
        sums = sum(float(s[:-lag] @ s[lag:]) + variance * (len(s) - lag) / len(s) for s in segments)
        pairs = used - lag * len(segments)
        np.testing.assert_allclose(result.correlation[lag, 0], sums / pairs / variance, rtol=1e-9, atol=1e-12)


def test_white_noise_is_not_biased_by_short_segments() -> None:
    """Mean over 600 columns and 10 lags in segments of 25 rows, where -1 / N is -0.04: within five errors of 0."""
    result = autocorrelation(np.random.default_rng(1).normal(size=(500, 600)), 10, 25)
    means = result.correlation[1:].mean(axis=0)
    assert abs(means.mean()) < 5 * means.std() / 600**0.5
    np.testing.assert_allclose(result.correlation[0], 1, rtol=1e-12)


def test_autocorrelation_of_first_order_noise() -> None:
    """0.8^lag for first-order noise, within five of the errors of a correlated series (Bartlett, below 3 / sqrt(n))."""
    values = lfilter([1.0], [1.0, -0.8], np.random.default_rng(2).normal(size=(200_000, 3)), axis=0)
    result = autocorrelation(values, 10, 8192)
    np.testing.assert_allclose(result.correlation[:, 1], 0.8 ** np.arange(11), atol=5 * 3 / 200_000**0.5)
    expected = ((1 + 2 * np.cumsum(0.64 ** np.arange(1, 10))) / 200_000) ** 0.5
    np.testing.assert_allclose(result.error[2:, 1], expected, rtol=0.02)


def test_a_slow_drift_adds_little_correlation() -> None:
    """A ramp of 40 spreads over 200,000 rows: 1.6 spreads in a segment of 8192, no more than 0.25 in one of 1000."""
    values = np.random.default_rng(3).normal(size=200_000) + np.linspace(0, 40, 200_000)
    expected = (40 / 200) ** 2 / 12  # variance of the remainder of the ramp in segments of 1000
    result = autocorrelation(values, 10, 1000)
    np.testing.assert_allclose(result.correlation[1:, 0], expected / (1 + expected), atol=5 / 200_000**0.5)


def test_products_do_not_span_a_gap() -> None:
    """Runs of +1, -1, ...: the phase of the next run changes nothing; with 160/156 for the variance, by hand."""
    estimate = Autocovariance(3, 1, 100)
    for first in (1, -1, 1, 1):
        estimate.update(first * np.tile([1, -1], 20))
        estimate.end_run()
    result = estimate.result()
    np.testing.assert_allclose(result.correlation[:, 0], [1, -0.95, 1, -0.95], rtol=1e-12)
    assert (result.segments, result.rows) == (4, 160)


@pytest.mark.slow
@pytest.mark.parametrize(("pole", "least", "most"), [(0.0, 0.05, 0.05), (0.1, 0.9, 1.0)])
def test_rates_of_the_portmanteau_test(pole: float, least: float, most: float) -> None:
    """5 % of 1000 white series have p < 0.05, nearly all with a correlation of 0.1; each limit fails once in 10,000."""
    values = lfilter([1.0], [1.0, -pole], np.random.default_rng(4).normal(size=(4000, 1000)), axis=0)
    small = int((autocorrelation(values).p_value < 0.05).sum())
    assert binom.ppf(1e-4, 1000, least) <= small <= binom.isf(1e-4, 1000, most)


def test_standard_errors_of_white_noise_cover() -> None:
    """68.3 % of the correlations of 500 columns at 10 lags are within one standard error."""
    result = autocorrelation(np.random.default_rng(5).normal(size=(4000, 500)))
    within = int((np.abs(result.correlation[1:]) < result.error[1:]).sum())
    assert binom.ppf(1e-5, 5000, 0.673) <= within <= binom.isf(1e-5, 5000, 0.693)


def test_a_constant_has_no_correlation_and_invalid_input_is_refused() -> None:
    assert np.isnan(autocorrelation(np.full(5000, 3)).correlation).all()
    assert np.isnan(autocorrelation(np.full(5000, 3)).p_value).all()
    with pytest.raises(ValueError, match="segments of 22"):
        Autocovariance(10, 1, 21)
    with pytest.raises(ValueError, match="2 columns, 1"):
        Autocovariance().update(np.zeros((5, 2)))
