"""One round of the search: the trials that are evaluated further, acceptance, and its limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.inference import search
from imuarray.gap.inference.comparison import compare_with_base
from imuarray.gap.inference.effects import Candidate, Hypothesis
from imuarray.gap.inference.evidence import Span, When
from imuarray.gap.inference.forward_selection import (
    ACCEPTED,
    COST,
    Evaluation,
    Round,
    confirm,
    guesses_of,
    likeliest,
    placebo_of,
    replicate_state,
    replicates_of,
    scores_by_wider,
    search_round,
)
from imuarray.gap.inference.refinement import WORTH, FittedHypothesis, looks
from imuarray.gap.inference.unit_state import Unit, UnitState
from imuarray.gap.model.bench import Bench
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias, BiasInstability, PopcornNoise
from imuarray.simulate.effects.conversion import Saturation
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.readings import Stuck
from imuarray.simulate.effects.timing import ClockError, Skew
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.search_inputs import evidence, found_in, standing_of
from tests.gap.small_bench import LINE, Run, prepared, static
from tests.gap.unit_states import drawn
from tests.gap.unit_states import standing as by_hand

UNIT: Unit = ("G1",)
KINDS: tuple[Effect, ...] = (Bias(1.0), WhiteNoise(1.0), LINE)


@pytest.fixture(scope="module")
def tone() -> tuple[Bench, UnitState]:
    found = found_in(LINE)
    return found.bench, standing_of(found)


@given(
    st.lists(st.tuples(st.integers(0, 2), st.booleans(), st.booleans(), st.floats(-10, 50)), max_size=15),
    st.integers(0, 6),
)
def test_the_likeliest_trials_are_selected(drawn_trials: list[tuple[int, bool, bool, float]], count: int) -> None:
    """The largest gains first; at most two of each effect and action; none with too small a gain, without a model, or
    with a gain below the best by more than 15 nats and by more than half, except the first of another form than the
    best.
    """
    tried = [
        FittedHypothesis(
            Hypothesis((KINDS[kind],), removed=KINDS[kind].name if taken else ""), {} if is_made else None, gain
        )
        for kind, taken, is_made, gain in drawn_trials
    ]
    kept = likeliest(tried, count)
    best = max((one.gain for one in tried if one.models is not None), default=0.0)
    least = max(WORTH, min(best - 15, best / 2))
    gains = [one.gain for one in kept]
    assert gains == sorted(gains, reverse=True)
    assert len(kept) <= count
    named = [(one.trial.name, one.trial.action) for one in kept]
    rival = next((one for one, form in zip(kept, named, strict=True) if form != named[0]), None)
    assert all(one.models is not None and (one.gain > least or (one is rival and one.gain > WORTH)) for one in kept)
    assert all(named.count(one) <= 2 for one in named)
    if len(kept) < count:  # every excluded trial had no place
        for one in tried:
            of_effect = named.count((one.trial.name, one.trial.action))
            assert any(one is other for other in kept) or one.models is None or one.gain <= least or of_effect == 2


def test_the_placebo_is_negligible() -> None:
    """A twentieth of the noise, at no simple fraction of the rate."""
    made = evidence({})
    trial = placebo_of(made)
    (effect,) = trial.effects
    assert isinstance(effect, Tone)
    np.testing.assert_allclose(effect.amplitude, 0.05 * made.noise)
    share = effect.frequency_hz / made.rows_per_s
    assert 0.1 < share < 0.5
    for below in range(1, 20):
        assert abs(share - float(Fraction(round(share * below), below))) > 0.2 / below**2
    assert trial.free == ("amplitude",)


def test_trials_are_of_a_single_sensor_or_of_a_family() -> None:
    alone, shared = Hypothesis((LINE,)), Hypothesis((Bias(1.0),), shared=True)
    candidates = {"tone": Candidate("tone", lambda _: [alone]), "bias": Candidate("bias", lambda _: iter([shared]))}
    found = guesses_of(evidence({}), candidates)
    assert [one for one in found if not one.shared] == [alone]
    assert [one for one in found if one.shared] == [shared]
    assert guesses_of(evidence({}), {}) == []


@pytest.mark.slow
def test_the_right_cause_gains_on_held_out_data(tone: tuple[Bench, UnitState]) -> None:
    bench, standing = tone
    right, wrong = (
        confirm(bench, standing, looks(bench, standing, [Hypothesis((effect,))])[0])
        for effect in (LINE, Tone(LINE.amplitude, 31.0))
    )
    assert min(right.gain, right.train_gain) > 10
    assert max(wrong.gain, wrong.train_gain) < 5
    assert right.own_share == pytest.approx(1.0)  # nothing moved
    assert right.standing.models["G1"].added == (LINE,)
    before, after = (np.nanmax(np.abs(one.scores)) for one in (standing, right.standing))
    assert after < 0.6 * before


@pytest.mark.slow
def test_the_choice_of_a_moment_has_a_cost(tone: tuple[Bench, UnitState]) -> None:
    """For an effect that begins within the log the gain is the mean of both parts, minus four nats."""
    bench, standing = tone
    tried = looks(bench, standing, [Hypothesis((LINE,))])[0]
    plain = confirm(bench, standing, tried)
    brief = confirm(bench, standing, replace(tried, trial=Hypothesis((Stuck(3.0, 1.0),))))
    assert brief.gain == pytest.approx((plain.train_gain + plain.gain) / 2 - 4)
    assert brief.train_gain == pytest.approx(plain.train_gain)


@pytest.mark.slow
def test_no_change_has_no_gain(tone: tuple[Bench, UnitState]) -> None:
    bench, standing = tone
    found = confirm(bench, standing, FittedHypothesis(Hypothesis(()), standing.models))
    assert (found.gain, found.train_gain) == (pytest.approx(0, abs=1e-6), pytest.approx(0, abs=1e-6))


@pytest.mark.slow
@pytest.mark.parametrize("unit", [("A1",), ("G1",), ("A1", "A2")])
def test_replicates_of_a_unit_are_those_of_the_comparison(unit: Unit) -> None:
    """The same numbers draw the same parts, whether the other sensors are simulated or not."""
    motions: list[tuple[str, Motion]] = [("tumble", Tumble(10.0, 1.0)), ("motion", HandShake(still_s=5, motion_s=20))]
    bench, campaign = prepared(motions, ("A1", "A2", "G1"))
    comparison = compare_with_base(bench, campaign, Run(bench), 20)
    state = search._states_of(comparison, [unit], Run(bench))[unit]
    alone = replicate_state(bench, replace(state, values=state.values[:0], misfit=0.0))
    np.testing.assert_array_equal(state.values, alone.values)
    assert state.misfit == alone.misfit
    assert np.isfinite(state.values).mean() > 0.8


def test_a_single_sensor_excludes_common_statistics() -> None:
    bench, _ = prepared([("static", static()[0].motions[0])], ["G1", "G2"])
    nothing = np.zeros(0)
    models = bench.models()
    for unit in (("G1",), ("G1", "G2")):
        own = {name: models[name] for name in unit}
        standing = replace(by_hand([], drawn(0)), unit=unit, models=own, real=nothing)
        columns = bench.columns(unit, cross=len(unit) > 1)
        (values,) = (one.values for one in replicates_of(bench, standing, [2]))
        assert values.shape == columns.shape
        assert np.isfinite(values).mean() > 0.5  # the rest has no information on one log


class CannedRun:
    """Replaces simulations: gains by effect, of first evaluations and refinements (`first`) and of confirmations."""

    def __init__(self, first: dict[str, float], last: dict[str, tuple[float, float]], independent: float = 1.0) -> None:
        self._first, self._last, self.asked = first, last, list[int]()
        self._independent = independent

    def __call__(self, job: Callable[[Bench, Any], Any], items: Sequence[Any]) -> list[Any]:
        if job.__name__ == "_confirm":
            self.asked.append(sum(len(several) for _, several in items))
            return [[self._confirmed(standing, tried) for tried in several] for standing, several in items]
        self.asked.append(len(items))
        if job.__name__ == "look_at":
            return [[self._looked(trial) for trial in trials] for _, trials in items]
        return [self._looked(fitted.trial) for _, fitted in items]

    def _looked(self, trial: Hypothesis) -> FittedHypothesis:
        return FittedHypothesis(trial, {}, self._first[trial.name])

    def _confirmed(self, standing: UnitState, tried: FittedHypothesis) -> Evaluation:
        return Evaluation(tried, standing, *self._last[tried.trial.name], independent=self._independent)


def round_of(
    first: dict[str, float], last: dict[str, tuple[float, float]], *effects: Effect
) -> tuple[Round, CannedRun]:
    """The placebo is the tone."""
    told = CannedRun(first, last)
    standing = by_hand([0.0], drawn(1))
    came = search_round(
        {UNIT: standing}, {UNIT: [Hypothesis((one,)) for one in effects]}, {UNIT: Hypothesis((LINE,))}, told
    )
    return came[UNIT], told


class RunByMoment(CannedRun):
    """First evaluations gain more if the beginning of the bias is nearer to a moment; if it is nan, all the same."""

    def __init__(self, moment_s: float) -> None:
        super().__init__({"bias": 99.0, "tone": 0.0}, {"bias": (9.0, 20.0), "tone": (0.0, 0.0)})
        self._moment_s = moment_s

    def _looked(self, trial: Hypothesis) -> FittedHypothesis:
        if not trial.when.spans:
            return super()._looked(trial)
        off_s = abs(trial.when.spans[-1].moment_s - self._moment_s)
        return FittedHypothesis(trial, {}, 100.0 - (0.0 if math.isnan(off_s) else off_s))


@pytest.mark.parametrize("moment_s", [11.0, 37.1, 49.0])
def test_a_beginning_within_a_motion_is_narrowed_down(moment_s: float) -> None:
    """From the middle, 30 s, to an eighth of a second: in each of four steps the interval of 40 s shrinks by 2 / 7."""
    trial = replace(Hypothesis((Bias(1.0),)).at(When((Span(0, 30.0, math.inf),))), begin_bounds_s=(10.0, 50.0))
    run = RunByMoment(moment_s)
    result = search_round({UNIT: by_hand([0.0], drawn(1))}, {UNIT: [trial]}, {UNIT: Hypothesis((LINE,))}, run)[UNIT]
    assert result.selection is not None
    (span,) = result.selection.trial.when.spans
    assert span.moment_s == pytest.approx(moment_s, abs=40.0 * (2 / 7) ** 4 / 2)


def test_a_beginning_that_nothing_shows_stays_in_the_middle() -> None:
    """As in a motion that is not compared. The held-out half of the rest before it follows the lower bound."""
    trial = replace(Hypothesis((Bias(1.0),)).at(When((Span(0, 30.0, math.inf),))), begin_bounds_s=(10.0, 50.0))
    run = RunByMoment(math.nan)
    result = search_round({UNIT: by_hand([0.0], drawn(1))}, {UNIT: [trial]}, {UNIT: Hypothesis((LINE,))}, run)[UNIT]
    (only,) = result.confirmed
    assert [span.moment_s for span in only.trial.when.spans] == [30.0]


def test_the_trial_with_the_largest_gain_is_accepted() -> None:
    first = {"bias": 5.0, "white_noise": 9.0, "stuck": 1.0, "tone": 0.0}
    last = {"bias": (5.0, 8.0), "white_noise": (9.0, 7.0), "tone": (0.0, 1.0)}
    found, told = round_of(first, last, Bias(1.0), WhiteNoise(1.0), Stuck(0.0))
    # first evaluation of all, refinement, confirmation, the placebo refined, confirmed
    assert told.asked == [1, 2, 2, 1, 1]
    assert [one.trial.name for one in found.confirmed] == ["bias", "white_noise"]
    assert found.placebo_gain == 1.0
    assert found.selection is found.confirmed[0]


def test_a_family_whose_causes_gain_too_little_needs_no_placebo() -> None:
    """It could only raise the required gain; the placebo of a single sensor is reported."""
    trials, placebo = [Hypothesis((Bias(1.0),))], Hypothesis((LINE,))
    for unit, gain, placebos in ((UNIT, 0.0, 1), (("G1", "G2"), 0.0, 0), (("G1", "G2"), ACCEPTED + 0.1, 1)):
        told = CannedRun({"bias": 9.0, "tone": 0.0}, {"bias": (9.0, gain), "tone": (0.0, -1.0)})
        standing = replace(by_hand([0.0], drawn(1)), unit=unit)
        search_round({unit: standing}, {unit: trials}, {unit: placebo}, told)
        assert told.asked == [1, 1, 1, placebos, placebos]


def test_a_cause_far_beyond_any_placebo_needs_none() -> None:
    """From 30 nats beyond the required gain on; the gain of a placebo that was not simulated is 0."""
    for gain, placebos in ((ACCEPTED + 29.9, 1), (ACCEPTED + 30.1, 0)):
        told = CannedRun({"bias": 90.0, "tone": 0.0}, {"bias": (90.0, gain), "tone": (0.0, -1.0)})
        trials, placebo = [Hypothesis((Bias(1.0),))], Hypothesis((LINE,))
        (found,) = search_round({UNIT: by_hand([0.0], drawn(1))}, {UNIT: trials}, {UNIT: placebo}, told).values()
        assert told.asked == [1, 1, 1, placebos, placebos]
        assert found.selection is not None
        assert found.placebo_gain == -placebos


def test_a_cause_without_a_placebo_must_reach_the_required_gain() -> None:
    """As in later rounds: the placebo of the first round measured the gain by chance."""
    for gain, is_taken in ((ACCEPTED + 0.1, True), (ACCEPTED - 0.1, False)):
        told = CannedRun({"bias": 9.0}, {"bias": (9.0, gain)})
        found = search_round({UNIT: by_hand([0.0], drawn(1))}, {UNIT: [Hypothesis((Bias(1.0),))]}, {}, told)[UNIT]
        assert told.asked == [1, 1, 1, 0, 0]
        assert ([one.trial.name for one in found.confirmed], found.placebo_gain) == (["bias"], 0.0)
        assert (found.selection is not None) == is_taken


def test_parameters_have_a_cost() -> None:
    """A nat for each fitted number, in the odds and not in the acceptance: of two causes with nearly equal gains the
    simpler is preferred.
    """
    first = {"bias": 5.0, "tone": 9.0, "white_noise": 0.0}
    last = {"bias": (5.0, 8.0), "tone": (9.0, 9.0), "white_noise": (0.0, 0.0)}
    told = CannedRun(first, last)
    trials = [
        Hypothesis((Tone(1.0, 9.0),), ("amplitude", "frequency_hz")),
        Hypothesis((Bias((1.0, 0.0, 0.0)),), ("offset",)),
    ]
    standing = by_hand([0.0], drawn(1))
    found = search_round({UNIT: standing}, {UNIT: trials}, {UNIT: Hypothesis((WhiteNoise(1.0),))}, told)[UNIT]
    assert [one.trial.name for one in found.confirmed] == ["bias", "tone"]
    assert [one.factors for one in found.confirmed] == [1, 4]
    assert found.log_odds == pytest.approx((8 - COST, 9 - 4 * COST))
    assert found.selection is found.confirmed[0]


def test_odds_use_the_independent_share_of_the_best() -> None:
    """Half of the independent share without it: half the nats, of the best and of the others."""
    standing = by_hand([0.0], drawn(1), independent=0.4)
    tried = [FittedHypothesis(Hypothesis((one,))) for one in (LINE, Bias(1.0))]
    every = tuple(
        Evaluation(one, standing, 9.0, gain, independent=share)
        for one, gain, share in zip(tried, (20.0, 6.0), (0.2, 0.4), strict=True)
    )
    assert Round(standing, every, 0.0, None).log_odds == pytest.approx((10.0, 3.0))
    assert Round(standing, every[1:], 0.0, None).log_odds == pytest.approx((6.0,))
    assert Round(standing, (), 0.0, None).log_odds == ()


@pytest.mark.parametrize(
    ("train", "gain", "placebo", "is_taken"),
    [
        (5.0, ACCEPTED + 0.1, -9.0, True),  # a placebo that loses does not lower the limit
        (5.0, ACCEPTED - 0.1, -9.0, False),
        (5.0, ACCEPTED + 1.9, 2.0, False),
        (5.0, ACCEPTED + 2.1, 2.0, True),
    ],
)
def test_a_cause_must_exceed_the_limit_and_the_placebo(
    train: float, gain: float, placebo: float, is_taken: bool
) -> None:
    found, _ = round_of({"bias": 9.0, "tone": 0.0}, {"bias": (train, gain), "tone": (0.0, placebo)}, Bias(1.0))
    assert (found.selection is not None) == is_taken


@pytest.mark.parametrize(
    ("free", "train", "gain", "is_taken"),
    [
        (("offset",), WORTH - 0.1, 99.0, False),  # no gain on the training part
        ((), WORTH - 0.1, 99.0, True),  # nothing was fitted
        ((), -0.1, 99.0, False),
        ((), 0.0, ACCEPTED + 8.1, True),  # the sum of both parts, less 8
        ((), 0.0, ACCEPTED + 7.9, False),
    ],
)
def test_a_cause_observable_in_the_held_out_part_only(
    free: tuple[str, ...], train: float, gain: float, is_taken: bool
) -> None:
    run = CannedRun({"bias": 9.0, "tone": 0.0}, {"bias": (train, gain), "tone": (0.0, 0.0)})
    trials, placebos = {UNIT: [Hypothesis((Bias(1.0),), free)]}, {UNIT: Hypothesis((LINE,))}
    result = search_round({UNIT: by_hand([0.0], drawn(1))}, trials, placebos, run)[UNIT]
    assert (result.selection is not None) == is_taken


@pytest.mark.parametrize(
    ("train", "gain", "is_taken"),
    [
        (ACCEPTED + 11.1, 0.0, True),  # beyond 8 nats for the choice and 1 for each fitted number
        (ACCEPTED + 10.9, 0.0, False),
        (ACCEPTED + 11.1, -0.2, False),  # the held-out part contradicts it
    ],
)
def test_a_cause_observable_in_the_training_part_only(train: float, gain: float, is_taken: bool) -> None:
    """It is then evaluated on both parts, by the mean of both minus 4 nats, and reports this."""
    run = CannedRun({"bias": 9.0, "tone": 0.0}, {"bias": (train, gain), "tone": (0.0, 0.0)})
    trials, placebos = {UNIT: [Hypothesis((Bias(1.0),), ("offset",))]}, {UNIT: Hypothesis((LINE,))}
    result = search_round({UNIT: by_hand([0.0], drawn(1))}, trials, placebos, run)[UNIT]
    assert (result.selection is not None) == is_taken
    if result.selection is not None:
        assert result.selection.trial.needs_both
        assert result.confirmed == (result.selection,)
        assert result.selection.gain == pytest.approx((train + gain) / 2 - 4)


@pytest.mark.parametrize(("train", "is_taken"), [(ACCEPTED + 8.1, True), (ACCEPTED + 7.9, False)])
def test_a_cause_without_numbers_observable_in_the_training_part_only(train: float, is_taken: bool) -> None:
    """As above, but nothing was fitted: limits of codes that are read off are not fitted."""
    run = CannedRun({"bias": 9.0, "tone": 0.0}, {"bias": (train, 0.0), "tone": (0.0, 0.0)})
    trials, placebos = {UNIT: [Hypothesis((Bias(1.0),))]}, {UNIT: Hypothesis((LINE,))}
    result = search_round({UNIT: by_hand([0.0], drawn(1))}, trials, placebos, run)[UNIT]
    assert (result.selection is not None) == is_taken


@pytest.mark.parametrize(("gain", "is_taken"), [(0.1, True), (-0.1, False)])
def test_a_known_effect_needs_no_significance(gain: float, is_taken: bool) -> None:
    """Neither a gain beyond chance nor a gain on the training part is required; a loss is not accepted."""
    told = CannedRun({"bias": 9.0, "tone": 0.0}, {"bias": (0.0, gain), "tone": (0.0, 5.0)})
    trials, placebos = {UNIT: [Hypothesis((Bias(1.0),))]}, {UNIT: Hypothesis((LINE,))}
    found = search_round({UNIT: by_hand([0.0], drawn(1))}, trials, placebos, told, known=True)[UNIT]
    assert (found.selection is not None) == is_taken


@pytest.mark.parametrize(("effect", "is_taken"), [(Bias(1.0), False), (Stuck(3.0, 1.0), True)])
def test_correlated_statistics_are_counted_once(effect: Effect, is_taken: bool) -> None:
    """20 nats of statistics of which a tenth is independent are 2; a single event has no more statistics."""
    told = CannedRun({effect.name: 9.0}, {effect.name: (9.0, 20.0)}, independent=0.1)
    found = search_round({UNIT: by_hand([0.0], drawn(1))}, {UNIT: [Hypothesis((effect,))]}, {}, told)[UNIT]
    assert (found.selection is not None) == is_taken


@pytest.mark.parametrize(("share", "is_taken"), [(0.9, True), (0.3, False)])
def test_gains_of_independent_statistics_have_more_weight(share: float, is_taken: bool) -> None:
    """Nats are weighted by the independent share of all statistics of the sensor, 0.3: where the moved statistics are
    independent, 2 are 6.
    """
    told = CannedRun({"bias": 9.0}, {"bias": (9.0, 2.0)}, independent=share)
    standing = by_hand([0.0], drawn(1), independent=0.3)
    found = search_round({UNIT: standing}, {UNIT: [Hypothesis((Bias(1.0),))]}, {}, told)[UNIT]
    assert (found.selection is not None) == is_taken


@pytest.mark.parametrize(("own_share", "odds"), [(1.0, 6.0), (0.5, 4.0), (0.0, 2.0), (-3.0, 2.0)])
def test_relative_statistics_have_no_additional_weight(own_share: float, odds: float) -> None:
    """2 nats that are three times as independent as most, by the share that the sensor shows alone."""
    one = Evaluation(
        FittedHypothesis(Hypothesis((Bias(1.0),))),
        by_hand([0.0], drawn(1)),
        9.0,
        2.0,
        own_share=own_share,
        independent=0.9,
    )
    found = Round(by_hand([0.0], drawn(1), independent=0.3), (one,), 0.0, None)
    assert found.log_odds == pytest.approx((odds,))


def test_a_trial_that_needs_both_parts_may_gain_in_one() -> None:
    last = {"stuck": (-1.0, 30.0), "tone": (0.0, 0.0)}
    found, _ = round_of({"stuck": 9.0, "tone": 0.0}, last, Stuck(3.0, 1.0))
    assert found.selection is not None


@pytest.mark.parametrize(("gain", "is_taken"), [(ACCEPTED / 2 + 0.1, True), (ACCEPTED / 2 - 0.1, False)])
def test_a_single_event_is_counted_over_both_parts(gain: float, is_taken: bool) -> None:
    """The evaluation of a brief cause has the mean of both parts: their sum is twice that."""
    result, _ = round_of({"stuck": 9.0, "tone": 0.0}, {"stuck": (0.0, gain), "tone": (0.0, 0.0)}, Stuck(3.0, 1.0))
    assert (result.selection is not None) == is_taken


def test_trials_without_gain_are_not_pursued() -> None:
    found, told = round_of({"bias": WORTH, "tone": 0.0}, {"tone": (0.0, -1.0)}, Bias(1.0))
    assert told.asked == [1, 0, 0, 0, 0]  # no placebo without a trial to compare with it
    assert (found.confirmed, found.selection, found.placebo_gain) == ((), None, 0.0)


def test_the_weight_of_independent_statistics_selects_but_does_not_rank() -> None:
    """Half of the required gain is sufficient with a weight of three; the order uses a weight of one."""
    weak, strong = (
        FittedHypothesis(Hypothesis((one,)), {}, gain)
        for one, gain in ((Bias(1.0), WORTH / 2), (Tone(1.0, 9.0), WORTH))
    )
    assert likeliest([weak, strong], 4) == []
    counted = [replace(weak, counts=3.0), replace(strong, counts=1.1)]
    assert likeliest(counted, 4) == counted[::-1]


@pytest.mark.slow
def test_a_round_on_simulations(tone: tuple[Bench, UnitState]) -> None:
    """A true line, suggested at half its size, and a wrong noise."""
    bench, standing = tone
    trials = [
        Hypothesis((Tone((0.0, 0.02, 0.0), 17.0),), ("amplitude",)),
        Hypothesis((WhiteNoise((0.03, 0.0, 0.0)),), ("rms",)),
    ]
    placebo = Hypothesis((Tone(0.0025, 100 * (math.sqrt(5) - 1) / 4),), ("amplitude",))
    (found,) = search_round({UNIT: standing}, {UNIT: trials}, {UNIT: placebo}, Run(bench)).values()
    assert found.selection is not None
    assert found.selection.trial.name == "tone"
    assert found.before is standing
    assert found.placebo_gain < ACCEPTED


def test_drifting_lines_are_of_another_form_than_constant_ones() -> None:
    """So that two constant lines leave room for a drifting one, for any amplitude."""
    stays, drifts = Hypothesis((Tone(1.0, 9.0),)), Hypothesis((Tone(1.0, 9.0, drift_hz_per_h=3.0),))
    assert stays.form == Hypothesis((Tone((2.0, 0.0, 0.0), 30.0),), ("amplitude",)).form
    assert len({stays.form, drifts.form, replace(stays, removed="tone").form, Hypothesis((), removed="tone").form}) == 4
    tried = [
        FittedHypothesis(one, {}, gain) for one, gain in ((stays, 30.0), (stays, 29.0), (stays, 28.0), (drifts, 27.0))
    ]
    assert [one.gain for one in likeliest(tried, 4)] == [30.0, 29.0, 27.0]


def test_the_best_trial_has_a_rival_of_another_form() -> None:
    """A delay, suggested too small, explains a third of the gain of a clock error on the training part."""
    clock, delay, noise = (
        FittedHypothesis(Hypothesis((effect,)), {}, gain)
        for effect, gain in ((ClockError(500.0), 36.0), (Skew(0.015), 12.0), (WhiteNoise(1.0), 11.0))
    )
    assert likeliest([noise, delay, clock], 4) == [clock, delay]


def test_a_third_trial_of_an_effect_does_not_displace_other_effects() -> None:
    """Wanders of three forms, of which two remain beside a step and a jump, and three beside a step alone."""
    forms = ({"rms": 1.0}, {"rms": 1.0, "time_constant_s": 3.0}, {"rms": 1.0, "fastest_time_constant_s": 1.0})
    wanders = [FittedHypothesis(Hypothesis((BiasInstability(**form),)), {}, 9.0 - at) for at, form in enumerate(forms)]
    step, jumps = (
        FittedHypothesis(Hypothesis((effect,)), {}, gain) for effect, gain in ((Bias(1.0), 6.0), (PopcornNoise(), 5.0))
    )
    assert likeliest([*wanders, step, jumps], 4) == [*wanders[:2], step, jumps]
    assert likeliest([*wanders, step], 4) == [*wanders, step]


def test_trials_of_both_parts_are_not_displaced_by_those_of_one() -> None:
    """Gains on other data can't be compared: the best of either kind is pursued."""
    own = [
        FittedHypothesis(Hypothesis((effect,)), {}, gain)
        for effect, gain in ((Tone(1.0, 9.0), 40.0), (Tone(1.0, 30.0), 39.0))
    ]
    late = [FittedHypothesis(Hypothesis((Bias(1.0),), whole=True), {}, gain) for gain in (25.0, 24.0)]
    assert [one.gain for one in likeliest([*own, *late], 2)] == [40.0, 39.0, 25.0]
    assert [one.gain for one in likeliest([*own, *late], 4)] == [40.0, 39.0, 25.0, 24.0]
    assert likeliest(late, 1) == late[:1]


