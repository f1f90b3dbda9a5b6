"""Compiled recursions compared with NumPy's, and with the equations that they solve."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from imuarray import kernels
from imuarray.arrays import Floats
from imuarray.calibrate import noise
from imuarray.calibrate.segments import SegmentMeans
from imuarray.fuse.techniques import ranges

pytestmark = pytest.mark.skipif(not kernels.COMPILED, reason="installed without a C compiler")


@pytest.mark.parametrize("rows", [1, 2, 3, 50])
def test_tridiagonal_equations_are_solved(rows: int) -> None:
    """Against a matrix of all equations."""
    rng = np.random.default_rng(rows)
    before, after = rng.uniform(-0.5, 0.5, (2, rows))
    alone = rng.normal(size=(4, rows))
    before[0] = after[-1] = 0.0
    matrix = np.eye(rows) - np.diag(before[1:], -1) - np.diag(after[:-1], 1)
    result = kernels.tridiagonal(before, after, alone)
    assert result is not None
    np.testing.assert_allclose(result, np.linalg.solve(matrix, alone.T).T, rtol=1e-12, atol=1e-14)


def stretch(rows: int) -> SegmentMeans:
    """Means over two seconds each, with pauses between them."""
    rng = np.random.default_rng(7)
    return SegmentMeans(np.cumsum(rng.uniform(2.0, 4.0, rows)), rng.normal(size=(rows, 3)))


@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("rows", [2, 31, 32, 200])
def test_the_compiled_likelihood_of_a_drift_equals_that_of_numpy(
    rows: int, axes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one grid for all axes, and of a grid for each, from a drift of a fiftieth of the noise to 500 times it."""
    times = np.geomspace(4.0, 400.0, 5)
    ratios = np.geomspace(0.02, 500.0, 9)[:, None] * np.linspace(1.0, 1.3, axes)
    compiled = noise._likelihood([stretch(rows)], 2.0, times, ratios)
    monkeypatch.setattr(kernels, "COMPILED", False)
    wanted = noise._likelihood([stretch(rows)], 2.0, times, ratios)
    np.testing.assert_allclose(compiled.log_likelihood, wanted.log_likelihood, rtol=1e-12, atol=1e-10)


def test_innovations_of_a_drift_match_the_covariance_of_all_means() -> None:
    """Squares of the innovations add up to x' C^-1 x, logs of their variances to log |C|, by C = shared exp(-|d| / tau)
    and the noise on its diagonal.
    """
    part, tau, shared, noise = stretch(60), 20.0, 2.5, 0.7
    kept = np.exp(-np.diff(part.time_s, append=np.inf) / tau)[:, None]
    sums = kernels.drift_sums(part.mean, kept, np.full((1, 1, 1), shared), np.full((1, 1, 1), noise))
    assert sums is not None
    covariance = shared * np.exp(-np.abs(part.time_s[:, None] - part.time_s) / tau) + noise * np.eye(60)
    solved = np.linalg.solve(covariance, np.column_stack([part.mean, np.ones(60)]))
    np.testing.assert_allclose(sums[0].ravel(), np.einsum("ij,ij->j", part.mean, solved[:, :3]), rtol=1e-10)
    np.testing.assert_allclose(sums[1].ravel(), solved[:, 3].sum(), rtol=1e-10)
    np.testing.assert_allclose(sums[2].ravel(), part.mean.T @ solved[:, 3], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(sums[3].ravel(), np.linalg.slogdet(covariance)[1], rtol=1e-10)


def segments_of(count: int, axes: int) -> ranges.SegmentMoments:
    """Moments of frames with some motion; a few segments contain nothing, in some no axis moved, in some one did."""
    rng = np.random.default_rng(3)
    terms = rng.normal(size=(count, axes, 62, 3)) * [0.0, 2.0, 0.5] + [1.0, 3.0, 0.0]
    products = np.einsum("kmni,kmnj->kmij", terms, terms)
    residual = np.einsum("kmni,kmn->kmi", terms, rng.normal(0.1, 0.2, terms.shape[:3]))
    nothing = rng.random(count) < 0.2
    products[nothing], residual[nothing] = 0.0, 0.0
    moved = rng.random((count, axes)) < rng.choice([0.0, 0.5, 1.0], (count, 1))
    return ranges.SegmentMoments(np.arange(count), np.ones((count, axes), bool), moved, products, residual)


def start_of(axes: int) -> tuple[Floats, Floats]:
    """Differences and covariances before all segments."""
    return np.full((axes, 3), 0.01), np.tile(np.diag([0.3, 1e-4, 1e-5]), (axes, 1, 1))


@pytest.mark.parametrize("count", [0, 1, 40])
def test_compiled_differences_of_axes_equal_those_of_numpy(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.vstack([np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0] for seed in range(3)])
    blend = ranges.Blends(rows, np.linspace(1, 2, 9), np.full(9, 0.2)).of(np.ones(9, bool))
    assert blend is not None
    segments, walks = segments_of(count, 9), np.random.default_rng(5).uniform(0, 1e-4, (count, 9, 3))
    compiled = ranges._track(start_of(9), segments, walks, blend)
    monkeypatch.setattr(kernels, "COMPILED", False)
    wanted = ranges._track(start_of(9), segments, walks, blend)
    for result, each in zip(compiled, wanted, strict=True):
        assert result.shape == each.shape
        np.testing.assert_allclose(result, each, rtol=1e-9, atol=1e-12)
    if count > 1:
        assert np.abs(wanted[0][-1] - wanted[0][0]).max() > 0.01  # they converge


@pytest.mark.parametrize("columns", [1, 2, 5, 16])
def test_non_negative_least_squares_equal_those_of_scipy(columns: int) -> None:
    """Against SciPy's, of random problems in which about half of the coefficients are zero, and of steep curves."""
    rng = np.random.default_rng(columns)
    for _ in range(100):
        design = np.abs(rng.normal(size=(20, columns))) ** rng.choice([1, 3])
        target = design @ np.maximum(rng.normal(size=columns), 0.0) + rng.normal(0, 0.5, 20)
        result, (wanted, residual) = kernels.non_negative(design, target), nnls(design, target)
        assert result is not None and result.min() >= 0
        np.testing.assert_allclose(result, wanted, rtol=1e-9, atol=1e-10)
        assert np.linalg.norm(design @ result - target) == pytest.approx(residual, rel=1e-12)


def test_a_target_of_opposite_direction_has_zero_coefficients() -> None:
    result = kernels.non_negative(np.ones((4, 2)), -np.ones(4))
    assert result is not None and result.tolist() == [0.0, 0.0]


def test_other_sizes_are_refused() -> None:
    from imuarray import _kernels

    five = (np.zeros(3), np.zeros(3), np.zeros((2, 3)), np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="array 0: 32 bytes"):
        _kernels.tridiagonal(five, (2, 4))
    with pytest.raises(ValueError, match="number of arrays"):
        _kernels.tridiagonal(five[:4], (2, 3))
    with pytest.raises(ValueError, match="no rows"):
        _kernels.tridiagonal(five, (0, 3))
    with pytest.raises(ValueError, match="sizes"):
        _kernels.drift(five, (3, 17, 1, 1, 1))
    with pytest.raises(ValueError, match="sizes"):
        _kernels.track(five, (-1, 3))
    read_only = np.zeros((2, 3))
    read_only.flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        _kernels.tridiagonal((five[0], five[1], read_only, five[3], five[4]), (2, 3))
