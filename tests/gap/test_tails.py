"""Normal scores: sizes of the same probability of being exceeded become equal, for any tails."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from imuarray.gap.inference.assessment import p_value
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.tails import (
    FREEDOMS,
    HEAVIER,
    NO_TAILS,
    THRESHOLD,
    RareTail,
    Tail,
    Tails,
    normal_scores_by_others,
    tails_of,
)

REPLICATES = 41


def keys(count: int, probe: str, sensor: str = "G1") -> list[Key]:
    return [Key(0, sensor, "x", "static", number, "level", probe) for number in range(count)]


def test_a_tail_has_the_shares_of_students_t() -> None:
    """t of two degrees of freedom: P(|t| > x) = 1 - x / sqrt(x^2 + 2); the normal deviation of the share 0.3173 is 1,
    of 0.0455 it is 2.
    """
    for share, deviation in ((0.31731, 1.0), (0.04550, 2.0)):
        size = (1 - share) * (2 / (1 - (1 - share) ** 2)) ** 0.5
        assert Tail(2.0, 3.0).normal(np.array([3.0 * size]))[0] == pytest.approx(deviation, abs=1e-3)


@given(st.sampled_from(FREEDOMS), st.floats(0.1, 5.0), st.floats(0.0, 40.0), st.floats(0.01, 10.0))
def test_normal_scores_keep_the_order(freedom: float, scale: float, size: float, more: float) -> None:
    """Scores of both signs: their normal scores ascend, and opposite scores have opposite ones."""
    tails = Tails({("noise", "G1"): Tail(freedom, scale)})
    normal = tails.normal(np.array([-size - more, -size, size, size + more]), keys(4, "noise"))
    assert normal[0] < normal[1] <= 0 <= normal[2] < normal[3]
    np.testing.assert_array_equal(normal, -normal[::-1])


def test_heavy_and_light_tails_become_equal() -> None:
    """For normal scores and t scores with 4 degrees of freedom, 4000 of each, the 99.9 % quantile is 3.29."""
    stream = np.random.default_rng(1)
    scores = np.concatenate([stream.normal(size=(40, 100)), stream.standard_t(4.0, size=(40, 100))], axis=1)
    both = [*keys(100, "noise"), *keys(100, "mean")]
    tails = tails_of(scores, both)
    normal = np.array([tails.normal(row, both) for row in scores])
    assert np.quantile(np.abs(scores[:, 100:]), 0.999) > 6
    for half in (normal[:, :100], normal[:, 100:]):
        assert np.quantile(np.abs(half), 0.999) == pytest.approx(3.29, abs=0.6)
    np.testing.assert_array_equal(np.sign(normal), np.sign(scores))


def test_a_deviation_among_heavy_tails_is_detected() -> None:
    """One of 60 normal scores of a recording is 6, together with 60 heavy-tailed ones, which are far larger in
    replicates.
    """
    stream = np.random.default_rng(2)
    scores = np.concatenate(
        [stream.normal(size=(REPLICATES, 60)), stream.standard_t(4.0, size=(REPLICATES, 60))], axis=1
    )
    scores[0, 60:] = 0.5
    scores[0, 7] = 6.0
    largest = np.abs(scores).max(axis=1)
    normal = np.abs(normal_scores_by_others(scores, [*keys(60, "noise"), *keys(60, "mean")])).max(axis=1)
    assert p_value(float(largest[0]), largest[1:]) > 0.05
    assert p_value(float(normal[0]), normal[1:]) == pytest.approx(1 / REPLICATES)


def mixture(stream: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return scores (b, count): zero, and one in 30 of 5 to 15."""
    shape = (REPLICATES, count)
    return np.where(stream.random(shape) < 1 / 30, stream.uniform(5.0, 15.0, shape), 0.0)


def test_a_deviation_beside_a_mixture_is_detected() -> None:
    """One of 60 normal scores of a recording is 6. A rare part of another statistic reaches 15 in most replicates."""
    stream = np.random.default_rng(6)
    scores = np.concatenate([stream.normal(size=(REPLICATES, 60)), mixture(stream, 60)], axis=1)
    scores[0, 60:] = 0.0
    scores[0, 7] = 6.0
    largest = np.abs(scores).max(axis=1)
    both = [*keys(60, "noise"), *keys(60, "stale")]
    normal = np.abs(normal_scores_by_others(scores, both)).max(axis=1)
    assert p_value(float(largest[0]), largest[1:]) > 0.5
    assert p_value(float(normal[0]), normal[1:]) == pytest.approx(1 / REPLICATES)
    tails = tails_of(scores[1:], both)
    assert set(tails.mixtures) == {("stale", "G1")}
    assert tails.normal(scores[0], both)[7] == pytest.approx(normal[0], rel=0.2)


