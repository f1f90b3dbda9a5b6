"""All rounds of the search, from the base model to models that explain a recording."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from imuarray.gap.findings.causes import causes_of
from imuarray.gap.inference import forward_selection
from imuarray.gap.inference.comparison import compare_with_base
from imuarray.gap.inference.effects import CANDIDATES, Candidate, Hypothesis
from imuarray.gap.inference.evidence import Evidence, Span, When, since
from imuarray.gap.inference.forward_selection import (
    Round,
    _shown_by_each_part,
    gaining_of,
    look_at,
    look_in_turns,
    precursors,
    search_round,
)
from imuarray.gap.inference.refinement import FittedHypothesis
from imuarray.gap.inference.search import ROUNDS, SearchResult, _deferred, search_causes
from imuarray.gap.inference.unit_state import Unit, UnitState
from imuarray.simulate.effects.bias import Bias, BiasInstability, CommonMode, PopcornNoise, RandomWalk
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.readings import ChannelSwap
from tests.gap.search_inputs import found_in
from tests.gap.small_bench import LINE, SHORT, Run, prepared
from tests.selection import some

OTHER = Tone((0.06, 0.0, 0.0), 29.0)


@pytest.fixture(scope="module")
def two_lines() -> SearchResult:
    """A line on y and one on x."""
    found = found_in(LINE, OTHER)
    return search_causes(found, {"tone": CANDIDATES["tone"]}, Run(found.bench))


@pytest.mark.slow
def test_the_effect_of_a_round_is_in_the_model_of_the_next(two_lines: SearchResult) -> None:
    """Both lines are accepted, one after the other or both at once; the last round accepts nothing, or
    no gap remains.
    """
    (rounds,) = two_lines.rounds.values()
    assert len(rounds) <= ROUNDS
    assert all(one.selection is not None for one in rounds[:-1])
    for before, after in pairwise(rounds):
        assert before.selection is not None
        assert after.before.models == before.selection.standing.models
    lines = [effect for effect in two_lines.models["G1"].added if isinstance(effect, Tone)]
    for line, axis in ((LINE, 1), (OTHER, 0)):
        near = [one for one in lines if abs(one.frequency_hz - line.frequency_hz) < 0.3]
        assert sum(one.amplitude[axis] for one in near) == pytest.approx(line.amplitude[axis], rel=0.25)


@pytest.mark.slow
def test_each_round_explains_more(two_lines: SearchResult) -> None:
    (rounds,) = two_lines.rounds.values()
    sizes = [np.sqrt(np.nanmean(np.square(one.before.scores))) for one in rounds]
    assert sizes == sorted(sizes, reverse=True)


@pytest.mark.slow
def test_an_effect_of_all_sensors_is_one_cause() -> None:
    """The same line in sensors of two chips, suggested for each of them as common to all."""
    bench, campaign = prepared([("static", SHORT)], ["G1", "A1"], {"G1": (LINE,), "A1": (LINE,)})
    found = compare_with_base(bench, campaign, Run(bench), 40)
    everywhere = Candidate("tone", lambda evidence: [Hypothesis((LINE,), shared=True, everywhere=True)])
    came = search_causes(found, {"tone": everywhere}, Run(bench))
    assert [unit for unit, rounds in came.rounds.items() if any(one.selection for one in rounds)] == [("A1", "G1")]
    assert all(LINE in model.added for model in came.models.values())
    (cause,) = causes_of(bench, came.rounds, 1)
    assert (cause.sensors, cause.origin) == (("A1", "G1"), "metadata")


@pytest.mark.slow
def test_an_effect_of_all_sensors_is_tried_for_a_single_sensor_too() -> None:
    found = found_in(LINE)
    everywhere = Candidate("tone", lambda evidence: [Hypothesis((LINE,), shared=True, everywhere=True)])
    came = search_causes(found, {"tone": everywhere}, Run(found.bench))
    (cause,) = causes_of(found.bench, came.rounds, 1)
    assert (cause.sensors, cause.origin) == (("G1",), "metadata")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shares", "gains", "waiting"),
    some(
        [
            ((0.0, 0.0), (9.0, 8.0), ["G2"]),  # the deviating sensor makes the other look deviating
            ((0.0, 0.0), (8.0, 9.0), ["G1"]),
            ((1.0, 0.0), (8.0, 9.0), ["G2"]),  # the first has not been tried yet
            ((0.0, 1.0), (8.0, 7.0), ["G1"]),
            ((1.0, 1.0), (8.0, 9.0), []),
            ((0.0, None), (8.0, 9.0), []),  # nothing was accepted for the other
        ],
        1,
    ),
)
def test_sensors_deviating_only_relative_to_others_wait(
    two_lines: SearchResult, shares: tuple[float, float | None], gains: tuple[float, float], waiting: list[str]
) -> None:
    """Two gyroscopes and an accelerometer, which is independent, by shares of the gain of each alone."""
    found = found_in()
    headers = {name: replace(found.bench.base.headers["G1"], name=name) for name in ("G1", "G2")}
    headers["A1"] = replace(headers["G1"], name="A1", quantity="specific_force")
    bench = replace(found.bench, base=replace(found.bench.base, headers=headers))
    (first, *_) = next(iter(two_lines.rounds.values()))
    assert first.selection is not None
    came: dict[Unit, Round] = {
        (name,): replace(
            first, selection=None if share is None else replace(first.selection, own_share=share, gain=gain)
        )
        for name, share, gain in zip(("G1", "G2", "A1"), (*shares, 1.0), (*gains, 50.0), strict=True)
    }
    assert [name for (name,) in _deferred(replace(found, bench=bench), came)] == waiting


@pytest.mark.slow
@pytest.mark.parametrize("is_there", some([True, False], 1))
def test_an_effect_hidden_by_noise_in_one_unit_may_be_common(is_there: bool) -> None:
    """The line is below the noise of G2, so that its absence is not observable; where G2 has the low noise of G1 and no
    line, the line is not common.
    """
    other = (WhiteNoise(1.0), LINE) if is_there else ()
    bench, campaign = prepared([("static", SHORT)], ["G1", "G2"], {"G1": (LINE,), "G2": other})
    found = compare_with_base(bench, campaign, Run(bench), 40)
    assert [node.path[-1] for node in found.localisation.root.significant("sensor")] == ["G1"]
    shared = Candidate("tone", lambda evidence: [Hypothesis((LINE,), shared=True)])
    came = search_causes(found, {"tone": shared}, Run(bench))
    units = [unit for unit, rounds in came.rounds.items() if any(one.selection for one in rounds)]
    assert units == ([("G1", "G2")] if is_there else [])


@pytest.mark.slow
def test_nothing_is_accepted_without_candidates() -> None:
    """One round, in which nothing is accepted; models are those of the base."""
    found = found_in(LINE)
    heard: list[str] = []
    came = search_causes(found, {}, Run(found.bench), heard.append)
    ((one,),) = came.rounds.values()
    assert (one.confirmed, one.selection) == ((), None)
    assert came.models == found.bench.models()
    assert heard == ["looking for causes, round 1: 1 sensors"]


@pytest.mark.slow
def test_a_known_sensor_is_the_only_one_searched() -> None:
    """Without a gap no sensor is searched; the sensor that is known to have the effect is."""
    found, candidates = found_in(), {"tone": CANDIDATES["tone"]}
    assert not search_causes(found, candidates, Run(found.bench)).rounds
    assert list(search_causes(found, candidates, Run(found.bench), known=("G1",)).rounds) == [("G1",)]


def test_candidates_receive_the_remaining_gap() -> None:
    """A candidate that records its evidence: at first the line, and a model without a tone; the training part for
    permanent effects, and both parts for brief ones.
    """
    shown: list[Evidence] = []

    def guesses(evidence: Evidence) -> list[Hypothesis]:
        shown.append(evidence)
        return []

    found = found_in(LINE)
    search_causes(found, {"made up": Candidate("made up", guesses)}, Run(found.bench))
    train, both = shown[:2]
    assert len(train.phases) == 1
    assert len(both.phases) == 2
    assert len(both.scores["line"]) == 2 * len(train.scores["line"])
    assert np.argmax(train.score("line")) == 1
    assert not [one for one in train.effects if isinstance(one, Tone)]
    assert {one.name for one in train.effects} >= {"white_noise", "bias", "thermal_bias"}


WANDER_ON_Z = Hypothesis((BiasInstability((0.0, 0.0, 0.1), 9.0),), ("rms",))
WANDER = Hypothesis((BiasInstability((0.1, 0.2, 0.1), 9.0),), ("rms",))
TELEGRAPH_ON_Z = Hypothesis((PopcornNoise((0.0, 0.0, 0.2), 0.1),), ("amplitude",))


def test_an_effect_waits_for_fewer_axes_and_telegraph_noise_for_wanders() -> None:
    walk, line = Hypothesis((RandomWalk((0.1, 0.1, 0.1)),), ("density",)), Hypothesis((LINE,), ("amplitude",))
    telegraph = Hypothesis((PopcornNoise((0.1, 0.0, 0.2), 0.1),), ("amplitude",))
    other_size = Hypothesis((BiasInstability((0.1, 0.2, 0.3), 9.0),), ("rms",))
    trials = [WANDER, WANDER_ON_Z, walk, TELEGRAPH_ON_Z, telegraph, line, other_size]
    assert precursors(trials) == [[1], [], [], [1, 2, 6], [3], [], []]
    once = replace(TELEGRAPH_ON_Z, whole=True)
    assert precursors([WANDER, once, line]) == [[], [], []]


@pytest.mark.parametrize("gains", [False, True])
def test_waiting_trials_are_evaluated_if_an_earlier_one_gains(gains: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    trials = [WANDER, WANDER_ON_Z, TELEGRAPH_ON_Z, Hypothesis((LINE,), ("amplitude",))]
    seen: list[Hypothesis] = []

    def run(job: Callable[..., object], items: Sequence[tuple[object, Sequence[Hypothesis]]]) -> list[object]:
        if job is not look_at:
            assert not items
            return []
        seen.extend(trial for _, some_trials in items for trial in some_trials)
        gain = 1.0 if gains else 0.0
        return [[FittedHypothesis(trial, {}, gain) for trial in some_trials] for _, some_trials in items]

    state = cast(UnitState, SimpleNamespace())
    with monkeypatch.context() as patch:
        patch.setattr(forward_selection, "_round", lambda *_: None)
        search_round({("G1",): state}, {("G1",): trials}, {}, run)
    assert seen == ([WANDER_ON_Z, trials[3], WANDER, TELEGRAPH_ON_Z] if gains else [WANDER_ON_Z, trials[3]])


def test_trials_are_pursued_if_they_gain_anywhere() -> None:
    """A trial that makes some logs likelier and others less likely may apply to the former."""
    line = Hypothesis((LINE,), ("amplitude",))
    assert not gaining_of([FittedHypothesis(line, {}, -5.0, by_log={0: -3.0, 1: 1.0})])
    divided, better = FittedHypothesis(line, {}, -5.0, by_log={0: -30.0, 1: 25.0}), FittedHypothesis(line, {}, 0.5)
    assert gaining_of([divided]) == [divided]
    assert gaining_of([better, FittedHypothesis(WANDER, {}, -1.0)]) == [better]


@pytest.mark.parametrize(("by_log", "divided"), [({0: -9.0, 1: -9.0, 2: 8.0}, [2]), ({0: -9.0, 1: 8.0, 2: -9.0}, None)])
def test_a_bias_that_comes_and_goes_is_not_divided(
    by_log: dict[int, float], divided: list[int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A level of one log, and not of the next, is that of a state after power-on. A line may come and go."""
    seen: list[Hypothesis] = []

    def run(job: Callable[..., object], items: Sequence[tuple[object, Sequence[Hypothesis]]]) -> list[object]:
        seen.extend(trial for _, some_trials in items for trial in some_trials)
        return [[FittedHypothesis(trial, {}, -7.0, by_log=by_log) for trial in trials] for _, trials in items]

    trials = [Hypothesis((Bias(0.3),), ("offset",)), Hypothesis((LINE,), ("amplitude",))]
    state = cast(UnitState, SimpleNamespace())
    with monkeypatch.context() as patch:
        patch.setattr(forward_selection, "_round", lambda *_: None)
        search_round({("G1",): state}, {("G1",): trials}, {}, run)
    logs = {trial.name: [span.log for span in trial.when.spans] for trial in seen if trial.when.spans}
    assert logs.get("tone") == [log for log, gain in by_log.items() if gain > 0]
    assert logs.get("bias") == divided


