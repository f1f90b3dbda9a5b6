"""A common cause of sensors against individual causes, and the state of members with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.comparison import compare_with_base
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.forward_selection import ACCEPTED, Evaluation, Round, confirm, confirm_each, look_state
from imuarray.gap.inference.refinement import FittedHypothesis, look_again, looks
from imuarray.gap.inference.search import (
    is_redundant,
    members_of,
    responses,
    separate_causes,
    shared_wins,
    together,
    without_duplicates,
)
from imuarray.gap.inference.unit_state import UnitState
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import SensorModel
from imuarray.simulate.effects.bias import BiasInstability, CommonMode
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.response import Misalignment
from imuarray.simulate.motion.faces import Still
from tests.gap.search_inputs import standing_of
from tests.gap.small_bench import Run, prepared
from tests.gap.unit_states import FITTED, drawn
from tests.gap.unit_states import standing as by_hand

BOTH = ("A1", "A2")
SWAP = Hypothesis((ChannelSwap("A2"),), shared=True, sensor="A1", others=("A2",))


@pytest.fixture(scope="module")
def swapped() -> tuple[Bench, UnitState, dict[tuple[str, ...], UnitState]]:
    """A1 has A2's readings, 10 s at rest: the two together, and each alone."""
    bench, campaign = prepared([("static", Still(seconds=10))], BOTH, {"A1": (ChannelSwap("A2"),)})
    found = compare_with_base(bench, campaign, Run(bench), 40)
    return bench, standing_of(found, BOTH), {(name,): standing_of(found, (name,)) for name in BOTH}


def found(gain: float) -> Evaluation:
    return Evaluation(FittedHypothesis(Hypothesis(())), by_hand([0.0], drawn(1)), gain, gain)


@pytest.mark.parametrize(
    ("shared", "members", "is_shared"), [(9.0, 8.0, True), (8.0, 9.0, False), (8.0, 8.0, False), (None, -5.0, False)]
)
def test_a_common_cause_must_be_accepted_and_gain_more(shared: float | None, members: float, is_shared: bool) -> None:
    best = None if shared is None else found(shared)
    round_ = Round(by_hand([0.0], drawn(1)), () if best is None else (best,), 0.0, best)
    assert shared_wins(round_, found(members)) is (best if is_shared else None)


def test_a_common_cause_is_preferred_by_both_parts() -> None:
    """A common cause that fits 6 nats better and gains 2 less; not if it is rarer by 5."""
    shared, members = replace(found(10.0), train_gain=18.0), replace(found(12.0), train_gain=12.0)
    round_ = Round(by_hand([0.0], drawn(1)), (shared,), 0.0, shared)
    assert shared_wins(round_, members) is shared
    rarer = replace(shared, hypothesis=FittedHypothesis(Hypothesis((), rarity=5.0)))
    assert shared_wins(replace(round_, selection=rarer), members) is None


def test_individual_causes_kept_with_a_common_cause() -> None:
    """A line that gains more than a member's part, 20 of 2; not a cause that gains less, nor another of
    the same kind.
    """
    shared = found(40.0)
    shared = replace(
        shared,
        hypothesis=FittedHypothesis(SWAP),
        standing=by_hand([0.0], drawn(1), models={name: SensorModel(FITTED) for name in BOTH}),
    )
    line, weak = (
        replace(found(gain), hypothesis=FittedHypothesis(Hypothesis((Tone(1.0, 5.0),)))) for gain in (20.5, 19.5)
    )
    same = replace(found(30.0), hypothesis=FittedHypothesis(SWAP))
    round_ = Round(by_hand([0.0], drawn(1)), (shared,), 0.0, shared)
    assert separate_causes(round_, (line, weak, same)) == (line,)
    assert separate_causes(replace(round_, selection=None), (line,)) == ()


def test_responses_of_members_stay_beside_noise_in_common() -> None:
    """A misalignment does not resemble noise, a wander does; with another shared cause nothing is known before."""
    noise = Hypothesis((CommonMode(0.1, 9.0),), shared=True)
    turned, wander = (
        replace(found(9.0), hypothesis=FittedHypothesis(Hypothesis((effect,))))
        for effect in (Misalignment((1.0, 0.0, 0.0, 0.0, 0.0, 0.0)), BiasInstability(0.1, 9.0))
    )
    assert responses([noise, noise], [turned, wander]) == (turned,)
    assert responses([noise, SWAP], [turned, wander]) == ()


def test_equal_trials_of_members_are_tried_once() -> None:
    trials = [Hypothesis((Tone(1.0, 5.0),), shared=True), SWAP, Hypothesis((Tone(1.0, 5.0),), shared=True), SWAP]
    assert without_duplicates(trials) == trials[:2]
    assert without_duplicates([]) == []


def test_an_exchange_is_one_trial_of_both_sensors() -> None:
    one = replace(SWAP, opposite=(ChannelSwap("A1"),))
    other = replace(one, effects=one.opposite, sensor="A2", others=("A1",), opposite=one.effects)
    assert without_duplicates([one, other]) == [other]
    assert without_duplicates([SWAP, one]) == [SWAP, one]


def test_several_causes_must_each_gain_enough() -> None:
    """One cause of three sensors instead of three, which gain up to twice the required gain more."""
    line = Hypothesis((Tone(1.0, 5.0),), ("amplitude",))
    one = replace(found(10.0), hypothesis=FittedHypothesis(line))
    round_ = Round(by_hand([0.0], drawn(1)), (one,), 0.0, one)
    assert shared_wins(round_, found(10.0 + 2 * ACCEPTED - 0.1), 3) is one
    assert shared_wins(round_, found(10.0 + 2 * ACCEPTED + 0.1), 3) is None


