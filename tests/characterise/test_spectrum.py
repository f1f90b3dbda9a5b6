"""The streamed spectrum against SciPy's, with any block sizes; runs, degrees of freedom, intervals, precision and
memory.
"""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter, welch
from scipy.stats import binom, chi2

from imuarray.characterise.spectrum import Spectrum, Welch, segment_rows
from tests.selection import examples, some


def spectrum(values: np.ndarray, rate_hz: float = 1.0, rows: int = 256, **how: Any) -> Spectrum:
    columns = 1 if values.ndim == 1 else values.shape[1]
    estimate = Welch(rate_hz, rows, columns, **how)
    estimate.update(values)
    return estimate.result()


@pytest.mark.parametrize("rows", [256, 1000, 4096])
@pytest.mark.parametrize("count", some([4096, 20_011, 300_000], 1))
def test_the_spectrum_equals_scipy(rows: int, count: int) -> None:
    """A walk far from 0, so that the means of the segments have an influence."""
    values = 1e4 + np.cumsum(np.random.default_rng(count).normal(size=(count, 2)), axis=0)
    result = spectrum(values, 400.0, rows, precision="double")
    frequency_hz, expected = welch(values, 400.0, nperseg=rows, axis=0)
    np.testing.assert_allclose(result.frequency_hz, frequency_hz, rtol=1e-14)
    np.testing.assert_allclose(result.density, expected, rtol=1e-10)
    assert result.segments == (count - rows // 2) // (rows // 2)
    assert (result.runs, result.rows, result.left_over) == (1, count, count - (result.segments + 1) * (rows // 2))


def test_single_precision_is_sufficient() -> None:
    """Noise after a filter that attenuates the top to 6e-7 of the mean: 1e-4 of each density, 1e-6 of the large
    densities.
    """
    values = np.random.default_rng(1).normal(size=200_000)
    for _ in range(2):
        values = lfilter([0.01], [1, -0.99], values)
    result = spectrum(5000 + 1e3 * values, rows=1024)
    expected = welch(5000 + 1e3 * values, nperseg=1024)[1]
    assert expected[2:].min() < 1e-6 * expected.mean()
    np.testing.assert_allclose(result.density[:, 0], expected, rtol=1e-4)
    np.testing.assert_allclose(result.density[:40, 0], expected[:40], rtol=1e-6)


@settings(deadline=None, max_examples=examples(40))
@given(st.lists(st.integers(0, 90), min_size=1, max_size=12), st.integers(0, 2**32 - 1))
def test_results_do_not_depend_on_blocks(blocks: list[int], seed: int) -> None:
    values = np.random.default_rng(seed).integers(-(2**15), 2**15, (sum(blocks), 3), dtype=np.int16)
    estimate = Welch(100.0, 16, 3, "double")
    for part in np.split(values, np.cumsum(blocks)[:-1]):
        estimate.update(part)
    result = estimate.result()
    if len(values) < 16:
        assert np.isnan(result.density).all()
        assert (result.segments, result.runs, result.left_over) == (0, 0, len(values))
        assert (result.freedom == 0).all()
    else:
        np.testing.assert_allclose(
            result.density, welch(values.astype(float), 100.0, nperseg=16, axis=0)[1], rtol=1e-9, atol=1e-9
        )


def test_segments_do_not_span_a_gap() -> None:
    """Two runs with a step between them, and a run that is too short: the mean of SciPy's spectra by segments."""
    rng = np.random.default_rng(2)
    first, second, short = rng.normal(size=1000), 50 + rng.normal(size=700), rng.normal(size=99)
    estimate = Welch(1.0, 100, precision="double")
    for run in (first, short, second):
        estimate.update(run)
        estimate.end_run()
    result = estimate.result()
    expected = (19 * welch(first, nperseg=100)[1] + 13 * welch(second, nperseg=100)[1]) / 32
    np.testing.assert_allclose(result.density[:, 0], expected, rtol=1e-10)
    assert (result.segments, result.runs, result.rows, result.left_over) == (32, 2, 1799, 99)


def test_power_of_a_sine_and_of_white_noise() -> None:
    """A^2 / 2 within the bins of a sine; 2 s^2 / rate of white noise, mean over bins within five standard errors."""
    time_s = np.arange(100_000) / 200
    result = spectrum(3 * np.sin(2 * np.pi * 20.3 * time_s), 200.0, 1000)
    assert result.density[:, 0].sum() * result.resolution_hz == pytest.approx(4.5, rel=1e-3)
    result = spectrum(np.random.default_rng(3).normal(0, 2, 100_000), 200.0, 1000)
    inner = result.density[2:-1, 0]
    assert abs(inner.mean() - 0.04) < 5 * 0.04 * (2 / (result.freedom[2] * len(inner) / 2)) ** 0.5


def test_degrees_of_freedom_by_simulation() -> None:
    """2 mean^2 / variance over 400 columns at 20 independent bins: its relative error is 1.6 %, 8 % are five."""
    rng = np.random.default_rng(4)
    for runs, rows in ((1, 2048), (4, 512), (8, 128)):
        estimate = Welch(1.0, 128, 400)
        for _ in range(runs):
            estimate.update(rng.normal(size=(rows, 400)))
            estimate.end_run()
        result = estimate.result()
        power = result.density[3:63:3]
        assert (2 * power.mean() ** 2 / power.var(axis=1)).mean() == pytest.approx(result.freedom[3], rel=0.08)
    assert result.freedom[[0, 3, -1]].tolist() == [8, 16, 8]  # eight single segments


def test_intervals_cover_the_true_density() -> None:
    """The true density 2 of 80 columns at 40 independent bins: freedom times estimate over truth is chi-squared; 95 %
    within 3200 draws' limits of 1e-6.
    """
    result = spectrum(np.random.default_rng(5).normal(size=(2048, 80)))
    freedom = result.freedom[:, None]
    low, high = (result.density * freedom / chi2.ppf(share, freedom) for share in (0.975, 0.025))
    covered = int(((low <= 2) & (high >= 2))[4:124:3].sum())
    assert binom.ppf(1e-6, 3200, 0.94) <= covered <= binom.isf(1e-6, 3200, 0.96)


def test_memory_does_not_grow() -> None:
    block = np.random.default_rng(6).integers(-100, 100, (50_000, 3), dtype=np.int16)

    def peak(blocks: int) -> int:
        tracemalloc.start()
        estimate = Welch(400.0, 1024, 3)
        for _ in range(blocks):
            estimate.update(block)
        estimate.result()
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    assert peak(24) < peak(6) + 10_000


@pytest.mark.parametrize(
    ("rate_hz", "rows", "columns", "message"),
    [(0.0, 256, 1, "rate_hz is 0.0"), (1.0, 255, 1, "255 rows"), (1.0, 8, 1, "8 rows"), (1.0, 256, 0, "0 columns")],
)
def test_invalid_arguments_are_refused(rate_hz: float, rows: int, columns: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Welch(rate_hz, rows, columns)


def test_invalid_values_are_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        spectrum(np.array([1.0, np.nan] * 200))
    with pytest.raises(ValueError, match="2 columns, 1"):
        Welch(1.0).update(np.zeros((5, 2)))


def test_segments_are_short_enough_for_sixteen() -> None:
    assert [segment_rows(rows) for rows in (10, 2000, 34_815, 34_816, 10**7)] == [64, 128, 2048, 4096, 4096]
