"""Common properties of probes, and those of level and spread against closed forms."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from imuarray.axes import up_vector
from imuarray.gap.statistics.campaign import Layout, LogSummary, PhaseSummary
from imuarray.gap.statistics.probes import PROBES, ArrayProbe, Domain
from imuarray.gap.statistics.probes.level import least_level, least_mean_level, least_return
from imuarray.gap.statistics.probes.probe import arcsine, noise_lsb, score_of_largest
from imuarray.log.format import Phase
from imuarray.simulate import EFFECTS
from imuarray.simulate.motion.tumble import ORDER
from tests.gap.small_campaign import SCALE, SECOND, block, gaussian, header, summary, value


def test_the_registry_covers_all_domains_and_effects() -> None:
    domains = {probe.domain for probe in PROBES.values()}
    assert domains == set(get_args(Domain))
    moved_by = {effect for probe in PROBES.values() for effect in probe.moved_by}
    nuisance = {"thermometer"}
    assert set(EFFECTS) - moved_by - nuisance == set(), "in moved_by of no probe"
    assert moved_by == set(EFFECTS) - nuisance
    assert all(probe.about for probe in PROBES.values())


@given(st.integers(1, 10**6), st.floats(0, 1))
def test_arcsine_of_a_share(of: int, share: float) -> None:
    assert np.isclose(np.sin(arcsine(share * of, of)) ** 2, share, atol=1e-12)


def test_arcsine_of_a_share_without_rows() -> None:
    assert np.isnan(arcsine(0, 0))


def test_the_score_of_the_largest_value_is_normal() -> None:
    """The largest of 50 normal numbers, 4000 times: Kolmogorov-Smirnov, a false alarm in 1000 seeds."""
    largest = np.random.default_rng(2).normal(size=(4000, 50)).max(axis=1)
    assert stats.kstest(score_of_largest(largest, 50), "norm").pvalue > 1e-3


@pytest.mark.parametrize("score", [5.0, 12.0, 60.0])
def test_the_score_of_a_far_value_is_near_the_value(score: float) -> None:
    """P = count * tail; lower by the root of 2 ln(count) in the exponent."""
    found = float(score_of_largest(score, 100.0))
    assert np.sqrt(score**2 - 2 * np.log(100)) - 0.3 < found < score


def test_noise_from_row_to_row_ignores_slow_changes() -> None:
    """The noise of white noise on any slow signal; 5 % outliers have little effect."""
    counts = gaussian()
    np.testing.assert_allclose(noise_lsb(summary(block(counts))), 20.0, rtol=0.02)
    drifting = counts + np.linspace(0, 9000, len(counts))[:, None]
    np.testing.assert_allclose(noise_lsb(summary(block(drifting))), 20.0, rtol=0.02)
    struck = counts.copy()
    struck[::50] += 4000
    np.testing.assert_allclose(noise_lsb(summary(block(struck))), 20.0, rtol=0.08)
    assert np.isnan(noise_lsb(summary(block(np.full(1000, 7))))).all()


def test_probes_of_the_level() -> None:
    counts = np.repeat([10.0, 10.0, 30.0, 34.0], 500)
    found = summary(block(counts))
    np.testing.assert_allclose(value("mean", found), 21.0 / SCALE)
    np.testing.assert_allclose(value("mean_halves", found), 22.0 / SCALE)
    again = summary(block(counts + 5), Phase(0, 20 * SECOND, "z_up_check", "+Z"))
    elsewhere = summary(block(counts - 99), Phase(0, 20 * SECOND, "x_up", "+X"))
    np.testing.assert_allclose(value("mean_return", [found, elsewhere, again]), 5.0 / SCALE)
    assert np.isnan(value("mean_return", [found, elsewhere])).all()


def test_the_resolution_of_a_level_is_half_its_standard_error() -> None:
    """Independent of the residual of the fit: for readings of 20 counts rms, 20 / sqrt(n) counts."""
    counts = gaussian()
    error = 20.0 / np.sqrt(len(counts)) / SCALE
    assert least_level(summary(block(counts))) == pytest.approx(error / 2, rel=0.05)
    assert least_level(summary(block(np.zeros_like(counts)))) < error / 10


def test_the_resolution_of_a_log_level_follows_from_its_phases() -> None:
    """The mean of four phases has half of the error of one; a difference of two 1.4 times the error."""
    phase = summary(block(gaussian()))
    assert least_mean_level([phase] * 4) == pytest.approx(least_level(phase) / 2)
    assert least_return([phase] * 4) == pytest.approx(least_level(phase) * math.sqrt(2))


def test_the_level_of_a_log_weighs_faces_equally() -> None:
    """Two phases on one face, one on another: half of it each."""
    phases = [
        summary(block(np.full(rows, code)), Phase(0, rows * SECOND // 100, name, up))
        for rows, code, name, up in ((500, 10, "z_up", "+Z"), (100, 30, "z_up_check", "+Z"), (900, 44, "x_up", "+X"))
    ]
    np.testing.assert_allclose(value("level", phases), 32.0 / SCALE)
    poses = [summary(block(np.full(99, code)), Phase(0, SECOND, f"pose {code}")) for code in (3, 4, 8)]
    np.testing.assert_allclose(value("level", poses), 5.0 / SCALE)
    assert np.isnan(value("level", phases[:1])).all()


def test_the_level_relative_to_other_sensors() -> None:
    """A1 minus the mean of A2 and A3, each along its own axes; not the gyroscope, nor an accelerometer of another chip,
    nor a sensor of the same chip with another quantity.
    """
    sensors = {
        "A1": (header("A1"), 60),
        "A2": (header("A2", "-X+Y-Z"), 20),
        "A3": (header("A3"), 30),
        "B": (header("B", chip="adxl345"), 999),
        "G": (header("G", chip="l3g4200d"), 500),
        "M": (header("M", quantity="angular_rate", unit="dps"), 700),
    }
    phase = Phase(0, SECOND, "static", "+Z")
    found = {name: summary(block(np.full(100, code)), phase, sensor=one) for name, (one, code) in sensors.items()}
    log = LogSummary("static", (PhaseSummary(phase, 0, Layout({}, 1), found, None),))
    probe = PROBES["level_apart"]
    assert isinstance(probe, ArrayProbe)
    np.testing.assert_allclose(probe.statistic(log, "A1"), 35.0 / SCALE)
    np.testing.assert_allclose(probe.statistic(log, "A2"), -25.0 / SCALE)
    assert all(np.isnan(probe.statistic(log, name)).all() for name in "BGM")


def test_the_resolution_of_relative_levels_is_half_their_standard_error() -> None:
    """An attitude that is estimated from two opposed chips makes the difference of some of their axes zero; the
    residual is then meaningless. 2 counts of noise in 100 rows: half of the standard error is 0.1 counts.
    """
    phase = Phase(0, SECOND, "static", "+Z")
    rows = gaussian(2.0, rows=100)
    summaries = {name: summary(block(rows), phase, sensor=header(name)) for name in ("A1", "A2")}
    log = LogSummary("static", (PhaseSummary(phase, 0, Layout({}, 1), summaries, None),))
    probe = PROBES["level_apart"]
    assert isinstance(probe, ArrayProbe)
    assert probe.resolution(log, "A1") == pytest.approx(0.1 / SCALE, rel=0.4)


def test_white_noise_has_no_wander() -> None:
    """64 segments: the log of a chi-squared variance with 62 degrees of freedom has a standard error of 0.18."""
    np.testing.assert_allclose(value("wander", summary(block(gaussian()))), 0.0, atol=0.9)
    walk = gaussian() + np.cumsum(gaussian(2.0, seed=3), axis=0)
    assert (value("wander", summary(block(walk))) > 3.0).all()


def test_skewness_of_a_rare_level() -> None:
    """Of 64 segments every fifth is higher, far beyond noise: skewness (1 - 2 p) / sqrt(p (1 - p)) of p = 13 / 64."""
    counts, p = gaussian(rows=64 * 300), 13 / 64
    counts += 400 * (np.arange(64) % 5 == 2)[np.arange(len(counts)) // 300][:, None]
    wanted = (1 - 2 * p) / np.sqrt(p * (1 - p))
    np.testing.assert_allclose(np.sinh(value("wander_uneven", summary(block(counts)))), wanted, rtol=0.05)
    np.testing.assert_allclose(np.sinh(value("wander_uneven", summary(block(-counts)))), -wanted, rtol=0.05)
    np.testing.assert_allclose(value("wander_uneven", summary(block(gaussian()))), 0.0, atol=5 * np.sqrt(6 / 64))


def test_probes_of_the_spread() -> None:
    counts = gaussian()
    found = summary(block(counts))
    np.testing.assert_allclose(value("noise", found), np.log(20 / SCALE), atol=0.02)
    np.testing.assert_allclose(value("noise_excess", found), 0.0, atol=0.03)
    counts[10_000:] *= 2
    louder = summary(block(counts))
    np.testing.assert_allclose(value("noise_halves", louder), np.log(4.0), atol=0.1)
    assert (value("noise_uneven", louder) > value("noise_uneven", found) + 2.0).all()


def test_a_segment_of_one_code_is_as_quiet_as_rounding() -> None:
    """The first of 64: ln(1/12 / 4) is 3.87 below the others, which adds 3.87^2 / 64 to the variance of the logs."""
    counts = np.rint(gaussian(2.0))
    counts[:313] = 0
    found = summary(block(counts))
    assert (found.segments.variance[0] == 0).all()
    np.testing.assert_allclose(value("noise_uneven", found), np.log(1 + 3.87**2 / 64 / (2 / 312)), atol=0.3)


def test_noise_of_axes_along_gravity() -> None:
    """Twice the noise on a vertical axis."""
    phases = []
    for seed, (name, up) in enumerate(ORDER):
        loaded = 1 + np.abs(up_vector(up))
        phases.append(summary(block(gaussian(seed=seed) * loaded), Phase(0, 200 * SECOND, name, up)))
    np.testing.assert_allclose(value("noise_force", phases), np.log(4.0), atol=0.1)
    assert np.isnan(value("noise_force", phases[:1])).all()
