"""Opposed axes: a common drift is removed, a drift of a single unit hardly increases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from imuarray.fuse import TECHNIQUES, Axis, Frames, fuse
from imuarray.fuse.techniques.opposed import CommonErrorEstimate, OpposingGroup, Smoother, opposing_groups
from imuarray.log import open_log
from tests.fuse.conftest import Floats, Part, WriteRun, calibration, joined, pointing

# The paper's three gyroscopes: 1 + 2 axes along every box axis.
GYROS = (("G1", "+X+Y+Z"), ("G2", "+X-Y-Z"), ("G3", "-X-Y+Z"))
DRIFT_DPS = 1.0
TIME_S = 100.0


def gyros(
    error: Callable[[Floats], Floats], ways: tuple[tuple[str, str], ...] = GYROS, sigma: float = 0.2
) -> list[Part]:
    return [Part(n, axes, "angular_rate", "l3g4200d", 250.0, 100.0, sigma=sigma, error=error) for n, axes in ways]


def temperatures(seconds: Floats) -> Floats:
    """The same drift on every axis of every unit: 1 dps (1 - exp(-t / 100 s))."""
    return np.outer(DRIFT_DPS * (1 - np.exp(-seconds / TIME_S)), [1, 1, 1])


def fused_dps(write_run: WriteRun, parts: list[Part], technique: str, **options: object) -> Floats:
    path = write_run(parts, name=f"{technique}.h5", **options)  # type: ignore[arg-type]
    with open_log(path) as log:
        return np.asarray(np.degrees(joined(list(fuse(log, calibration(parts), technique)), "angular_rate")[1]))


def test_a_common_drift_is_removed(write_run: WriteRun) -> None:
    """1 + 2 axes: the average keeps a third. The low-pass of 10 s lags by 10 s times the slope."""
    parts = gyros(temperatures)
    average = fused_dps(write_run, parts, "mean", frames=8000, rate_hz=20.0)
    opposed = fused_dps(write_run, parts, "opposed", frames=8000, rate_hz=20.0)
    end = slice(6000, 8000)
    drift = temperatures(np.arange(6000, 8000) / 20).mean()
    # Of 1 + 2 axes, one minus two over three: +1/3 of it along X (two point along), -1/3 along Y, +1/3 along Z.
    noise = 5 * 0.2 / np.sqrt(3 * 2000)
    assert average[end].mean(axis=0) == pytest.approx(drift / 3 * np.array([1, -1, 1]), abs=noise)
    # The lag, and an initial weight below one: a fortieth of the drift that the average keeps.
    assert np.abs(opposed[end].mean(axis=0)).max() < drift / 3 / 40 + noise


@pytest.mark.slow
def test_removing_the_drift_adds_no_noise(write_run: WriteRun) -> None:
    parts = gyros(temperatures)
    scatter = {}
    for name in ("mean", "opposed"):
        rows = fused_dps(write_run, parts, name, frames=8000, rate_hz=20.0)
        scatter[name] = np.diff(rows, axis=0).std(axis=0)
    assert scatter["opposed"] / scatter["mean"] == pytest.approx([1.0] * 3, abs=0.01)


def test_a_motion_is_not_removed_as_drift(write_run: WriteRun) -> None:
    """Without noise and errors the result is the truth, also for a slow turn of the box."""
    rate: Callable[[Floats], Floats] = lambda seconds: np.outer(np.sin(seconds / 20), [50.0, 30.0, -40.0])  # noqa: E731
    parts = gyros(lambda seconds: np.zeros((len(seconds), 3)), sigma=0.0)
    opposed = fused_dps(write_run, parts, "opposed", frames=4000, rate_hz=20.0, rate=rate)
    assert np.abs(opposed - rate(np.arange(4000) / 20)).max() < 1.01 / 100


@pytest.mark.slow
def test_one_pair_is_balanced(write_run: WriteRun) -> None:
    """1 + 1 axes along Y and Z: the average has no common error. Along X both have the same direction: it is not
    observable.
    """
    parts = gyros(temperatures, GYROS[:2], sigma=0.0)
    average = fused_dps(write_run, parts, "mean", frames=4000, rate_hz=20.0)
    opposed = fused_dps(write_run, parts, "opposed", frames=4000, rate_hz=20.0)
    assert opposed == pytest.approx(average, abs=1e-12)
    assert np.abs(average[:, 1:]).max() < 1e-9
    assert average[:, 0] == pytest.approx(temperatures(np.arange(4000) / 20)[:, 0], abs=0.6 / 100)


def steady(errors: Floats, ways: tuple[tuple[str, str], ...] = GYROS) -> tuple[Floats, Floats]:
    """Average and opposed result (3,) of n gyroscopes with constant errors (n, 3), along their own axes."""
    axes = [
        Axis(name, "g", index, tuple(row), 1e3, 1.0)
        for name, way in ways
        for index, row in enumerate(pointing(way).tolist())
    ]
    frames = Frames(
        np.arange(2, dtype=np.int64) * 10_000_000, np.tile(errors.ravel(), (2, 1)), np.ones((2, errors.size), bool)
    )
    average, opposed = (TECHNIQUES[name](axes)(frames).triad_box[1] for name in ("mean", "opposed"))
    return average, opposed


def cost(ways: tuple[tuple[str, str], ...], draws: int, seed: int) -> float:
    """Rms of the opposed result over that of the average for independent errors of units, minus one."""
    rng = np.random.default_rng(seed)
    result = np.array([steady(rng.normal(size=(len(ways), 3)), ways) for _ in range(draws)])
    return float(np.sqrt((result[:, 1] ** 2).sum() / (result[:, 0] ** 2).sum())) - 1


@pytest.mark.slow
@pytest.mark.parametrize("against", [2, 3, 5])
def test_independent_errors_increase_by_less_than_one_percent(against: int) -> None:
    """One axis along and 2, 3 or 5 against: 3000 draws of independent errors determine the increase to 0.3 %."""
    ways = (("G0", "+X+Y+Z"), *((f"G{unit}", "-X-Y+Z") for unit in range(1, against)), ("G9", "-X-Y-Z"))
    assert -0.003 < cost(ways, 1000, 21) < 0.0125


def test_a_common_constant_error_is_removed() -> None:
    """1 + 2 axes with an error of 1 that differs by a hundredth: the average keeps a third."""
    own = 0.01 * np.random.default_rng(3).normal(size=(3, 3))
    average, opposed = steady(1 + own)
    assert np.abs(average) == pytest.approx([1 / 3] * 3, abs=0.03)
    assert np.abs(opposed).max() < 1 / 30


@pytest.mark.slow
def test_a_common_drift_is_removed_under_individual_biases(write_run: WriteRun) -> None:
    """Biases of 2 dps that differ from unit to unit stay as they are in the average; the drift of 1 dps is removed."""
    rng = np.random.default_rng(4)

    def biased(bias: Floats) -> Callable[[Floats], Floats]:
        return lambda seconds: temperatures(seconds) + bias

    parts = [part._replace(error=biased(rng.normal(0, 2, 3))) for part in gyros(temperatures, sigma=0.05)]
    moved = {}
    for name in ("mean", "opposed"):
        rows = fused_dps(write_run, parts, name, frames=12000, rate_hz=20.0)
        moved[name] = np.abs(rows[-1000:].mean(axis=0) - rows[:200].mean(axis=0))
    assert moved["mean"] == pytest.approx([0.95 / 3] * 3, rel=0.1)
    assert moved["opposed"].max() < 0.95 / 3 / 10


def test_results_do_not_depend_on_blocks() -> None:
    """Errors with nearly the same drift, 25 s at 10 Hz: one block, and blocks of 1, 7 and the rest."""
    rng = np.random.default_rng(5)
    time = np.arange(250, dtype=np.int64) * 100_000_000
    residual = np.linspace(0, 1, 250)[:, None] + 0.01 * rng.normal(size=(250, 3))
    valid = rng.random((250, 3)) > 0.1
    whole = CommonErrorEstimate(OpposingGroup((0,), (1, 2)), seconds=2.0).estimate(time, residual, valid)
    assert whole[-1] > 0.5
    for edges in (range(251), (0, 1, 8, 250), (0, 20, 21, 250)):
        mode = CommonErrorEstimate(OpposingGroup((0,), (1, 2)), seconds=2.0)
        parts = [mode.estimate(time[a:b], residual[a:b], valid[a:b]) for a, b in pairwise(edges)]
        assert np.concatenate(parts) == pytest.approx(whole, abs=1e-12)


def vibrating(seconds: Floats) -> Floats:
    """100 dps at 3 Hz about each axis, after a minute at rest."""
    shaken = np.where(seconds > 60, 100 * np.sin(2 * np.pi * 3 * seconds), 0.0)
    return np.outer(shaken, [1.0, 1.0, 1.0])


@pytest.mark.slow
def test_even_order_errors_of_a_design_cancel(write_run: WriteRun) -> None:
    """Every axis reads k u^2 too much: vibration shifts each by k U^2 / 2 = 1 dps, the average of 1 + 2 by a third."""
    parts = gyros(lambda seconds: 2e-4 * vibrating(seconds) ** 2, sigma=0.05)
    shift = {}
    for name in ("mean", "opposed"):
        rows = fused_dps(write_run, parts, name, frames=6000, rate_hz=20.0, rate=vibrating)
        shift[name] = np.abs((rows - vibrating(np.arange(6000) / 20))[-2000:].mean(axis=0))
    assert shift["mean"] == pytest.approx([1 / 3] * 3, rel=0.05)
    assert shift["opposed"].max() < 1 / 30


@pytest.mark.slow
def test_odd_order_errors_stay_as_in_the_average(write_run: WriteRun) -> None:
    """k u^3 changes its sign with the axis, like the truth: it is not observable, not cancelled and not increased."""

    def cubic(way: str) -> Callable[[Floats], Floats]:
        signs = pointing(way).sum(axis=1)
        return lambda seconds: 1e-5 * (signs * steady_turn(seconds)) ** 3

    def steady_turn(seconds: Floats) -> Floats:
        return np.outer(np.where(seconds > 60, 80.0, 0.0), [1.0, 1.0, 1.0])

    parts = [part._replace(error=cubic(part.axes)) for part in gyros(temperatures, sigma=0.0)]
    average, opposed = (
        fused_dps(write_run, parts, name, frames=6000, rate_hz=20.0, rate=steady_turn) for name in ("mean", "opposed")
    )
    off = np.abs(average - steady_turn(np.arange(6000) / 20))[-100:].mean(axis=0)
    assert off == pytest.approx([5.12] * 3, rel=0.01)
    assert opposed == pytest.approx(average, abs=1.01 / 100)  # a count: rounding is not an error of a design


def test_groups_are_unbalanced_opposed_axes_of_one_design() -> None:
    def triad(name: str, way: str, chip: str) -> list[Axis]:
        rows = pointing(way).tolist()
        return [Axis(name, chip, index, tuple(row), 1.0, None) for index, row in enumerate(rows)]

    axes = [
        *triad("A", "+X+Y+Z", "a"),
        *triad("B", "-X+Y-Z", "a"),
        *triad("C", "+X+Y-Z", "a"),
        *triad("D", "-X-Y+Z", "b"),
    ]
    # Design a: X has A.x and C.x (0, 6) against B.x (3); Y all along; Z has A.z (2) against B.z and C.z (5, 8).
    assert opposing_groups(axes) == [OpposingGroup((0, 6), (3,), "X"), OpposingGroup((2,), (5, 8), "Z")]
    assert opposing_groups(axes[:6]) == []  # one pair along X and Z


def test_the_smoother_is_a_mean_at_first_and_exponential_after() -> None:
    """10 rows to the time constant: a running mean of ten rows, then x' = x + (new - x) / 10, by hand."""
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(40, 2))
    result = Smoother(0.1, 2)(np.arange(40, dtype=np.int64) * 10_000_000, rows)
    state = np.zeros(2)
    for index, row in enumerate(rows):
        state = rows[: index + 1].mean(axis=0) if index < 10 else state + (row - state) / 10
        assert result[index] == pytest.approx(state)


