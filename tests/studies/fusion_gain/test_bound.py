"""The bound against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import FusionError
from imuarray.studies.fusion_gain.cramer_rao import (
    BoundStretch,
    ErrorLaw,
    SlowError,
    StretchReadings,
    bound,
    frame_weights,
)
from tests.selection import examples

MG = 9.80665e-3


def triads(noise: list[float], slow: tuple[SlowError, ...] = ()) -> ErrorLaw:
    """Sensors whose three axes are along those of the box, each with one noise."""
    return ErrorLaw(np.tile(np.eye(3), (len(noise), 1)), np.repeat(noise, 3), slow)


def stretches(
    law: ErrorLaw, times_s: list[float], frames: int = 100, degc: list[float] | None = None
) -> list[BoundStretch]:
    everything = np.ones(len(law.noise_si), bool)
    warm = degc or [25.0] * len(times_s)
    return [BoundStretch(t, (StretchReadings(everything, frames),), T) for t, T in zip(times_s, warm, strict=True)]


def on(axis: int, rms: float, law: ErrorLaw, **kind: float) -> SlowError:
    return SlowError(rms * np.eye(len(law.noise_si))[axis], **kind)


@pytest.mark.parametrize("count", [1, 2, 9])
def test_the_bound_of_equal_axes_with_white_noise(count: int) -> None:
    """sigma / sqrt(n), for any number of frames."""
    law = triads([0.3] * count)
    result = bound(law, stretches(law, [0.0, 5.0], frames=7))
    assert result.causal_rms == pytest.approx([0.3 / np.sqrt(count)] * 3)
    assert result.smoothed_rms == pytest.approx([0.3 / np.sqrt(count)] * 3)


def test_the_bound_of_two_ranges_is_that_of_inverse_variance() -> None:
    """Table 10: 9.53 mg at 1.5 g and 17.05 mg at 16 g; by inverse variance 1 / sqrt(1 / 9.53^2 + 1 / 17.05^2)."""
    law = triads([9.53 * MG, 17.05 * MG])
    assert bound(law, stretches(law, [0.0])).causal_rms / MG == pytest.approx([8.319] * 3, abs=0.001)


def test_the_bound_of_perpendicular_boards() -> None:
    """z of one board along X, that of the other along Z: 25 mg in plane and 47 mg out of it, one of each on X and Z."""
    first, second = np.eye(3), np.array([[0, 0, 1.0], [0, 1, 0], [1, 0, 0]])
    noise = np.array([25.0, 25.0, 47.0] * 2)
    mixed = 1 / np.sqrt(1 / 25**2 + 1 / 47**2)
    law = ErrorLaw(np.concatenate([first, second]), noise)
    assert bound(law, stretches(law, [0.0])).causal_rms == pytest.approx([mixed, 25 / np.sqrt(2), mixed])


def test_the_bound_with_a_constant_error_of_one_of_two_sensors() -> None:
    """By hand: the difference of two equal axes determines a constant b ~ N(0, 1) with noise 2 s^2 / n; half of its
    remainder is in the mean, in addition to s^2 / 2.
    """
    law = triads([0.5, 0.5])
    law = triads([0.5, 0.5], (on(0, 1.0, law),))
    result = bound(law, stretches(law, [0.0, 1.0], frames=10))
    left = [1 / (1 + frames / (2 * 0.5**2)) for frames in (10, 20)]
    assert result.causal[:, 0, 0] == pytest.approx([0.125 + part / 4 for part in left])
    assert result.smoothed[:, 0, 0] == pytest.approx([0.125 + left[1] / 4] * 2)
    assert result.causal[:, 1, 1] == pytest.approx([0.125] * 2)


def test_the_bound_with_gauss_markov_errors_of_two_sensors() -> None:
    """Two axes, each with a Gauss-Markov error: half of their sum q is not observable, half of their difference p is.
    The error of the mean is q and the white noise, q independent of p: variance (s^2 + b^2) / 2 at all times, for
    filter and smoother, for two equal sensors. If only one wanders, p = q and p is estimated: by the two-point
    regression.
    """
    base = triads([0.5, 0.5])
    law = triads([0.5, 0.5], (on(0, 0.2, base, time_constant_s=30.0), on(3, 0.2, base, time_constant_s=30.0)))
    result = bound(law, stretches(law, [0.0, 10.0, 50.0]))
    assert result.causal[:, 0, 0] == pytest.approx([(0.25 + 0.04) / 2] * 3)
    assert result.smoothed[:, 0, 0] == pytest.approx([(0.25 + 0.04) / 2] * 3)

    law = triads([0.5, 0.5], (on(0, 0.2, base, time_constant_s=30.0),))
    result = bound(law, stretches(law, [0.0, 30.0], frames=4))
    noise, prior, lagged = 2 * 0.25 / 4, 0.04, 0.04 * np.exp(-1)  # of the difference; of the error; over 30 s
    first = prior - prior**2 / (prior + noise)
    given = np.array([[prior + noise, lagged], [lagged, prior + noise]])
    with_past = np.array([lagged, prior])
    second = prior - with_past @ np.linalg.solve(given, with_past)
    assert result.causal[:, 0, 0] == pytest.approx([0.125 + first / 4, 0.125 + second / 4])
    assert result.smoothed[:, 0, 0] == pytest.approx([0.125 + second / 4] * 2)


def test_a_common_error_is_observable_by_opposing_axes_only() -> None:
    """z = +-u + c: with opposing axes c is half of their sum, u half of their difference, for any c; with parallel axes
    c stays in u.
    """
    shared = SlowError(np.full(6, 3.0))
    opposed = ErrorLaw(np.concatenate([np.eye(3), -np.eye(3)]), np.full(6, 0.5), (shared,))
    assert bound(opposed, stretches(opposed, [0.0])).causal_rms == pytest.approx([0.5 / np.sqrt(2)] * 3)
    parallel = triads([0.5, 0.5], (shared,))
    assert bound(parallel, stretches(parallel, [0.0])).causal_rms == pytest.approx([np.sqrt(0.125 + 9)] * 3)


def test_the_bound_with_a_thermal_slope() -> None:
    """Slope ~ N(0, 0.1^2) on one axis of two, 10 degC from the reference: a constant of rms 1."""
    base = triads([0.5, 0.5])
    law = triads([0.5, 0.5], (on(0, 0.1, base, per_degc=25.0),))
    result = bound(law, stretches(law, [0.0, 1.0], frames=10, degc=[25.0, 35.0]))
    assert result.smoothed[:, 0, 0] == pytest.approx([0.125, 0.125 + 1 / (1 + 10 / 0.5) / 4])


def test_aggregation_loses_nothing() -> None:
    """Five frames at one time are five stretches of a frame each, where slow errors don't change."""
    base = triads([0.5, 0.4, 0.3])
    law = triads([0.5, 0.4, 0.3], tuple(on(k, 0.3, base) for k in range(9)))
    together, apart = (bound(law, stretches(law, times, n)) for times, n in (([0.0], 5), ([0.0] * 5, 1)))
    assert apart.smoothed[0] == pytest.approx(together.causal[0])


