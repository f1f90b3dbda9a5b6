"""The stated covariance is that of the errors, and no other technique has smaller errors."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from scipy.stats import chi2

from imuarray.fuse.frames import Axis, Frames, matrices
from imuarray.fuse.optimal import AxisErrors, DesignErrors, ErrorModel, Optimal
from imuarray.fuse.techniques import TECHNIQUES
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
    times,
    triad,
)
from tests.selection import some

LOGS = 30
FRAMES = 40
CHECKED = (0, 3, 20, FRAMES - 1)


@pytest.mark.parametrize("smoothed", some([False, True], 1))
def test_normalised_errors_squared_are_within_their_chi_square_interval(smoothed: bool) -> None:
    """Over 90 logs of three arrays, at four frames each: 99.9 % over the four of them."""
    rng = np.random.default_rng(93)
    sums = np.zeros(len(CHECKED))
    for _ in range(3):
        axes = random_axes(rng, 8)
        logs = drawn_logs(rng, axes, rich_model(axes, slowness=25.0), FRAMES, warming_degc=0.1)
        sums += sum((normalised(log, smoothed) for log in islice(logs, LOGS)), np.zeros(len(CHECKED)))
    low, high = chi2.ppf([0.0005 / 4, 1 - 0.0005 / 4], 9 * LOGS)
    assert ((low < sums) & (sums < high)).all()


def normalised(log: Log, smoothed: bool) -> Floats:
    """Error squared over its covariance, at the frames that are checked."""
    optimal = Optimal({FORCE: log.axes}, log.model, period_s=PERIOD_S, segment_s=8 * PERIOD_S)
    frames = {FORCE: frames_of(log.values)}
    estimates = optimal(frames, log.degc)
    if smoothed:
        ((_, estimates),) = optimal.smoothed(lambda: blocks_of(frames, FRAMES, log.degc))
    triads, covariances = estimates[FORCE].triad_box, matrices(estimates[FORCE].covariance_box)
    errors = (triads - log.truth)[list(CHECKED)]
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances[list(CHECKED)]), errors)


def paper_like() -> list[Axis]:
    """Two designs of two ranges, boards in both orientations: 5 sensors, three of which have the same direction along
    box X.
    """
    plus, turned, minus = np.eye(3), np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), np.diag([1.0, -1, -1])
    return [
        *triad("S0", plus, "a", noise_si=0.17),
        *triad("S1", turned, "a", noise_si=0.17),
        *triad("S2", minus, "a", noise_si=0.08),
        *triad("S3", plus, "b", noise_si=0.25),
        *triad("S4", minus, "b", noise_si=0.25),
    ]


CASES = {
    "noise alone": (AxisErrors(0.1), DesignErrors()),
    "turn-on": (AxisErrors(0.1, bias=0.3), DesignErrors()),
    "drift": (AxisErrors(0.1, bias=0.02, drift=0.1, drift_time_constant_s=100.0), DesignErrors()),
    "a design drifts": (AxisErrors(0.1, drift=0.02, drift_time_constant_s=100.0), DesignErrors(0.5, 100.0)),
    "heating": (AxisErrors(0.1, slope_per_degc=0.005), DesignErrors(slope_per_degc=0.03)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", some(CASES, 1))
def test_optimal_is_not_worse_than_any_other_technique(case: str) -> None:
    """20 s of 20 logs each: the mean squared error of all frames. Common noise and draws cancel in the ratio of two
    techniques; 1 % allows for the scatter of the draws where the weights are equal.
    """
    rng = np.random.default_rng(94)
    axes = paper_like()
    usual, design = CASES[case]
    errors = {
        (axis.sensor, axis.index): AxisErrors(
            axis.noise_si or 0.0,
            0.0,
            usual.bias,
            usual.drift,
            usual.drift_time_constant_s,
            usual.slope_per_degc,
            0.0,
            20.0,
        )
        for axis in axes
    }
    model = ErrorModel(errors, {(chip, index): design for chip in "ab" for index in range(3)})
    squares = dict.fromkeys([*TECHNIQUES, "optimal"], 0.0)
    for _ in range(20):
        values, truth, degc = slow_log(rng, axes, model, 2000)
        frames = Frames(times(len(values)), values, np.ones(values.shape, bool))
        optimal = Optimal({FORCE: axes}, model, period_s=PERIOD_S)
        squares["optimal"] += float(np.sum((optimal({FORCE: frames}, degc)[FORCE].triad_box - truth) ** 2))
        for name, maker in TECHNIQUES.items():
            squares[name] += float(np.sum((maker(axes)(frames).triad_box - truth) ** 2))
    best = min(squares[name] for name in TECHNIQUES)
    assert squares["optimal"] < 1.01 * best


def slow_log(
    rng: np.random.Generator, axes: list[Axis], model: ErrorModel, count: int
) -> tuple[Floats, Floats, dict[str, Floats]]:
    """A long log, its processes stepped from frame to frame: values, truth and temperatures that rise by 28 degC."""
    truth = np.cumsum(rng.normal(0.0, 0.02, (count, 3)), axis=0) + np.array([0.0, 0.0, 9.8])
    warmer = np.linspace(0.0, 28.0, count)
    values = truth @ np.array([axis.direction_box for axis in axes]).T
    shared = {
        key: design.common * wander(rng, count, design.common_time_constant_s)
        + design.slope_per_degc * rng.normal() * warmer
        for key, design in model.designs.items()
    }
    for index, axis in enumerate(axes):
        errors = model.axes[axis.sensor, axis.index]
        values[:, index] += errors.bias * rng.normal() + errors.noise * rng.normal(size=count)
        values[:, index] += errors.drift * wander(rng, count, errors.drift_time_constant_s)
        values[:, index] += errors.slope_per_degc * rng.normal() * warmer + shared[axis.chip, axis.index]
    return values, truth, {axis.sensor: 20.0 + warmer for axis in axes}


def wander(rng: np.random.Generator, count: int, time_constant_s: float) -> Floats:
    """A Gauss-Markov process of unit variance, in steps of 16 frames."""
    kept = np.exp(-16 * PERIOD_S / time_constant_s)
    result = [rng.normal()]
    for _ in range(count // 16 + 1):
        result.append(kept * result[-1] + np.sqrt(1 - kept**2) * rng.normal())
    return np.interp(np.arange(count) / 16, np.arange(len(result)), result)


@pytest.mark.slow
def test_errors_are_within_a_twentieth_of_the_bound() -> None:
    """Root mean square over 600 logs of a frame at which all observable errors are learned: 1800 squares determine it
    to 1.7 % (one sigma; fixed seed). The bound is least squares of all readings so far.
    """
    rng = np.random.default_rng(95)
    axes = random_axes(rng, 7)
    squares, logs = 0.0, 600
    for log in islice(drawn_logs(rng, axes, rich_model(axes, slowness=25.0), 16, warming_degc=0.1), logs):
        optimal = Optimal({FORCE: axes}, log.model, period_s=PERIOD_S, segment_s=8 * PERIOD_S)
        estimate = optimal({FORCE: frames_of(log.values)}, log.degc)[FORCE]
        squares += float(np.sum((estimate.triad_box[-1] - log.truth[-1]) ** 2))
    _, covariance = dense(log, np.arange(log.values.size))
    assert np.sqrt(squares / logs) < 1.05 * np.sqrt(np.trace(covariance[-3:, -3:]))


@pytest.mark.slow
def test_covariances_with_wrong_directions_agree_with_the_errors() -> None:
    """40 arrays whose axes have errors of 2 % in every direction and biases, turned through all poses and shaken; at
    three frames each, chi-square of 120 degrees of freedom, 99.9 % over the three of them.
    """
    rng = np.random.default_rng(97)
    seconds = times(2000)[:, None] * 1e-9
    truth = 9.8 * np.sin([1.1, 0.7, 0.3] * seconds + [0.0, 1.0, 2.0]) + 3 * np.sin([7.0, 9.0, 8.0] * seconds)
    checked, sums = [2, 500, 1999], np.zeros(3)
    for _ in range(40):
        axes = random_axes(rng, 9)
        errors = {(axis.sensor, axis.index): AxisErrors(0.1, bias=0.1, response=0.02) for axis in axes}
        rows = np.array([axis.direction_box for axis in axes]) + 0.02 * rng.normal(size=(9, 3))
        values = truth @ rows.T + 0.1 * rng.normal(size=9) + 0.1 * rng.normal(size=(2000, 9))
        optimal = Optimal({FORCE: axes}, ErrorModel(errors), period_s=PERIOD_S, segment_s=0.5)
        estimate = optimal({FORCE: frames_of(values)})[FORCE]
        error = (estimate.triad_box - truth)[checked]
        sums += np.einsum("ni,nij,nj->n", error, np.linalg.inv(matrices(estimate.covariance_box[checked])), error)
    low, high = chi2.ppf([0.0005 / 3, 1 - 0.0005 / 3], 120)
    assert ((low < sums) & (sums < high)).all()