@pytest.mark.parametrize(("members", "is_shared"), [(1050.0, True), (1059.0, False)])
def test_an_exchange_without_fitted_numbers_may_explain_slightly_less(members: float, is_shared: bool) -> None:
    """1000 nats on each part compared with those of two fitted causes: 5 % less and 3 nats on each are accepted."""
    exchange = replace(found(1000.0), hypothesis=FittedHypothesis(SWAP))
    round_ = Round(by_hand([0.0], drawn(1)), (exchange,), 0.0, exchange)
    assert (shared_wins(round_, found(members), 2) is exchange) == is_shared
    fitted = replace(exchange, hypothesis=FittedHypothesis(Hypothesis((Tone(1.0, 5.0),), ("amplitude",))))
    assert shared_wins(Round(round_.before, (fitted,), 0.0, fitted), found(members), 2) is None


@pytest.mark.slow
def test_equal_readings_of_two_sensors_are_observable_as_a_pair(
    swapped: tuple[Bench, UnitState, dict[tuple[str, ...], UnitState]],
) -> None:
    """Alone neither deviates; as a pair they deviate strongly, and with the right cause they do not."""
    bench, pair, alone = swapped
    assert all(np.nanmax(np.abs(one.scores)) < 8 for one in alone.values())
    right = confirm(bench, pair, FittedHypothesis(SWAP, pair.changed(SWAP)))
    assert min(right.gain, right.train_gain) > 10
    before, after = (np.nanmean(np.abs(one.scores) > 8) for one in (pair, right.standing))
    assert before > 0.05
    assert after < 0.01
    assert right.standing.models["A1"].added == (ChannelSwap("A2"),)
    assert right.standing.models["A2"].added == ()
    jointly = confirm_each(bench, pair, [FittedHypothesis(SWAP), FittedHypothesis(SWAP, pair.changed(SWAP))])
    assert [one.gain for one in jointly] == pytest.approx([0.0, right.gain], abs=1e-6)


@pytest.mark.slow
def test_a_look_is_judged_again_by_more_replicates(
    swapped: tuple[Bench, UnitState, dict[tuple[str, ...], UnitState]],
) -> None:
    """By the same draws: the gain is that of a new look at the state with all replicates."""
    bench, pair, _ = swapped
    few = look_state(bench, pair)
    (seen,), (new,) = looks(bench, few, [SWAP]), looks(bench, pair, [SWAP])
    again = look_again(bench, pair, seen)
    assert seen.gain > 10
    assert (again.gain, again.counts, again.by_log) == (new.gain, new.counts, new.by_log)


@pytest.mark.slow
def test_states_of_members_use_the_models_of_the_family(
    swapped: tuple[Bench, UnitState, dict[tuple[str, ...], UnitState]],
) -> None:
    """Each with its own model and statistics, without those between sensors."""
    bench, pair, alone = swapped
    with_it = replace(pair, models=pair.changed(SWAP))
    members = members_of(bench, with_it, alone)
    assert list(members) == [("A1",), ("A2",)]
    for (name,), one in members.items():
        assert one.models == {name: with_it.models[name]}
        columns = bench.columns([name], cross=False)
        assert one.values.shape == (len(pair.values), len(columns))
        np.testing.assert_array_equal(one.real, alone[(name,)].real)
        family = bench.columns(BOTH, cross=True)
        for at, place in enumerate(columns):
            (where,) = np.flatnonzero(family == place)
            np.testing.assert_array_equal(one.values[:, at], pair.values[:, where])
            np.testing.assert_array_equal(one.likelihood.location[at], pair.likelihood.location[where])


@pytest.mark.slow
def test_gain_of_individual_causes_of_members_together(
    swapped: tuple[Bench, UnitState, dict[tuple[str, ...], UnitState]],
) -> None:
    """Without causes the gain is zero; wrong causes lose."""
    bench, pair, alone = swapped
    assert together(bench, (pair, ())).gain == pytest.approx(0.0, abs=1e-6)
    line = Tone((0.01, 0.0, 0.0), 9.0)
    members = []
    for (name,), one in alone.items():
        model = replace(one.models[name], added=(line,))
        members.append(Evaluation(FittedHypothesis(Hypothesis((line,))), replace(one, models={name: model}), 1.0, 1.0))
    both = together(bench, (pair, tuple(members)))
    assert both.gain < 0
    assert all(both.standing.models[name].added == (line,) for name in BOTH)


@pytest.mark.slow
def test_an_individual_cause_explained_by_the_common_one_is_redundant(
    swapped: tuple[Bench, UnitState, dict[tuple[str, ...], UnitState]],
) -> None:
    """A member's own cause moves twelve statistics that deviate by 5 back to the middle; the common one moves seven of
    them, or five, or makes all of them worse.
    """
    bench, pair, alone = swapped
    member, mine = alone[("A1",)], bench.among(("A1",), BOTH)
    places = np.flatnonzero(np.isfinite(member.likelihood.location) & ~member.likelihood.is_silent)[:12]

    def moved(standing: UnitState, at: np.ndarray, by: float) -> UnitState:
        location = standing.likelihood.location.copy()
        location[at] = standing.real[at] + by * standing.likelihood.scale[at]
        return replace(standing, likelihood=replace(standing.likelihood, location=location))

    inside = np.flatnonzero(mine)[places]
    before = moved(pair, inside, 5.0)
    own = replace(found(50.0), standing=moved(member, places, 0.0))
    for count, by, twice in ((7, 0.0, True), (5, 0.0, False), (12, 9.0, False)):
        shared = replace(found(40.0), standing=moved(before, inside[:count], by))
        assert is_redundant(bench, Round(before, (shared,), 0.0, shared), own) is twice
    assert not is_redundant(bench, Round(before, (), 0.0, None), own)
