"""The spline by its conditions, and against that of another library."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from imuarray.fuse.alignment import between_gaps, derivatives


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 50, 700])
def test_the_spline_equals_scipy(count: int) -> None:
    rng = np.random.default_rng(count)
    known = np.cumsum(rng.integers(5_000_000, 15_000_000, count)) + 1_700_000_000_000_000_000
    rows = rng.normal(size=(count, 3))
    seconds = (known - known[0]) * 1e-9
    peer = CubicSpline(seconds, rows)
    at = np.sort(rng.integers(known[0], known[-1], 100))
    result = between_gaps(known, rows, at, gap_ns=1e12)
    np.testing.assert_allclose(result, peer((at - known[0]) * 1e-9), rtol=1e-12, atol=1e-12 * np.abs(result).max())
    first, second = derivatives(known, rows, gap_ns=1e12)
    for ours, order in ((first, 1), (second, 2)):
        wanted = peer(seconds, order)
        np.testing.assert_allclose(ours, wanted, rtol=1e-11, atol=1e-11 * max(1.0, np.abs(wanted).max()))


def test_a_cubic_is_its_own_spline() -> None:
    """t^3 - 2 t in seconds: slope 3 t^2 - 2, curvature 6 t."""
    known = np.array([0, 1, 3, 4, 6]) * 10**9
    seconds = known * 1e-9
    rows = (seconds**3 - 2 * seconds)[:, None]
    np.testing.assert_allclose(between_gaps(known, rows, np.array([2 * 10**9]), 1e12), [[4.0]], rtol=1e-13)
    first, second = derivatives(known, rows, 1e12)
    np.testing.assert_allclose(first[:, 0], 3 * seconds**2 - 2, atol=1e-11)
    np.testing.assert_allclose(second[:, 0], 6 * seconds, atol=1e-11)


def test_the_spline_does_not_span_a_pause() -> None:
    known = np.array([0, 1, 2, 10, 11, 12]) * 10**9
    result = between_gaps(known, np.arange(6.0)[:, None], np.array([5, 11]) * 10**9, gap_ns=2e9)
    assert np.isnan(result[0, 0])
    assert result[1, 0] == pytest.approx(4.0)


@pytest.mark.parametrize("narrowest", [1_000, 1_000_000])
def test_very_uneven_knots(narrowest: int) -> None:
    """Widths from a microsecond to ten seconds in any order, against a solver that eliminates row by row."""
    rng = np.random.default_rng(narrowest)
    known = np.cumsum(10.0 ** rng.uniform(np.log10(narrowest), 10, 300)).astype(np.int64)
    rows = rng.normal(size=(300, 2))
    first, _ = derivatives(known, rows, gap_ns=1e12)
    wanted = CubicSpline((known - known[0]) * 1e-9, rows)((known - known[0]) * 1e-9, 1)
    np.testing.assert_allclose(first, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())


def test_values_at_the_knots_are_exact() -> None:
    known = np.array([0, 10, 20, 31, 40]) * 10**6
    rows = np.random.default_rng(3).normal(size=(5, 3))
    np.testing.assert_array_equal(between_gaps(known, rows, known[[0, 1, 3, 4]], gap_ns=1e9), rows[[0, 1, 3, 4]])
