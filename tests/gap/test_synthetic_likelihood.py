"""Densities against scipy's, the share that is independent against correlations that are known."""

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
def test_density_is_students(location: float, scale: float, one: float, other: float) -> None:
    """Up to a constant: differences are those of the t distribution."""
    model = likelihood([location] * 2, [scale] * 2)
    values = location + scale * np.array([one, other])
    found = model.log_density(values)
    expected = stats.t.logpdf(values, FREEDOM, location, scale)
    assert found[0] - found[1] == pytest.approx(expected[0] - expected[1], abs=1e-6)
    constant = stats.t.logpdf(0.0, FREEDOM)
    np.testing.assert_allclose(found + constant, expected, atol=1e-6)


def test_what_a_score_costs() -> None:
    """z = 3, 10, 100 cost 3.1, 9.1 and 22.8 nats, and nothing costs more."""
    model = likelihood([0.0] * 4, [1.0] * 4)
    found = model.log_density(np.array([3.0, 10.0, 100.0, 1e9]))
    np.testing.assert_allclose(-found, [3.09, 9.13, 22.81, 22.81], atol=0.01)


def test_what_an_effect_moves_may_be_off_by_a_share() -> None:
    """Moved by 20 standard deviations, it may be 1 standard deviation off: variances add."""
    model = likelihood([20.0], [1.0])
    found = model.log_density(np.array([23.0]), np.array([20.0]))
    width = math.sqrt(1 + (20 * FORM) ** 2)
    expected = stats.t.logpdf(3.0, FREEDOM, 0.0, width) - stats.t.logpdf(0.0, FREEDOM)
    assert found[0] == pytest.approx(expected)
    unmoved = model.log_density(np.array([23.0]), np.array([NAN]))
    assert unmoved[0] == pytest.approx(model.log_density(np.array([23.0]))[0])


def test_silence_says_nothing_where_it_is_usual() -> None:
    """Neither what is now there and now not, nor what is never there, nor what the fit makes the same every time."""
    model = likelihood([0.0, NAN, 5.0], [2.0, NAN, 1e-9], never=[False, True, False])
    np.testing.assert_array_equal(model.log_density(np.array([NAN, NAN, 5.0 + 1e-8])), 0.0)
    np.testing.assert_array_equal(model.scores(np.array([NAN, NAN, 5.0])), [NAN, NAN, 0.0])
    apart = model.log_density(np.array([NAN, NAN, 5.1]))
    assert apart[2] < -1.0  # what is always the same, and another one here, does say something


def test_what_one_side_lacks_is_missing() -> None:
    """It has no score; a model under which a recorded statistic vanishes pays for it as for the largest score."""
    model = likelihood([1.0, NAN], [2.0, NAN], always=[True, False], never=[False, True])
    np.testing.assert_array_equal(model.scores(np.array([NAN, 3.0])), NAN)
    cost = stats.t.logpdf(0.0, FREEDOM) - stats.t.logpdf(LARGEST_SCORE, FREEDOM)
    np.testing.assert_allclose(model.log_density(np.array([NAN, 3.0])), [0.0, -cost])
    assert model.scores(np.array([1e9, NAN]))[0] == LARGEST_SCORE


def test_replicates_tell_middle_and_scatter() -> None:
    """Of 4000 normal ones within 5 standard errors: 1.25 sigma / sqrt(n) of a median, sigma / sqrt(2 n)."""
    random = np.random.default_rng(2)
    replicates = random.normal([3.0, -7.0], [0.1, 10.0], (4000, 2))
    found = likelihood_of(replicates, np.zeros(2))
    assert abs(found.location[0] - 3.0) < 5 * 1.25 * 0.1 / 4000**0.5
    assert abs(found.location[1] + 7.0) < 5 * 1.25 * 10 / 4000**0.5
    np.testing.assert_allclose(found.scale, [0.1, 10.0], rtol=5 / 8000**0.5)
    assert found.always.all()
    assert not found.never.any()


def test_one_wild_replicate_does_little() -> None:
    """It counts as five of the median distances, 5 x 0.67 sigma x 1.4826 = 5 sigma: of 60 it adds 25 / 60 at most."""
    values = np.random.default_rng(3).normal(size=(60, 1))
    wild = values.copy()
    wild[7] = 1e6
    before, after = (likelihood_of(one, np.zeros(1)) for one in (values, wild))
    assert after.scale[0] < math.sqrt(before.scale[0] ** 2 + 40 / 60)
    assert after.location[0] == pytest.approx(before.location[0], abs=0.2)


