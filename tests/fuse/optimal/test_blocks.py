"""Results do not depend on blocks; missing, stale and wrong readings do no harm."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imuarray.fuse.frames import Axis, Frames, matrices
from imuarray.fuse.optimal import AxisErrors, DesignErrors, ErrorModel, Optimal
from imuarray.fuse.optimal import filter as spooled
from tests.fuse.optimal.conftest import FORCE, PERIOD_S, blocks_of, frames_of, model_of, times, triad

RATE = "angular_rate"
COUNT = 450


def whole() -> tuple[dict[str, list[Axis]], ErrorModel]:
    """Four accelerometers away from the origin, one of a narrow range, and two gyroscopes; every kind of error."""
    places = [(0.02, 0.0, 0.01), (-0.03, 0.02, 0.0), (0.0, -0.04, 0.01), (0.01, 0.02, -0.03)]
    force = [
        axis
        for index, place in enumerate(places)
        for axis in triad(
            f"S{index}",
            np.diag([1.0, -1, -1]) if index % 2 else np.eye(3),
            position_m=place,
            range_si=14.0 if index == 3 else 1e3,
        )
    ]
    rate = [axis for index in (4, 5) for axis in triad(f"S{index}", np.eye(3), "g", noise_si=0.01)]
    errors = {
        (axis.sensor, axis.index): AxisErrors(axis.noise_si or 0.0, 0.2, 0.1, 0.05, 2.0, 0.01, 0.01, None, 0.001)
        for axis in [*force, *rate]
    }
    designs = {(chip, index): DesignErrors(0.1, 3.0, 0.01) for chip in "ag" for index in range(3)}
    return {FORCE: force, RATE: rate}, ErrorModel(errors, designs)


def readings(
    axes: dict[str, list[Axis]],
) -> tuple[dict[str, Frames], dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]]:
    """A shaking that sometimes clips the narrow sensor, with gaps, stale readings and unusual temperatures."""
    rng = np.random.default_rng(102)
    time = np.delete(times(COUNT + 60), slice(300, 360))
    frames = {}
    for quantity, its in axes.items():
        truth = 8 * np.sin(2 * np.pi * np.outer(time * 1e-9, [1.0, 0.7, 0.4])) * (1.0 if quantity == FORCE else 0.3)
        values = truth @ np.array([axis.direction_box for axis in its]).T + 0.1 * rng.normal(size=(COUNT, len(its)))
        values[40, 1] = np.nan
        valid = np.repeat(rng.random((COUNT, len(its) // 3)) > 0.02, 3, axis=1) & np.isfinite(values)
        valid[200:203] = False
        stale = np.repeat(rng.random((COUNT, len(its) // 3)) > 0.95, 3, axis=1)
        clipped = np.zeros(values.shape, np.int8)
        if quantity == FORCE:
            clipped[:, 9:] = (values[:, 9:] > 7.8).astype(np.int8) - (values[:, 9:] < -7.8)
        frames[quantity] = Frames(time, values, valid & (clipped == 0), clipped, stale)
    degc = {"S0": np.linspace(20.0, 30.0, COUNT), "S4": np.full(COUNT, 21.0)}
    degc["S0"][100:150] = np.nan
    return frames, degc


def run(size: int, smoothed: bool) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Triads and covariances of both quantities, fed `size` frames at a time."""
    axes, model = whole()
    frames, degc = readings(axes)
    optimal = Optimal(axes, model, period_s=PERIOD_S, segment_s=0.2)
    if smoothed:
        found = [estimates for _, estimates in optimal.smoothed(lambda: blocks_of(frames, size, degc))]
    else:
        found = [optimal(*block) for block in blocks_of(frames, size, degc)]
    return {
        quantity: np.concatenate(
            [np.hstack([one[quantity].triad_box, one[quantity].covariance_box, one[quantity].used]) for one in found]
        )
        for quantity in axes
    }


@pytest.mark.slow
@pytest.mark.parametrize("smoothed", [False, True])
def test_results_do_not_depend_on_blocks(smoothed: bool) -> None:
    """Frame by frame, in blocks of 97, and all at once."""
    once = run(COUNT, smoothed)
    for size in (1, 97):
        parts = run(size, smoothed)
        for quantity, rows in once.items():
            assert (np.isnan(parts[quantity]) == np.isnan(rows)).all()
            assert np.nanmax(np.abs(parts[quantity] - rows)) < 1e-9
            assert np.isnan(rows[200:203, :9]).all()
            assert np.isfinite(np.delete(rows, slice(200, 203), axis=0)).mean() > 0.99


@pytest.mark.slow
def test_a_log_may_be_smoothed_twice() -> None:
    axes, model = whole()
    frames, degc = readings(axes)
    optimal = Optimal(axes, model, period_s=PERIOD_S)
    optimal(frames, degc)
    results = [
        np.concatenate(
            [estimates[FORCE].triad_box for _, estimates in optimal.smoothed(lambda: blocks_of(frames, 200, degc))]
        )
        for _ in range(2)
    ]
    assert np.nanmax(np.abs(results[0] - results[1])) == 0.0


