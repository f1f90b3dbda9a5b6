"""Probes of the shape of noise, in values, codes, frequencies and time, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.gap.statistics.probes import spectrum
from imuarray.log.format import Phase
from tests.gap.small_campaign import block, gaussian, summary, value


def test_distribution_of_gaussian_noise() -> None:
    """Standard errors: root of 6/n, of 24/n over 3, half over root n; five of each."""
    found = summary(block(gaussian()))
    np.testing.assert_allclose(value("skewness", found), 0.0, atol=0.09)
    np.testing.assert_allclose(value("kurtosis", found), 0.0, atol=0.06)
    np.testing.assert_allclose(value("tail", found), np.arcsin(np.sqrt(2.7e-3)), atol=0.025)
    np.testing.assert_allclose(value("extreme", found), 0.0, atol=5.0)


def test_distribution_of_exponential_noise() -> None:
    """Skewness 2, kurtosis 9."""
    counts = np.rint(np.random.default_rng(1).exponential(200.0, (200_000, 3)))
    found = summary(block(counts))
    np.testing.assert_allclose(np.sinh(value("skewness", found)), 2.0, rtol=0.05)
    np.testing.assert_allclose(3 * np.exp(value("kurtosis", found)), 9.0, rtol=0.1)


def test_probes_of_codes() -> None:
    counts = gaussian()
    found = summary(block(counts))
    quarter, half = np.pi / 4, 5 * 0.5 / np.sqrt(20_000)  # arcsin of the root of a half; five standard errors
    for name in ("odd_codes", "second_bit"):
        np.testing.assert_allclose(value(name, found), quarter, atol=half)
    np.testing.assert_array_equal(value("absent_codes", found), 0.0)
    np.testing.assert_array_equal(value("code_ends", found), 0.0)
    assert (np.abs(value("code_pile", found)) < 4.0).all()
    even = summary(block(2 * gaussian(10.0)))
    np.testing.assert_array_equal(value("odd_codes", even), 0.0)
    np.testing.assert_allclose(value("absent_codes", even), quarter, atol=0.02)
    clipped = summary(block(np.minimum(counts, 10)))
    assert (value("code_pile", clipped) > 50.0).all()
    ends = summary(block(np.clip(counts * 1000, -8192, 8191)))  # a BMA180's codes
    assert (value("code_ends", ends) > 0.9).all()


def test_codes_skipped_by_a_quick_turn_are_not_absent() -> None:
    """20,000 rows on a slope over 5000 codes have four rows per code, over 6000 codes fewer."""
    slopes = np.linspace(0.0, 1.0, 20_000)[:, None] * np.array([100.0, 5000.0, 6000.0])
    values = value("absent_codes", summary(block(np.rint(slopes))))
    np.testing.assert_array_equal(values, 0.0)
    halved = value("absent_codes", summary(block(2 * np.rint(slopes))))
    np.testing.assert_allclose(halved[0], np.pi / 4, atol=0.01)
    np.testing.assert_array_equal(halved[1:], 0.0)


@pytest.mark.parametrize("cuts", [(), (1, 2, 3, 700, 1001)])
def test_a_single_wrong_reading_is_a_spike_in_a_motion(cuts: tuple[int, ...]) -> None:
    """A spike of 500 counts in noise of 5, on a swing whose curvature is up to 63 counts per row, by which a spike is
    smaller on a crest. At rest the largest step is more sensitive.
    """
    rows, amplitude, radians, spike = 2000, 16_000, 2 * np.pi / 100, 500
    swing = amplitude * np.cos(radians * np.arange(rows))
    counts = np.rint(swing[:, None] + np.random.default_rng(2).normal(0.0, 5.0, (rows, 3)))
    counts[1000, 1] -= spike
    moving = Phase(0, rows * 10_000_000, "motion", "")
    noise, spiked, _ = value("spike", summary(block(counts), moving, cuts=cuts))
    eighth = summary(block(counts), moving).spikes[-1, 1]
    np.testing.assert_allclose(spiked, np.log((spike - 63 / 2 + 0.5) / (eighth + 0.5)), atol=0.05)
    assert noise < 1.0
    assert np.isnan(value("spike", summary(block(counts)))).all()


def test_a_motion_without_noise_has_no_spikes() -> None:
    """Also where its slope changes suddenly: second differences of one sign do not alternate."""
    rows = np.arange(2000.0)
    counts = np.stack([rows**2 / 200, np.abs(rows - 1000) * 10, rows * 0 + 7], axis=1)
    moving = Phase(0, len(rows) * 10_000_000, "motion", "")
    assert summary(block(counts * 2), moving).spikes[0].max() <= 1.0


def test_spectrum_of_white_noise_is_flat() -> None:
    """Bands of at least a bin: 2 / (2 K) of variance, K = 38 segments, 5 standard errors."""
    found = summary(block(gaussian()))
    for number in range(1, 7):
        np.testing.assert_allclose(value(f"band_{number}", found), 0.0, atol=0.8)
    assert (np.abs(value("line", found)) < 5.0).all()
    np.testing.assert_allclose(value("alternation", found), 0.0, atol=1.2)


def test_probes_of_lines() -> None:
    rows = np.arange(20_000)
    tone = summary(block(gaussian() + 8 * np.sin(2 * np.pi * 0.123 * rows)[:, None]))
    assert (value("line", tone) > 10.0).all()
    turns = summary(block(gaussian() + 8 * (-1.0) ** rows[:, None]))
    assert (value("alternation", turns) > 3.0).all()


@pytest.mark.slow
def test_the_line_over_all_phases_exceeds_that_of_each_phase() -> None:
    """A sine of 0.12 of the noise's standard deviation at one frequency, in phases of 8000, 4000 and 3000 rows: in the
    mean of twenty such logs the score of all phases together is higher than that of any phase.
    """
    rng, scores = np.random.default_rng(5), []
    for _ in range(20):
        phases = []
        for rows in (8000, 4000, 3000):
            sine = 2.4 * np.sin(2 * np.pi * 0.1801 * np.arange(rows) + rng.uniform(0, 6))[:, None]
            phases.append(summary(block(np.rint(rng.normal(0, 20, (rows, 3)) + sine).astype(np.int16))))
        scores.append([spectrum.line_of_log(phases), *(spectrum.line(phase) for phase in phases)])
    together, *alone = np.mean(scores, axis=(0, 2))
    assert together > max(alone) + 0.5
    assert np.isnan(spectrum.line_of_log(phases[:1])).all()


@pytest.mark.slow
def test_the_line_of_a_log_is_a_normal_score() -> None:
    """Of white noise in three phases, 60 times on three axes: about 0 and 1, since the shorter segments have wider bins
    than those that are counted. The standard errors of mean and scatter are 0.075 and 0.05.
    """
    rng = np.random.default_rng(6)
    scores = [
        spectrum.line_of_log(
            [summary(block(np.rint(rng.normal(0, 20, (n, 3))).astype(np.int16))) for n in (6000, 3000, 700)]
        )
        for _ in range(60)
    ]
    assert abs(np.mean(scores)) < 0.6
    assert 0.75 < np.std(scores) < 1.25


def test_an_alternation_of_readings() -> None:
    """0.3 of the noise alternately added and subtracted, over 20000 rows: 0.3 sqrt(20000) = 42; the phase of a sine of
    twice that, at 0.4985 of the rate, rotates. Without either it is normal.
    """
    rows, noise = np.arange(20_000), gaussian()
    spread = noise.std(axis=0).mean()
    assert (np.abs(value("every_other", summary(block(noise)))) < 5.0).all()
    turns = summary(block(noise + 0.3 * spread * (-1.0) ** rows[:, None]))
    np.testing.assert_allclose(value("every_other", turns), 42.0, rtol=0.25)
    beats = summary(block(noise + 0.6 * spread * np.sin(2 * np.pi * 0.4985 * rows)[:, None]))
    assert (np.abs(value("every_other", beats)) < 6.0).all()


def test_probes_of_correlation() -> None:
    """A moving mean of two: 1/2 at lag 1, zero beyond; and noise in bursts."""
    noise = gaussian(rows=20_001)
    found = summary(block(noise[1:] + noise[:-1]))
    np.testing.assert_allclose(np.tanh(value("lag_1", found)), 0.5, atol=0.03)
    for name in ("lag_2", "lag_3", "lag_5"):
        np.testing.assert_allclose(value(name, found), 0.0, atol=0.05)
    np.testing.assert_allclose(value("arch", summary(block(gaussian()))), 0.0, atol=0.05)
    bursts = gaussian() * np.repeat(np.random.default_rng(3).choice([1, 4], 400), 50)[:, None]
    assert (value("arch", summary(block(np.rint(bursts)))) > 0.15).all()


def test_kurtosis_of_jumps() -> None:
    """Every 1000 rows, far beyond noise: a jump u from the middle of 2 m rows changes their two means by 1 - |u| / m,
    whose mean square is 2 m / 3 rows per jump, the mean fourth power 2 m / 5: kurtosis 9 x 1000 / (10 m). Noise, and a
    wander in many small steps, has 3.
    """
    turns = np.rint(200 * (-1.0) ** (np.arange(40_000) // 1000))[:, None]
    found = summary(block(turns + gaussian(1.0, rows=40_000)))
    for rows in (8, 32, 128):
        np.testing.assert_allclose(3 * np.exp(value(f"jumps_{rows}", found)), 900 / rows, rtol=0.1)
    walk = summary(block(np.rint(np.cumsum(np.random.default_rng(4).normal(0.0, 20.0, (40_000, 3)), axis=0) / 30)))
    for rows in (8, 32):  # 40 000 / 2 m independent differences: root of 24 over that, over 3; five of these
        for one in (walk, summary(block(gaussian(rows=40_000)))):
            np.testing.assert_allclose(value(f"jumps_{rows}", one), 0.0, atol=5 * np.sqrt(24 * 2 * rows / 40_000) / 3)


def test_probes_of_allan_variances() -> None:
    """White: not above 0; a random walk: (2 m^2 + 1) / (3 m) as much at m rows, known for its variance (2 m + 1 / m) /
    6 against 1 / 2 at one row.
    """
    white = summary(block(gaussian()))
    np.testing.assert_allclose(value("allan_8", white), 0.0, atol=0.2)
    walk = summary(block(np.rint(np.cumsum(np.random.default_rng(1).normal(0, 8, (20_000, 3)), axis=0))))
    for rows in (8, 32, 128):
        expected = np.log((2 * rows**2 + 1) / 3)
        np.testing.assert_allclose(value(f"allan_{rows}", walk), expected, atol=0.6)
    assert np.isnan(value("allan_2048", summary(block(gaussian(rows=5000))))).all()
    assert np.isfinite(value("allan_longest", summary(block(gaussian(rows=5000))))).all()
