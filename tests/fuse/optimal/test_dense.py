"""Comparison with another derivation: one generalised least squares over all readings of a short log."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.fuse.frames import matrices
from imuarray.fuse.optimal import Optimal
from tests.fuse.optimal.conftest import (
    FORCE,
    PERIOD_S,
    Floats,
    Log,
    blocks_of,
    dense,
    drawn_logs,
    frames_of,
    random_axes,
    rich_model,
)

FRAMES = 40


@pytest.fixture(scope="module")
def log() -> Log:
    rng = np.random.default_rng(90)
    axes = random_axes(rng)
    return next(drawn_logs(rng, axes, rich_model(axes), FRAMES, warming_degc=10.0))


@pytest.fixture(scope="module")
def valid() -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """One reading in eight is missing; seldom more than three of nine in a frame."""
    return np.random.default_rng(91).random((FRAMES, 9)) > 0.125


def test_the_filter_equals_least_squares_of_all_readings_so_far(
    log: Log, valid: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
) -> None:
    optimal = Optimal({FORCE: log.axes}, log.model, period_s=PERIOD_S, segment_s=PERIOD_S)
    estimate = optimal({FORCE: frames_of(log.values, valid)}, log.degc)[FORCE]
    for frame in (0, 1, 7, 20, FRAMES - 1):
        sofar = np.flatnonzero(valid.ravel() & (np.arange(valid.size) < (frame + 1) * valid.shape[1]))
        triads, covariance = dense(log, sofar)
        at = slice(3 * frame, 3 * frame + 3)
        assert estimate.triad_box[frame] == pytest.approx(triads[at], abs=1e-6)
        assert matrices(estimate.covariance_box[frame]) == pytest.approx(covariance[at, at], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("block", [7, FRAMES])
def test_the_smoother_equals_least_squares_of_all_readings(
    log: Log, valid: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], block: int
) -> None:
    """33 steps and more: the backward pass crosses from one stride to another."""
    optimal = Optimal({FORCE: log.axes}, log.model, period_s=PERIOD_S, segment_s=PERIOD_S)
    frames = {FORCE: frames_of(log.values, valid)}
    estimates = [estimates[FORCE] for _, estimates in optimal.smoothed(lambda: blocks_of(frames, block, log.degc))]
    triads, covariance = dense(log, np.flatnonzero(valid.ravel()))
    result: Floats = np.concatenate([estimate.triad_box for estimate in estimates])
    assert result == pytest.approx(triads.reshape(-1, 3), abs=1e-6)
    spreads = matrices(np.concatenate([estimate.covariance_box for estimate in estimates]))
    for frame in range(FRAMES):
        at = slice(3 * frame, 3 * frame + 3)
        assert spreads[frame] == pytest.approx(covariance[at, at], rel=1e-6, abs=1e-9)


def test_segments_hardly_increase_the_variance() -> None:
    """Segments of up to 8 frames, 1 % of the shortest time constant: the stated variance is within 5 % of the bound,
    which is that of least squares of all readings so far.
    """
    rng = np.random.default_rng(92)
    axes = random_axes(rng)
    log = next(drawn_logs(rng, axes, rich_model(axes, slowness=25.0), FRAMES, warming_degc=0.1))
    optimal = Optimal({FORCE: log.axes}, log.model, period_s=PERIOD_S, segment_s=8 * PERIOD_S)
    estimate = optimal({FORCE: frames_of(log.values)}, log.degc)[FORCE]
    for frame in (1, 7, 20, FRAMES - 1):
        _, covariance = dense(log, np.arange((frame + 1) * len(log.axes)))
        bound = covariance[3 * frame : 3 * frame + 3, 3 * frame : 3 * frame + 3].trace()
        assert bound * 0.98 < matrices(estimate.covariance_box[frame]).trace() < bound * 1.05
