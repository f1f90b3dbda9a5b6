"""The learnt normal model: errors of calibration, delays, the colour of noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from imuarray.arrays import Floats
from imuarray.fuse.faults.window import DecisionWindow, NormalModel, Spaces, window_residuals

ROWS = np.tile(np.eye(3), (3, 1))
PERIOD_S = 0.01


def learnt(values: Floats, sigma: float = 0.02, window: int = 10) -> NormalModel:
    """The normal model after all of `values` (n, 9)."""
    normal = NormalModel(np.full(9, sigma), "specific_force", window, PERIOD_S)
    normal.begin((np.diff(values[:window], axis=0) ** 2).mean(axis=0))
    spaces, every = Spaces(ROWS), np.ones(9, bool)
    time = np.arange(len(values)) * int(PERIOD_S * 1e9)
    for start in range(0, len(values) - window + 1, window):
        part = slice(start, start + window)
        normal.age(every)
        seen = window_residuals(
            DecisionWindow(time[part], values[part], np.ones((window, 9), bool), None), normal, ROWS, every, spaces
        )
        assert seen is not None
        normal.learn(seen.regressors, seen.residual, every)
        share = seen.white.matrix.diagonal() * normal.variance
        normal.learn_noise(seen.residual, seen.means, share, seen.counts, every)
    return normal


@pytest.mark.slow
def test_errors_of_calibration_are_learnt_in_motion() -> None:
    """One of three triads: 0.3 m/s2 of bias on x, 3 % too much on y, z 4 ms late. Only differences between the three
    are observable: two thirds of each error for this triad, a third with the other sign for the others.
    """
    rng = np.random.default_rng(2)
    seconds = np.arange(6000) * PERIOD_S
    hertz = np.array([1.1, 1.7, 2.3])
    truth = 20 * np.sin(2 * np.pi * np.outer(seconds, hertz))
    late = 20 * np.sin(2 * np.pi * np.outer(seconds - 0.004, hertz))
    values = np.tile(truth, 3) + rng.normal(0, 0.02, (6000, 9))
    values[:, 0] += 0.3
    values[:, 1] += 0.03 * truth[:, 1]
    values[:, 2] += late[:, 2] - truth[:, 2]
    state = learnt(values).state
    assert state[0, 0] == pytest.approx(0.2, abs=0.02)
    assert state[1, 2] == pytest.approx(0.02, abs=0.001)
    assert state[2, 4] == pytest.approx(-0.004 * 2 / 3, abs=0.0003)
    assert state[5, 4] == pytest.approx(0.004 / 3, abs=0.0003)


def test_jerks_are_not_learnt_as_errors_of_calibration() -> None:
    """Three perfect triads that are shaken at 6 Hz (750 m/s3); every reading is up to a conversion of 1/800 s older
    than assumed, which is 47 times the noise. Errors of learnt responses and delays agree with their variances: the
    mean of the 36 squares over their variances is below 1 + 4 sqrt(2 / 36).
    """
    rng = np.random.default_rng(5)
    seconds = np.arange(3000) * PERIOD_S
    age_s = rng.uniform(-0.5, 0.5, (3000, 3)) / 800
    hertz, phase = np.array([5.3, 6.1, 6.7]), np.array([0.3, 1.1, 2.0])
    values = np.concatenate(
        [20 * np.sin(2 * np.pi * np.outer(seconds - age_s[:, triad], hertz) + phase) for triad in range(3)], axis=1
    )
    normal = learnt(values + rng.normal(0, 0.02, values.shape))
    variances = np.einsum("mii->mi", normal.covariance)
    assert (normal.state[:, 1:] ** 2 / variances[:, 1:]).mean() < 1 + 4 * np.sqrt(2 / 36)
    assert np.sqrt(variances[:, 1:4]).max() < 0.002  # of a prior of 0.04


def test_axes_without_a_change_use_the_noise_of_the_others() -> None:
    """Six of nine axes are stuck and one is nearly stuck: the usual change is that of the changing axes."""
    normal = NormalModel(np.full(9, np.nan), "specific_force", 10, PERIOD_S)
    normal.begin(np.array([0.0] * 6 + [1e-6, 4.0, 4.0]))
    assert not normal.begun
    assert normal.variance.tolist() == [4.0] * 9
    assert normal.change.tolist() == [8.0] * 9
    normal.begin(np.full(9, 1.0))
    assert normal.begun
    assert normal.variance.tolist() == [1.0] * 7 + [4.0, 4.0]


@pytest.mark.slow
def test_the_colour_of_noise_is_estimated() -> None:
    """An AR(1) process of correlation p = 0.7: the mean of n = 10 readings scatters (1 + p) / (1 - p) - 2 p (1 - p^n) /
    (n (1 - p)^2) = 5.667 - 1.512 = 4.155 times as much as that of white ones. Change from window to window shows that
    less the covariance of neighbours, p (1 - p^n)^2 / (n (1 - p)^2) = 0.735.
    """
    rng = np.random.default_rng(4)
    white = rng.normal(0, 0.02 * np.sqrt(1 - 0.7**2), (30000, 9))
    noise = lfilter([1.0], [1.0, -0.7], white, axis=0)
    assert learnt(noise).colour.mean() == pytest.approx(4.155 - 0.735, rel=0.15)


@pytest.mark.slow
def test_white_noise_has_no_colour() -> None:
    noise = np.random.default_rng(4).normal(0, 0.02, (10000, 9))
    assert learnt(noise).colour.mean() < 1.3


def test_unmeasured_noise_is_learnt() -> None:
    """Of 50 windows of 10 readings: known to 5 % and better, so to 25 % at five standard deviations."""
    sigma = np.array([0.02, 0.03, 0.05, 0.03, 0.02, 0.05, 0.04, 0.02, 0.03])
    noise = np.random.default_rng(6).normal(0, sigma, (2000, 9))
    result = np.sqrt(learnt(noise, sigma=np.nan).variance)
    assert np.median(result / sigma) == pytest.approx(1.0, abs=0.1)
    assert np.abs(np.log(result / sigma)).max() < np.log(1.5)
