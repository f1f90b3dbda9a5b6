"""The experiment that separates two causes, and the advice without such causes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from imuarray.gap.findings import experiment_design as menu
from imuarray.gap.findings.diagnosis import Cause, Unobservable
from imuarray.gap.findings.experiment_design import LEAST, MENU, Offer, nats_between, next_experiment, rivals_of
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.forward_selection import Evaluation, Round
from imuarray.gap.inference.refinement import FittedHypothesis
from imuarray.gap.inference.search import SearchResult
from imuarray.gap.inference.unit_state import UnitState
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias, TurnOnBias
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.campaign_bench import Run, benched, where

SHORT: Mapping[str, Offer] = MappingProxyType(
    {
        "static": Offer((Still(seconds=20),), 0.5, "a static log"),
        "tumble": Offer((Tumble(3.0, 0.5),), 0.25, "a tumble"),
        "heating": Offer((Heating(scale=0.005),), 0.6, "a heating"),
        "turn-on": Offer(tuple(turn_on_run(run, 5.0) for run in range(1, 13)), 0.4, "a turn-on series"),
    }
)

_NOTHING = np.zeros(0)


def standing(models: Mapping[str, SensorModel], independent: float = 0.3) -> UnitState:
    """A state of which only models and share are used."""
    never = np.zeros(0, bool)
    likelihood = SyntheticLikelihood(_NOTHING, _NOTHING, never, never)
    return UnitState(tuple(models), models, _NOTHING, likelihood, np.zeros((0, 0)), {}, independent)


def confirmed(bench: Bench, effect: Effect, sensor: str, gain: float = 9.0) -> Evaluation:
    model = replace(bench.models()[sensor], added=(effect,))
    return Evaluation(FittedHypothesis(Hypothesis((effect,))), standing({sensor: model}), gain, gain)


def searched(bench: Bench, sensor: str, *effects: Effect) -> SearchResult:
    """One round in which these were confirmed and the first was accepted."""
    every = tuple(confirmed(bench, effect, sensor, 9.0 - at) for at, effect in enumerate(effects))
    before = standing({sensor: bench.models()[sensor]})
    return SearchResult({(sensor,): [Round(before, every, 0.0, every[0])]}, bench.models())


def cause(effect: str, *sensors: str, rivals: Sequence[str] = (), probability: float = 0.6) -> Cause:
    return Cause(effect, "add", sensors, (), probability, {}, 0.5, (0.4, 0.6), tuple(rivals))


@pytest.fixture(scope="module")
def bench() -> Bench:
    return benched(["static"], {})[0]


@pytest.fixture
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(menu, "MENU", SHORT)


def test_a_distance_in_nats_by_hand() -> None:
    """Two statistics of variance 1; the second 4 apart, the same draws: 3 ln(1 + 16 / (1 + 0.2^2) / 5)."""
    draws = np.array([[-1.0, -1.0], [1.0, 1.0]] * 3) * math.sqrt(5 / 6)
    apart = draws + np.array([0.0, 4.0])
    expected = 3 * math.log(1 + 16 / 1.04 / 5)
    assert nats_between(draws, apart, np.zeros(2), 1.0) == pytest.approx(expected)
    assert nats_between(apart, draws, np.zeros(2), 0.25) == pytest.approx(expected / 4)
    assert nats_between(draws, draws, np.zeros(2), 1.0) == 0.0


def test_a_difference_below_the_least_scatter_is_zero() -> None:
    constant = np.ones((6, 1))
    assert nats_between(constant, constant + 0.01, np.ones(1), 1.0) < 0.001
    assert nats_between(constant, constant + 0.01, np.zeros(1), 1.0) > 10


def test_a_statistic_of_one_model_only_has_the_largest_distance() -> None:
    """3 ln(1 + 100^2 / 5) nats; a statistic with occasional values has no distance."""
    spoken, silent = np.ones((6, 2)), np.full((6, 2), np.nan)
    silent[0, 1] = 1.0
    assert nats_between(spoken, silent, np.zeros(2), 1.0) == pytest.approx(3 * math.log(2001))


def test_equal_models_have_no_distance() -> None:
    """300 statistics, 100 pairs of equal models: mean below 1 nat for any correlation of the draws, and with the same
    draws (correlation 0.8) always below 3 nats for a share of one in five.
    """
    random = np.random.default_rng(1)
    for share in (0.0, 0.8):
        found = []
        for _ in range(100):
            common = math.sqrt(share) * random.normal(size=(6, 300))
            one, other = (common + math.sqrt(1 - share) * random.normal(size=(6, 300)) for _ in range(2))
            found.append(nats_between(one, other, np.zeros(300), 0.2))
        assert np.mean(found) < 1.0
        assert share == 0.0 or max(found) < LEAST


def test_the_experiment_is_for_the_most_probable_cause_with_a_rival(bench: Bench) -> None:
    found = searched(bench, "G1", Tone(0.05, 20.0), Bias(0.1), TurnOnBias(0.1))
    causes = [cause("tone", "G1"), cause("bias", "G1", rivals=["turn_on_bias"]), cause("tone", "G2", rivals=["bias"])]
    rivals = rivals_of(found, causes)
    assert rivals is not None
    assert (rivals.selection.trial.name, rivals.rival.trial.name) == ("bias", "turn_on_bias")
    assert (rivals.sensors, rivals.independent) == (("G1",), 0.3)
    assert rivals_of(found, causes[:1]) is None
    assert rivals_of(found, causes[2:]) is None


@pytest.mark.slow
@pytest.mark.usefixtures("_short")
def test_a_turn_on_series_separates_a_bias_from_a_turn_on_bias(bench: Bench) -> None:
    """No other experiment does: in one run both are a bias. The bias of usual parts scatters by up to 0.15 dps."""
    found = searched(bench, "G1", Bias(1.0), TurnOnBias(1.0))
    said = next_experiment(bench, found, [cause("bias", "G1", rivals=["turn_on_bias"])], [], [], Run(bench))
    assert said.startswith("Record a turn-on series. It separates bias from turn_on_bias of G1 (")
    odds, static = re.findall(r"odds (.*?) to 1 in .*?; static (.*?) to 1", said)[0]
    assert odds == "more than 200000" or float(odds) > math.exp(LEAST)
    assert float(static) < math.exp(LEAST)


@pytest.mark.slow
@pytest.mark.usefixtures("_short")
def test_no_experiment_separates_lines_of_different_phase(bench: Bench) -> None:
    """A static log does not determine the phase of a line; a turned box does not change it. The line is weak: the ends
    of short phases would determine the phase of a strong line.
    """
    found = searched(bench, "A1", Tone(0.005, 20.0, 0.0), Tone(0.005, 20.0, 90.0))
    (one,) = found.rounds["A1",]
    other = replace(one.confirmed[1], hypothesis=FittedHypothesis(Hypothesis((Bias(),))))  # the name of another kind
    rounds = {("A1",): [replace(one, confirmed=(one.confirmed[0], other))]}
    said = next_experiment(bench, SearchResult(rounds, {}), [cause("tone", "A1", rivals=["bias"])], [], [], Run(bench))
    assert said.startswith(
        "No usual experiment (static, tumble, heating, turn-on) separates tone from bias of A1: the expected odds are"
    )
    assert float(re.findall(r"at most ([\d.]+) to 1", said)[0]) <= 1.1 * math.exp(LEAST)  # rounded


@pytest.mark.campaign
@pytest.mark.usefixtures("_short")
def test_the_source_of_exchanged_data_is_simulated_too(bench: Bench) -> None:
    """G2 is reversed about y and z: in a tumble, or with another bias, it differs from G1."""
    found = searched(bench, "G1", ChannelSwap("G2"), Bias(0.1))
    said = next_experiment(bench, found, [cause("channel_swap", "G1", rivals=["bias"])], [], [], Run(bench))
    assert said.startswith("Record a tumble. It separates channel_swap from bias of G1 (")


def test_without_rivals_the_advice_is_for_unexplained_or_unobservable_effects(bench: Bench) -> None:
    nothing, run = SearchResult({}, {}), Run(bench)
    hidden = [
        Unobservable("thermal_scale", ("A1",), "heating: on all six faces"),
        Unobservable("thermal_lag", ("A1",), "heating: fast"),
        Unobservable("tone", ("A1",), "static: for 5 minutes"),
    ]
    left = [where("A2", "z", "run_to_run"), where()]
    assert next_experiment(bench, nothing, [], left, hidden, run) == (
        "Record a turn-on series: 12 runs of 1 minute, switched off in between (0.4 h): it shows more of the change "
        "from run to run of A2 z, which is not explained."
    )
    assert next_experiment(bench, nothing, [], [], hidden, run) == (
        "Record a heating log: it can show thermal_scale and thermal_lag, which these recordings cannot; what to do for"
        " each is listed with it."
    )
    short = [Unobservable("differences of spread", ("A1", "A2"), "4 minutes")]
    assert next_experiment(bench, nothing, [], [], short, run) == (
        "To observe differences of spread of A1, A2, record 4 minutes."
    )
    assert next_experiment(bench, nothing, [], [], [], run).startswith("Nothing: ")
    assert run.items == 0


def test_every_domain_has_an_experiment() -> None:
    assert {probe.domain for probe in PROBES.values()} == set(menu._MORE)


def test_stated_hours_include_the_logs() -> None:
    for offer in MENU.values():
        assert sum(motion.seconds for motion in offer.motions) / 3600 < offer.hours < 1


@pytest.mark.campaign
def test_the_advice_with_the_full_menu(bench: Bench) -> None:
    """As above, with logs of full length."""
    found = searched(bench, "G1", Bias(0.5), TurnOnBias(0.5))
    said = next_experiment(bench, found, [cause("bias", "G1", rivals=["turn_on_bias"])], [], [], Run(bench))
    assert said.startswith("Record a turn-on series: 12 runs of 1 minute, switched off in between. It separates bias")