@pytest.mark.parametrize(("name", "numbers"), [("saturation", [10.0, 42.0]), ("tone", [10.0])])
def test_a_range_limit_reached_in_one_part_only_is_tried(
    monkeypatch: pytest.MonkeyPatch, name: str, numbers: list[float]
) -> None:
    """The training part suggests 10, both parts together 42: a line that both show need not be tried twice."""

    def effect(number: float) -> Effect:
        return Saturation((number,) * 3) if name == "saturation" else Tone((number,) * 3, 17.0)

    guesses = iter([[Hypothesis((effect(10.0),))], [Hypothesis((effect(42.0),))]])
    monkeypatch.setattr(search, "guesses_of", lambda *_: next(guesses))
    monkeypatch.setattr(search, "_evidence", lambda *_: SimpleNamespace(phases=()))
    monkeypatch.setattr(search, "placebo_of", lambda _: None)
    split = SimpleNamespace(train=lambda _: None, both=lambda _: None)
    comparison = SimpleNamespace(bench=SimpleNamespace(split=split), campaign=None)
    tried = search._guesses_of(comparison, {("G1",): None}, {})[("G1",)]  # type: ignore[arg-type, dict-item]
    assert tried.shared == []
    assert [trial.effects[0] for trial in tried.alone] == [effect(number) for number in numbers]
    assert [trial.whole for trial in tried.alone] == [False, True][: len(numbers)]


def test_a_scatter_narrowed_by_chance_does_not_hide_a_closure() -> None:
    """A statistic at 6 standard deviations is explained, and 40 others at 1.2 scatter by half as much afterwards, or by
    twice as much, by chance: by the wider scatter these add up to less than before.
    """
    real = np.array([6.0, *([1.2] * 40)])
    always, never = np.ones(41, bool), np.zeros(41, bool)
    before = SyntheticLikelihood(np.zeros(41), np.ones(41), always, never)
    after = SyntheticLikelihood(np.array([6.0] + [0.0] * 40), np.array([1.0] + [0.5, 2.0] * 20), always, never)
    np.testing.assert_allclose(scores_by_wider(before, after, real), [0.0] + [1.2, 0.6] * 20)
    assert (after.scores(real) ** 2).sum() > (before.scores(real) ** 2).sum()
