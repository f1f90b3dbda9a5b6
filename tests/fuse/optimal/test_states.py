"""The algebra of slow errors against the textbook's products of full matrices."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from imuarray.fuse.optimal import compiled
from imuarray.fuse.optimal.filter import SegmentEvidence, _measurements
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.states import (
    Adjoint,
    Gaussian,
    Innovation,
    StateResponse,
    correct_states,
    predict_states,
    step_back,
)

ROWS, STATES = 6, 40


def _spread(rng: np.random.Generator, size: int) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return root @ root.T


def _dense(rng: np.random.Generator, terms: int) -> np.ndarray:
    """Sparse rows: some depend on no state, some on several."""
    dense = np.where(rng.random((terms, ROWS, STATES)) < 0.05, rng.choice([1.0, 0.3], (terms, ROWS, STATES)), 0.0)
    dense[0, 0] = 0.0
    return dense


@pytest.mark.parametrize("terms", [1, 4])
def test_the_response_of_rows_equals_the_full_matrix_product(terms: int) -> None:
    rng = np.random.default_rng(terms)
    dense = _dense(rng, terms)
    flat = dense.reshape(-1, STATES)
    belief = Gaussian(rng.normal(size=STATES), _spread(rng, STATES))
    mean, covariance = StateResponse(dense).of(belief)
    np.testing.assert_allclose(mean.ravel(), flat @ belief.mean, rtol=1e-12, atol=1e-12)
    expected = (flat @ belief.covariance @ flat.T).reshape(terms, ROWS, terms, ROWS).transpose(0, 2, 1, 3)
    np.testing.assert_allclose(covariance, expected, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("terms", [1, 4])
def test_the_response_of_rows_to_smoothed_states(terms: int) -> None:
    """The smoothed estimate is mean - P lambda, P - P Lambda P (Bierman 1973); drifting states act on
    the first term.
    """
    rng = np.random.default_rng(3)
    dense = _dense(rng, terms)
    drifting = rng.random(STATES) < 0.4
    dense[1:, :, drifting] = 0.0
    flat = dense.reshape(-1, STATES)
    belief = Gaussian(rng.normal(size=STATES), _spread(rng, STATES) / STATES)
    adjoint = Adjoint(rng.normal(size=STATES), _spread(rng, STATES) / 1e4)
    mean = belief.mean - belief.covariance @ adjoint.vector
    smoothed = belief.covariance - belief.covariance @ adjoint.matrix @ belief.covariance
    drift = StateResponse(dense).drift(belief, adjoint, drifting)
    steady = flat * ~drifting
    np.testing.assert_allclose(drift.offset, dense[0] @ (mean * drifting), atol=1e-12)
    added = flat @ smoothed @ flat.T - steady @ smoothed @ steady.T
    np.testing.assert_allclose(drift.errors.reshape(ROWS, -1), added[:ROWS], atol=1e-12)
    assert np.allclose(added[ROWS:, ROWS:], 0.0, atol=1e-14)


def test_rows_without_states_have_zero_response() -> None:
    mean, covariance = StateResponse(np.zeros((1, 3, 0))).of(Gaussian(np.zeros(0), np.zeros((0, 0))))
    assert mean.tolist() == [[0.0, 0.0, 0.0]] and not covariance.any()


def test_a_backward_step_equals_that_of_full_matrices() -> None:
    """lambda' = K' lambda - H' S^-1 v, Lambda' = K' Lambda K + H' S^-1 H, K = 1 - P H' S^-1 H (Bierman 1973)."""
    rng = np.random.default_rng(4)
    at = Gaussian(rng.normal(size=STATES), _spread(rng, STATES) / STATES)
    rows, values = rng.normal(size=(5, STATES)), rng.normal(size=5)
    later = Adjoint(rng.normal(size=STATES), _spread(rng, STATES))
    _, innovation = correct_states(at, rows, values)
    inverse = np.linalg.inv(rows @ at.covariance @ rows.T + np.eye(5))
    kept = np.eye(STATES) - at.covariance @ rows.T @ inverse @ rows
    vector = kept.T @ later.vector - rows.T @ inverse @ (values - rows @ at.mean)
    matrix = kept.T @ later.matrix @ kept + rows.T @ inverse @ rows
    before = step_back(later, innovation)
    np.testing.assert_allclose(before.vector, vector, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(before.matrix, matrix, rtol=1e-11, atol=1e-10)
    np.testing.assert_array_equal(before.matrix, before.matrix.T)


def test_a_backward_step_without_measurements_changes_nothing() -> None:
    rng = np.random.default_rng(5)
    later = Adjoint(rng.normal(size=3), _spread(rng, 3))
    before = step_back(later, Innovation(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)))
    np.testing.assert_array_equal(before.vector, later.vector)
    np.testing.assert_array_equal(before.matrix, later.matrix)


def test_states_without_measurements_are_unchanged() -> None:
    belief = Gaussian(np.arange(3.0), np.diag([1.0, 2.0, 3.0]))
    after, innovation = correct_states(belief, np.zeros((0, 3)), np.zeros(0))
    assert (after.mean == belief.mean).all() and (after.covariance == belief.covariance).all()
    assert innovation.gain.shape == (0, 3)


