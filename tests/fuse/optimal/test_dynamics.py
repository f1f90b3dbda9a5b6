"""Uncertain times: covariances are wider, and less is learned."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.fuse.optimal import AxisErrors, ErrorModel, Optimal
from tests.fuse.optimal.conftest import FORCE, PERIOD_S, frames_of, times, triad

TIMING_S = 0.002


def test_a_steady_change_widens_the_covariance() -> None:
    """100 m/s3 along X for 2 ms is 0.2: the variance of one sensor of 0.01 becomes 0.05 along each axis, that of two
    sensors half of it. Its difference over 0.05 s has a noise of 2 * 0.01 / 0.05^2 per axis: 24 m2/s6 of 10 000.
    """
    ramp = np.outer(100.0 * times(200) * 1e-9, [1.0, 0, 0])
    rng = np.random.default_rng(106)
    for count in (1, 2):
        axes = [axis for index in range(count) for axis in triad(f"S{index}", np.eye(3))]
        model = ErrorModel({(axis.sensor, axis.index): AxisErrors(0.1, timing_s=TIMING_S) for axis in axes})
        values = np.tile(ramp, count) + 0.1 * rng.normal(size=(200, 3 * count))
        estimate = Optimal({FORCE: axes}, model, period_s=PERIOD_S)({FORCE: frames_of(values)})[FORCE]
        assert estimate.covariance_box[10:, :3].mean() == pytest.approx(0.05 / count, rel=0.01)
        still = Optimal({FORCE: axes}, model, period_s=PERIOD_S)({FORCE: frames_of(values - np.tile(ramp, count))})
        assert still[FORCE].covariance_box[10:, :3].mean() == pytest.approx(0.01 / count, rel=0.02)


def test_a_late_sensor_is_not_estimated_as_biased() -> None:
    """18.5 swings of 10 m/s2 in 20 s, the second sensor 20 ms late: its error is up to 1.2 m/s2, and 0.02 in the mean,
    where noise over 2000 frames gives 0.1 sqrt(2 / 2000) = 0.003. That is six standard deviations for a filter that
    assumes exact times.
    """
    seconds = times(2000)[:, None] * 1e-9
    axes = [axis for name in ("S0", "S1") for axis in triad(name, np.eye(3))]
    swings = [-10 * np.cos(2 * np.pi * 0.925 * (seconds - late)) * np.ones(3) for late in (0.0, 0.02)]
    values = np.concatenate(swings, axis=1) + 0.1 * np.random.default_rng(107).normal(size=(2000, 6))
    wrong = []
    for timing_s in (0.0, 0.02):
        errors = {
            (axis.sensor, axis.index): AxisErrors(0.1, bias=1.0 if axis.sensor == "S1" else 1e-6, timing_s=timing_s)
            for axis in axes
        }
        optimal = Optimal({FORCE: axes}, ErrorModel(errors), period_s=PERIOD_S, segment_s=0.2)
        optimal({FORCE: frames_of(values)})
        wrong.append(np.mean([(of.bias / of.sd) ** 2 for of in optimal.learned()[FORCE][3:]]))
    assert wrong[0] > 5**2
    assert wrong[1] < 2.5**2
