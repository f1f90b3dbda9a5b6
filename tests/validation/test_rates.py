"""Statistics of rates against closed forms, brute force and all permutations."""

from __future__ import annotations

from itertools import permutations
from math import inf, isnan, nan, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.validation.rates import (
    auroc,
    bootstrap,
    bootstrap_groups,
    brier,
    calibration_error,
    calibration_error_by_chance,
    limit_of,
    permute_labels,
    rate,
    reliability,
)

Z = 1.959963984540054
"""97.5 % quantile of the normal distribution."""
scores = st.lists(st.integers(0, 6).map(float), min_size=1, max_size=12)


@given(st.integers(1, 400).flatmap(lambda cases: st.tuples(st.integers(0, cases), st.just(cases))))
def test_intervals_equal_wilsons(counts: tuple[int, int]) -> None:
    """The roots of (p - share)^2 = z^2 p (1 - p) / n."""
    hits, cases = counts
    share = hits / cases
    middle = (share + Z**2 / (2 * cases)) / (1 + Z**2 / cases)
    half = Z / (1 + Z**2 / cases) * sqrt(share * (1 - share) / cases + Z**2 / (4 * cases**2))
    assert rate(hits, cases) == pytest.approx((share, max(middle - half, 0), min(middle + half, 1), cases), abs=1e-12)


def test_zero_cases_have_no_rate() -> None:
    value, low, high, cases = rate(0, 0)
    assert isnan(value) and isnan(low) and isnan(high) and cases == 0


@given(scores, scores)
def test_area_under_the_curve_counts_pairs(positives: list[float], negatives: list[float]) -> None:
    pairs = [(positive > negative) + 0.5 * (positive == negative) for positive in positives for negative in negatives]
    assert auroc(positives, negatives) == pytest.approx(sum(pairs) / len(pairs))


def test_area_without_positives_or_negatives_is_nan() -> None:
    assert isnan(auroc([], [1.0])) and isnan(auroc([1.0], []))


@given(scores, st.sampled_from([0.0, 0.1, 0.25, 0.5, 1.0]))
def test_a_limit_is_the_least_with_the_stated_share_above(negatives: list[float], most: float) -> None:
    limit = limit_of(negatives, most)
    assert sum(value > limit for value in negatives) <= most * len(negatives) + 1e-9
    lower = max((value for value in negatives if value < limit), default=-inf)
    if limit > -inf:
        assert sum(value > lower for value in negatives) > most * len(negatives)


def test_a_limit_of_ten_values_by_hand() -> None:
    assert limit_of(np.arange(10.0), 0.1) == 8.0
    assert limit_of([], 0.1) == -inf


def test_bins_of_probabilities_by_hand() -> None:
    bins = reliability([0.0, 0.05, 0.1, 0.95, 1.0], [False, True, True, True, True])
    assert len(bins) == 10
    assert bins[0] == pytest.approx((0.0, 0.1, 2, 0.025, 0.5))
    assert bins[1] == pytest.approx((0.1, 0.2, 1, 0.1, 1.0))
    assert bins[9] == pytest.approx((0.9, 1.0, 2, 0.975, 1.0))
    assert bins[5].cases == 0 and isnan(bins[5].right)


@given(st.integers(0, 20), st.integers(1, 20), st.floats(0, 1))
def test_calibration_error_and_brier_score_of_one_probability(hits: int, misses: int, probability: float) -> None:
    """ECE is |p - share|, Brier (p - share)^2 + share (1 - share)."""
    right = [True] * hits + [False] * misses
    share, text = hits / len(right), [probability] * len(right)
    assert calibration_error(text, right) == pytest.approx(abs(probability - share), abs=1e-12)
    assert brier(text, right) == pytest.approx((probability - share) ** 2 + share * (1 - share), abs=1e-12)


def test_errors_of_bins_are_weighted_by_their_cases() -> None:
    """Two at 0.9, one right; one at 0.2, wrong: (2 * 0.4 + 0.2) / 3."""
    assert calibration_error([0.9, 0.9, 0.2], [True, False, False]) == pytest.approx(1 / 3)
    assert isnan(calibration_error([], []))


def test_calibration_error_of_few_right_probabilities() -> None:
    """For n probabilities of a half the share of true events differs by sqrt(1 / (2 pi n)) on average; certainties have
    no error. The mean of 200 such is known to 5 %; 0.2 is four times that.
    """
    assert calibration_error_by_chance(np.full(100, 0.5), seed=1) == pytest.approx(1 / sqrt(200 * pi), rel=0.2)
    assert calibration_error_by_chance(np.ones(7), seed=1) == 0.0


def test_the_interval_of_a_mean_is_that_of_its_standard_error() -> None:
    """400 normal values: 1.96 standard errors to either side; 1000 draws scatter by 4 % of that: six of it."""
    values = np.random.default_rng(5).normal(3.0, 2.0, 400)
    score = bootstrap(lambda drawn: float(np.mean(drawn)), values, seed=1)
    reach = Z * values.std() / 20
    assert score.value == values.mean() and score.cases == 400
    assert score.low == pytest.approx(values.mean() - reach, abs=0.24 * reach)
    assert score.high == pytest.approx(values.mean() + reach, abs=0.24 * reach)
    assert bootstrap(lambda drawn: float(np.mean(drawn)), values, seed=1) == score


def test_a_single_value_has_no_interval() -> None:
    score = bootstrap(max, [2.0], seed=1)
    assert (score.value, score.cases) == (2.0, 1) and isnan(score.low)
    assert bootstrap(max, [], seed=1).cases == 0


def test_whole_groups_are_resampled() -> None:
    """A hundred copies in each of ten groups have the information of ten values: the standard deviation of a share of
    1/2 is 0.16; independent copies would have 0.016.
    """
    groups = [([1.0] * 100, [place % 2 == 0] * 100) for place in range(10)]
    score = bootstrap_groups(lambda said, right: float(np.mean(right)), [*groups, ([], [])], seed=1)
    assert (score.value, score.cases) == (0.5, 1000)
    assert 0.15 <= score.low <= 0.3 and 0.7 <= score.high <= 0.85


@given(st.lists(st.lists(st.booleans(), min_size=4, max_size=4), min_size=4, max_size=4), st.integers(0, 5))
def test_the_p_value_is_that_of_all_permutations(hits: list[list[bool]], seed: int) -> None:
    shares = [sum(row[place] for row, place in zip(hits, order, strict=True)) / 4 for order in permutations(range(4))]
    score = permute_labels(hits, seed)
    assert score.mean == pytest.approx(np.mean(shares))
    assert score.deviation == pytest.approx(np.std(shares), abs=1e-9)
    assert score.hits / 4 in shares


def test_too_few_cases_to_permute_have_no_p_value() -> None:
    assert permute_labels([], 0) == pytest.approx((0, nan, nan), nan_ok=True)
    assert permute_labels([[True]], 0) == (1, 1.0, 0.0)