def test_axes_without_a_reading_have_no_weight() -> None:
    law = triads([0.3, 0.4])
    one = np.repeat([True, False], 3)
    both = np.ones(6, bool)
    result = bound(law, [BoundStretch(0.0, (StretchReadings(both, 30), StretchReadings(one, 10)))])
    assert result.causal_rms**2 == pytest.approx([(30 * 0.24**2 + 10 * 0.3**2) / 40] * 3)
    with pytest.raises(FusionError, match="2 of 6 axes known"):
        bound(law, [BoundStretch(0.0, (StretchReadings(np.arange(6) < 2, 5),))])


@settings(max_examples=examples(25), deadline=None)
@given(st.integers(0, 10**6), st.integers(4, 9))
def test_more_readings_do_not_increase_the_bound(seed: int, axes: int) -> None:
    """For any array: another axis, more frames, or future frames do not increase the bound in any direction, and the
    order of the axes does not change it.
    """
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(axes, 3))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    slow = tuple(SlowError(loading, 20.0) for loading in rng.normal(size=(axes + 2, axes)))
    law = ErrorLaw(rows, rng.uniform(0.1, 2.0, axes), slow)
    whole = bound(law, stretches(law, [0.0, 10.0, 30.0], frames=5))
    fewer = np.arange(axes) < max(4, axes - 1)
    less = bound(law, [BoundStretch(t, (StretchReadings(fewer, 3),)) for t in (0.0, 10.0, 30.0)])
    order = rng.permutation(axes)
    mixed = ErrorLaw(rows[order], law.noise_si[order], tuple(SlowError(s.loading[order], 20.0) for s in slow))
    assert bound(mixed, stretches(mixed, [0.0, 10.0, 30.0], frames=5)).causal == pytest.approx(whole.causal, rel=1e-6)
    scale = np.trace(less.causal.mean(axis=0))
    for larger, smaller in ((less.causal, whole.causal), (whole.causal, whole.smoothed)):
        assert np.linalg.eigvalsh(larger - smaller).min() > -1e-7 * scale


@pytest.mark.slow
def test_the_posterior_mean_reaches_the_bound() -> None:
    """300 arrays drawn from the law: the errors of the frames' best estimate have the covariance that is stated.

    Intervals of an array correlate; an rms over 300 arrays and three axes is known to 1 / sqrt(2 * 900) = 2.4 % at
    worst; four of these are allowed.
    """
    rng = np.random.default_rng(11)
    base = triads([0.5, 0.4, 0.3])
    slow = tuple(on(k, 0.4, base, time_constant_s=20.0) for k in range(9))
    law = ErrorLaw(rng.normal(size=(9, 3)), base.noise_si, slow)
    times = np.array([0.0, 10.0, 20.0, 40.0])
    root = np.linalg.cholesky(0.16 * np.exp(-np.abs(times[:, None] - times) / 20.0))
    weights, _ = frame_weights(law, np.ones(9, bool))
    squares = np.zeros((2, 300))
    for run in range(300):
        errors = root @ rng.normal(size=(4, 9))
        means = errors + law.noise_si / np.sqrt(5) * rng.normal(size=(4, 9))
        seen = [
            BoundStretch(t, (StretchReadings(np.ones(9, bool), 5, mean),))
            for t, mean in zip(times.tolist(), means, strict=True)
        ]
        result = bound(law, seen)
        for row, known in enumerate((result.slow_causal, result.slow_smoothed)):
            squares[row, run] = np.mean(((errors - known) @ weights.T) ** 2)
    alone = np.trace(frame_weights(law, np.ones(9, bool))[1]) / 3
    stated = [np.mean(rms**2) - alone for rms in (result.causal_rms, result.smoothed_rms)]
    assert np.sqrt(squares.mean(axis=1) / stated) == pytest.approx([1.0, 1.0], abs=4 * 0.024)
