"""Streaming statistics against the whole array at once, and the error of the mean against its true spread."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom, t

from imuarray.characterise import noise as noise_module
from imuarray.characterise import noise_statistics
from imuarray.log import SensorLog
from imuarray.log.format import OVERRUN, SATURATED, STALE, SUSPECT
from tests.selection import examples


class Rows:
    """The part of a `SensorLog` that the statistics read."""

    def __init__(self, counts: np.ndarray, status: np.ndarray | None = None) -> None:
        self.counts = counts
        self.status = np.zeros(len(counts), np.uint16) if status is None else status


def statistics(counts: np.ndarray, status: np.ndarray | None = None, rows: slice | None = None) -> Any:
    return noise_statistics(cast(SensorLog, Rows(counts, status)), rows or slice(0, len(counts)))


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(2, 700), st.integers(0, 3), st.integers(0, 2**32 - 1), st.sampled_from([3, 50, 1 << 16]))
def test_streamed_statistics_equal_numpy(count: int, share: int, seed: int, block: int) -> None:
    """Mean and spread of the used rows equal those by NumPy of the whole array, with any block sizes."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(-(2**15), 2**15, (count, 3), dtype=np.int16)
    status = np.where(rng.random(count) < share / 4, rng.choice([STALE, SATURATED, SUSPECT]), OVERRUN).astype(np.uint16)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(noise_module, "_BLOCK", block)
        result = statistics(counts, status)
    used = counts[status == OVERRUN].astype(float)
    assert (result.rows, result.used) == (count, len(used))
    assert result.flags["overrun"] == len(used)
    if len(used) > 1:
        np.testing.assert_allclose(result.mean, used.mean(axis=0), rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(result.std, used.std(axis=0, ddof=1), rtol=1e-12)
        np.testing.assert_allclose(result.even_share, (used % 2 == 0).mean(axis=0), rtol=1e-12)


def test_a_large_mean_keeps_the_precision() -> None:
    """A mean 10^8 times the spread, where a sum of squares in float64 has no digit left."""
    noise = np.random.default_rng(2).integers(-3, 4, (10_000, 1))
    np.testing.assert_allclose(statistics(noise + 300_000_000).std, noise.std(axis=0, ddof=1), rtol=1e-8)


def test_rows_outside_the_range_are_excluded() -> None:
    counts = np.vstack([np.full((100, 3), 9), np.tile([[0], [2]], (50, 3)), np.full((100, 3), 9)])
    result = statistics(counts, rows=slice(100, 200))
    np.testing.assert_array_equal(result.mean, [1, 1, 1])
    np.testing.assert_allclose(result.lag1, -1, atol=0.02)
    np.testing.assert_array_equal(result.even_share, 1)


def test_lag_one_correlation_of_a_known_process() -> None:
    """0.6 within 5 standard errors (sqrt((1 - 0.36) / n) each), also where every reading is followed by a stale one."""
    noise = lfilter([1.0], [1.0, -0.6], np.random.default_rng(4).normal(0, 100, (40_000, 3)), axis=0)
    counts = np.rint(noise).astype(np.int16)
    limit = 5 * (0.64 / 40_000) ** 0.5
    np.testing.assert_allclose(statistics(counts).lag1, 0.6, atol=limit)
    status = np.tile(np.array([0, STALE], np.uint16), 40_000)
    np.testing.assert_allclose(statistics(np.repeat(counts, 2, axis=0), status).lag1, 0.6, atol=limit)


def test_lag_one_correlation_of_a_ramp() -> None:
    """Every row is a little larger than the previous row, and the first rows are far from the mean: 1 except for the
    ends.
    """
    np.testing.assert_allclose(statistics(np.arange(32_000)[:, np.newaxis]).lag1, 1, atol=1e-3)


def test_too_few_rows_give_no_statistics() -> None:
    nothing = statistics(np.zeros((0, 3), np.int16))
    assert nothing.rows == nothing.used == 0
    assert np.isnan([nothing.mean, nothing.std, nothing.sem, nothing.lag1, nothing.even_share]).all()
    one = statistics(np.array([[1, 2, 3]]))
    np.testing.assert_array_equal(one.mean, [1, 2, 3])
    assert np.isnan([one.std, one.sem, one.lag1]).all()
    stuck = statistics(np.full((100, 3), 7))
    np.testing.assert_array_equal(stuck.std, 0)
    np.testing.assert_array_equal(stuck.sem, 0)
    assert np.isnan(stuck.lag1).all()


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.0, 0.8])
def test_intervals_of_the_mean_cover(pole: float) -> None:
    """Mean +- t(31) * error covers the true mean in 95 % of 600 series, white or with a correlation of 0.8.

    A chance below 1e-5 to fail if coverage is between 93 % and 97 % (batches of 100 rows are not quite independent).
    With the plain s / sqrt(n) the correlated series would be covered in 49 %.
    """
    rng = np.random.default_rng(6)
    noise = lfilter([1.0], [1.0, -pole], rng.normal(0, 100, (3400, 600)), axis=0)[200:]
    result = statistics(np.rint(noise).astype(np.int32))
    covered = int((np.abs(result.mean) <= t.ppf(0.975, 31) * result.sem).sum())
    assert binom.ppf(1e-5, 600, 0.93) <= covered <= binom.isf(1e-5, 600, 0.97)
