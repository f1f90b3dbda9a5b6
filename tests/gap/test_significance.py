"""False alarms in campaigns without a gap, gaps where they were put, and the tree on scores made by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from imuarray.array import parse_array
from imuarray.gap.base_model import Base, fit
from imuarray.gap.campaign import Campaign, summarise_log
from imuarray.gap.null import Experiment, Null, null, residual_statistics
from imuarray.gap.significance import LEVELS, Significance, p_value, significance
from imuarray.gap.source import simulated_sources
from imuarray.gap.statistics import Key, statistics
from imuarray.simulate import Motion, plan_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.misalignment import Misalignment
from imuarray.simulate.effects.nonlinearity import Nonlinearity
from imuarray.simulate.effects.scale import Scale
from imuarray.simulate.effects.tone import Tone
from imuarray.simulate.motion.still import Still
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.made import ARRAY, BASE, RATE_HZ, phases_of, simulation, temperature_of

Logs = Sequence[tuple[str, Motion]]

STATIC: Logs = (("static", Still(seconds=20)),)


def diagnosed(
    logs: Logs, more: Mapping[str, Sequence[Effect]], seed: int, replicates: int, workers: int = 1
) -> Significance:
    """The whole way, from a simulated recording on."""
    campaign, motions = recorded(logs, more, seed), [motion for _, motion in logs]
    base, experiments = fit(campaign, motions, seed=seed), experiments_of(logs)
    with ThreadPoolExecutor(workers) as executor:
        found = null(campaign, experiments, base, replicates, executor=executor if workers > 1 else None)
    return significance(campaign, motions, found)


def recorded(logs: Logs, more: Mapping[str, Sequence[Effect]], seed: int) -> Campaign:
    found = []
    for boot, (kind, motion) in enumerate(logs):
        sources = simulated_sources(simulation(motion, more, seed, boot))
        found.append(summarise_log(kind, sources, phases_of(motion), temperature_of(motion)))
    return Campaign(tuple(found))


def experiments_of(logs: Logs) -> list[Experiment]:
    return [Experiment(plan_of(parse_array(ARRAY), RATE_HZ, motion.seconds), motion) for _, motion in logs]


def units(seed: int) -> dict[str, tuple[Effect, ...]]:
    """Scales and leaning axes as the data sheets have them, drawn by other means than the library's."""
    random = np.random.default_rng((99, seed))
    return {
        name: (
            Scale(tuple(np.clip(random.normal(0, 0.01, 3), -0.02, 0.02))),  # type: ignore[arg-type]
            Misalignment(tuple(np.clip(random.normal(0, 0.5, 6), -1, 1))),
        )
        for name in BASE
    }


def test_false_alarms(static: tuple[Campaign, Base]) -> None:
    """60 campaigns, each with its own fit, against the null of another one, of 40 scored replicates: p <= 0.05 has a
    probability of 2/41 over both; at most 14 come with one of 0.998 (beta-binomial: 60, 2, 39).
    """
    campaign, base = static
    made = null(campaign, experiments_of(STATIC), base, 80)
    found = [recorded(STATIC, units(seed), 1000 + seed) for seed in range(60)]
    motions = [motion for _, motion in STATIC]
    alarms = sum(significance(one, motions, made).is_gap for one in found)
    assert alarms <= 14


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_promised() -> None:
    """60 campaigns, 20 scored replicates each: p <= 0.05 has a probability of 1/21 each; at most 8 of 60 come with
    one of 0.998 (binomial).
    """
    alarms = sum(diagnosed(STATIC, units(seed), seed, 40).is_gap for seed in range(60))
    assert alarms <= 8


def test_a_tone_is_found_where_it_is() -> None:
    """0.8 of the noise's standard deviation at 17 Hz on one axis of one gyroscope."""
    more = {**units(1), "G2": (*units(1)["G2"], Tone((0.0, 0.04, 0.0), 17.0))}
    found = diagnosed(STATIC, more, 1, 80)
    assert found.is_gap
    assert found.p == pytest.approx(1 / 41)
    assert [node.path for node in found.root.found("chip")][:1] == [("l3g4200d",)]
    assert [node.path for node in found.root.found("axis")] == [("l3g4200d", "G2", "y")]
    assert found.root.found("domain")[0].path[-1] == "spectrum"
    worst = found.findings[0]
    assert (worst.key.sensor, worst.key.axis, worst.key.probe) == ("G2", "y", "line")
    assert worst.score > 5
    assert worst.real - worst.simulated == pytest.approx(worst.effect_size)
    assert {(item.key.sensor, item.key.axis) for item in found.findings} == {("G2", "y")}


