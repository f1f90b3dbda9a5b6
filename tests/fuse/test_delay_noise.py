"""The noise that the correction of delays adds, and the frames to which readings belong."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from imuarray.fuse.alignment import AlignedSensor, align
from imuarray.fuse.frames import Frames, matrices
from imuarray.fuse.least_squares import AxisNoise, whole_gain
from imuarray.log import Block
from tests.fuse.conftest import Floats, Part, calibration, pointing

PARTS = (
    Part("A", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 100.0),
    Part("B", "-Y-X-Z", "angular_rate", "l3g4200d", 250.0, 100.0),
)
NOISE = np.repeat([0.7, 1.3], 3)
ROWS = np.concatenate([pointing(part.axes) for part in PARTS])
INNER = slice(40, -40)
RNG = np.random.default_rng(2)

# Periods (ms), and readings of B after those of A (ms): in alternating order, at different rates, and at random times.
GRIDS = {
    "regular": (np.full(200, 3.0), np.full(201, 0.8)),
    "alternating order": (np.resize([3.3, 2.7], 200), np.resize([0.3, -0.7], 201)),
    "far apart": (np.resize([2.3, 1.7], 200), np.full(201, -0.8)),
    "random": (3 + 0.25 * np.random.default_rng(1).uniform(-1, 1, 200), np.full(201, 0.5)),
}


def aligned_noise(grid_ns: Floats, late_ns: Floats, present: Floats) -> tuple[Floats, Frames]:
    """The weights (n, n, 2), of the readings of both sensors in all frames, of the mean along one axis in each frame,
    and the frames.
    """
    known = calibration(PARTS).sensors
    units = [AlignedSensor(known[part.name], 30000.0) for part in PARTS]
    times = [grid_ns, (grid_ns + late_ns)[present > 0]]
    blocks = [
        Block(
            time.astype(np.int64), RNG.integers(-9, 9, (len(time), 3)).astype(np.int16), np.zeros(len(time), np.uint16)
        )
        for time in times
    ]
    frames = align(units, blocks, grid_ns.astype(np.int64), 3e6, ROWS)
    shares = np.stack([np.ones(len(grid_ns)), present], axis=1)
    shares /= shares.sum(axis=1, keepdims=True)
    seconds = grid_ns * 1e-9
    delay = (shares[:, 1] * late_ns) * 1e-9  # of the mean
    spline = CubicSpline(seconds, np.eye(len(seconds)))
    second = 0.375 * (1 - 1 / np.sqrt(3)) * delay
    slope = spline(seconds, 1) - second[:, None] * spline(seconds, 2)
    weights = np.eye(len(seconds)) - delay[:, None] * slope
    return weights[:, :, None] * shares, frames


@pytest.mark.parametrize("case", GRIDS)
def test_the_covariance_of_the_mean_includes_the_noise_of_delays(case: str) -> None:
    """Compared with the weights of every reading by SciPy's spline: variances to 1.5 % of the noise, on average to 0.3
    %, where the correction changes some of them by up to 30 %.
    """
    steps, late = GRIDS[case]
    grid_ns = np.round(1e6 * np.concatenate([[0.0], np.cumsum(steps)]))
    weights, frames = aligned_noise(grid_ns, np.round(1e6 * late), np.ones(len(grid_ns)))
    equal = AxisNoise(ROWS, np.ones(6), frames.delay_noise)
    stated = matrices(equal.covariance(whole_gain(np.ones(6), ROWS)[None], np.ones((1, 6), bool)))[INNER]
    expected = (weights**2).sum(axis=(1, 2))[INNER]
    for axis in range(3):
        assert stated[:, axis, axis] == pytest.approx(expected, abs=0.0075)
        assert stated[:, axis, axis].mean() == pytest.approx(expected.mean(), abs=0.0015)
    assert np.abs(stated[:, 0, 1]).max() < 1e-9


def test_the_noise_of_delays_with_weights_by_inverse_variance() -> None:
    """Inverse variances: the mean of the readings of two sensors with different noise, whose delay is corrected by the
    plain mean.
    """
    steps, late = GRIDS["far apart"]
    grid_ns = np.round(1e6 * np.concatenate([[0.0], np.cumsum(steps)]))
    plain, frames = aligned_noise(grid_ns, np.round(1e6 * late), np.ones(len(grid_ns)))
    noise = AxisNoise(ROWS, NOISE, frames.delay_noise)
    stated = noise.covariance(whole_gain(NOISE**-2, ROWS)[None], np.ones((1, 6), bool))[INNER, 0]
    count, best = len(grid_ns), NOISE[[0, 3]] ** -2 / (NOISE[[0, 3]] ** -2).sum()
    delay = 1e-9 * np.round(1e6 * late) / 2
    correction = (np.eye(count) - plain.sum(axis=2)) / delay[:, None]  # the slope's weights
    weights = np.eye(count)[:, :, None] * best - (2 * best[1] * delay)[:, None, None] * correction[:, :, None] / 2
    expected = (weights**2 * NOISE[[0, 3]] ** 2).sum(axis=(1, 2))[INNER]
    assert stated == pytest.approx(expected, abs=0.01)
    assert np.ptp(expected) > 0.04


def test_the_noise_of_delays_in_frames_that_lack_a_sensor() -> None:
    """The slower sensor is in two of three frames; the means of neighbouring frames have more noise."""
    count = 201
    grid_ns, present = 3e6 * np.arange(count), np.resize([1.0, 0.0, 1.0], count)
    late = np.round(1e6 * np.resize([1.0, 0.0, -1.0], count))
    weights, frames = aligned_noise(grid_ns, late, present)
    equal = AxisNoise(ROWS, np.ones(6), frames.delay_noise)
    gains = np.stack([whole_gain(np.repeat([1.0, each], 3), ROWS) for each in present])
    stated = equal.covariance(gains, gains.any(axis=1))[INNER, 0]
    assert stated == pytest.approx((weights**2).sum(axis=(1, 2))[INNER], abs=0.01)


def test_a_reading_belongs_to_the_nearest_frame_only() -> None:
    """Frames 2.7 and 3.3 ms apart: a reading between two near frames is within half a period of both."""
    known = calibration(PARTS).sensors
    units = [AlignedSensor(known[part.name], 30000.0) for part in PARTS]
    grid = np.cumsum(np.resize([3_300_000, 2_700_000], 60))
    between = grid[1:-1:2] - 1_300_000  # 1.4 ms after the previous frame, 1.3 ms before the next frame
    blocks = [
        Block(time, np.ones((len(time), 3), np.int16), np.zeros(len(time), np.uint16)) for time in (grid, between)
    ]
    frames = align(units, blocks, grid, 3e6, ROWS)
    assert frames.valid[:, :3].all()
    assert frames.valid[:, 3].sum() == len(between)
    assert frames.valid[1:-1:2, 3].all()


def test_the_age_of_a_reading() -> None:
    """Half a conversion of 10 ms and the delay of the filter; of one conversion per frame the delay alone."""
    unit = AlignedSensor(calibration(PARTS).sensors[PARTS[0].name], 30000.0, conversion_s=0.01, delay_s=0.003)
    assert unit.age_s(0.02) == pytest.approx(0.008)
    assert unit.age_s(0.01) == pytest.approx(0.003)