def test_the_rare_part_of_a_mixture_has_its_share() -> None:
    """One in 30 of 4000 scores is 3 or more, with a mean excess of 3. The exponential tail has the share 1/30 exp(-x/3)
    of excesses of x: 1/3000, which is a normal score of 3.403, at x = 3 ln 100. Smaller scores keep their order.
    """
    stream = np.random.default_rng(7)
    scores = np.where(stream.random((40, 100)) < 1 / 30, 3.0 + stream.exponential(3.0, (40, 100)), 0.0)
    rare = tails_of(scores, keys(100, "stale")).mixtures["stale", "G1"]
    assert rare.threshold == THRESHOLD == 3.0
    assert rare.share == pytest.approx(1 / 30, rel=0.3)
    assert rare.mean_excess == pytest.approx(3.0, rel=0.3)
    sizes = np.array([0.0, 2.9, 3.1, 5.0, 3 + 3 * np.log(100), 40.0])
    reduced = RareTail(3.0, 1 / 30, 3.0).reduced(sizes, sizes)
    np.testing.assert_allclose(reduced[:5], [0.0, 2.9, 3.0, 3.0, 3.403], atol=1e-3)
    assert reduced[5] > 4.5


@pytest.mark.slow
def test_p_values_beside_a_mixture_are_uniform() -> None:
    """Of 400 recordings like their replicates, p is 1/20 or less in a twentieth: 20, and at most 35 with a probability
    of 0.999 (binomial).
    """
    both, detected = [*keys(20, "noise"), *keys(20, "stale")], 0
    for seed in range(400):
        stream = np.random.default_rng((8, seed))
        scores = np.concatenate([stream.normal(size=(REPLICATES, 20)), mixture(stream, 20)], axis=1)
        largest = np.abs(normal_scores_by_others(scores, both)).max(axis=1)
        detected += p_value(float(largest[0]), largest[1:]) <= 0.05
    assert 8 <= detected <= 35


@pytest.mark.slow
def test_p_values_without_a_gap_are_uniform() -> None:
    """Of 400 recordings like their replicates, p is 1/20 or less in a twentieth: 20, and at most 35 with a probability
    of 0.999 (binomial).
    """
    both, detected = [*keys(20, "noise"), *keys(20, "mean")], 0
    for seed in range(400):
        stream = np.random.default_rng((3, seed))
        scores = np.concatenate([stream.normal(size=(40, 20)), stream.standard_t(2.0, size=(40, 20))], axis=1)
        largest = np.abs(normal_scores_by_others(scores, both)).max(axis=1)
        detected += p_value(float(largest[0]), largest[1:]) <= 0.05
    assert 8 <= detected <= 35


def test_rare_and_missing_values_are_unchanged() -> None:
    """Shares that are zero in nearly all replicates have no tail; a missing score stays missing."""
    scores = np.zeros((REPLICATES, 3))
    scores[0] = [9.0, 0.0, np.nan]
    np.testing.assert_array_equal(normal_scores_by_others(scores, keys(3, "gaps")), scores)
    np.testing.assert_array_equal(NO_TAILS.normal(scores[0], keys(3, "gaps")), scores[0])


def test_each_campaign_is_scored_by_the_others() -> None:
    """Ten scores of 50 of one campaign do not widen the tail used for them: 50 is far beyond that of the others."""
    scores = np.random.default_rng(4).normal(size=(REPLICATES, 30))
    scores[0, :10] = 50.0
    assert normal_scores_by_others(scores, keys(30, "noise"))[0].max() > 9


def test_a_score_far_beyond_chance_remains_so() -> None:
    """Two of 40 replicates have scores of 10 on three axes, the recording one of 60 among 200 normal ones: no tail is
    so heavy that this is chance.
    """
    scores = np.random.default_rng(5).normal(size=(REPLICATES, 203))
    scores[[5, 9], :3] = 10.0
    scores[0, 0] = 60.0
    normal = np.abs(normal_scores_by_others(scores, [*keys(3, "thermal_slope"), *keys(200, "noise")])).max(axis=1)
    assert p_value(float(normal[0]), normal[1:]) == pytest.approx(1 / REPLICATES)


def test_a_mostly_zero_statistic_has_no_short_tail() -> None:
    """Most scores are 0, one in eight is 0.06: one of 0.6 is no deviation, and one of 6 is."""
    several = keys(24, "stale")
    chance = np.where(np.arange(40 * 24).reshape(40, 24) % 8 == 0, 0.06, 0.0)
    scores = np.array([0.6, -6.0, *np.zeros(22)])
    normal = tails_of(chance, several).normal(scores, several)
    assert 0 < normal[0] < 1.5
    assert normal[1] < -5.0


def test_scores_that_do_not_determine_the_tail_are_treated_as_normal() -> None:
    """In 9 of 200 draws of 120 normal scores fewer than 20 degrees of freedom are chosen; without a prior in 31."""
    assert HEAVIER == 1.0
    names = [("noise", f"G{number}") for number in range(200)]
    every = [key for probe, sensor in names for key in keys(3, probe, sensor)]
    tails = tails_of(np.random.default_rng(3).standard_normal((40, len(every))), every)
    heavy = sum(tails.by_statistic[name].freedom < 20 for name in names)
    assert 1 <= heavy <= 15
