"""Parameters refined from rough suggestions, with adapted noise and level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.refinement import (
    Factor,
    FittedHypothesis,
    _step,
    factors_of,
    has_hope,
    looks,
    move_factors,
    refine,
    regress,
)
from imuarray.gap.inference.unit_state import UnitState
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.replication import Models, ReplicateRequest
from imuarray.simulate.effects.bias import Bias, CommonMode
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.readings import ChannelSwap, Glitches, StaleSamples, Stuck
from imuarray.simulate.effects.response import GSensitivity, Scale
from tests.gap.search_inputs import found_in, standing_of
from tests.gap.small_bench import LINE
from tests.gap.unit_states import standing as by_hand


@pytest.fixture(scope="module")
def tone() -> tuple[Bench, UnitState]:
    found = found_in(LINE)
    return found.bench, standing_of(found)


def test_factors_are_the_effective_numbers() -> None:
    assert factors_of(Hypothesis((Tone((0.0, 0.1, 0.0), 9.0),), ("amplitude", "frequency_hz"))) == [
        Factor(0, "amplitude", 1, 1),
        Factor(0, "frequency_hz"),
    ]
    nine = (0.0, 0.1, 0.0, 0.0, 0.0, 0.2, 0.3, 0.0, 0.0)
    assert factors_of(Hypothesis((Bias(1.0), GSensitivity(nine)), ("response",))) == [
        Factor(1, "response", 1, 0, 1),
        Factor(1, "response", 5, 1, 2),
        Factor(1, "response", 6, 2, 0),
    ]
    assert factors_of(Hypothesis((Stuck(0.0, math.inf),), ("onset_s", "duration_s"))) == []
    assert factors_of(Hypothesis((Tone(1.0, 2.0),))) == []


def test_sensors_with_individual_sizes_keep_their_ratio() -> None:
    """One process has one time constant, and a factor of two applies to both sizes."""
    trial = Hypothesis(
        (CommonMode((0.006, 0.004, 0.002), 1.0),),
        ("rms", "time_constant_s"),
        sensor="A1",
        others=("A2",),
        opposite=(CommonMode((0.003, 0.002, 0.001), 1.0),),
    )
    doubled = move_factors(trial, factors_of(trial), np.log([2.0, 1.0, 1.0, 4.0]))
    assert doubled.effects == (CommonMode((0.012, 0.004, 0.002), 4.0),)
    assert doubled.opposite == (CommonMode((0.006, 0.002, 0.001), 4.0),)


def test_trials_are_ranked_by_their_gain(tone: tuple[Bench, UnitState]) -> None:
    """The right line, a line at another frequency, and no effect."""
    bench, standing = tone
    right, wrong, nothing = (
        looks(bench, standing, [Hypothesis(effects)])[0] for effects in ((LINE,), (Tone(LINE.amplitude, 31.0),), ())
    )
    assert right.gain > 10
    assert right.gain > wrong.gain + 10
    assert nothing.gain == pytest.approx(0.0, abs=0.2)  # noise and level are adapted by two draws


def count_requests(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of replicates of each call, as they are simulated."""
    simulated: list[int] = []
    replicates = Bench.replicates

    def count(
        self: Bench, requests: Sequence[ReplicateRequest], held_out: bool = True, **others: Models
    ) -> list[StatisticValues]:
        simulated.append(len(requests))
        return replicates(self, requests, held_out=held_out, **others)

    monkeypatch.setattr(Bench, "replicates", count)
    return simulated


