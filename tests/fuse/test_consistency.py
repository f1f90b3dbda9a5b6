"""Consistency of covariances: the stated error rate for right covariances, a verdict for wrong ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from imuarray.fuse.error_consistency import Consistency, consistency
from imuarray.fuse.frames import entries
from tests.fuse.conftest import Floats
from tests.selection import some

COVARIANCE = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
ROOT = np.linalg.cholesky(COVARIANCE)
ROWS = 2000


def judged(unit: Floats, claimed: float = 1.0) -> Consistency:
    """Consistency of errors with covariance `COVARIANCE` if `unit` (n, 3) has unit variance, where `claimed` times that
    is stated.
    """
    result = consistency(unit @ ROOT.T, np.tile(entries(claimed * COVARIANCE), (len(unit), 1)))
    assert result is not None
    return result


def white(rng: np.random.Generator) -> Floats:
    return np.asarray(rng.normal(size=(ROWS, 3)))


def slow(rng: np.random.Generator) -> Floats:
    """First-order Gauss-Markov with a memory of 50 frames."""
    phi = np.exp(-1 / 50)
    return np.asarray(lfilter([np.sqrt(1 - phi**2)], [1, -phi], rng.normal(size=(ROWS + 500, 3)), axis=0)[500:])


def constant(rng: np.random.Generator) -> Floats:
    return np.tile(rng.normal(size=3), (ROWS, 1))


def mixed(rng: np.random.Generator) -> Floats:
    """A tenth of the variance stays, the rest is white."""
    return np.sqrt(0.1) * constant(rng) + np.sqrt(0.9) * white(rng)


@pytest.mark.parametrize(("kind", "fewest"), some([(white, 86), (slow, 84), (mixed, 84)], 1))
def test_right_covariances_are_inside_the_interval(kind: Callable[[np.random.Generator], Floats], fewest: int) -> None:
    """About 95 of 100; four standard errors of 2.2 allow 86; somewhat more where the correlation time is estimated."""
    inside = sum(judged(kind(np.random.default_rng(seed))).holds for seed in range(100))
    assert inside >= fewest


def test_a_constant_error_has_one_to_three_degrees_of_freedom() -> None:
    """One draw: chi-square of one to three degrees of freedom, for any length."""
    result = judged(constant(np.random.default_rng(1)))
    assert 1 <= result.freedom <= 3.1
    assert result.high > 3


def test_white_errors_have_a_degree_of_freedom_each() -> None:
    result = judged(white(np.random.default_rng(2)))
    assert result.freedom == pytest.approx(3 * ROWS, rel=0.15)
    assert result.high - 1 == pytest.approx(1.96 * np.sqrt(2 / (3 * ROWS)), rel=0.1)


@pytest.mark.parametrize(("claimed", "normalised"), [(0.8, 1.25), (1.25, 0.8)])
def test_wrong_covariances_are_outside_the_interval(claimed: float, normalised: float) -> None:
    """An error of a fifth: 12 standard deviations of 6000 squares."""
    result = judged(white(np.random.default_rng(3)), claimed)
    assert result.normalised == pytest.approx(normalised, rel=0.08)
    assert not result.holds


def test_an_unstated_bias_is_outside_the_interval() -> None:
    assert not judged(white(np.random.default_rng(4)) + 5.0).holds


def test_unknown_covariances_have_no_verdict() -> None:
    assert consistency(np.zeros((100, 3)), np.full((100, 6), np.nan)) is None
    assert consistency(np.zeros((5, 3)), np.tile(entries(COVARIANCE), (5, 1))) is None


def test_every_covariance_whitens_its_own_error() -> None:
    """Compared with the general solution for each frame; covariances that are not positive definite are excluded."""
    rng = np.random.default_rng(7)
    roots = np.tril(rng.normal(size=(500, 3, 3))) + 2 * np.eye(3)
    covariances = roots @ roots.transpose(0, 2, 1)
    errors = rng.normal(size=(500, 3))
    wanted = np.mean(
        [error @ np.linalg.solve(covariance, error) / 3 for error, covariance in zip(errors, covariances, strict=True)]
    )
    none = np.array(
        [[-1.0, -1.0, 1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0, 0.0, 0.0], [np.nan, 1.0, 1.0, 0.0, 0.0, 0.0]]
    )
    result = consistency(np.concatenate([errors, np.ones((3, 3))]), np.concatenate([entries(covariances), none]))
    assert result is not None
    assert result.normalised == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize(("segment", "block"), [(1 << 17, 1 << 15), (401, 100), (64, 399), (37, 1)])
def test_the_freedom_is_that_of_all_lags_for_any_blocks(
    segment: int, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sum in the module's docstring, for each lag; lags beyond half of 401 equal those of its upper half."""
    monkeypatch.setattr("imuarray.fuse.spools.AT_ONCE", block)
    monkeypatch.setattr("imuarray.fuse.error_consistency._SEGMENT", segment)
    monkeypatch.setattr("imuarray.fuse.error_consistency._CACHED", block)
    unit = slow(np.random.default_rng(9))[:401]
    unit /= np.sqrt(np.mean(unit**2))
    rows = len(unit)
    squares = np.array([np.sum((unit[:-k].T @ unit[k:] / (rows - k)) ** 2) - 9 / (rows - k) for k in range(1, 201)])
    lagged = sum((1 - k / rows) * squares[k - 1] for k in range(1, 201)) + rows / 8 * squares[100:].mean()
    result = consistency(unit, np.tile([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], (rows, 1)))
    assert result is not None
    assert result.freedom == pytest.approx(9 * rows / (3 + 2 * lagged), rel=1e-12)
