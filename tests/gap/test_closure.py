"""Closed shares of scores made by hand, and the coverage of their interval."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.gap.findings.verdict import (
    BEYOND_CHOICE,
    BY_ITSELF,
    DEVIATES,
    LARGEST,
    DeviatingStatistics,
    deviating,
    deviating_in_either,
)
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import ABSENT, Pairs, pairs_of
from tests.selection import examples

Floats = npt.NDArray[np.float64]

NAN = math.nan


def key(domain: str = "level", number: int = 0, sensor: str = "A1", probe: str = "mean") -> Key:
    return Key(0, sensor, "x", "static", number, domain, probe)  # type: ignore[arg-type]


def counted(domains: list[str], before: list[float], after: list[float]) -> DeviatingStatistics:
    """Scores that deviate in both parts, the training part as `before`."""
    keys = [key(domain, number) for number, domain in enumerate(domains)]
    pairs = pairs_of([*keys, *keys], [False] * len(keys) + [True] * len(keys))
    scores = [np.array([*part, *part]) for part in (before, after)]
    return deviating(pairs, scores[0], scores[1], np.zeros(2 * len(keys), bool))


def test_the_share_of_the_excess() -> None:
    """Squares 25 and 1 (chance): excess 24; 13 after, excess 12: half is closed."""
    found = counted(["level"], [5.0], [13**0.5]).closure(0)
    assert found.before == pytest.approx(5.0)
    assert found.after == pytest.approx(13**0.5)
    assert found.closed == pytest.approx(0.5)
    assert found.interval is not None
    low, high = found.interval
    assert low < 0.5 < high  # also for a single score


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(1, 10), st.floats(4, 90), st.floats(0, 90), st.floats(4, 90), st.floats(0, 90))
def test_domains_have_equal_weights(count: int, one: float, one_after: float, other: float, other_after: float) -> None:
    """For any number of statistics of a domain: the mean over domains of their mean squares. The closed share is at
    most one.
    """
    found = counted(["level"] * count + ["spectrum"], [one] * count + [-other], [one_after] * count + [-other_after])
    before, after = (one**2 + other**2) / 2, (one_after**2 + other_after**2) / 2
    shrunk = found.closure(1)
    assert shrunk.before == pytest.approx(before**0.5)
    assert shrunk.after == pytest.approx(
        after**0.5, abs=1e-7
    )  # 1 is subtracted from the square and added: root of its rounding
    assert shrunk.closed == pytest.approx(min(1 - (after - 1) / (before - 1), 1.0))
    assert found.domains() == ("level", "spectrum")
    level = found.of(np.array([True] * count + [False])).closure(1)
    assert level.closed == pytest.approx(min(1 - (one_after**2 - 1) / (one**2 - 1), 1.0))


@settings(max_examples=examples(30), deadline=None)
@given(st.lists(st.floats(4, 90), min_size=1, max_size=20), st.integers(0, 5))
def test_unchanged_scores_close_nothing_and_scores_of_chance_close_all(scores: list[float], seed: int) -> None:
    domains = ["level", "allan"] * len(scores)
    same = counted(domains[: len(scores)], scores, scores).closure(seed)
    assert (same.closed, same.interval) == (pytest.approx(0), pytest.approx((0, 0)))
    right = counted(domains[: len(scores)], scores, [1.0] * len(scores)).closure(seed)
    assert right.closed == pytest.approx(1)
    assert right.interval is not None
    assert right.interval[1] == pytest.approx(1)


def test_scores_are_limited_to_the_largest() -> None:
    assert counted(["level"], [1e6], [1.0]).closure(0).before == pytest.approx(LARGEST)


def test_without_deviations_no_closure_is_stated() -> None:
    assert counted(["level"], [1.0], [1.0]).closure(0) == (1.0, 1.0, None, None)


def test_no_closure_is_stated_without_a_held_out_excess() -> None:
    """The statistic deviates on the training part alone: on held-out data its score is that of chance."""
    one = key()
    pairs = pairs_of([one, one], [False, True])
    found = deviating(pairs, np.array([9.0, 1.2]), np.array([1.0, 0.3]), np.zeros(2, bool)).closure(0)
    assert found.before == pytest.approx(1.2)
    assert (found.closed, found.interval) == (None, None)


def test_statistics_are_selected_on_the_training_part() -> None:
    """The last has a value on the training part only; the fourth is zero there because of the fit, and small here; the
    third deviates here only.
    """
    keys = [key(number=number) for number in range(5)]
    pairs = Pairs(tuple(keys), np.arange(5), np.array([5, 6, 7, 8, ABSENT]))
    before = np.array([9.0, -9.0, 1.0, 9.0, 9.0, 2.0, NAN, BEYOND_CHOICE - 0.1, 4.0])
    found = deviating(pairs, before, before / 2, np.arange(9) == 3)
    assert found.keys == (keys[0],)
    np.testing.assert_array_equal(found.before, [2.0])
    np.testing.assert_array_equal(found.after, [1.0])


def test_statistics_beyond_chance_on_the_held_out_part_are_always_selected() -> None:
    """Of four thousand normal scores the largest is beyond this in one of ten billion draws."""
    keys = [key(number=number) for number in range(2)]
    pairs = Pairs(tuple(keys), np.arange(2), np.arange(2, 4))
    before = np.array([9.0, 1.0, 4.0, -BEYOND_CHOICE - 0.1])
    counted = deviating(pairs, before, np.zeros(4), np.zeros(4, bool))
    assert counted.keys == tuple(keys)
    assert 4000 * math.erfc(BEYOND_CHOICE / math.sqrt(2)) < 1e-10


def test_statistics_of_the_held_out_part_alone_are_selected_there() -> None:
    """Where the training part has no value, or the fit makes it zero: further from zero than those in both parts."""
    keys = [key(number=number) for number in range(5)]
    pairs = Pairs(tuple(keys), np.array([ABSENT, ABSENT, 0, 1, 2]), np.arange(3, 8))
    train, held_out = [NAN, 0.0, 0.0], [BY_ITSELF + 0.1, BY_ITSELF - 0.1, 8.0, 8.0, 8.0]
    found = deviating(pairs, np.array([*train, *held_out]), np.full(8, NAN), np.arange(8) == 1)
    assert found.keys == (keys[0], keys[2], keys[3])
    np.testing.assert_array_equal(found.after, 0.0)  # no value with the causes in the model: no remainder


def test_the_held_out_part_selects_where_nothing_else_deviates() -> None:
    keys = [key(number=number) for number in range(2)]
    pairs = Pairs(tuple(keys), np.arange(2), np.arange(2, 4))
    before = np.array([DEVIATES - 0.1, 0.0, DEVIATES - 0.1, DEVIATES + 0.1])
    assert deviating(pairs, before, before, np.zeros(4, bool)).keys == (keys[1],)


@pytest.mark.slow
def test_the_interval_covers() -> None:
    """40 blocks of 3 correlated scores, of standard deviation 10 before and sqrt(10.9) after: of the excess 99 9.9
    remains, 90 % is closed. In 150 campaigns a 95 % bootstrap interval of 40 blocks covers it in 0.85 or more of all;
    at least 115 of 150 have a probability of 0.996 at that rate.
    """
    random, covered = np.random.default_rng(8), 0
    for seed in range(150):
        before, after = (np.repeat(random.normal(0, sigma, 40), 3) for sigma in (10.0, 10.9**0.5))
        keys = tuple(key(number=block, probe=f"{part}") for block in range(40) for part in range(3))
        found = DeviatingStatistics(
            keys, np.arange(120), np.full(120, 1 / 120), np.clip(before, -99, 99), after
        ).closure(seed)
        assert found.interval is not None
        low, high = found.interval
        assert low <= high
        covered += low <= 0.9 <= high
    assert covered >= 115


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [1, 2, 3, 6])
def test_the_interval_of_a_few_blocks_covers(blocks: int) -> None:
    """Three scores each, about 10 before and a share of that with the same sign after; chance adds one standard
    deviation to both. At least 134 of 150 have a probability of 0.96 for an interval that covers 0.925 of all.
    """
    random, covered = np.random.default_rng(blocks), 0
    keys = tuple(key(number=block, probe=f"{part}") for block in range(blocks) for part in range(3))
    for seed in range(150):
        off = np.repeat(random.choice((-10.0, 10.0), blocks), 3) * random.uniform(0.5, 1.5, 3 * blocks)
        left = off * np.repeat(random.normal(0, 0.3, blocks), 3)
        chance = random.normal(size=len(keys))
        found = DeviatingStatistics(
            keys, np.arange(len(keys)), np.full(len(keys), 1 / len(keys)), off + chance, left + chance
        ).closure(seed)
        assert found.interval is not None
        low, high = found.interval
        covered += low <= 1 - (left**2).sum() / (off**2).sum() <= high
    assert covered >= 134


def test_the_interval_depends_on_the_seed_only() -> None:
    values = np.random.default_rng(9).normal(10, 3, 12).tolist()
    made = counted(["level"] * 12, values, [value / 3 for value in values])
    assert made.closure(4) == made.closure(4)
    assert made.closure(4).interval != made.closure(5).interval


def test_events_of_one_part_are_counted_in_that_part() -> None:
    """Squares 400 and 900 minus chance: half of the first remains and none of the second, 199.5 of 1298."""
    keys = [key(number=number) for number in range(3)]
    pairs = pairs_of([*keys, *keys], [False] * 3 + [True] * 3)
    before = np.array([20.0, 0.3, 4.0, 1.0, 30.0, NAN])
    found = deviating_in_either(pairs, before, np.array([200**0.5, 50.0, 50.0, 50.0, 1.0, 50.0]))
    assert found.keys == (keys[0], keys[1])
    assert found.places.tolist() == [0, 4]
    assert found.closure(0).closed == pytest.approx(1 - 199 / 1298)
