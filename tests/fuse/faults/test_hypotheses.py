"""The suspected sensor where several sensors differ at once."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.arrays import Floats
from imuarray.fuse.faults.hypotheses import disagreement, strongest, unresolved_motion
from imuarray.fuse.faults.window import DecisionWindow, NormalModel, Spaces, WindowResiduals, window_residuals
from tests.selection import some

FRAMES = 6
PERIOD_S = 0.016
SIGMA = 9.80665e-3 * np.array([[3.4, 3.4, 4.7]] * 3 + [[12.2, 5.0, 4.7]] + [[3.4, 3.4, 4.7]] * 4).ravel()
"""Noise of the axes of eight MPU-9150 at rest, m/s2, as recorded; the fourth has a line on its x axis."""

KNOCK = np.array(
    [
        [-3.1, 3.6, 4.0, 1.3, -3.0, 2.0, 1.8, -13.8],
        [-7.1, 1.8, -3.6, -2.7, -0.9, 5.5, 4.2, -6.3],
        [-3.8, 0.4, 3.2, -5.8, -2.1, 4.5, 1.9, -0.3],
    ]
)
"""Residuals of x, y and z of eight chips in the one frame of a knock, in standard deviations, as recorded (experiment 6
of the MIMU4444 board, 397.15 s)."""


def window_of(off: Floats) -> tuple[WindowResiduals, NormalModel]:
    """A window of a box at rest in whose second frame axes are `off` (24,) standard deviations, as seen by the normal
    model of the half minute of noise before it.
    """
    rng = np.random.default_rng(1)
    rows, every = np.tile(np.eye(3), (8, 1)), np.ones(24, bool)
    normal, spaces = NormalModel(SIGMA, "specific_force", FRAMES, PERIOD_S), Spaces(rows)
    time = (np.arange(FRAMES) * PERIOD_S * 1e9).astype(np.int64)
    present = np.ones((FRAMES, 24), bool)
    for _ in range(300):
        values = np.tile([0.0, 0.0, 9.8], 8) + rng.normal(0, SIGMA, present.shape)
        seen = window_residuals(DecisionWindow(time, values, present, None), normal, rows, every, spaces)
        assert seen is not None
        normal.age(every)
        normal.learn(seen.regressors, seen.residual, every)
        normal.learn_noise(
            seen.residual, seen.means, seen.white.matrix.diagonal() * normal.variance, seen.counts, every
        )
    values[1] = np.tile([0.0, 0.0, 9.8], 8) + off * SIGMA
    last = window_residuals(DecisionWindow(time, values, present, None), normal, rows, every, spaces)
    assert last is not None
    return last, normal


def test_a_knock_within_one_frame_is_not_a_fault() -> None:
    """The chip that differs most would be blamed if the others agreed, and is not, since most differ in that frame."""
    seen, normal = window_of(KNOCK.T.ravel())
    suspect = strongest(seen, normal)
    assert suspect is not None and suspect.axes[0] // 3 == 7
    assert strongest(seen, normal, disagreement(seen, normal)) is None


@pytest.mark.parametrize("sensor", some([0, 3, 7], 1))
def test_a_single_wrong_reading_is_a_fault_of_its_sensor(sensor: int) -> None:
    """All others have noise only."""
    off = np.zeros((8, 3))
    off[sensor, 1] = 30.0
    seen, normal = window_of(off.ravel())
    assert disagreement(seen, normal) == 0
    suspect = strongest(seen, normal)
    assert suspect is not None and suspect.axes == (3 * sensor + 1,) and suspect.rivals == ()


def shaken_variance(frequency_hz: float, period_s: float, peak: float = 100.0) -> float:
    """`unresolved_motion` along x of eight sensors that agree, over many periods of a sine."""
    frames = 2000
    rows, every = np.tile(np.eye(3), (8, 1)), np.ones(24, bool)
    time = (np.arange(frames) * period_s * 1e9).astype(np.int64)
    motion = peak * np.sin(2 * np.pi * frequency_hz * time * 1e-9)
    values = motion[:, None] * np.tile([1.0, 0.0, 0.0], 8) + np.random.default_rng(3).normal(0, SIGMA, (frames, 24))
    window = DecisionWindow(time, values, np.ones((frames, 24), bool), None)
    normal = NormalModel(SIGMA, "specific_force", frames, period_s)
    seen = window_residuals(window, normal, rows, every, Spaces(rows))
    assert seen is not None
    return unresolved_motion(window, seen)


@pytest.mark.parametrize("share", [0.2, 0.31, 0.45])
def test_motion_too_fast_for_the_rows_is_not_a_fault(share: float) -> None:
    """Delays of 3 ms (DELAY_S) give an error of at most 0.003 * 2 pi f * 100 for a sine of peak 100 and frequency f;
    the allowance is at least that and at most pi / 2 times that (closed form: pi / 2 sin(pi f T) / (pi f T), f T <
    1/2).
    """
    allowed = np.sqrt(2 * shaken_variance(share / 0.1, 0.1)) / (0.003 * 2 * np.pi * (share / 0.1) * 100)
    assert allowed == pytest.approx(np.sin(np.pi * share) / (2 * share), rel=0.01)
    assert 1 <= allowed <= np.pi / 2


def test_motion_that_the_rows_resolve_has_no_allowance() -> None:
    """Below a sixth of the rate of rows, in fast rows, and at rest, where there is noise only."""
    assert shaken_variance(0.15 / 0.1, 0.1) == 0
    assert shaken_variance(0.3 / 0.02, 0.02) == 0
    assert shaken_variance(3.0, 0.1, peak=0.0) == 0
