"""Runs made by hand, and what the probes of runs say of them in closed form."""

from __future__ import annotations

import numpy as np

from imuarray.gap.statistics.probes import PROBES, RunsProbe
from imuarray.gap.statistics.runs import PARTS, Runs, runs_of
from tests.gap.made import block, header, summary

SCALE = 1 / 2048.0


def value(name: str, runs: Runs) -> np.ndarray:
    probe = PROBES[name]
    assert isinstance(probe, RunsProbe)
    return probe.statistic(runs)


def runs(means: np.ndarray, profiles: np.ndarray | None = None) -> Runs:
    wide = np.stack([means] * 3, axis=1)
    flat = np.zeros((len(means), PARTS, 3)) if profiles is None else profiles
    return Runs(header(), wide, np.full_like(wide, 0.5), flat)


def test_means_errors_and_profiles_are_those_of_the_rows() -> None:
    rng = np.random.default_rng(1)
    counts = [rng.integers(-20, 20, (3200, 3)) + shift for shift in (0, 7)]
    found = runs_of([summary(block(rows)) for rows in counts])
    for run, rows in enumerate(counts):
        np.testing.assert_allclose(found.means[run], SCALE * rows.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(found.errors[run], SCALE * rows.std(axis=0) / np.sqrt(3200), rtol=0.03)
        parts = rows.reshape(PARTS, 200, 3).mean(axis=1) - rows.mean(axis=0)
        np.testing.assert_allclose(found.profiles[run], SCALE * parts, atol=1e-12)


def test_short_runs_have_profiles_too() -> None:
    found = runs_of([summary(block(np.arange(40)))] * 2)
    assert np.isfinite(found.profiles).all()
    assert (np.diff(found.mean_profile[:, 0]) >= 0).all()


def test_two_states() -> None:
    """Sorted gaps 1, 1, 97, 1, 1 and so log 97."""
    found = runs(np.array([100.0, 1.0, 99.0, 0.0, 101.0, 2.0]))
    np.testing.assert_allclose(value("run_two_states", found), np.log(97.0))


def test_spread_scatter_and_outlier() -> None:
    means = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 40.0, 1.0, 3.0])
    found = runs(means)
    robust = 1.4826 * np.median(np.abs(means - np.median(means)))
    np.testing.assert_allclose(value("run_spread", found), np.log(robust))
    np.testing.assert_allclose(value("run_scatter", found), np.log(means.var(ddof=1) / 0.25))
    np.testing.assert_allclose(value("run_outlier", found), np.log(np.sqrt(3) * (40 - 2.5) / robust))


def test_runs_whose_means_are_mostly_equal() -> None:
    """Three of five are: their spread is a fifth of what readings that know nothing of each other make, 0.5."""
    found = runs(np.array([2.0, 2.0, 2.0, 1.9, 2.1]))
    np.testing.assert_allclose(value("run_spread", found), np.log(0.1))
    np.testing.assert_allclose(value("run_outlier", found), np.log(np.sqrt(3)))


def test_creep_and_profile() -> None:
    """A common course 0.3 ln t; single ones are 0.1 off it at every point, up or down."""
    course = np.log((np.arange(PARTS) + 0.5) / PARTS)
    course -= course.mean()
    sides = np.array([1.0, -1.0, 1.0, -1.0])
    wiggle = np.tile([1.0, -1.0], PARTS // 2)
    profiles = 0.3 * course + 0.1 * sides[:, None] * wiggle
    found = runs(np.arange(4.0), np.stack([profiles] * 3, axis=2))
    np.testing.assert_allclose(value("run_creep", found), 0.3)
    expected = 4 * 0.09 * (course**2).sum() / (4 * PARTS * 0.01 / 3)
    np.testing.assert_allclose(value("run_profile", found), np.log(expected))


def test_three_runs_say_nothing() -> None:
    found = runs(np.arange(3.0))
    for name, probe in PROBES.items():
        if isinstance(probe, RunsProbe):
            assert np.isnan(value(name, found)).all()