@pytest.mark.slow
def test_sizes_are_in_the_units_of_the_statistic() -> None:
    """0.06 g per g^2 along x: the mean of the faces +x and -x is off by 0.06 g."""
    logs: Logs = (("tumble", Tumble(4.0, 1.0)),)
    found = diagnosed(logs, {"A2": (Nonlinearity(quadratic=(0.06, 0.0, 0.0)),)}, 3, 40)
    (square,) = [item for item in found.findings if item.key.probe == "force_square"]
    assert (square.key.sensor, square.key.axis, square.unit) == ("A2", "x", "g/g^2")
    assert square.effect_size == pytest.approx(0.06, abs=0.002)
    assert square.real == pytest.approx(0.06, abs=0.002)


def test_workers_change_nothing() -> None:
    more = {"A1": (Tone((0.01, 0.0, 0.0), 9.0),)}
    alone, together = (diagnosed(STATIC, more, 4, 40, workers) for workers in (1, 3))
    assert alone == together
    assert alone.is_gap


def by_hand(scores: np.ndarray, chance: np.ndarray, campaign: Campaign) -> Significance:
    """As if the residual statistics themselves were the scores."""
    left = residual_statistics(campaign, [Still(seconds=20)])
    nothing = np.zeros(len(left.keys), bool)
    made = Null(left.keys, left.values - scores, np.ones(len(left.keys)), chance, nothing, nothing)
    return significance(campaign, [Still(seconds=20)], made)


@pytest.fixture(scope="module")
def static() -> tuple[Campaign, Base]:
    campaign = recorded(STATIC, {}, 0)
    return campaign, fit(campaign, [Still(seconds=20)])


def test_a_step_down_is_paid_for_among_siblings(static: tuple[Campaign, Base]) -> None:
    """Chance makes 3 somewhere in A2, 1 elsewhere: a 2 of A1 is beyond its own chance, not beyond its family's."""
    campaign, _ = static
    keys = by_keys(static)
    of_a1, of_a2, of_g1 = (np.array([key.sensor == name for key in keys]) for name in ("A1", "A2", "G1"))
    chance = np.ones((40, len(keys)))
    chance[:, np.flatnonzero(of_a2)[0]] = 3.0
    scores = np.zeros(len(keys))
    scores[np.flatnonzero(of_g1)[5]] = 4.0
    scores[np.flatnonzero(of_a1)[0]] = 2.0
    found = by_hand(scores, chance, campaign)
    assert found.p == pytest.approx(1 / 41)
    assert [node.path for node in found.root.found("sensor")] == [("l3g4200d", "G1")]
    scores[np.flatnonzero(of_a1)[0]] = 3.5
    both = by_hand(scores, chance, campaign)
    assert [node.path[1] for node in both.root.found("sensor")] == ["G1", "A1"]
    assert [item.score for item in both.findings] == pytest.approx([4.0, 3.5])
    assert [child.is_found for child in both.root.found("chip")[1].children] == [True, False]


def test_nothing_is_looked_for_where_nothing_was_found(static: tuple[Campaign, Base]) -> None:
    campaign, _ = static
    keys = by_keys(static)
    none = by_hand(np.zeros(len(keys)), np.ones((40, len(keys))), campaign)
    assert (none.is_gap, none.p, none.root.children, none.findings) == (False, 1.0, (), ())
    assert none.root.level == LEVELS[0]


def test_too_few_replicates_tell_nothing(static: tuple[Campaign, Base]) -> None:
    keys = by_keys(static)
    with pytest.raises(ValueError, match=r"level: 0\.05; 10 scored replicates tell nothing below 0\.0909"):
        by_hand(np.zeros(len(keys)), np.ones((10, len(keys))), static[0])


def by_keys(static: tuple[Campaign, Base]) -> tuple[Key, ...]:
    return statistics(static[0]).keys


def test_p_is_never_zero() -> None:
    chance = np.arange(1.0, 100.0)
    assert p_value(1000.0, chance) == pytest.approx(0.01)
    assert p_value(95.0, chance) == pytest.approx(0.06)
    assert p_value(0.0, chance) == 1.0
