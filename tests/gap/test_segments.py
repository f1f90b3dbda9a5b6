"""Moments of parts of a phase against SciPy, with any block sizes; temperatures by the reference."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from imuarray import series
from imuarray.gap.statistics.segments import Segments, SegmentTally
from tests.selection import examples

SECOND = 10**9


def warm(time_ns: np.ndarray) -> np.ndarray:
    """20 degC, and half a degree per second squared."""
    return 20 + 0.5 * (np.asarray(time_ns) * 1e-9) ** 2


def tallied(time_ns: np.ndarray, counts: np.ndarray, parts: int, cuts: tuple[int, ...] = ()) -> Segments:
    tally = SegmentTally(0, 10 * SECOND, parts)
    origin = np.array([7.0, 0.0, -3.0])
    edges = [0, *cuts, len(time_ns)]
    for first, stop in pairwise(edges):
        thermometer = np.arange(first, stop, dtype=np.int16) % 5
        tally.update(time_ns[first:stop], counts[first:stop].T - origin[:, None], thermometer)
    return tally.result(origin, warm)


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 9), st.lists(st.integers(1, 299), max_size=3, unique=True))
def test_moments_equal_scipy(seed: int, parts: int, cuts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    time_ns = np.sort(rng.choice(10**6, 300, replace=False)) * 10_000
    counts = rng.integers(-40, 60, size=(300, 3)).astype(float)
    found = tallied(time_ns, counts, parts, tuple(sorted(cuts)))
    for part in range(parts):
        inside = (time_ns >= part * 10 * SECOND // parts) & (time_ns < (part + 1) * 10 * SECOND // parts)
        rows = counts[inside]
        assert found.rows[part] == len(rows)
        np.testing.assert_allclose(found.mean[part], rows.mean(axis=0), atol=1e-9)
        np.testing.assert_allclose(found.variance[part], stats.moment(rows, 2), rtol=1e-9)
        np.testing.assert_allclose(found.third[part], stats.moment(rows, 3), atol=1e-4)
        np.testing.assert_allclose(found.fourth[part], stats.moment(rows, 4), rtol=1e-7)
        np.testing.assert_allclose(found.time_s[part], time_ns[inside].mean() * 1e-9, rtol=1e-12)


def test_moments_without_compiled_code_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    time_ns, counts = np.arange(100) * SECOND // 10, np.random.default_rng(3).integers(-40, 60, (100, 3)).astype(float)
    compiled = tallied(time_ns, counts, 7)
    monkeypatch.setattr(series, "COMPILED", False)
    plain = tallied(time_ns, counts, 7)
    for moment in ("mean", "variance", "third", "fourth"):
        np.testing.assert_allclose(getattr(compiled, moment), getattr(plain, moment), rtol=1e-12, atol=1e-9)


def test_temperature_is_that_of_the_reference() -> None:
    time_ns = np.arange(100) * SECOND // 10
    found = tallied(time_ns, np.zeros((100, 3)), 5)
    np.testing.assert_allclose(found.temperature_degc, warm(found.time_s * 1e9), rtol=1e-9)
    np.testing.assert_allclose(found.warming_degc_per_s, [1.0, 3.0, 5.0, 7.0, 9.0], rtol=1e-9)  # t, in the middle
    np.testing.assert_allclose(found.thermometer, 2.0)  # 0, 1, 2, 3, 4 repeated
    assert found.width_s == 2.0


def test_the_variance_includes_a_slope() -> None:
    """400 rows per part, a step of a count every 40 rows, and noise of two: a ramp of 10 counts has a
    variance of 8.3.
    """
    rng = np.random.default_rng(1)
    time_ns = np.arange(20_000) * SECOND // 2000
    counts = 0.025 * np.arange(20_000)[:, None] + rng.normal(0, 2, (20_000, 3))
    found = tallied(time_ns, counts, 50)
    np.testing.assert_allclose(found.variance.mean(axis=0), 8.33 + 4, rtol=0.05)
    np.testing.assert_allclose(found.steady_variance[1:-1].mean(axis=0), 4.0, atol=0.5)  # 48 parts, 0.65 each: 5 errors
    flat = tallied(time_ns, np.full((20_000, 3), 4.0), 50)
    np.testing.assert_array_equal(flat.steady_variance, 0.0)


def test_a_part_without_rows_is_nan() -> None:
    time_ns = np.array([0, 1, 2, 9 * SECOND], np.int64)
    found = tallied(time_ns, np.full((4, 3), 5.0), 5)
    np.testing.assert_array_equal(found.rows, [3, 0, 0, 0, 1])
    assert np.isnan(found.mean[1:4]).all()
    np.testing.assert_array_equal(found.mean[[0, 4]], 5.0)
    assert np.isfinite(found.temperature_degc).all()