@pytest.mark.slow
def test_a_smoother_closed_early_closes_its_files() -> None:
    axes, model = whole()
    frames, degc = readings(axes)
    optimal = Optimal(axes, model, period_s=PERIOD_S)
    before = len(list(Path("/proc/self/fd").iterdir()))
    results = optimal.smoothed(lambda: blocks_of(frames, 100, degc))
    next(results)
    assert len(list(Path("/proc/self/fd").iterdir())) == before + 4
    results.close()  # type: ignore[attr-defined]
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_no_frames_give_no_estimates() -> None:
    axes, model = whole()
    frames, degc = readings(axes)
    optimal = Optimal(axes, model, period_s=PERIOD_S)
    nothing = {quantity: Frames(its.time[:0], its.values[:0], its.valid[:0]) for quantity, its in frames.items()}
    assert optimal(nothing)[FORCE].triad_box.shape == (0, 3)
    optimal(frames, degc)
    assert optimal(nothing)[RATE].covariance_box.shape == (0, 6)


def test_axes_that_do_not_span_space_give_no_estimate() -> None:
    axes = [*triad("S0", np.eye(3)), *triad("S1", np.diag([1.0, -1, -1]))]
    valid = np.ones((4, 6), bool)
    valid[1, [2, 5]] = False  # no axis along Z
    valid[2] = False
    valid[3, :3] = False
    estimate = Optimal({FORCE: axes}, model_of(axes, bias=0.1), period_s=PERIOD_S)(
        {FORCE: frames_of(np.tile([1.0, 1, 1, 1, -1, -1], (4, 1)), valid)}
    )[FORCE]
    assert np.isnan(estimate.triad_box).all(axis=1).tolist() == [False, True, True, False]
    assert np.isnan(estimate.covariance_box).all(axis=1).tolist() == [False, True, True, False]
    assert estimate.used.sum(axis=1).tolist() == [6, 0, 0, 3]
    assert estimate.triad_box[3] == pytest.approx([1.0] * 3, abs=1e-9)


def test_stale_readings_are_used_only_where_they_are_needed() -> None:
    axes = [*triad("S0", np.eye(3)), *triad("S1", np.eye(3))]
    stale = np.zeros((3, 6), bool)
    stale[1, 3:] = True
    stale[2] = True
    values = np.repeat([[1.0, 3.0]], 3, axis=1).repeat(3, axis=0)
    estimate = Optimal({FORCE: axes}, model_of(axes), period_s=PERIOD_S)({FORCE: frames_of(values, stale=stale)})[FORCE]
    assert estimate.used.sum(axis=1).tolist() == [6, 3, 6]
    assert estimate.triad_box == pytest.approx(np.array([[2.0] * 3, [1.0] * 3, [2.0] * 3]))


def test_a_learned_bias_remains_after_the_loss_of_sensors() -> None:
    """In the first half of the run all three sensors determine the bias of 1 of S2; then it is alone, and correct to
    0.02.
    """
    rng = np.random.default_rng(103)
    axes = [axis for name in ("S0", "S1", "S2") for axis in triad(name, np.eye(3))]
    errors = {(axis.sensor, axis.index): AxisErrors(0.1, bias=2.0 if axis.sensor == "S2" else 1e-4) for axis in axes}
    values = 0.1 * rng.normal(size=(4000, 9)) + np.repeat([0.0, 0.0, 1.0], 3)
    valid = np.ones(values.shape, bool)
    valid[2000:, :6] = False
    estimate = Optimal({FORCE: axes}, ErrorModel(errors), period_s=PERIOD_S)({FORCE: frames_of(values, valid)})[FORCE]
    assert np.abs(estimate.triad_box[2000:].mean(axis=0)).max() < 0.02
    # Noise of one sensor, and the uncertainty after 2000 frames
    assert matrices(estimate.covariance_box)[-1].diagonal() == pytest.approx([0.01] * 3, rel=0.01)


@pytest.mark.slow
def test_memory_of_smoothing_does_not_grow_with_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    """The peak of Python's and numpy's own memory, of 48 s and of 120 s: 1200 and 3000 segments, of which both spools
    keep the last eighth of a megabyte, less than the segments of either need.
    """
    monkeypatch.setattr(spooled, "_HELD_BYTES", 1 << 17)
    axes, model = whole()
    peaks = []
    for blocks in (16, 40):
        optimal = Optimal({RATE: axes[RATE]}, model, period_s=PERIOD_S, segment_s=4 * PERIOD_S)

        def log(count: int = blocks) -> Iterator[tuple[dict[str, Frames], None]]:
            for block in range(count):
                yield (
                    {RATE: Frames(times(300) + block * 3_000_000_000, np.zeros((300, 6)), np.ones((300, 6), bool))},
                    None,
                )

        tracemalloc.start()
        for _ in optimal.smoothed(log):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]