def test_what_scatters_widely_in_half_of_the_replicates_is_not_wild() -> None:
    """Half are nearly alike, half normal with a standard deviation of 1: a tenth of all is beyond c = 1.282, and counts
    as c; with 2 c phi(c) = 0.4499 the mean square is (0.8 - 0.4499 + 0.2 c^2) / 2, and its root 0.583.
    """
    values = np.random.default_rng(4).normal(0.0, np.repeat([1e-3, 1.0], 4000))[:, None]
    found = likelihood_of(values, np.zeros(1))
    assert found.scale[0] == pytest.approx(0.583, rel=0.03)
    assert np.abs(found.scores(values)).max() < 4.5 / 0.583  # of 4000 normal ones, the largest


def test_what_is_seldom_said_has_no_scatter() -> None:
    replicates = np.full((10, 4), NAN)
    replicates[:4, 1], replicates[:6, 2], replicates[:, 3] = 1.0, 1.0, 1.0
    found = likelihood_of(replicates, np.full(4, 0.5))
    np.testing.assert_array_equal(np.isfinite(found.location), [False, False, True, True])
    np.testing.assert_array_equal(found.always, [False, False, False, True])
    np.testing.assert_array_equal(found.never, [True, False, False, False])
    np.testing.assert_allclose(found.scale[2:], 0.5)  # no finer than the floor


@given(st.integers(1, 6), st.integers(2, 6))
@settings(max_examples=examples(12), deadline=None)
def test_copies_count_once(copies: int, independent: int) -> None:
    """k copies of m independent statistics, in whatever size and sign: m of k m are independent. 2000 replicates: what
    chance adds scatters by less than 1 %.
    """
    random = np.random.default_rng((copies, independent))
    drawn = random.normal(size=(2000, independent))
    scores = np.repeat(drawn, copies, axis=1) * random.choice([-2.0, 0.5, 1.0], independent * copies)
    assert independent_share(scores) == pytest.approx(1 / copies, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("rho", some([0.0, 0.3, 0.7, 0.95], 1))
def test_what_is_correlated_counts_in_part(rho: float) -> None:
    """Blocks of 4 of which any two have correlation rho: each one's squares sum to 1 + 3 rho^2. 5000 replicates."""
    random = np.random.default_rng(5)
    shared, own = random.normal(size=(2, 5000, 6)), random.normal(size=(5000, 24))
    scores = rho**0.5 * np.repeat(shared[0], 4, axis=1) + (1 - rho) ** 0.5 * own
    assert independent_share(scores) == pytest.approx(1 / (1 + 3 * rho**2), rel=0.03)


def test_few_replicates_of_many_statistics_are_no_correlation() -> None:
    """60 replicates of 500 independent ones: chance alone makes squares of 500 x 500 / 60, which are taken off. Their
    sum scatters by 2 % of that: the share is 1 or little less.
    """
    scores = np.random.default_rng(6).normal(size=(60, 500))
    assert independent_share(scores) > 0.7


def test_what_says_nothing_is_no_statistic() -> None:
    """Neither what is missing now and then nor what never changes makes the others count less."""
    drawn = np.random.default_rng(7).normal(size=(2000, 3))
    silent = np.concatenate([drawn, drawn], axis=1)
    more = np.concatenate([silent, np.zeros((2000, 5)), np.full((2000, 4), NAN)], axis=1)
    assert independent_share(more) == pytest.approx(independent_share(silent))
    assert independent_share(np.zeros((10, 4))) == 1.0
    assert independent_share(drawn[:, :1]) == 1.0


@pytest.mark.parametrize("replicates", [7, 8])
def test_the_middle_is_the_median(replicates: int) -> None:
    values = np.random.default_rng(1).normal(size=(replicates, 5))
    values[0, 1] = np.nan
    np.testing.assert_array_equal(likelihood_of(values, np.zeros(5)).location, np.nanmedian(values, axis=0))


@given(
    seed=st.integers(0, 2**31),
    lost_here=st.lists(st.booleans(), min_size=12, max_size=12),
    lost_there=st.lists(st.booleans(), min_size=12, max_size=12),
)
def test_dropping_columns_changes_no_other_score(seed: int, lost_here: list[bool], lost_there: list[bool]) -> None:
    """Whatever columns the recording or the replicates lack: these have no score, all others the one they had."""
    random = np.random.default_rng(seed)
    replicates, recording = random.normal(size=(30, 12)), random.normal(size=12)
    whole = likelihood_of(replicates, np.zeros(12)).scores(recording)
    here, there = np.array(lost_here), np.array(lost_there)
    found = likelihood_of(np.where(there, NAN, replicates), np.zeros(12)).scores(np.where(here, NAN, recording))
    assert np.array_equal(np.isnan(found), here | there)
    np.testing.assert_array_equal(found[~(here | there)], whole[~(here | there)])
