"""Margins against figures of use with and without the difference; sizes; lengths."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm, pearson3, t

from imuarray.gap.findings.deviations import length_words, margin, needed, sized, sizes
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.margins import share
from imuarray.gap.statistics.probes import PROBES
from tests.gap.small_campaign import header

NOISE = np.array([0.004, 0.005, 0.006])
ROWS_PER_S = 100.0
FINITE = st.floats(1e-3, 1e3)


def margin_of(probe: str, axis: str = "x", chip: str = "bma180", seconds: float = 600.0) -> float:
    key = Key(0, "S", axis, "static", 0, PROBES[probe].domain, probe)
    return margin(key, header(chip=chip), NOISE, ROWS_PER_S, seconds)


def coasting_error(noise: float) -> float:
    """Error of white noise after 60 s: 6000 readings minus the mean of 6000 before, 10 ms each."""
    return 0.01 * math.sqrt(6000 * noise**2 + 6000**2 * noise**2 / 6000)


def test_every_probe_has_a_rule() -> None:
    for probe in PROBES:
        for chip in ("bma180", "l3g4200d"):
            found = margin_of(probe, chip=chip)
            assert math.isfinite(found) and found > 0


def test_noise_larger_by_a_margin_increases_errors_by_a_twentieth() -> None:
    more = NOISE[0] * math.exp(margin_of("noise"))
    assert coasting_error(more) == pytest.approx(1.05 * coasting_error(NOISE[0]))
    assert margin_of("allan_2048") == pytest.approx(math.log(1.05**2))
    assert margin_of("band_1") == margin_of("band_3") < margin_of("band_4")


def added(integral: float) -> float:
    """Increase of the rms error of white noise by a constant with that integral over 60 s."""
    noise = coasting_error(NOISE[0])
    return math.sqrt(noise**2 + integral**2) / noise - 1


def test_a_level_of_a_margin_increases_errors_by_a_twentieth() -> None:
    assert added(margin_of("mean") * 60) == pytest.approx(0.05)
    assert margin_of("mean") * 60 == pytest.approx(0.3202 * coasting_error(NOISE[0]), rel=1e-3)
    assert margin_of("level") == margin_of("level_apart") == margin_of("mean")
    assert margin_of("mean_halves", axis="z") == pytest.approx(1.5 * margin_of("mean"))
    assert margin_of("mean", axis="") == pytest.approx(margin_of("mean") * math.sqrt((16 + 25 + 36) / 48))


def test_a_slope_of_a_margin_gives_that_level_in_ten_degrees() -> None:
    assert margin_of("thermal_slope") * 10 == pytest.approx(margin_of("mean"))
    assert margin_of("thermal_square") * 10**2 == pytest.approx(margin_of("mean"))
    assert margin_of("thermal_change") * 10 / 60 == pytest.approx(margin_of("mean"))


def test_the_margin_of_a_response_is_by_a_quarter_turn() -> None:
    """And that of an accelerometer by the contribution of 1 g in one second."""
    assert added(margin_of("motion_gain", chip="l3g4200d") * 90) == pytest.approx(0.05)
    assert added(margin_of("motion_delay", chip="l3g4200d") * 90) == pytest.approx(0.05)
    assert added(margin_of("motion_gain") * 1.0) == pytest.approx(0.05)


def test_margins_of_shares() -> None:
    """From zero to one row in a thousand, from half of the codes to 52.5 % of them."""
    assert math.sin(margin_of("lost")) ** 2 == pytest.approx(0.001)
    assert math.sin(math.pi / 4 + margin_of("odd_codes")) ** 2 == pytest.approx(0.525)
    assert share(0.2, usual=0.3) == pytest.approx(math.asin(math.sqrt(0.5)) - math.asin(math.sqrt(0.3)))
    usual = 2 * norm.sf(3.0)
    assert math.sin(math.asin(math.sqrt(usual)) + margin_of("tail")) ** 2 == pytest.approx(usual + 0.001, rel=1e-3)


def test_margins_of_tails_move_three_sigma_by_a_twentieth() -> None:
    """Three-sigma limits of a Pearson III distribution of that skewness, and of Student's t of that kurtosis, whose
    excess is 6 / (n - 4); the margins are the first term of an expansion, accurate to 0.5 % here.
    """
    beyond = norm.sf(3.0)
    assert pearson3.isf(beyond, math.sinh(margin_of("skewness"))) == pytest.approx(3 * 1.05, rel=0.005)
    freedom = 4 + 6 / (3 * math.expm1(margin_of("kurtosis")))
    assert t.isf(beyond, freedom) / t.std(freedom) == pytest.approx(3 * 1.05, rel=0.005)


def test_margin_of_uneven_noise() -> None:
    """6000 rows in 64 segments, whose noise scatters by 5 %: log variances scatter by 2 ln 1.05 more than by chance."""
    rows = 6000 / 64
    chance = 2 / (rows - 1)
    expected = math.log((chance + (2 * math.log(1.05)) ** 2) / chance)
    assert margin_of("noise_uneven", seconds=60.0) == pytest.approx(expected)


def test_margin_of_a_correlation_in_a_mean_of_three() -> None:
    """Three sensors with this correlation: the root of the mean of all covariances is a twentieth larger."""
    rho = math.tanh(margin_of("fast_own_axes"))
    covariance = np.full((3, 3), rho) + np.eye(3) * (1 - rho)
    assert math.sqrt(covariance.mean() * 3) == pytest.approx(1.05, rel=2e-3)


def test_a_size_is_material_harmless_or_undetermined() -> None:
    assert sized(1.0, 0.1, 0.5) == sized(-1.0, 0.1, 0.5) == "material"
    assert sized(0.1, 0.01, 0.5) == "harmless"  # ten standard deviations, but without effect
    assert sized(0.0, 0.1, 0.5) == "harmless"
    assert sized(0.5, 0.1, 0.5) == sized(0.0, 1.0, 0.5) == sized(1.0, 0.3, 0.5) == "can't tell"
    assert sized(math.nan, 0.1, 0.5) == sized(1.0, math.nan, 0.5) == "can't tell"
    found = sizes(np.array([1.0, 0.1, 0.5]), np.array([0.1, 0.01, 0.1]), np.full(3, 0.5))
    assert found == ("material", "harmless", "can't tell")


def test_sizes_are_rarely_wrong() -> None:
    """Differences on either side of the margin, 20000 each: 2.5 % at most on the wrong side (standard error 0.11 %)."""
    random = np.random.default_rng(5)
    for true, wrong in ((1.0, "material"), (1.0, "harmless")):
        found = sizes(random.normal(true, 0.2, 20_000), np.full(20_000, 0.2), np.full(20_000, 1.0))
        assert found.count(wrong) / 20_000 == pytest.approx(0.025, abs=0.0045)


@given(st.floats(-1e3, 1e3), FINITE, FINITE)
def test_smaller_margins_make_more_differences_material(shift: float, scale: float, limit: float) -> None:
    order = ("harmless", "can't tell", "material")
    assert order.index(sized(shift, scale, limit)) <= order.index(sized(shift, scale, limit / 2))


@given(FINITE, FINITE, FINITE)
def test_a_log_of_the_required_length_determines_the_size(seconds: float, scale: float, limit: float) -> None:
    """At that length 1.96 standard errors are the margin."""
    longer = needed(seconds, scale, limit) / seconds
    assert 1.96 * scale / math.sqrt(longer) == pytest.approx(limit)


def test_a_margin_of_zero_needs_an_infinite_log() -> None:
    assert needed(60.0, 1.0, 0.0) == math.inf
    assert length_words(math.inf) == "no log is long enough"


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.01, "1 second"),
        (41.2, "42 seconds"),
        (1500.0, "25 minutes"),
        (1501.0, "26 minutes"),
        (5400.0, "90 minutes"),
        (5401.0, "2 hours"),
        (172_800.0, "48 hours"),
        (172_801.0, "3 days"),
        (86_400.0 * 123, "130 days"),
    ],
)
def test_text_of_lengths(seconds: float, words: str) -> None:
    assert length_words(seconds) == words