@pytest.mark.parametrize("cuts", [(1,), (7,), (10,), (11, 12, 30), range(1, 60)])
def test_the_smoother_does_not_depend_on_blocks(cuts: Sequence[int]) -> None:
    rows = np.random.default_rng(2).normal(size=(60, 3))
    rows[[4, 5, 20, 31]] = np.nan
    time = np.arange(60, dtype=np.int64) * 10_000_000
    whole = Smoother(0.1, 3)(time, rows)
    parts = Smoother(0.1, 3)
    edges = (0, *cuts, 60)
    pieces = [parts(time[a:b], rows[a:b]) for a, b in pairwise(edges)]
    assert np.concatenate(pieces) == pytest.approx(whole)


def test_the_smoother_keeps_its_value_through_a_gap() -> None:
    rows = np.array([[1.0], [1.0], [np.nan], [np.nan], [1.0]])
    assert Smoother(0.02, 1)(np.arange(5, dtype=np.int64) * 10_000_000, rows).ravel() == pytest.approx([1.0] * 5)


def test_a_common_error_is_weighted_by_the_ratio_of_variances() -> None:
    """Three axes along and two against: their own errors have 2 + 1 degrees of freedom, and contribute 1/3 + 1/2 to the
    variance of the sum of both means. Squares of 6 are 2 each, so 5/3 in the sum; 600 are 360 times as much.
    """
    mode = CommonErrorEstimate(OpposingGroup((0, 1, 2), (3, 4)))
    own = [2.0, 2.0, 2.0, 0.0, 0.0]
    assert mode._trust(np.array([[600.0, *own], [5 / 3, *own], [0.0, *own]])) == pytest.approx([1 - 1 / 360, 0, 0])
