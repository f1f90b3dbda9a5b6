"""The algebra of slow errors beside the textbook's products of whole matrices."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.fuse.optimal.states import Adjoint, Gaussian, Innovation, StateResponse, backwards, corrected

ROWS, STATES = 6, 40


def _spread(rng: np.random.Generator, size: int) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return root @ root.T


def _dense(rng: np.random.Generator, terms: int) -> np.ndarray:
    """Sparse rows: some feel nothing, some several states."""
    dense = np.where(rng.random((terms, ROWS, STATES)) < 0.05, rng.choice([1.0, 0.3], (terms, ROWS, STATES)), 0.0)
    dense[0, 0] = 0.0
    return dense


@pytest.mark.parametrize("terms", [1, 4])
def test_what_rows_feel_is_the_product_with_the_whole_matrix(terms: int) -> None:
    rng = np.random.default_rng(terms)
    dense = _dense(rng, terms)
    flat = dense.reshape(-1, STATES)
    belief = Gaussian(rng.normal(size=STATES), _spread(rng, STATES))
    mean, covariance = StateResponse(dense).of(belief)
    np.testing.assert_allclose(mean.ravel(), flat @ belief.mean, rtol=1e-12, atol=1e-12)
    expected = flat @ belief.covariance @ flat.T
    np.testing.assert_allclose(covariance.reshape(expected.shape), expected, rtol=1e-12, atol=1e-11)


def test_what_rows_feel_of_smoothed_states() -> None:
    """The smoothed belief is mean - P lambda, P - P Lambda P (Bierman 1973)."""
    rng = np.random.default_rng(3)
    dense = _dense(rng, 4)
    flat = dense.reshape(-1, STATES)
    belief = Gaussian(rng.normal(size=STATES), _spread(rng, STATES) / STATES)
    adjoint = Adjoint(rng.normal(size=STATES), _spread(rng, STATES) / 1e4)
    mean, covariance = StateResponse(dense).of(belief, adjoint)
    smoothed = belief.covariance - belief.covariance @ adjoint.matrix @ belief.covariance
    np.testing.assert_allclose(mean.ravel(), flat @ (belief.mean - belief.covariance @ adjoint.vector), atol=1e-12)
    np.testing.assert_allclose(covariance.reshape(len(flat), -1), flat @ smoothed @ flat.T, atol=1e-12)


def test_states_that_nothing_feels() -> None:
    mean, covariance = StateResponse(np.zeros((1, 3, 0))).of(Gaussian(np.zeros(0), np.zeros((0, 0))))
    assert mean.tolist() == [[0.0, 0.0, 0.0]] and not covariance.any()


def test_step_back_is_that_of_whole_matrices() -> None:
    """lambda' = K' lambda - H' S^-1 v, Lambda' = K' Lambda K + H' S^-1 H, K = 1 - P H' S^-1 H (Bierman 1973)."""
    rng = np.random.default_rng(4)
    at = Gaussian(rng.normal(size=STATES), _spread(rng, STATES) / STATES)
    rows, values = rng.normal(size=(5, STATES)), rng.normal(size=5)
    later = Adjoint(rng.normal(size=STATES), _spread(rng, STATES))
    _, innovation = corrected(at, rows, values)
    inverse = np.linalg.inv(rows @ at.covariance @ rows.T + np.eye(5))
    kept = np.eye(STATES) - at.covariance @ rows.T @ inverse @ rows
    vector = kept.T @ later.vector - rows.T @ inverse @ (values - rows @ at.mean)
    matrix = kept.T @ later.matrix @ kept + rows.T @ inverse @ rows
    before = backwards(later, at, innovation)
    np.testing.assert_allclose(before.vector, vector, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(before.matrix, matrix, rtol=1e-11, atol=1e-10)
    np.testing.assert_array_equal(before.matrix, before.matrix.T)


def test_step_back_without_measurements_changes_nothing() -> None:
    rng = np.random.default_rng(5)
    later = Adjoint(rng.normal(size=3), _spread(rng, 3))
    empty = Innovation(np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(0))
    before = backwards(later, Gaussian(np.zeros(3), np.eye(3)), empty)
    np.testing.assert_array_equal(before.vector, later.vector)
    np.testing.assert_array_equal(before.matrix, later.matrix)