@pytest.mark.parametrize(("states", "measurements"), [(1, 1), (5, 9), (8, 3), (40, 5), (114, 15), (50, 33)])
def test_compiled_steps_equal_those_of_numpy(states: int, measurements: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes below, at and above those of the tiles of products."""
    rng = np.random.default_rng(states)
    belief = Gaussian(rng.normal(size=states), _spread(rng, states) / states)
    rows, values = rng.normal(size=(measurements, states)), rng.normal(size=measurements)
    later = Adjoint(rng.normal(size=states), _spread(rng, states))
    decay, added = rng.random(states), rng.random(states)

    def results() -> list[np.ndarray]:
        after, innovation = correct_states(belief, rows, values)
        return [*after, *innovation, *step_back(later, innovation), *predict_states(belief, decay, added)]

    ours = results()
    for name in ("predict", "correct", "turn_back"):
        monkeypatch.setattr(compiled, name, lambda *_: False)
    for got, expected in zip(ours, results(), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())
    assert (ours[1] == ours[1].T).all()


@pytest.mark.parametrize("terms", [1, 4])
def test_compiled_effects_equal_those_of_numpy(terms: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(8)
    dense, drifting = _dense(rng, terms), rng.random(STATES) < 0.4
    dense[1:, :, drifting] = 0.0
    belief = Gaussian(rng.normal(size=STATES), _spread(rng, STATES) / STATES)
    adjoint = Adjoint(rng.normal(size=STATES), _spread(rng, STATES) / 1e4)
    response = StateResponse(dense)
    ours = [*response.of(belief), *response.drift(belief, adjoint, drifting)]
    monkeypatch.setattr(compiled, "effect", lambda *_: False)
    monkeypatch.setattr(compiled, "drifts", lambda *_: False)
    for got, expected in zip(ours, [*response.of(belief), *response.drift(belief, adjoint, drifting)], strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


def test_covariances_that_are_not_positive_are_refused() -> None:
    belief = Gaussian(np.zeros(2), np.diag([-5.0, 1.0]))
    with pytest.raises(np.linalg.LinAlgError):
        correct_states(belief, np.eye(2), np.zeros(2))


@pytest.mark.skipif(
    importlib.util.find_spec("imuarray.fuse.optimal._states") is None, reason="installed without a C compiler"
)
def test_compiled_steps_refuse_arrays_of_another_size() -> None:
    arrays = tuple(np.zeros(4) for _ in range(6))
    with pytest.raises(ValueError, match="array 3: 128 bytes are required"):
        compiled.predict(arrays, 4)
    with pytest.raises(ValueError, match="other sizes are required"):
        compiled.predict(arrays, -1)
    outside = (np.zeros(1), np.zeros(1), np.array([0, 1]), np.array([1]), np.zeros(1), np.zeros(1), np.zeros(1))
    assert not compiled.effect(outside, (1, 1, 1, 1))


@pytest.mark.parametrize("terms", [1, 4])
@pytest.mark.parametrize("moves", [0.0, 3.0])
def test_compiled_measurements_equal_those_of_numpy(terms: int, moves: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Components that the stimulus does not determine are omitted by both; the sign of a component is free."""
    rng = np.random.default_rng(9)
    evidence = SegmentEvidence(_geometry(), terms)
    sums = evidence.sums_of(np.ones(ROWS, bool))
    stimulus = [9.8, 0.0, 0.0] + moves * rng.normal(size=(50, 3))
    felt = np.concatenate([np.ones((50, 1)), stimulus], axis=1)[:, :terms]
    sums.squares += felt.T @ felt
    sums.products += felt.T @ rng.normal(size=(50, ROWS))
    sums.blur += 50 * np.diag([1e-4, 2e-4, 3e-4])
    parity, response = _geometry().parity(np.ones(ROWS, bool)), StateResponse(_dense(rng, terms))
    ours = _measurements(sums, parity, response)
    monkeypatch.setattr(compiled, "measure", lambda *_: -1)
    theirs = _measurements(sums, parity, response)
    assert len(ours[0]) == len(theirs[0]) == len(parity) * (terms if moves else 1)
    for got, expected in zip(_information(*ours), _information(*theirs), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("is_compiled", [True, False])
def test_a_model_without_states_has_no_columns(is_compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "COMPILED", compiled.COMPILED and is_compiled)
    evidence = SegmentEvidence(_geometry(), 1)
    sums = evidence.sums_of(np.ones(ROWS, bool))
    sums.squares += 4.0
    parity = _geometry().parity(np.ones(ROWS, bool))
    rows, values = _measurements(sums, parity, StateResponse(np.zeros((1, ROWS, 0))))
    assert rows.shape == (len(parity), 0)
    assert values.shape == (len(parity),)


def _geometry() -> Geometry:
    rows = np.concatenate([np.eye(3), np.linalg.qr(np.random.default_rng(10).normal(size=(3, 3)))[0]])
    noise = np.linspace(0.1, 0.2, ROWS)
    return Geometry(rows, noise, noise, np.full(ROWS, 40.0), np.zeros(ROWS), ROWS)


def _information(rows: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rows.T @ rows, rows.T @ values
