"""Histogram and code-density test against NumPy and SciPy, on converters with known faults, and their error rates."""

from __future__ import annotations

import tracemalloc
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.stats import binom, kurtosis, skew

from imuarray.characterise.codes import NOTHING, CodeDensity, Histogram, code_density, histogram, histograms

CODES = hnp.arrays(np.int16, st.integers(1, 60), elements=st.integers(-(2**15), 2**15 - 1))


def of(values: np.ndarray, span: tuple[int, int] | None = None) -> CodeDensity:
    return code_density(histogram(np.asarray(values)), span)


def gauss(seed: int, spread: float = 10.0, rows: int = 20_000) -> np.ndarray:
    return np.rint(np.random.default_rng(seed).normal(1000.3, spread, rows)).astype(np.int32)


@settings(deadline=None)
@given(st.lists(hnp.arrays(np.int16, st.integers(0, 40), elements=st.integers(-300, 300)), max_size=5))
def test_histograms_of_blocks_merge_to_the_whole(blocks: list[np.ndarray]) -> None:
    merged = reduce(Histogram.merge, (histogram(block) for block in blocks), NOTHING)
    codes, counts = np.unique(np.concatenate([*blocks, np.zeros(0, np.int16)]), return_counts=True)
    np.testing.assert_array_equal(merged.codes, codes)
    np.testing.assert_array_equal(merged.counts, counts)


@settings(deadline=None)
@given(hnp.arrays(np.int64, st.tuples(st.integers(1, 4), st.integers(0, 40)), elements=st.integers(-3000, 3000)))
def test_histograms_of_several_rows_equal_numpy(values: np.ndarray) -> None:
    for seen, row in zip(histograms(values), values, strict=True):
        codes, counts = np.unique(row, return_counts=True)
        np.testing.assert_array_equal(seen.codes, codes)
        np.testing.assert_array_equal(seen.counts, counts)


def test_a_histogram_of_widely_spread_codes_needs_little_memory() -> None:
    """Three codes that span 2^32: a counter for each code between them would take 32 GiB."""
    tracemalloc.start()
    try:
        seen = histogram(np.array([-(2**31), 5, 5, 2**31 - 1], np.int32))
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 100_000
    assert seen.codes.tolist() == [-(2**31), 5, 2**31 - 1]
    assert seen.counts.tolist() == [1, 2, 1]


@settings(deadline=None)
@given(CODES)
def test_moments_and_step_equal_scipy(values: np.ndarray) -> None:
    result = of(values)
    assert result.readings == len(values)
    assert result.mean == pytest.approx(float(values.mean(dtype=float)), abs=1e-9)
    assert result.even_share == pytest.approx(float((values % 2 == 0).mean()))
    whole = [int(value) for value in values]
    assert result.step == np.gcd.reduce([value - whole[0] for value in whole])
    if len(values) >= 4 and values.std() > 0:
        real = values.astype(float)
        assert result.std == pytest.approx(real.std(ddof=1), rel=1e-9)
        assert result.skewness == pytest.approx(float(skew(real, bias=False)), rel=1e-6, abs=1e-6)
        assert result.excess_kurtosis == pytest.approx(float(kurtosis(real, bias=False)), rel=1e-6, abs=1e-6)


def test_skewness_and_kurtosis_scatter_by_their_errors() -> None:
    """Over 400 Gaussian series the estimates scatter by their standard errors (known to 3.5 %; 18 % are five)."""
    result = [of(gauss(seed, rows=500)) for seed in range(400)]
    assert np.std([one.skewness for one in result]) == pytest.approx(result[0].skewness_error, rel=0.18)
    assert np.std([one.excess_kurtosis for one in result]) == pytest.approx(result[0].kurtosis_error, rel=0.18)


def test_false_alarms_of_a_sound_converter() -> None:
    """200 Gaussian series of 5000 readings: each test has p < 1 % in at most 1 % of them (limit: 1e-4)."""
    result = [of(gauss(seed, 4.0, 5000)) for seed in range(200)]
    most = binom.isf(1e-4, 200, 0.01)
    assert sum(one.even_p < 0.01 for one in result) <= most
    assert sum(any(gap.p_value < 0.01 for gap in one.missing) for one in result) <= most
    assert sum(one.low_end.p_value < 0.01 for one in result) <= most
    assert sum(one.high_end.p_value < 0.01 for one in result) <= most
    assert {one.step for one in result} == {one.usual_step for one in result} == {1}


def test_p_values_of_even_codes_by_chance_are_uniform() -> None:
    """Its p-value is below 5 % in 5 % of 600 series (each limit fails once in 10,000 runs)."""
    small = sum(of(gauss(seed, 4.0, 500)).even_p < 0.05 for seed in range(600))
    assert binom.ppf(1e-4, 600, 0.05) <= small <= binom.isf(1e-4, 600, 0.05)


def test_even_codes_alone_are_detected() -> None:
    """An ADXL345 at 1600 Hz and more: the least bit is 0 (ADX-47); a bus word of ones changes the step."""
    even = gauss(1) // 2 * 2
    result = of(even)
    assert (result.even_share, result.step, result.usual_step) == (1, 2, 2)
    assert result.even_p < 1e-100
    assert all(gap.p_value > 0.01 for gap in result.missing)
    result = of(np.concatenate([even, [-1]]))
    assert (result.step, result.usual_step) == (1, 2)


def test_missing_codes_are_detected() -> None:
    values = gauss(2)
    values = values[(values != 1003) & ((values < 990) | (values > 991))]
    result = of(values)
    gaps = {(gap.first, gap.last): gap.p_value for gap in result.missing}
    assert gaps[1003, 1003] < 1e-100
    assert gaps[990, 991] < 1e-100
    assert sum(p_value < 0.01 for p_value in gaps.values()) == 2
    assert result.missing_codes >= 3


def test_missing_code_by_hand() -> None:
    """Neighbours occur 5 and 3 times, three codes occur: 2 * (1 / 2)^3."""
    result = of(np.repeat([10, 12, 13], [5, 3, 9]))
    assert [(gap.first, gap.last) for gap in result.missing] == [(11, 11)]
    assert result.missing[0].p_value == pytest.approx(0.25)


def test_a_clipped_end_is_detected() -> None:
    values = np.minimum(gauss(3), 1010)
    result = of(values, (-4096, 1010))
    assert result.high_end.code == 1010
    assert result.high_end.share == result.span_share == pytest.approx(float((values == 1010).mean()))
    assert result.high_end.p_value < 1e-100
    assert result.low_end.p_value > 0.01
    assert np.isnan(of(values).span_share)


def test_narrow_or_constant_readings_have_no_parity_test() -> None:
    result = of(gauss(4, 0.5))
    assert np.isnan([result.even_p, result.low_end.p_value, result.high_end.p_value]).all()
    result = of(np.full(100, 7))
    assert (result.mean, result.std, result.step, result.usual_step, result.missing_codes) == (7, 0, 0, 0, 0)
    assert np.isnan([result.skewness, result.excess_kurtosis, result.even_p]).all()
    with pytest.raises(ValueError, match="needs readings"):
        code_density(NOTHING)
