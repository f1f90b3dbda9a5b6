"""Densities against scipy, the independent share against known correlations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from imuarray.gap.statistics.synthetic_likelihood import (
    FORM,
    FREEDOM,
    LARGEST_SCORE,
    SyntheticLikelihood,
    independent_share,
    likelihood_of,
)
from tests.selection import examples, some

NAN = math.nan


def likelihood(
    location: list[float], scale: list[float], always: object = None, never: object = None
) -> SyntheticLikelihood:
    nothing = np.zeros(len(location), bool)
    sides = [nothing if one is None else np.array(one, bool) for one in (always, never)]
    return SyntheticLikelihood(np.array(location), np.array(scale), *sides)


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3), st.floats(-90, 90), st.floats(-90, 90))
def test_the_density_is_that_of_students_t(location: float, scale: float, one: float, other: float) -> None:
    """Up to a constant: differences are those of the t distribution."""
    model = likelihood([location] * 2, [scale] * 2)
    values = location + scale * np.array([one, other])
    found = model.log_density(values)
    expected = stats.t.logpdf(values, FREEDOM, location, scale)
    assert found[0] - found[1] == pytest.approx(expected[0] - expected[1], abs=1e-6)
    constant = stats.t.logpdf(0.0, FREEDOM)
    np.testing.assert_allclose(found + constant, expected, atol=1e-6)


def test_the_cost_of_a_score() -> None:
    """z = 3, 10, 100 cost 3.1, 9.1 and 22.8 nats, which is the maximum."""
    model = likelihood([0.0] * 4, [1.0] * 4)
    found = model.log_density(np.array([3.0, 10.0, 100.0, 1e9]))
    np.testing.assert_allclose(-found, [3.09, 9.13, 22.81, 22.81], atol=0.01)


def test_a_shift_by_an_effect_has_a_proportional_error() -> None:
    """A shift of 20 standard deviations has an error of 1 standard deviation: variances add."""
    model = likelihood([20.0], [1.0])
    found = model.log_density(np.array([23.0]), np.array([20.0]))
    width = math.sqrt(1 + (20 * FORM) ** 2)
    expected = stats.t.logpdf(3.0, FREEDOM, 0.0, width) - stats.t.logpdf(0.0, FREEDOM)
    assert found[0] == pytest.approx(expected)
    unmoved = model.log_density(np.array([23.0]), np.array([NAN]))
    assert unmoved[0] == pytest.approx(model.log_density(np.array([23.0]))[0])


def test_usually_missing_values_are_no_evidence() -> None:
    """Neither values that are sometimes missing, nor those always missing, nor those that the fit makes constant."""
    model = likelihood([0.0, NAN, 5.0], [2.0, NAN, 1e-9], never=[False, True, False])
    np.testing.assert_array_equal(model.log_density(np.array([NAN, NAN, 5.0 + 1e-8])), 0.0)
    np.testing.assert_array_equal(model.scores(np.array([NAN, NAN, 5.0])), [NAN, NAN, 0.0])
    apart = model.log_density(np.array([NAN, NAN, 5.1]))
    assert apart[2] < -1.0  # a constant with another value in the recording is evidence


def test_a_statistic_of_one_side_only_is_missing() -> None:
    """It has no score; a model under which a recorded statistic vanishes has the cost of the largest score."""
    model = likelihood([1.0, NAN], [2.0, NAN], always=[True, False], never=[False, True])
    np.testing.assert_array_equal(model.scores(np.array([NAN, 3.0])), NAN)
    cost = stats.t.logpdf(0.0, FREEDOM) - stats.t.logpdf(LARGEST_SCORE, FREEDOM)
    np.testing.assert_allclose(model.log_density(np.array([NAN, 3.0])), [0.0, -cost])
    assert model.scores(np.array([1e9, NAN]))[0] == LARGEST_SCORE


def test_replicates_determine_location_and_scatter() -> None:
    """For 4000 normal ones within 5 standard errors: 1.25 sigma / sqrt(n) of a median, sigma / sqrt(2 n)."""
    random = np.random.default_rng(2)
    replicates = random.normal([3.0, -7.0], [0.1, 10.0], (4000, 2))
    found = likelihood_of(replicates, np.zeros(2))
    assert abs(found.location[0] - 3.0) < 5 * 1.25 * 0.1 / 4000**0.5
    assert abs(found.location[1] + 7.0) < 5 * 1.25 * 10 / 4000**0.5
    np.testing.assert_allclose(found.scale, [0.1, 10.0], rtol=5 / 8000**0.5)
    assert found.always.all()
    assert not found.never.any()


def test_one_outlying_replicate_has_little_effect() -> None:
    """It is limited to five of the median distances, 5 x 0.67 sigma x 1.4826 = 5 sigma: of 60 it adds
    25 / 60 at most.
    """
    values = np.random.default_rng(3).normal(size=(60, 1))
    wild = values.copy()
    wild[7] = 1e6
    before, after = (likelihood_of(one, np.zeros(1)) for one in (values, wild))
    assert after.scale[0] < math.sqrt(before.scale[0] ** 2 + 40 / 60)
    assert after.location[0] == pytest.approx(before.location[0], abs=0.2)


def test_a_wide_scatter_of_half_of_the_replicates_is_not_limited() -> None:
    """Half are nearly equal, half normal with a standard deviation of 1: a tenth of all is beyond c = 1.282, and is
    limited to c; with 2 c phi(c) = 0.4499 the mean square is (0.8 - 0.4499 + 0.2 c^2) / 2, and its root 0.583.
    """
    values = np.random.default_rng(4).normal(0.0, np.repeat([1e-3, 1.0], 4000))[:, None]
    found = likelihood_of(values, np.zeros(1))
    assert found.scale[0] == pytest.approx(0.583, rel=0.03)
    assert np.abs(found.scores(values)).max() < 4.5 / 0.583  # largest of 4000 normal ones


def test_a_rarely_present_statistic_has_no_scatter() -> None:
    replicates = np.full((10, 4), NAN)
    replicates[:4, 1], replicates[:6, 2], replicates[:, 3] = 1.0, 1.0, 1.0
    found = likelihood_of(replicates, np.full(4, 0.5))
    np.testing.assert_array_equal(np.isfinite(found.location), [False, False, True, True])
    np.testing.assert_array_equal(found.always, [False, False, False, True])
    np.testing.assert_array_equal(found.never, [True, False, False, False])
    np.testing.assert_allclose(found.scale[2:], 0.5)  # no finer than the floor


@given(st.integers(1, 6), st.integers(2, 6))
@settings(max_examples=examples(12), deadline=None)
def test_copies_are_counted_once(copies: int, independent: int) -> None:
    """k copies of m independent statistics, of any size and sign: m of k m are independent. 2000 replicates: what
    chance adds scatters by less than 1 %.
    """
    random = np.random.default_rng((copies, independent))
    drawn = random.normal(size=(2000, independent))
    scores = np.repeat(drawn, copies, axis=1) * random.choice([-2.0, 0.5, 1.0], independent * copies)
    assert independent_share(scores) == pytest.approx(1 / copies, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("rho", some([0.0, 0.3, 0.7, 0.95], 1))
def test_correlated_statistics_are_counted_in_part(rho: float) -> None:
    """Blocks of 4 of which any two have correlation rho: each one's squares sum to 1 + 3 rho^2. 5000 replicates."""
    random = np.random.default_rng(5)
    shared, own = random.normal(size=(2, 5000, 6)), random.normal(size=(5000, 24))
    scores = rho**0.5 * np.repeat(shared[0], 4, axis=1) + (1 - rho) ** 0.5 * own
    assert independent_share(scores) == pytest.approx(1 / (1 + 3 * rho**2), rel=0.03)


