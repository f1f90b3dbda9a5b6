"""Sums of a statistic over both parts, and the scatter of such sums."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import ABSENT, LEAST, Pairs, pairs_of, spread_of

NAN = math.nan

BOTH = Pairs((), np.array([0, 1, ABSENT]), np.array([2, ABSENT, 3]))
"""Of four statistics: one in both parts, one in each alone."""


def key(name: str, log: int = 0) -> Key:
    return Key(log, name, "x", "static", 0, "level", "mean")


def test_a_sum_is_over_the_parts_with_a_value() -> None:
    """The sum of two independent standard scores over the root of two is standard; a single score is unchanged."""
    np.testing.assert_allclose(BOTH.sums(np.array([3.0, -2.0, 1.0, 7.0])), [4 / 2**0.5, -2.0, 7.0])
    np.testing.assert_allclose(BOTH.sums(np.array([3.0, NAN, NAN, 7.0])), [3.0, NAN, 7.0])
    np.testing.assert_allclose(BOTH.sums(np.array([NAN, 1.0, -4.0, NAN])), [-4.0, 1.0, NAN])
    np.testing.assert_allclose(BOTH.sums(np.full(4, NAN)), [NAN] * 3)


def test_means_are_over_the_parts_with_a_value() -> None:
    np.testing.assert_allclose(BOTH.means(np.array([3.0, -2.0, 1.0, 7.0])), [2.0, -2.0, 7.0])
    np.testing.assert_allclose(BOTH.means(np.array([NAN, -2.0, 1.0, NAN])), [1.0, -2.0, NAN])


@given(st.lists(st.lists(st.one_of(st.just(NAN), st.floats(-1e6, 1e6)), min_size=4, max_size=4), max_size=5))
def test_each_replicate_is_summed(rows: list[list[float]]) -> None:
    scores = np.array(rows).reshape(-1, 4)
    every = BOTH.sums(scores)
    assert every.shape == (len(rows), 3)
    for row, sums in zip(scores, every, strict=True):
        np.testing.assert_array_equal(BOTH.sums(row), sums)


@given(st.sets(st.text("abc", min_size=1, max_size=2)), st.sets(st.text("abc", min_size=1, max_size=2)))
def test_pairs_have_the_same_key(train: set[str], held_out: set[str]) -> None:
    """Each key once; the places of both parts are the original ones."""
    keys = [*map(key, sorted(train)), *map(key, sorted(held_out, reverse=True))]
    pairs = pairs_of(keys, [False] * len(train) + [True] * len(held_out))
    assert set(pairs.keys) == set(keys)
    assert len(pairs.keys) == len(set(keys))
    for one, first, second in zip(pairs.keys, pairs.train, pairs.held_out, strict=True):
        assert (first != ABSENT) == (one.sensor in train)
        assert (second != ABSENT) == (one.sensor in held_out)
        assert first == ABSENT or (keys[first] == one and first < len(train))
        assert second == ABSENT or (keys[second] == one and second >= len(train))


def test_the_spread_of_standard_sums() -> None:
    """1 if parts are independent, the root of two if they are the same, the root of a half if the fit makes one of them
    zero: 2000 replicates, each within 5 standard errors of 1 / sqrt(4000).
    """
    random = np.random.default_rng(1)
    one, other = random.normal(size=(2, 2000))
    pair = Pairs((), np.array([0]), np.array([1]))
    for scores, expected in (((one, other), 1.0), ((one, one), 2**0.5), ((0 * one, other), 0.5**0.5)):
        spread = spread_of(pair.sums(np.stack(scores, axis=1)))
        assert spread[0] == pytest.approx(expected, rel=0.08)


def test_a_spread_has_a_lower_limit_and_outliers_have_little_weight() -> None:
    """No values, equal values, and one value of 100 in 50: squares are limited to those of 5."""
    sums = np.zeros((50, 3))
    sums[:, 0] = NAN
    sums[3, 2] = 100.0
    sums[:, 2] += np.where(np.arange(50) % 2, 1.0, -1.0) * (np.arange(50) != 3)
    np.testing.assert_allclose(spread_of(sums), [LEAST, LEAST, math.sqrt((49 + 25) / 50)])
