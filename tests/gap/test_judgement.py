"""Verdicts and figures of single statistics, on replicates made by hand and on a recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.diagnose import REPAIRED
from imuarray.gap.findings.deviations import StatisticReport, beyond_form, map_of, remainder_of, tail_p, where_of
from imuarray.gap.findings.diagnosis import Cause, Gap
from imuarray.gap.findings.verdict import (
    DOUBT,
    EVEN,
    EXPLAINED,
    PARTLY,
    Judgement,
    deviating,
    floor_of,
    gap_of,
    judge,
    unknown_probability,
)
from imuarray.gap.inference.assessment import Assessment, assess
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import Pairs, pairs_of
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood, likelihood_of
from imuarray.gap.statistics.tails import NO_TAILS
from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.invariants import check_agreement
from tests.gap.search_inputs import found_in
from tests.gap.small_bench import LINE, prepared
from tests.selection import some

Floats = npt.NDArray[np.float64]

CAUSE = Cause("tone", "add", ("G1",), (), 0.9, {}, 0.9, (0.8, 1.0), ())
COUNT = 60
"""Statistics of each part."""


def key(number: int, sensor: str = "G1", domain: Literal["level", "spectrum"] = "level") -> Key:
    return Key(0, sensor, "x", "static", number, domain, "mean")


def paired(keys: Sequence[Key]) -> Pairs:
    return pairs_of([*keys, *keys], [False] * len(keys) + [True] * len(keys))


PAIRS = paired([key(number) for number in range(COUNT)])


def chance(rows: int, seed: int) -> Floats:
    return np.random.default_rng(seed).normal(size=(rows, 2 * COUNT))


def gap(closed: float | None) -> Gap:
    return Gap(9.0, 1.0, 0.9, closed, None if closed is None else (closed, closed))


def after(largest: float, p: float = 0.5, limit: float = 4.0) -> Assessment:
    nothing = np.zeros(1)
    return Assessment(
        np.array([largest]), np.array([largest]), nothing, nothing, SyntheticLikelihood(*(nothing,) * 4), p, limit
    )  # type: ignore[arg-type]


@pytest.mark.slow
def test_p_values_without_a_gap_are_uniform() -> None:
    """Of 150 campaigns without a gap, each with its own 40 replicates, p is 0.1 or less in a tenth: 15, and at most 27
    with a probability of 0.999 (binomial).
    """
    ps = []
    for seed in range(150):
        drawn = chance(41, seed)
        ps.append(assess(PAIRS, drawn[0], drawn[1:], np.zeros(2 * COUNT)).p)
    assert sum(p <= 0.1 for p in ps) <= 27
    assert 0.3 < np.median(ps) < 0.7


def test_deviations_are_scored_in_standard_deviations() -> None:
    """5 in both parts: 5 sqrt(2); 6 in one: 6 / sqrt(2). 120 replicates determine a scatter to 7 %."""
    real = chance(1, 1)[0]
    real[[3, COUNT + 3]], real[[4, COUNT + 4]] = 5.0, (6.0, 0.0)
    found = assess(PAIRS, real, chance(120, 2), np.zeros(2 * COUNT))
    assert found.scores[3] == pytest.approx(5 * 2**0.5, rel=0.3)
    assert found.scores[4] == pytest.approx(6 / 2**0.5, rel=0.3)
    assert found.p == pytest.approx(1 / 121)
    assert found.limit < found.furthest < 7  # of 120 such campaigns any
    assert 2.5 < found.limit < 5  # the largest of 60 standard ones, in one of twenty campaigns: 3.3
    assert np.abs(np.delete(found.scores, [3, 4])).max() < 5


def test_p_of_few_replicates_has_a_lower_limit() -> None:
    """For any size of a score."""
    real = np.full(2 * COUNT, 50.0)
    assert assess(PAIRS, real, chance(40, 3), np.zeros(2 * COUNT)).p == pytest.approx(1 / 41)


def judged(closed: float | None, chances: Sequence[float], unknown: float = 0.1, left: str = "") -> Judgement:
    """One cause of G1, the next of G2, and so on; the sensor `left` has a remainder."""
    causes = [replace(CAUSE, sensors=(f"G{at}",), probability=chance) for at, chance in enumerate(chances, 1)]
    return judge(gap(closed), causes, unknown, is_gap=True, unlikely=[left] if left else [])


def test_the_thresholds_of_the_verdict() -> None:
    """As in docs/explanation/gap.md: 95 %, three tenths, and a probability of a half."""
    assert (EXPLAINED, PARTLY, EVEN) == (0.95, 0.3, 0.5)


@pytest.mark.parametrize(
    ("closed", "chances", "unknown", "left", "verdict"),
    [
        (1.0, [0.9], 0.1, "", "explained"),
        (0.95, [0.5], 0.49, "", "explained"),
        (0.94, [0.9], 0.1, "", "partly explained"),
        (0.95, [0.49], 0.1, "", "partly explained"),  # the effective one of several causes is not determined
        (0.95, [0.9], 0.5, "", "partly explained"),
        (0.3, [0.1], 0.9, "", "partly explained"),
        (0.29, [0.9], 0.1, "", "unexplained"),
        (-2.0, [0.9], 0.1, "", "unexplained"),
        (1.0, [], 0.1, "", "unexplained"),
        # two converters in turn: closed by a line, which does not explain the noise
        (0.99, [0.9], 0.1, "G1", "unexplained"),
        (0.99, [0.9, 0.4], 0.1, "G1", "unexplained"),
        (0.99, [0.9, 0.6], 0.1, "G1", "partly explained"),  # the remainder is of another sensor than the second cause
        (0.99, [0.9], 0.1, "G7", "partly explained"),
        (0.2, [0.9], 0.1, "G7", "unexplained"),
        (None, [0.9], 0.1, "", "partly explained"),
        (None, [0.01], 0.1, "", "unexplained"),
        (None, [], 0.1, "", "unexplained"),
    ],
)
def test_the_verdict_of_closure_probabilities_and_remainder(
    closed: float | None, chances: list[float], unknown: float, left: str, verdict: str
) -> None:
    assert judged(closed, chances, unknown, left).verdict == verdict


def test_no_cause_is_probable_if_none_makes_the_recording_likely() -> None:
    found = judged(0.97, [0.98, 0.3], 0.2, "G1")
    assert (found.verdict, found.unknown) == ("unexplained", 0.5)
    assert [cause.probability for cause in found.causes] == [0.5, 0.3]
    surer = judged(0.1, [0.98, 0.3], 0.8)
    assert (surer.verdict, surer.unknown) == ("unexplained", 0.8)
    assert [cause.probability for cause in surer.causes] == pytest.approx([0.2, 0.2])


def test_a_cause_of_a_sensor_without_remainder_is_first() -> None:
    """An unknown effect has 0.1 or less; G1 has a remainder, G2 has none."""
    found = judged(0.95, [0.98, 0.85], 0.1, "G1")
    assert found.verdict == "partly explained"
    assert [(cause.sensors, cause.probability) for cause in found.causes] == [(("G2",), 0.85), (("G1",), 0.5)]


def test_a_cause_of_all_sensors_is_doubtful_with_a_remainder() -> None:
    everywhere = replace(CAUSE, sensors=())
    assert judge(gap(0.99), [everywhere], 0.1, is_gap=True, unlikely=["G1"]).verdict == "unexplained"
    assert judge(gap(0.99), [everywhere], 0.1, is_gap=True).verdict == "explained"


def test_a_small_remainder_is_partly_explained() -> None:
    assert judge(gap(0.99), [CAUSE], 0.1, is_gap=True, has_remainder=True).verdict == "partly explained"
    assert judge(gap(0.2), [CAUSE], 0.1, is_gap=True, has_remainder=True).verdict == "unexplained"
    assert judge(gap(0.99), [CAUSE], 0.1, is_gap=False, has_remainder=True).verdict == "no gap"


@pytest.mark.parametrize(
    ("closed", "chances", "unknown", "left", "reason"),
    [
        (0.95, [0.9], 0.1, "", "the causes close the gap, except what their approximate models leave"),
        (0.94, [0.9], 0.1, "", "only 94 % of the gap closes (explained from 95 % on)"),
        (0.29, [0.9], 0.1, "", "only 29 % of the gap closes (explained from 95 % on)"),
        (0.9499, [0.9], 0.1, "", "only 94 % of the gap closes (explained from 95 % on)"),
        (-0.2, [0.9], 0.1, "", "nothing of the gap closes (explained from 95 % on)"),
        (0.95, [0.49], 0.1, "", "the cause remains open: none has a probability of one half or more"),
        (0.99, [0.9], 0.1, "G1", "G1 still differs far beyond chance"),
        (0.95, [0.9], 0.5, "", "something outside the library has a probability of at least one half"),
        (None, [0.9], 0.1, "", "how much of the gap closes cannot be measured"),
        (
            0.4,
            [0.1],
            0.9,
            "",
            "only 40 % of the gap closes (explained from 95 % on); the cause remains open: none has a"
            " probability of one half or more",
        ),
        (None, [], 0.1, "", "no known effect was accepted as a cause"),
    ],
)
def test_a_verdict_has_its_reason(
    closed: float | None, chances: list[float], unknown: float, left: str, reason: str
) -> None:
    assert judged(closed, chances, unknown, left).reason == reason


def test_a_small_remainder_is_a_reason() -> None:
    found = judge(gap(0.99), [CAUSE], 0.1, is_gap=True, has_remainder=True)
    assert found.reason == "the remaining differences still matter"


def test_p_by_fitted_tails() -> None:
    """5 standard deviations, two-sided, in 4 statistics: 4 x 5.73e-7."""
    assert tail_p(np.array([1.0, -5.0, math.nan, 0.2, 0.0])) == pytest.approx(4 * 5.7330e-7, rel=1e-3)
    assert tail_p(np.array([0.1, 0.2])) == 1.0
    assert math.isnan(tail_p(np.array([math.nan])))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "is_left", "is_unlikely"),
    some([(0.8, False, False), (1.2, True, False), (1.4, True, False), (1.8, True, True)], 3),
)
def test_a_deviation_far_beyond_all_replicates_makes_a_recording_unlikely(
    times: float, is_left: bool, is_unlikely: bool
) -> None:
    """A line without a cause; the limit of chance is chosen so that its worst statistic is this many
    times 1.25 of it.
    """
    found = found_in(LINE)
    report = StatisticReport(found.bench, found.campaign, found.pairs, ["a.h5"])
    scores = beyond_form(found.pairs, found.assessment, found.assessment, found.real.values, found.chance)
    worst = float(np.nanmax(np.abs(scores)))
    left = remainder_of(found, replace(found.assessment, furthest=worst / 1.25 / times), found.chance, (), report)
    assert (bool(left.sizes), bool(left.unlikely)) == (is_left, is_unlikely)
    assert set(left.sizes) <= {"G1"}
    assert left.where[0].axis == "y"


CHANCES = st.floats(0.0, 1.0)
CLOSED = st.none() | st.floats(-10.0, 1.0)
CAUSES = st.lists(st.tuples(CHANCES, st.lists(st.sampled_from("ABCD"), max_size=3, unique=True)), max_size=5)


@given(CLOSED, CAUSES, CHANCES, st.booleans(), st.sets(st.sampled_from("ABCD")), st.booleans())
def test_verdict_closure_and_probabilities_are_consistent(
    closed: float | None,
    given_causes: list[tuple[float, list[str]]],
    unknown: float,
    is_gap: bool,
    left: set[str],
    more: bool,
) -> None:
    causes = [replace(CAUSE, probability=chance, sensors=tuple(sensors)) for chance, sensors in given_causes]
    found = judge(gap(closed), causes, unknown, is_gap=is_gap, unlikely=left, has_remainder=more)
    unexplained = [] if not is_gap else [{}]
    sentence = "something outside the library" if found.verdict == "unexplained" else ""
    check_agreement(
        {
            "verdict": found.verdict,
            "gap": vars(found.gap),
            "causes": [vars(cause) for cause in found.causes],
            "unknown": found.unknown,
            "unexplained": unexplained,
            "sentence": sentence,
        }
    )
    assert (found.verdict == "no gap") == (not is_gap)
    for cause in found.causes:
        if left and (not cause.sensors or left & set(cause.sensors)):
            assert cause.probability <= 0.5
    if found.verdict == "explained":
        assert not left and not more
    assert found.reason.startswith("the causes close the gap") == (found.verdict == "explained")
    assert (found.reason == "no statistic differs beyond chance") == (found.verdict == "no gap")
    if is_gap:
        assert found.gap.closed == closed
        assert len(found.causes) == len(causes)


@given(CLOSED, CHANCES, CHANCES, st.booleans())
def test_the_judgement_does_not_raise_a_probability(
    closed: float | None, chance: float, unknown: float, is_left: bool
) -> None:
    found = judged(closed, [chance], unknown, "G1" if is_left else "")
    assert [cause.probability <= chance for cause in found.causes] == [True]


def test_a_cause_may_have_an_error_of_a_twentieth_of_its_shift() -> None:
    """All statistics are moved by 200, by a model with an error of 10: the root of 1 + 10^2 is its uncertainty in both
    parts. A statistic with an error of 50, and one with 30 that is not moved, have another cause.
    """
    without, replicates = np.zeros(2 * COUNT), chance(100, 5) + 200.0
    replicates[:, [3, COUNT + 3]] -= 200.0
    real = np.full(2 * COUNT, 210.0)
    real[[3, COUNT + 3]], real[[4, COUNT + 4]] = 30.0, 250.0
    before = assess(PAIRS, real, chance(100, 6), without)
    with_it = assess(PAIRS, real, replicates, without)
    found = beyond_form(PAIRS, before, replace(with_it, tails=NO_TAILS), real, replicates)
    assert with_it.parts[5] == pytest.approx(10, rel=0.3)
    assert found[5] == pytest.approx(10 * (2 / 101) ** 0.5, rel=0.3)
    assert found[4] == pytest.approx(50 * (2 / 101) ** 0.5, rel=0.3)
    assert found[3] == pytest.approx(30 * 2**0.5, rel=0.3)


@given(st.floats(-1, 1.2), st.floats(0.001, 0.2), st.floats(0.1, 99), st.floats(0.1, 10))
def test_an_unknown_effect_is_less_probable_with_more_closure(
    closed: float, more: float, largest: float, further: float
) -> None:
    found = unknown_probability(closed, after(largest))
    assert 0 <= found <= 1
    assert unknown_probability(closed + more, after(largest)) < found
    assert unknown_probability(closed, after(largest + further)) >= found


def test_an_unknown_effect_has_even_odds_at_two_thirds() -> None:
    """With a remainder at the limit of chance."""
    assert unknown_probability(0.65, after(4.0)) == pytest.approx(0.5)
    assert unknown_probability(1.0, after(4.0)) < 0.2
    assert unknown_probability(0.0, after(40.0)) > 0.9
    likely, unlikely = (unknown_probability(None, after(4.0, p=p)) for p in (2 * DOUBT, DOUBT / 2))
    assert likely == pytest.approx(unknown_probability(1.0, after(4.0)))
    assert unlikely == pytest.approx(unknown_probability(0.0, after(4.0)))


def test_a_large_remainder_has_a_small_p() -> None:
    """Scores of 50 with the causes in the model."""
    left = assess(PAIRS, np.full(2 * COUNT, 50.0), chance(REPAIRED, 4), np.zeros(2 * COUNT))
    assert left.p < DOUBT
    assert unknown_probability(None, left) > 0.9


def test_the_gap_is_stated_overall_and_by_domain() -> None:
    """A level of 10 that is explained, a line of 8 that remains: squares 100, 64 before, 1, 64 after."""
    pairs = paired([key(0), key(1, domain="spectrum")])
    before, left = np.array([10.0, 8.0, 10.0, 8.0]), np.array([1.0, 8.0, 1.0, 8.0])
    found = gap_of(deviating(pairs, before, left, np.zeros(4, bool)), 0.7, 1)
    assert found.floor == 0.7
    assert found.before == pytest.approx(82**0.5)
    assert found.after == pytest.approx(32.5**0.5)
    assert found.closed == pytest.approx(1 - 31.5 / 81)
    assert found.domains == {
        "level": pytest.approx((10.0, 1.0, 1.0)),
        "spectrum": pytest.approx((8.0, 8.0, 0.0)),
    }


def test_the_floor_is_that_of_chance() -> None:
    """About 1 for standard scores of many statistics; 1 where nothing is counted."""
    pairs, rows = PAIRS, chance(200, 5)
    scores = np.full(2 * COUNT, 9.0)
    before = Assessment(
        scores[:COUNT], scores[:COUNT], scores, np.zeros(2 * COUNT), likelihood_of(rows, np.zeros(2 * COUNT)), 0.01, 4.0
    )
    counted = deviating(pairs, scores, scores, np.zeros(2 * COUNT, bool))
    assert floor_of(counted, before, rows) == pytest.approx(1.0, abs=0.1)
    nothing = deviating(pairs, 0 * scores, scores, np.zeros(2 * COUNT, bool))
    assert floor_of(nothing, before, rows) == 1.0


def test_the_map_has_the_largest_score_of_each_sensor_and_domain() -> None:
    keys = [key(0), key(1), key(0, "A1"), key(2, domain="spectrum")]
    nothing = SyntheticLikelihood(*(np.zeros(8),) * 4)  # type: ignore[arg-type]
    one, two = (
        Assessment(np.zeros(4), np.array(scores), np.zeros(8), np.zeros(8), nothing, 0.5, 4.0)
        for scores in ([1.0, -7.0, math.nan, 2.0], [1.0, 0.5, 3.0, math.nan])
    )
    found = map_of(paired(keys), one, two, ["A1", "G1"])
    level, spectrum = (found.domains.index(name) for name in ("level", "spectrum"))
    np.testing.assert_array_equal(found.before[:, [level, spectrum]], [[math.nan, math.nan], [7.0, 2.0]])
    np.testing.assert_array_equal(found.after[:, [level, spectrum]], [[3.0, math.nan], [1.0, math.nan]])
    assert np.isnan(np.delete(found.before, [level, spectrum], axis=1)).all()
    assert (found.sensors, found.limit) == (("A1", "G1"), 4.0)


@pytest.mark.slow
def test_a_statistic_is_reported_in_its_unit() -> None:
    """A line of 0.04 dps in noise of 0.05 dps; 20 s of 100 rows/s."""
    found = found_in(LINE)
    places = list(found.localisation.p_by_place)
    told = where_of(
        StatisticReport(found.bench, found.campaign, found.pairs, ["a.h5"]),
        found.assessment,
        places,
        found.localisation.p_by_place,
    )
    worst = next(one for one in told if one.statistic == "noise_excess" or one.statistic == "line")
    assert (worst.log, worst.sensor, worst.axis, worst.phase) == ("a.h5", "G1", "y", "static")
    assert worst.p == found.localisation.p_by_place[places[told.index(worst)]]
    for one in told:
        assert one.significance == pytest.approx(found.assessment.scores[places[told.index(one)]])
        assert one.effect_size == pytest.approx((one.real - one.simulated) / one.margin)
        assert np.sign(one.effect_size) == np.sign(one.significance)


def labelled(logs: Sequence[tuple[str, Motion]]) -> list[tuple[str, str, int, int]]:
    """For every pair of levels: the reported log, its phase, and the places of the two parts (-1: none)."""
    bench, campaign = prepared(logs, ["G1"])
    pairs = bench.pairs()
    count = len(bench.keys)
    plain = SyntheticLikelihood(np.zeros(count), np.ones(count), np.zeros(count, bool), np.zeros(count, bool))
    one = Assessment(*np.zeros((2, len(pairs.keys))), np.zeros(count), np.zeros(count), plain, 0.5, 4.0)
    places = [at for at, item in enumerate(pairs.keys) if item.probe == "mean" and item.axis == "x"]
    names = [f"log {number}" for number in range(len(logs))]
    told = where_of(StatisticReport(bench, campaign, pairs, names), one, places, {})
    return [
        (found.log, found.phase, int(pairs.train[at]), int(pairs.held_out[at]))
        for at, found in zip(places, told, strict=True)
    ]


def test_pairs_of_boots_are_labelled_by_their_parts() -> None:
    """Four boots: the first and third are for training, the second and fourth are held out."""
    found = labelled([("turn-on", turn_on_run(run, 2.0)) for run in range(1, 5)])
    assert sorted((log, phase) for log, phase, _, _ in found) == [
        (f"log {run - 1}", f"run {run}") for run in range(1, 5)
    ]


def test_halves_are_paired_among_other_logs() -> None:
    """Three static logs, two of them for training, and a tumble, whose halves are a pair."""
    logs: list[tuple[str, Motion]] = [("static", Still(seconds=2))] * 3
    found = labelled([*logs, ("tumble", Tumble(1.0, 0.5))])
    tumbled = [one for one in found if one[1] != "static"]
    assert tumbled
    assert all(first >= 0 and second >= 0 for _, _, first, second in tumbled)


def test_the_nearest_effect_reduces_the_probability_of_unknown() -> None:
    """An effect that was not accepted closes nothing; one that was accepted, and closes nothing, is improbable."""
    nearest = replace(CAUSE, probability=0.4, is_accepted=False)
    judgement = judge(gap(0.0), [nearest], 0.98, is_gap=True)
    assert judgement.verdict == "unexplained"
    assert judgement.unknown == pytest.approx(0.6)
    assert judgement.causes[0].probability == pytest.approx(0.4)
    accepted = judge(gap(0.0), [replace(nearest, is_accepted=True)], 0.98, is_gap=True)
    assert accepted.unknown == 0.98
    assert accepted.causes[0].probability == pytest.approx(0.02)