def test_effects_on_the_response_have_more_looks(
    tone: tuple[Bench, UnitState], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each replicate draws a response of its own, and two of them may agree by chance: four instead of two."""
    bench, standing = tone
    simulated = count_requests(monkeypatch)
    line, scale = Hypothesis((LINE,), ("amplitude",)), Hypothesis((Scale(0.05),), ("error",))
    found = looks(bench, standing, [line, scale, line])
    assert simulated == [3 * 2, 2]
    assert [one.trial.name for one in found] == ["tone", "scale", "tone"]
    assert found[0].gain == found[2].gain > found[1].gain


def test_a_response_without_hope_has_no_more_looks(
    tone: tuple[Bench, UnitState], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line of 1 dps that the recording lacks loses far more than 10 nats in the first two replicates."""
    bench, standing = tone
    simulated = count_requests(monkeypatch)
    (found,) = looks(bench, standing, [Hypothesis((Scale(0.05), Tone(1.0, 31.0)), ("error",))])
    assert simulated == [2]
    assert found.values is not None
    assert len(found.values) == 2
    assert found.gain < -10


@pytest.mark.parametrize(
    ("gain", "by_log", "hope"),
    [
        (-9.9, {0: -9.9}, True),
        (-10.1, {0: -10.1}, False),
        (-10.1, {0: -12.2, 1: 2.1}, True),  # an effect of the second log alone
        (-10.1, {0: -11.0, 1: 0.9}, False),
    ],
)
def test_a_trial_has_hope_if_it_loses_little_or_gains_in_a_log(
    gain: float, by_log: dict[int, float], hope: bool
) -> None:
    assert has_hope(FittedHypothesis(Hypothesis((LINE,)), {}, gain, by_log=by_log)) == hope
    assert not has_hope(FittedHypothesis(Hypothesis((LINE,)), None, 9.0))  # refused parameters


def test_a_step_starts_from_the_level_that_the_recording_has(
    tone: tuple[Bench, UnitState], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model with a bias of 5 dps more than the recording, far more than the noise, is first given the recorded bias.
    Slopes are those of an amplitude alone: while it is changed, the bias stays.
    """
    bench, standing = tone
    (name,) = standing.unit
    displaced = replace(standing.models[name].fitted, offset=(5.0, 0.0, 0.0))
    seen: list[tuple[float, float]] = []
    replicates = Bench.replicates

    def record(
        self: Bench, requests: Sequence[ReplicateRequest], held_out: bool = True, **others: Models
    ) -> list[StatisticValues]:
        of_first = [models[name] for models, number in requests if number == 0]
        amplitudes = [effect.amplitude[1] for model in of_first for effect in model.added if isinstance(effect, Tone)]
        seen.extend(zip([model.fitted.offset[0] for model in of_first], amplitudes, strict=True))
        return replicates(self, requests, held_out=held_out, **others)

    monkeypatch.setattr(Bench, "replicates", record)
    refine(bench, standing, Hypothesis((Tone((0.0, 0.01, 0.0), 9.0),), ("amplitude",), fitted=displaced))
    first, second, *later = seen
    assert first == (5.0, 0.01)
    assert second == pytest.approx((standing.target[name].offset[0], 0.01), abs=0.3)
    assert second[1] == 0.01
    assert later[0][0] == second[0]
    assert later[0][1] != 0.01


def test_slopes_of_a_response_need_fewer_replicates_than_its_gain(
    tone: tuple[Bench, UnitState], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four replicates of the trial, of its noise adapted and of each step; two of each slope."""
    bench, standing = tone
    simulated = count_requests(monkeypatch)
    refine(bench, standing, Hypothesis((Scale(0.01),), ("error",)))
    assert simulated[0] == 4
    assert 2 in simulated


@pytest.mark.parametrize(("deviation", "slope", "gain"), [(2.0, 1e3, 1.333333), (2.0, 0.0, 0.0), (0.0, 1e3, 0.0)])
def test_a_step_has_an_expected_gain(deviation: float, slope: float, gain: float) -> None:
    """A deviation of two standard deviations, which a small step removes: by Student's t with 5 degrees of freedom it
    has the weight 6 / (5 + 4), so its square, 4, costs 6 / 9 * 4 / 2 nats.
    """
    standing = by_hand([deviation], np.zeros((8, 1)))
    statistics = SimpleNamespace(likelihood=standing.likelihood)
    _, expected = _step(standing, cast(Any, statistics), np.array([[slope]]))
    assert expected == pytest.approx(gain, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("guess", [0.025, 0.06])
def test_an_amplitude_is_refined(tone: tuple[Bench, UnitState], guess: float) -> None:
    """From 0.6 and 1.5 of it; the noise, which had included the line, is restored. 1000 rows of 0.05 dps determine an
    amplitude to 0.05 sqrt(2 / 1000) = 0.0022 dps and a noise to 2.2 %; frequencies are 0.1 Hz apart.
    """
    bench, standing = tone
    trial = Hypothesis((Tone((0.0, guess, 0.0), 17.0),), ("amplitude",))
    found = refine(bench, standing, trial)
    (effect,) = found.trial.effects
    assert isinstance(effect, Tone)
    assert effect.amplitude[1] == pytest.approx(0.04, abs=5 * 0.0022)
    assert (effect.amplitude[0], effect.amplitude[2], effect.frequency_hz) == (0.0, 0.0, 17.0)
    assert found.gain > looks(bench, standing, [trial])[0].gain
    assert found.models is not None
    assert found.models["G1"].added == (effect,)
    assert standing.models["G1"].fitted.rms[1] == pytest.approx(math.hypot(0.05, 0.04 / 2**0.5), rel=0.1)
    assert found.models["G1"].fitted.rms[1] == pytest.approx(0.05, rel=0.1)


def test_axes_without_gain_are_removed(tone: tuple[Bench, UnitState]) -> None:
    """A line suggested on all three axes stays on its true axis."""
    bench, standing = tone
    found = refine(bench, standing, Hypothesis((Tone((0.02, 0.03, 0.02), 17.0),), ("amplitude",)))
    (effect,) = found.trial.effects
    assert isinstance(effect, Tone)
    assert [bool(one) for one in effect.amplitude] == [False, True, False]
    assert found.models is not None
    assert found.models["G1"].added == (effect,)


@pytest.mark.slow
def test_an_axis_without_gain_is_kept_if_its_removal_loses() -> None:
    """Another range for half a second, with half the counts: its offset on x compensates that, so that there is no
    change; without the offset x of the model would change by half of its bias.
    """
    known = {"runs": (0.0,), "moments_s": (8.0,), "lengths_s": (0.5,), "doubts_s": (0.0,)}
    reset = RangeReset(500.0, (0.5, 0.0, 2.0), (2.0, 1.0, 1.0), **known)
    found = found_in(reset)
    refined = refine(found.bench, standing_of(found), Hypothesis((reset,), ("offset",), whole=True))
    (effect,) = refined.trial.effects
    assert isinstance(effect, RangeReset)
    assert effect.offset == pytest.approx(reset.offset, rel=0.2)
    assert effect.offset[0] > 0


def test_a_trial_without_free_parameters_is_unchanged(tone: tuple[Bench, UnitState]) -> None:
    bench, standing = tone
    trial = Hypothesis((LINE,))
    found = refine(bench, standing, trial)
    assert found.trial == trial
    # mean of two draws, and the first draw
    assert found.gain == pytest.approx(looks(bench, standing, [trial])[0].gain, abs=3)


@pytest.mark.slow
def test_shares_stay_below_one(tone: tuple[Bench, UnitState]) -> None:
    """For any gain: a probability is at most one."""
    bench, standing = tone
    for effect in (StaleSamples(0.9), Glitches(0.9, 0.5)):
        (found,) = refine(bench, standing, Hypothesis((effect,), ("probability",))).trial.effects
        assert 0 < found.probability <= 1  # type: ignore[attr-defined]


def test_an_effect_that_cannot_be_simulated_has_no_model(tone: tuple[Bench, UnitState]) -> None:
    """Data of a sensor that does not exist."""
    bench, standing = tone
    for job in (lambda *request: looks(*request[:2], [request[2]])[0], refine):
        found = job(bench, standing, Hypothesis((ChannelSwap("G9"),)))
        assert (found.models, found.gain) == (None, -math.inf)


@pytest.mark.parametrize("size", [1.0, 1e12, 1e160])
def test_collinear_columns_share_their_contribution(size: float) -> None:
    """3 is explained by two columns of ones: with a prior of width 2, x = 3 n / (2 n + 1/4) each, for n = 4 rows of
    weight 1; as columns grow it is half of 3 over their size.
    """
    found = regress(np.full((4, 2), size), np.full(4, 3.0), np.ones(4))
    expected = 12 / 8.25 if size == 1 else 1.5 / size
    np.testing.assert_allclose(found, expected, rtol=1e-6)
