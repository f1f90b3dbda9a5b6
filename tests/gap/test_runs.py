"""Runs made by hand, and the probes of runs in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.gap.statistics.probes import PROBES, RunsProbe
from imuarray.gap.statistics.runs import PARTS, Runs, divide, runs_of
from tests.gap.small_campaign import block, header, summary

SCALE = 1 / 2048.0


def value(name: str, runs: Runs) -> np.ndarray:
    probe = PROBES[name]
    assert isinstance(probe, RunsProbe)
    return probe.statistic(runs)


def runs(means: np.ndarray, profiles: np.ndarray | None = None) -> Runs:
    wide = np.stack([means] * 3, axis=1)
    flat = np.zeros((len(means), PARTS, 3)) if profiles is None else profiles
    return Runs(header(), wide, np.full_like(wide, 0.5), flat)


def test_means_errors_and_profiles_equal_those_of_the_rows() -> None:
    rng = np.random.default_rng(1)
    counts = [rng.integers(-20, 20, (3200, 3)) + shift for shift in (0, 7)]
    found = runs_of([summary(block(rows)) for rows in counts])
    for run, rows in enumerate(counts):
        np.testing.assert_allclose(found.means[run], SCALE * rows.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(found.errors[run], SCALE * rows.std(axis=0) / np.sqrt(3200), rtol=0.03)
        parts = rows.reshape(PARTS, 200, 3).mean(axis=1) - rows.mean(axis=0)
        np.testing.assert_allclose(found.profiles[run], SCALE * parts, atol=1e-12)


def test_short_runs_have_profiles() -> None:
    found = runs_of([summary(block(np.arange(40)))] * 2)
    assert np.isfinite(found.profiles).all()
    assert (np.diff(found.mean_profile[:, 0]) >= 0).all()


def test_the_probe_of_two_states_by_hand() -> None:
    """Squares about the common mean are 6 (49.5)^2 + 4, about those of two groups 4; the errors' variances add 6/4."""
    states = runs(np.array([100.0, 1.0, 99.0, 0.0, 101.0, 2.0]))
    log_ratio = np.log((6 * 49.5**2 + 4 + 1.5) / (4 + 1.5))
    np.testing.assert_allclose(value("run_two_states", states), log_ratio)
    np.testing.assert_allclose(value("run_shared_states", states), log_ratio)


def test_a_drift_leaves_a_quarter_of_the_scatter_in_two_groups() -> None:
    """Squares of n equal steps are n (n^2 - 1) / 12."""
    means = np.arange(12.0)[:, None]
    upper, log_ratio = divide(means, np.zeros_like(means))
    assert upper.tolist() == [False] * 6 + [True] * 6
    np.testing.assert_allclose(np.exp(log_ratio), (12**2 - 1) / (6**2 - 1))


def test_axes_with_different_times_of_change_have_no_common_states() -> None:
    """Eight runs on three axes: states of their own leave about half of the scatter in any two groups, while common
    states of all axes, in noise of a fifth of their distance, leave less than a tenth.
    """
    rng = np.random.default_rng(1)
    none = np.full((8, 3), 1e-6)
    state = np.array([0, 1, 1, 0, 1, 0, 0, 1])
    shared = [divide(state[:, None] + rng.normal(0, 0.2, (8, 3)), none) for _ in range(200)]
    own = [
        divide(np.array([rng.permutation(state) for _ in range(3)]).T + rng.normal(0, 0.2, (8, 3)), none)[1]
        for _ in range(200)
    ]
    assert np.quantile([log_ratio for _, log_ratio in shared], 0.05) > np.quantile(own, 0.95)
    assert np.mean([(upper == state).all() or (upper != state).all() for upper, _ in shared]) > 0.95


@pytest.mark.parametrize("means", [np.zeros((8, 3)), np.arange(9.0).reshape(3, 3), np.zeros((0, 3))])
def test_equal_or_few_runs_have_no_two_groups(means: np.ndarray) -> None:
    """All equal, or fewer than twice the two runs that a group has."""
    upper, log_ratio = divide(means, np.zeros_like(means))
    assert not upper.any()
    assert np.isnan(log_ratio)


def test_probes_of_spread_scatter_and_outlier() -> None:
    means = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 40.0, 1.0, 3.0])
    found = runs(means)
    robust = 1.4826 * np.median(np.abs(means - np.median(means)))
    np.testing.assert_allclose(value("run_spread", found), np.log(robust))
    np.testing.assert_allclose(value("run_scatter", found), np.log(means.var(ddof=1) / 0.25))
    np.testing.assert_allclose(value("run_rms", found), 13.498677, rtol=1e-6)
    np.testing.assert_allclose(value("run_outlier", found), np.log(np.sqrt(3) * (40 - 2.5) / robust))


def test_the_spread_of_mostly_equal_means() -> None:
    """Three of five are equal: their spread is a fifth of that of independent readings, 0.5."""
    found = runs(np.array([2.0, 2.0, 2.0, 1.9, 2.1]))
    np.testing.assert_allclose(value("run_spread", found), np.log(0.1))
    np.testing.assert_allclose(value("run_outlier", found), np.log(np.sqrt(3)))


def test_probes_of_creep_and_profile() -> None:
    """A common course 0.3 ln t; single courses differ by 0.1 at every point, up or down."""
    course = np.log((np.arange(PARTS) + 0.5) / PARTS)
    course -= course.mean()
    sides = np.array([1.0, -1.0, 1.0, -1.0])
    wiggle = np.tile([1.0, -1.0], PARTS // 2)
    profiles = 0.3 * course + 0.1 * sides[:, None] * wiggle
    found = runs(np.arange(4.0), np.stack([profiles] * 3, axis=2))
    np.testing.assert_allclose(value("run_creep", found), 0.3)
    expected = 4 * 0.09 * (course**2).sum() / (4 * PARTS * 0.01 / 3)
    np.testing.assert_allclose(value("run_profile", found), np.log(expected))


def test_three_runs_have_no_probes() -> None:
    found = runs(np.arange(3.0))
    for name, probe in PROBES.items():
        if isinstance(probe, RunsProbe):
            assert np.isnan(value(name, found)).all()
