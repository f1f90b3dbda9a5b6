"""Causes, their probabilities, and merged causes, from rounds made by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.findings.causes import (
    NEAREST_NATS,
    NEAREST_RIGHT,
    TEMPER,
    causes_of,
    judged_of,
    nearest_of,
    probabilities,
)
from imuarray.gap.findings.diagnosis import CandidateEvaluation, Cause
from imuarray.gap.findings.verdict import calibrated_probability
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.forward_selection import BRIEF, COST, Evaluation, Round
from imuarray.gap.inference.refinement import FittedHypothesis
from imuarray.gap.inference.unit_state import UnitState
from imuarray.gap.model.bench import Bench
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.conversion import Quantisation, RangeReset
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.readings import ChannelSwap, Glitches, Stuck
from imuarray.simulate.effects.response import AxisError, GSensitivity
from imuarray.simulate.effects.timing import DroppedSamples
from imuarray.simulate.motion.faces import Still
from tests.gap.small_bench import prepared

LINE = Tone((0.0, 0.04, 0.0), 17.0)


def nats(log_odds: float) -> float:
    """The gain that gives these odds after tempering by its share."""
    return log_odds / TEMPER


@pytest.fixture(scope="module")
def bench() -> Bench:
    return prepared([("static", Still(seconds=4))], ["G1", "G2", "A1"])[0]


def standing(bench: Bench, sensor: str, score: float) -> UnitState:
    """All statistics of a sensor have this score."""
    count = len(bench.columns([sensor], cross=False))
    nothing, always = np.zeros(count, bool), np.ones(count, bool)
    likelihood = SyntheticLikelihood(np.zeros(count), np.ones(count), always, nothing)
    models = {sensor: bench.models()[sensor]}
    return UnitState((sensor,), models, np.full(count, score), likelihood, np.zeros((0, count)), {}, 1.0)


def confirmed(bench: Bench, sensor: str, trial: Hypothesis | Effect, gain: float, score: float = 1.0) -> Evaluation:
    """A confirmed trial after which all statistics have this score."""
    wanted = trial if isinstance(trial, Hypothesis) else Hypothesis((trial,))
    return Evaluation(FittedHypothesis(wanted), standing(bench, sensor, score), 2 * gain, gain)


def round_of(bench: Bench, sensor: str, *found: Evaluation, selection: int | None = 0, before: float = 10.0) -> Round:
    return Round(standing(bench, sensor, before), found, -1.0, None if selection is None else found[selection])


def causes(bench: Bench, sensor: str, *rounds: Round) -> tuple[Cause, ...]:
    return causes_of(bench, {(sensor,): rounds}, 1)


def of_sensors(bench: Bench, *effects: tuple[str, Effect], gain: float = 10.0) -> tuple[Cause, ...]:
    """One round for each, in which it was accepted."""
    rounds: dict[tuple[str, ...], Sequence[Round]] = {
        (sensor,): [round_of(bench, sensor, confirmed(bench, sensor, effect, gain))] for sensor, effect in effects
    }
    return causes_of(bench, rounds, 1)


@given(st.lists(st.floats(-1e4, 1e4), max_size=5))
def test_probabilities_of_causes_sum_to_at_most_one(gains: list[float]) -> None:
    """They sum to one or less, the larger gain is more probable; gains too large for exp are handled."""
    unit = UnitState((), {}, np.zeros(0), SyntheticLikelihood(*(np.zeros(0),) * 4), np.zeros((0, 0)), {}, 1.0)  # type: ignore[arg-type]
    found = tuple(Evaluation(FittedHypothesis(Hypothesis((LINE,))), unit, gain, gain) for gain in gains)
    chances = probabilities(Round(unit, found, 0.0, None))
    assert all(0 <= chance <= 1 for chance in chances)
    assert math.fsum(chances) <= 1 + 1e-9
    order = np.argsort(gains, kind="stable")
    assert (np.diff(np.array(chances)[order]) >= 0).all()


def test_probabilities_use_tempered_gains(bench: Bench) -> None:
    """Odds are e^2 to e^1 to 1."""
    one = round_of(bench, "G1", *(confirmed(bench, "G1", LINE, gain) for gain in (nats(2.0), nats(1.0))))
    total = 1 + math.e + math.e**2
    assert probabilities(one) == pytest.approx([math.e**2 / total, math.e / total])


def test_all_fields_of_a_cause(bench: Bench) -> None:
    """Scores of 10 before, of 1 after: all of the excess is closed. Odds are e^15 to 1, after the cost of the
    parameters.
    """
    trial = Hypothesis((LINE,), ("amplitude",))
    (found,) = causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", trial, nats(15.0) + COST)))
    assert (found.effect, found.action, found.sensors, found.axes) == ("tone", "add", ("G1",), ("y",))
    assert found.parameters == {"amplitude_dps": [0.0, 0.04, 0.0], "frequency_hz": 17.0}
    assert found.each == {"G1": found.parameters}
    assert found.share == pytest.approx(1 / (1 + math.exp(-15)))
    assert found.probability == calibrated_probability(found.share, 1.0)
    assert (found.closed, found.all_closed) == (pytest.approx(1.0), pytest.approx(1.0))
    assert found.closed_ci95 == pytest.approx((1.0, 1.0), abs=0.02)
    assert (found.confusable_with, found.origin, found.gain) == ((), "sensor", nats(15.0) + COST)
    assert not found.needs_both
    late = replace(trial, whole=True)
    (found,) = causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", late, nats(15.0))))
    assert found.needs_both


@pytest.mark.parametrize(
    ("effect", "axes"),
    [
        (AxisError("+X+Y-Z"), ("z",)),
        (AxisError("+Y+X+Z"), ("x", "y")),
        (AxisError("-X-Y-Z"), ()),
        (GSensitivity((0, 0, 0, 0.1, 0, 0, 0, 0, 0)), ("y",)),
        (Glitches(runs=(0, 0), moments_s=(1.0, 2.0), jumps=(0, 0, 3.0, 0, 0, -3.0)), ("z",)),
        (Glitches(0.01, amplitude=1.0), ()),
        (Bias((0.0, 0.1, 0.2)), ("y", "z")),
        (Stuck(0.0, 5.0), ()),
    ],
)
def test_the_axes_on_which_a_cause_acts(bench: Bench, effect: Effect, axes: tuple[str, ...]) -> None:
    """No axis is named where all are affected."""
    (cause,) = causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", effect, nats(15.0))))
    assert (cause.effect, cause.axes) == (effect.name, axes)


def test_equally_likely_effects_are_confusable(bench: Bench) -> None:
    """Odds of e^-0.5 are listed as a separate cause; e^-5 is below 1 in 20; e^-2.5 is confusable but too improbable to
    be listed.
    """
    found = [
        confirmed(bench, "G1", LINE, nats(10.0)),
        confirmed(bench, "G1", Bias(0.3), nats(9.5)),
        confirmed(bench, "G1", Stuck(0.0, 5.0), nats(7.5)),
        confirmed(bench, "G1", Quantisation(2.0), nats(5.0)),
    ]
    told = causes(bench, "G1", round_of(bench, "G1", *found))
    assert [(cause.effect, cause.confusable_with) for cause in told] == [
        ("tone", ("bias", "stuck")),
        ("bias", ("stuck", "tone")),
    ]


def test_two_trials_of_one_effect_are_added(bench: Bench) -> None:
    """With odds e^2, e^2 and 1 for no cause."""
    found = [confirmed(bench, "G1", effect, nats(2.0)) for effect in (LINE, Tone(LINE.amplitude, 34.0))]
    (told,) = causes(bench, "G1", round_of(bench, "G1", *found))
    assert told.share == pytest.approx(2 * math.e**2 / (1 + 2 * math.e**2))
    assert told.parameters["frequency_hz"] == 17.0
    assert told.confusable_with == ()


def test_the_accepted_trial_is_reported(bench: Bench) -> None:
    """The best trial had no gain on the training part; the second trial of the same effect was accepted."""
    found = [confirmed(bench, "G1", LINE, 6.0), confirmed(bench, "G1", Tone(LINE.amplitude, 34.0), 5.0)]
    (told,) = causes(bench, "G1", round_of(bench, "G1", *found, selection=1))
    assert told.parameters["frequency_hz"] == 34.0


def test_shares_are_relative_to_the_remaining_excess(bench: Bench) -> None:
    """10 at first, 6 after the first round, 1 after the second: excesses 99, 35, 0. The second closes the whole
    remainder of the first.
    """
    first = round_of(bench, "G1", confirmed(bench, "G1", LINE, 10.0, score=6.0))
    second = round_of(bench, "G1", confirmed(bench, "G1", Quantisation(2.0), 8.0), before=6.0)
    line, steps = causes(bench, "G1", first, second)
    assert line.closed == pytest.approx(1 - 35 / 99)
    assert steps.closed == pytest.approx(1.0)
    assert line.all_closed == steps.all_closed == pytest.approx(1.0)


def test_a_cause_that_closes_less_is_less_probable(bench: Bench) -> None:
    """Half of the excess of 10 is closed with a score of sqrt(50.5), none of it with 10; for every share."""
    half, all_, none = (
        causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", LINE, 99.0, score)))
        for score in (50.5**0.5, 1.0, 10.0)
    )
    assert none == ()
    assert half[0].all_closed == pytest.approx(0.5)
    assert half[0].probability == calibrated_probability(half[0].share, half[0].all_closed)
    assert all_[0].probability == calibrated_probability(all_[0].share, all_[0].all_closed) > half[0].probability


def test_rounds_without_an_accepted_trial_have_no_cause(bench: Bench) -> None:
    assert causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", LINE, 2.0), selection=None)) == ()
    assert causes_of(bench, {}, 1) == ()


def test_removal_has_no_parameters(bench: Bench) -> None:
    (gone,) = causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", Hypothesis((), removed="tone"), 9.0)))
    assert (gone.effect, gone.action, gone.axes, gone.parameters) == ("tone", "remove", (), {})


def test_only_effects_of_the_base_model_are_replaced(bench: Bench) -> None:
    """A line that replaces a line of an earlier round is new to the base model, which has noise only."""
    for effect, action in ((LINE, "add"), (WhiteNoise((0.1, 0.1, 0.1)), "replace")):
        trial = Hypothesis((effect,), removed=effect.name)
        (found,) = causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", trial, 9.0)))
        assert (found.effect, found.action) == (effect.name, action)


def test_a_rival_is_an_alternative_to_the_accepted_cause(bench: Bench) -> None:
    one = round_of(bench, "G1", *(confirmed(bench, "G1", effect, 9.0) for effect in (LINE, Bias((0.1, 0.0, 0.0)))))
    found = {cause.effect: cause for cause in causes(bench, "G1", one)}
    assert {name: cause.alternative_to for name, cause in found.items()} == {"tone": "", "bias": "tone"}
    assert [name for name, cause in found.items() if cause.is_in_model] == ["tone"]


@pytest.mark.parametrize(
    ("effect", "origin"),
    [
        (ChannelSwap("G2"), "metadata"),
        (RangeReset(500.0, onset_s=0.0), "metadata"),  # from the boot on
        (RangeReset(500.0, onset_s=2.0), "sensor"),
        (LINE, "sensor"),
    ],
)
def test_the_origin_of_a_cause(bench: Bench, effect: Effect, origin: str) -> None:
    (found,) = of_sensors(bench, ("G1", effect))
    assert found.origin == origin


def test_a_cause_of_one_sensor_replaces_that_of_its_family(bench: Bench) -> None:
    """Of the two sensors that show it, the cause names the sensor that has it."""
    trial = Hypothesis((ChannelSwap("G2"),), shared=True, sensor="G1", others=("G2",))
    columns = bench.columns(["G1", "G2"], cross=True)
    count = len(columns)
    likelihood = SyntheticLikelihood(np.zeros(count), np.ones(count), np.ones(count, bool), np.zeros(count, bool))
    both = UnitState(("G1", "G2"), {}, np.full(count, 9.0), likelihood, np.zeros((0, count)), {}, 1.0)
    one = Evaluation(FittedHypothesis(trial), replace(both, real=np.zeros(count)), 9.0, 9.0)
    (found,) = causes_of(bench, {("G1", "G2"): [Round(both, (one,), 0.0, one)]}, 1)
    assert found.sensors == ("G1",)
    assert found.each.keys() == {"G1"}


def test_an_exchange_is_one_cause_of_two_sensors(bench: Bench) -> None:
    """Each sensor has its own parameters."""
    one, other = ChannelSwap("G2", "place"), ChannelSwap("G1", "place")
    trial = Hypothesis((one,), shared=True, sensor="G1", others=("G2",), opposite=(other,))
    count = len(bench.columns(["G1", "G2"], cross=True))
    likelihood = SyntheticLikelihood(np.zeros(count), np.ones(count), np.ones(count, bool), np.zeros(count, bool))
    both = UnitState(("G1", "G2"), {}, np.full(count, 9.0), likelihood, np.zeros((0, count)), {}, 1.0)
    taken = Evaluation(FittedHypothesis(trial), replace(both, real=np.zeros(count)), 9.0, 9.0)
    (found,) = causes_of(bench, {("G1", "G2"): [Round(both, (taken,), 0.0, taken)]}, 1)
    assert (found.effect, found.sensors, found.origin) == ("channel_swap", ("G1", "G2"), "metadata")
    assert found.each == {"G1": {"sensor": "G2", "kind": "place"}, "G2": {"sensor": "G1", "kind": "place"}}


def test_the_same_in_two_sensors_of_a_chip_is_one_cause(bench: Bench) -> None:
    """0.04 and 0.045 are within a quarter; odds are multiplied, gains added."""
    one, other = LINE, Tone((0.0, 0.045, 0.0), 17.1)
    (alone,) = of_sensors(bench, ("G1", one), gain=2.0)
    (both,) = of_sensors(bench, ("G1", one), ("G2", other), gain=2.0)
    assert both.sensors == ("G1", "G2")
    assert both.parameters == both.each["G1"]
    assert both.each["G2"]["frequency_hz"] == 17.1
    assert both.gain == pytest.approx(4.0)
    odds = (alone.share / (1 - alone.share)) ** 2
    assert both.share == pytest.approx(odds / (1 + odds))
    assert both.probability == calibrated_probability(both.share, 1.0)  # an effect outside the library is so for both


@pytest.mark.parametrize(
    "other",
    [
        ("G2", Tone((0.0, 0.06, 0.0), 17.0)),  # larger by a half
        ("G2", Tone((0.04, 0.0, 0.0), 17.0)),  # on another axis
        ("G2", Quantisation(2.0)),
        ("A1", LINE),  # a sensor of another chip
    ],
)
def test_different_effects_are_separate_causes(bench: Bench, other: tuple[str, Effect]) -> None:
    assert len(of_sensors(bench, ("G1", LINE), other)) == 2


def test_permanent_and_temporary_effects_are_separate_causes(bench: Bench) -> None:
    assert len(of_sensors(bench, ("G1", Stuck(5.0, math.inf)), ("G2", Stuck(5.0, 3.0)))) == 2


def test_separate_lists_of_events_are_separate_causes(bench: Bench) -> None:
    """Two sensors with different lists of lost rows: these are two causes."""
    one = DroppedSamples(runs=(0, 0), moments_s=(1.0, 2.0), lengths_s=(0.1, 0.1))
    other = DroppedSamples(runs=(0, 0, 0), moments_s=(1.0, 2.0, 3.0), lengths_s=(0.1, 0.1, 0.1))
    assert len(of_sensors(bench, ("G1", one), ("G2", other))) == 2
    assert len(of_sensors(bench, ("G1", one), ("G2", one))) == 1


def test_lines_of_different_frequencies_are_separate_causes(bench: Bench) -> None:
    """17 and 20 Hz, which 4 s of rows resolve."""
    assert len(of_sensors(bench, ("G1", LINE), ("G2", replace(LINE, frequency_hz=20.0)))) == 2


def test_no_sensor_is_named_twice(bench: Bench) -> None:
    """Both gyroscopes have two equal lines."""
    lines = [confirmed(bench, "G1", LINE, 9.0, 5.0), confirmed(bench, "G1", replace(LINE, frequency_hz=18.0), 9.0)]
    rounds = {
        (name,): [
            round_of(bench, name, replace(lines[0], standing=standing(bench, name, 5.0))),
            round_of(bench, name, replace(lines[1], standing=standing(bench, name, 1.0)), before=5.0),
        ]
        for name in ("G1", "G2")
    }
    for cause in causes_of(bench, rounds, 1):
        assert len(set(cause.sensors)) == len(cause.sensors)


def test_causes_are_in_order_of_probability(bench: Bench) -> None:
    rounds = {
        ("G1",): [round_of(bench, "G1", confirmed(bench, "G1", LINE, 1.0))],
        ("A1",): [round_of(bench, "A1", confirmed(bench, "A1", Quantisation(2.0), 9.0))],
    }
    assert [cause.sensors for cause in causes_of(bench, rounds, 1)] == [("A1",), ("G1",)]


def test_all_confirmed_trials_are_reported_with_the_placebo(bench: Bench) -> None:
    found = [confirmed(bench, "G1", LINE, 9.0), confirmed(bench, "G1", Hypothesis((), removed="scale"), 1.0)]
    judged = judged_of({("G1",): [round_of(bench, "G1", *found)]})
    assert judged[:2] == (
        CandidateEvaluation("tone", "add", ("G1",), 18.0, 9.0, True),
        CandidateEvaluation("scale", "remove", ("G1",), 2.0, 1.0, False),
    )
    assert (judged[2].effect, judged[2].gain, judged[2].is_accepted) == ("", -1.0, False)


def test_a_trial_that_closes_nothing_is_not_a_cause(bench: Bench) -> None:
    """Scores of 9 that become 8.95: 1 % less of the squares; with 8.0 it is a cause."""
    for score, count in ((8.95, 0), (8.0, 1)):
        found = causes(bench, "G1", round_of(bench, "G1", confirmed(bench, "G1", LINE, 9.0, score), before=9.0))
        assert len(found) == count


def test_of_two_equal_gains_the_trial_with_the_smaller_remainder_is_preferred(bench: Bench) -> None:
    """Where statistics are correlated, gains are reduced and the cost of parameters is not: the simpler trial is not
    preferred if its remaining squares are more than twice as large.
    """
    free = Hypothesis((Tone((0.1, 0.1, 0.1), 9.0),), ("amplitude", "frequency_hz"))
    simple, better = (
        replace(confirmed(bench, "G1", trial, gain), independent=0.01, squared_scores=left)
        for trial, gain, left in ((Hypothesis((LINE,)), 400.0, 300.0), (free, 460.0, 100.0))
    )
    assert better.factors - simple.factors == 4
    simple_odds, better_odds = round_of(bench, "G1", simple, better).log_odds
    assert better_odds > simple_odds
    equal = replace(simple, squared_scores=100.0)
    simple_odds, better_odds = round_of(bench, "G1", equal, better).log_odds
    assert better_odds < simple_odds


def test_a_later_cause_is_at_most_as_probable_as_the_earlier_one(bench: Bench) -> None:
    """A line with even odds is accepted first. With it in the model a second effect has hardly a rival, and would be
    the more probable one.
    """
    alone = confirmed(bench, "G1", LINE, nats(0.0))
    with_line = replace(standing(bench, "G1", 5.0), models={"G1": replace(bench.models()["G1"], added=(LINE,))})
    second = confirmed(bench, "G1", Stuck(0.5, 0.1), nats(15.0), score=0.5)
    rounds = round_of(bench, "G1", alone), Round(with_line, (second,), -1.0, second)
    first, later = causes(bench, "G1", *rounds)
    assert (first.effect, later.effect) == ("tone", "stuck")
    assert first.share < later.share
    assert later.probability == first.probability
    assert (first.preceding, later.preceding) == (0, 1)
    (only,) = causes(bench, "G1", round_of(bench, "G1", second))
    assert only.probability > first.probability


def rounds_without_selection(bench: Bench, **offers: Sequence[Evaluation]) -> dict[tuple[str, ...], list[Round]]:
    """One round of each sensor, in which nothing was accepted."""
    return {
        (sensor,): [round_of(bench, sensor, *evaluations, selection=None)] for sensor, evaluations in offers.items()
    }


def test_the_nearest_effect_of_an_unexplained_gap(bench: Bench) -> None:
    """The effect with the larger gain on both parts: twice as much on the training part (`confirmed`)."""
    weaker, stronger = confirmed(bench, "G1", Bias((0.1, 0.0, 0.0)), 1.2), confirmed(bench, "A1", Bias((0.2,) * 3), 1.9)
    (cause,) = nearest_of(bench, rounds_without_selection(bench, G1=[weaker], A1=[stronger]), 1)
    assert (cause.effect, cause.sensors, cause.is_accepted) == ("bias", ("A1",), False)
    assert cause.probability == pytest.approx(NEAREST_RIGHT / (1 + math.exp(3 * (1.2 - 1.9))))


def test_small_gains_and_removals_are_not_the_nearest_effect(bench: Bench) -> None:
    little = confirmed(bench, "G1", Bias((0.1, 0.0, 0.0)), 0.9 * NEAREST_NATS / 3)
    removal = confirmed(bench, "G1", Hypothesis((), removed="tone"), 9.0)
    assert nearest_of(bench, rounds_without_selection(bench, G1=[little, removal]), 1) == ()
    assert nearest_of(bench, {}, 1) == ()


def test_many_equally_near_effects_give_no_nearest_effect(bench: Bench) -> None:
    """With three, each has a probability of 0.13, with four 0.1."""
    effects = [Bias((0.1, 0.0, 0.0)), LINE, Quantisation(2.0), GSensitivity((0.1,) * 9), DroppedSamples(0.01)]
    alike = [confirmed(bench, "G1", effect, 3.0) for effect in effects]
    assert len(nearest_of(bench, rounds_without_selection(bench, G1=alike[:3]), 1)) == 1
    assert nearest_of(bench, rounds_without_selection(bench, G1=alike), 1) == ()


def test_a_sensor_with_an_accepted_effect_has_no_nearest_effect(bench: Bench) -> None:
    accepted = round_of(bench, "G1", confirmed(bench, "G1", LINE, 20.0))
    assert nearest_of(bench, {("G1",): [accepted]}, 1) == ()


def test_the_cost_of_a_moment_applies_to_odds_but_not_to_the_nearest_effect(bench: Bench) -> None:
    """The gain of a trial that needs both parts is their mean, minus the cost of a moment: a sum of 14
    nats is 2 * 7.
    """
    needs_both = Hypothesis((Bias((0.1, 0.0, 0.0)),), whole=True)
    sure = confirmed(bench, "G1", needs_both, 7.0 - BRIEF)
    (cause,) = nearest_of(bench, rounds_without_selection(bench, G1=[sure]), 1)
    assert cause.needs_both
    assert cause.probability == pytest.approx(NEAREST_RIGHT)
    lasting = confirmed(bench, "A1", Bias((0.2,) * 3), 2.5)  # 7.5 nats, more than 14 - 8
    (cause,) = nearest_of(bench, rounds_without_selection(bench, G1=[sure], A1=[lasting]), 1)
    assert cause.sensors == ("A1",)
