"""Compiled passes over series compared with NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray import series
from imuarray.calibrate.pose_readings import _add_windows
from imuarray.characterise.allan import sums_of_squares
from imuarray.characterise.correlation import Autocovariance
from imuarray.characterise.lines import _median

pytestmark = pytest.mark.skipif(not series.COMPILED, reason="installed without a C compiler")


@pytest.mark.parametrize("rows", [40, 300])
def test_medians_of_windows_equal_those_of_numpy(rows: int) -> None:
    """Of windows that move, grow, repeat, begin again at an earlier row, and contain equal heights."""
    rng = np.random.default_rng(rows)
    height = rng.integers(0, 9, rows) * rng.choice([0.5, 1.7])
    first = np.concatenate([np.arange(0, 10), np.repeat(10, 3), np.arange(3, 20), [rows - 1, 0]])
    side = np.concatenate([np.full(10, 8), [8, 12, 15], np.arange(3, 20), [1, 20]])
    result = series.window_medians(height, first, side)
    assert result is not None
    wanted = [np.median(height[start : start + count]) for start, count in zip(first, side, strict=True)]
    assert result.tolist() == wanted


def test_medians_are_those_of_sorted_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    height = np.random.default_rng(3).normal(size=500)
    first, side = np.arange(20, 400), (np.arange(20, 400) // 12).clip(4, 32)
    result = _median(height, first, side)
    monkeypatch.setattr(series, "COMPILED", False)
    np.testing.assert_array_equal(result, _median(height, first, side))


@pytest.mark.parametrize(("first", "side"), [([0], [257]), ([490], [11]), ([-1], [4]), ([0], [0])])
def test_invalid_windows_have_no_compiled_result(first: list[int], side: list[int]) -> None:
    assert series.window_medians(np.zeros(500), np.array(first), np.array(side)) is None


@pytest.mark.parametrize("flags", [0, 4])
def test_compiled_sums_of_windows_equal_those_of_numpy(flags: int) -> None:
    """Of two blocks with pauses, rows before the first window and after the last, and windows without rows."""
    rng = np.random.default_rng(5)
    results = [(np.zeros(30), np.zeros((4, 30, 3))) for _ in range(2)]
    for rows, figures in results:
        figures[2], figures[3] = np.inf, -np.inf
        assert not rows.any()
    turn = rng.normal(size=(3, 3))
    time = np.cumsum(rng.integers(1, 40, 800))
    counts, status = rng.integers(-900, 900, (800, 3)).astype(np.int16), (4 * (rng.random(800) < 0.1)).astype(np.uint16)
    for part in (slice(0, 300), slice(330, 800)):
        block = time[part], counts[part], status[part]
        assert series.add_windows(block, turn, results[0], (500, 250), flags)
        _add_windows(block, turn, results[1], (500, 250), flags)
    assert results[0][0].sum() > 200
    for result, wanted in zip(*results, strict=True):
        np.testing.assert_allclose(result, wanted, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("kind", [np.int32, np.float64])
@pytest.mark.parametrize("first", [0, 70_000])
def test_sums_of_second_differences_equal_their_definition(
    kind: type, first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of distances from one to half of the series and beyond."""
    phase = np.cumsum(np.random.default_rng(1).integers(-50, 60, 140_001)).astype(kind)
    distances = [1, 2, 7, 4096, 40_000, 70_000, 70_001, 200_000]
    compiled = sums_of_squares(phase, distances, first)
    whole = phase.astype(float)
    for m, result in zip(distances, compiled, strict=True):
        ends = np.arange(max(first, 2 * m), len(phase))
        wanted = np.square(whole[ends] - 2 * whole[ends - m] + whole[ends - 2 * m]).sum()
        assert result == pytest.approx(wanted, rel=1e-12)
    monkeypatch.setattr(series, "COMPILED", False)
    assert compiled == pytest.approx(sums_of_squares(phase, distances, first), rel=1e-12)


@pytest.mark.parametrize(("rows", "lags"), [(1, 3), (7, 7), (100, 33), (1000, 1)])
def test_lagged_products_equal_their_definition(rows: int, lags: int) -> None:
    lines = np.random.default_rng(rows).normal(size=(3, rows))
    result = series.lagged_products(lines, lags)
    wanted = [[line[: max(rows - lag, 0)] @ line[lag:] for lag in range(lags)] for line in lines]
    np.testing.assert_allclose(result, wanted, rtol=1e-12, atol=1e-12)


def test_powers_in_parts_equal_their_definition() -> None:
    """Parts of no row, of one, and of more than a processor adds at once."""
    lines, starts = np.random.default_rng(5).normal(size=(3, 100)), np.array([0, 1, 1, 40])
    result = series.part_powers(lines, starts)
    parts = [lines[:, :1], lines[:, :0], lines[:, 1:40], lines[:, 40:]]
    wanted = [[(part**power).sum(axis=1) for part in parts] for power in (1, 2, 3, 4)]
    np.testing.assert_allclose(result, wanted, rtol=1e-12, atol=1e-12)


def test_powers_of_second_differences_equal_their_definition() -> None:
    """Of 90 - 2 x 4 neighbouring ones, and of nine with larger distances and steps, the last of which ends the line."""
    lines = np.random.default_rng(6).normal(size=(2, 90))
    result = series.change_powers(lines, [(0, 82, 4, 1), (1, 9, 16, 7)])
    fine = lines[:, 8:] - 2 * lines[:, 4:-4] + lines[:, :-8]
    coarse = np.stack([lines[:, at + 32] - 2 * lines[:, at + 16] + lines[:, at] for at in range(1, 58, 7)], axis=1)
    wanted = [[(changes**power).sum(axis=1) for changes in (fine, coarse)] for power in (2, 4)]
    np.testing.assert_allclose(result, wanted, rtol=1e-12)


def test_a_compiled_autocorrelation_equals_that_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(4).integers(-99, 99, (30_000, 3))
    results = []
    for compiled in (True, False):
        monkeypatch.setattr(series, "COMPILED", compiled)
        sums = Autocovariance(columns=3)
        sums.update(values)
        results.append(sums.result().correlation)
    np.testing.assert_allclose(*results, rtol=1e-12, atol=1e-14)


def test_other_sizes_are_refused() -> None:
    from imuarray import _series

    numbers = np.zeros(12)
    with pytest.raises(ValueError, match="number of arrays"):
        _series.medians((numbers,), (12, 1))
    with pytest.raises(ValueError, match="array 1: 8 bytes"):
        _series.medians((numbers, numbers, numbers, numbers), (12, 1))
    with pytest.raises(ValueError, match="sizes"):
        _series.windows((numbers,) * 6, (1, 0), 0, 1, 0)
    with pytest.raises(ValueError, match="sizes"):
        _series.second_differences((numbers,) * 3, (12, 12), 2, 0, 1)
    with pytest.raises(ValueError, match="sizes"):
        _series.lagged_products((numbers, numbers), (3, 4, -1))
    with pytest.raises(ValueError, match="ascending"):
        _series.part_powers((numbers, np.array([0, 13]), np.zeros(8)), (1, 12, 2))
    with pytest.raises(ValueError, match="beyond"):
        _series.change_powers((numbers, np.array([0, 11, 1, 1]), np.zeros(2)), (1, 12, 1))
    with pytest.raises(ValueError, match="distance"):
        _series.second_differences((numbers, np.zeros(12, np.int64), numbers.copy()), (12, 12), 8, 0, 12)