def test_chance_correlations_of_few_replicates_are_subtracted() -> None:
    """60 replicates of 500 independent ones: chance alone gives squares of 500 x 500 / 60, which are subtracted. Their
    sum scatters by 2 % of that: the share is 1 or little less.
    """
    scores = np.random.default_rng(6).normal(size=(60, 500))
    assert independent_share(scores) > 0.7


def test_missing_or_constant_statistics_do_not_reduce_the_share() -> None:
    """Neither sometimes missing nor constant statistics reduce the weight of the others."""
    drawn = np.random.default_rng(7).normal(size=(2000, 3))
    silent = np.concatenate([drawn, drawn], axis=1)
    more = np.concatenate([silent, np.zeros((2000, 5)), np.full((2000, 4), NAN)], axis=1)
    assert independent_share(more) == pytest.approx(independent_share(silent))
    assert independent_share(np.zeros((10, 4))) == 1.0
    assert independent_share(drawn[:, :1]) == 1.0


@pytest.mark.parametrize("replicates", [7, 8])
def test_the_location_is_the_median(replicates: int) -> None:
    values = np.random.default_rng(1).normal(size=(replicates, 5))
    values[0, 1] = np.nan
    np.testing.assert_array_equal(likelihood_of(values, np.zeros(5)).location, np.nanmedian(values, axis=0))


@given(
    seed=st.integers(0, 2**31),
    lost_here=st.lists(st.booleans(), min_size=12, max_size=12),
    lost_there=st.lists(st.booleans(), min_size=12, max_size=12),
)
def test_dropping_columns_changes_no_other_score(seed: int, lost_here: list[bool], lost_there: list[bool]) -> None:
    """For any columns that the recording or the replicates lack: these have no score, all others are unchanged."""
    random = np.random.default_rng(seed)
    replicates, recording = random.normal(size=(30, 12)), random.normal(size=12)
    whole = likelihood_of(replicates, np.zeros(12)).scores(recording)
    here, there = np.array(lost_here), np.array(lost_there)
    found = likelihood_of(np.where(there, NAN, replicates), np.zeros(12)).scores(np.where(here, NAN, recording))
    assert np.array_equal(np.isnan(found), here | there)
    np.testing.assert_array_equal(found[~(here | there)], whole[~(here | there)])