COMMON = Hypothesis((CommonMode((0.1, 0.0, 0.1), 9.0),), ("rms",), shared=True)
COMMON_FOR_A_WHILE = Hypothesis((CommonMode((0.3, 0.0, 0.3), 9.0),), ("rms",), shared=True).at(
    since(Span(1, 5.0, 60.0), [2])
)


def test_temporary_common_effects_wait_for_permanent_ones() -> None:
    elsewhere = replace(COMMON_FOR_A_WHILE, members=("G1", "G2"))
    assert precursors([COMMON_FOR_A_WHILE, COMMON, elsewhere]) == [[1], [], []]
    alone = replace(COMMON_FOR_A_WHILE, shared=False)
    assert precursors([alone, COMMON]) == [[], []]
    faster, slower = (Hypothesis((CommonMode((0.2, 0.0, 0.2), time_s),), ("rms",), shared=True) for time_s in (4, 17))
    assert precursors([COMMON_FOR_A_WHILE, faster, slower]) == [[2], [], []]
    assert precursors([COMMON_FOR_A_WHILE, faster]) == [[1], []]


def test_another_sensors_data_for_a_while_wait_for_nothing() -> None:
    """Before the while, the readings contradict the other sensor's data in every row."""
    always = Hypothesis((ChannelSwap("G2"),), shared=True, sensor="G1", others=("G2",))
    assert precursors([always.at(When((Span(0, 40.0, math.inf),))), always]) == [[], []]


