"""The compiled part of `optimal` against NumPy, for every frame."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import pytest

from imuarray.fuse.frames import Axis, Frames
from imuarray.fuse.optimal import AxisErrors, DesignErrors, ErrorModel, Optimal, compiled
from tests.fuse.optimal.conftest import FORCE, PERIOD_S, Floats, blocks_of, times, triad
from tests.selection import some

RATE = "angular_rate"
COUNT = 900
PLACES = [(0.02, 0.0, 0.01), (-0.03, 0.02, 0.0), (0.0, -0.04, 0.01), (0.01, 0.02, -0.03)]
CASES = ("noise alone", "responses", "uncertain times", "away from the origin")

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("imuarray.fuse.optimal._segments") is None, reason="installed without a C compiler"
)


def array_of(case: str) -> tuple[dict[str, list[Axis]], ErrorModel]:
    """Four accelerometers turned differently and two gyroscopes."""
    turned = np.linalg.qr(np.random.default_rng(5).normal(size=(4, 3, 3)))[0]
    force = [
        axis
        for index, place in enumerate(PLACES)
        for axis in triad(
            f"S{index}",
            turned[index],
            position_m=place if case == "away from the origin" else (0.0, 0.0, 0.0),
            range_si=40.0,
        )
    ]
    rate = [axis for index in (4, 5) for axis in triad(f"S{index}", np.eye(3), "g", noise_si=0.01)]
    errors = {
        (axis.sensor, axis.index): AxisErrors(
            axis.noise_si or 0.0,
            bias=0.2,
            drift=0.1,
            drift_time_constant_s=2.0,
            response=0.01 if case == "responses" else 0.0,
            timing_s=0.001 if case == "uncertain times" else 0.0,
        )
        for axis in [*force, *rate]
    }
    return {FORCE: force, RATE: rate}, ErrorModel(errors, {("a", 0): DesignErrors(0.1, 3.0, 0.0)})


def readings_of(axes: dict[str, list[Axis]]) -> dict[str, Frames]:
    """A shaking; one sensor is missing for a while, frames are lost, and a reading is near the end of its range."""
    rng = np.random.default_rng(6)
    time = np.delete(times(COUNT + 60), slice(500, 560))
    frames = {}
    for quantity, its in axes.items():
        size = 8.0 if quantity == FORCE else 0.5
        truth = size * np.sin(2 * np.pi * np.outer(time * 1e-9, [1.0, 0.7, 0.4]))
        values = truth @ np.array([axis.direction_box for axis in its]).T + 0.1 * rng.normal(size=(COUNT, len(its)))
        values[700, 0] = 39.0 if quantity == FORCE else values[700, 0]
        valid = np.ones(values.shape, bool)
        valid[350:420, 3:6] = False
        frames[quantity] = Frames(time, values, valid)
    return frames


def fused(case: str, smoothed: bool) -> dict[str, Floats]:
    """Triads, covariances and the axes in use, of blocks whose ends are not ends of segments."""
    axes, model = array_of(case)
    frames = readings_of(axes)
    optimal = Optimal(axes, model, period_s=PERIOD_S, segment_s=0.2)
    if smoothed:
        results = [estimates for _, estimates in optimal.smoothed(lambda: blocks_of(frames, 70, {}))]
    else:
        results = [optimal(*block) for block in blocks_of(frames, 70, {})]
    return {
        quantity: np.concatenate(
            [
                np.hstack([block[quantity].triad_box, block[quantity].covariance_box, block[quantity].used])
                for block in results
            ]
        )
        for quantity in axes
    }


@pytest.mark.parametrize("smoothed", [False, True])
@pytest.mark.parametrize("case", some(CASES, 1))
def test_compiled_segments_equal_those_of_numpy(case: str, smoothed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[int] = []
    frames = compiled.frames

    def counted(arrays: tuple[Any, ...], sizes: tuple[int, ...], *more: Any) -> tuple[int, float]:
        result = frames(arrays, sizes, *more)
        done.append(sizes[0] if result[0] else 0)
        return result

    with monkeypatch.context() as patch:
        patch.setattr(compiled, "frames", counted)
        ours = fused(case, smoothed)
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "begin", lambda *_: -1.0)
        patch.setattr(compiled, "frames", None)
        theirs = fused(case, smoothed)
    assert sum(done) > 0.5 * 2 * COUNT
    for quantity, wanted in theirs.items():
        np.testing.assert_allclose(ours[quantity], wanted, rtol=1e-9, atol=1e-11, err_msg=quantity)


def test_compiled_segments_refuse_arrays_of_another_size() -> None:
    arrays = tuple(np.zeros(1) for _ in range(8))
    with pytest.raises(ValueError, match="array 0: 72 bytes are required"):
        compiled.begin(arrays, (3, 3, 1), False, 0.0, 0.1)
    with pytest.raises(ValueError, match="another number of arrays"):
        compiled.begin(arrays[1:], (3, 3, 1), False, 0.0, 0.1)
    assert compiled.begin(arrays, (3, 4, 1), False, 0.0, 0.1) == -1.0  # NumPy is used
    with pytest.raises(ValueError, match="array 0: 240 bytes are required"):
        compiled.frames((*arrays, *arrays[:3]), (10, 3, 3, 1, 5), False, 1.0, 0.0, 0.0)
    assert compiled.frames((*arrays, *arrays[:3]), (10, 3, 3, 2, 5), False, 1.0, 0.0, 0.0) == (0, 0.0)