@pytest.mark.parametrize(
    ("by_log", "is_seen"),
    [
        ({0: -9.0, 1: 2.0}, True),
        ({0: -9.0, 1: 0.5}, False),
        ({0: 2.0, 1: -9.0}, False),
        ({0: 2.0, 1: 0.0, 2: 0.0}, True),  # the part that was looked at does not have its logs
        ({}, False),
    ],
)
def test_temporary_effects_are_evaluated_if_one_of_their_logs_gains(
    by_log: dict[int, float], is_seen: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Hypothesis] = []

    def run(job: Callable[..., object], items: Sequence[tuple[object, Sequence[Hypothesis]]]) -> list[object]:
        seen.extend(trial for _, some_trials in items for trial in some_trials)
        return [[FittedHypothesis(trial, {}, -7.0, by_log=by_log) for trial in trials] for _, trials in items]

    state = cast(UnitState, SimpleNamespace())
    look_in_turns(run, {("G1",): state}, {("G1",): [COMMON_FOR_A_WHILE, COMMON]})
    assert seen == ([COMMON, COMMON_FOR_A_WHILE] if is_seen else [COMMON])


def test_events_that_recur_in_both_parts_do_not_need_both() -> None:
    """The choice of their moments costs 4 nats in the mean of both parts, and twice that in their sum."""
    recurring = _shown_by_each_part(Hypothesis((), whole=True, rarity=1.0))
    assert (recurring.needs_both, recurring.rarity) == (False, 9.0)
    assert _shown_by_each_part(Hypothesis((), rarity=1.0)) == Hypothesis((), rarity=1.0)
