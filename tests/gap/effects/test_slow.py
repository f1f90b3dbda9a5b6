"""Slow processes are suggested at their simulated size. A minute has few of their correlation times, so that even the
best estimate scatters: factors of 2 to 4, at fixed seeds.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.levels import Levels
from imuarray.gap.inference.effects.wander import (
    Allan,
    allan_of,
    gauss_markov,
    size_of,
    slower,
    two_levels,
    wander_of,
    within,
)
from imuarray.gap.inference.evidence import Span, Spell, When
from imuarray.simulate.effects.bias import BiasInstability, CommonMode, PopcornNoise, RandomWalk, TurnOnBias
from tests.gap.effects.evidence_of import evidence_of
from tests.selection import some


def is_near(found: float, put_in: float, factor: float) -> bool:
    return 1 / factor < found / put_in < factor


@pytest.mark.parametrize("x", [1e-5, 0.01, 0.7, 3.0, 40.0])
def test_the_law_of_allan_variances(x: float) -> None:
    """Half the mean square of the difference of two neighbouring means of a process with autocovariance exp(-|t|)."""

    def mean_product(apart: float) -> float:
        """Mean product of means over [0, x] and [apart, apart + x]."""
        whole, _ = quad(lambda t: (x - abs(t)) * np.exp(-abs(apart + t)), -x, x, points=[0.0, -apart], epsabs=1e-14)
        return whole / x**2

    assert float(gauss_markov(np.array([x]), 1.0)[0]) == pytest.approx(mean_product(0.0) - mean_product(x), rel=1e-4)


def test_the_variance_of_a_process_within_an_interval() -> None:
    """1 - the variance of the mean, 2 (x - 1 + exp(-x)) / x^2: the whole variance in long intervals, that of a random
    walk in short.
    """
    assert within(1e6, 1.0) == pytest.approx(1.0, abs=1e-5)
    assert within(1e-4, 1.0) == pytest.approx(1e-4 / 3, rel=1e-3)
    assert within(2.0, 1.0) == pytest.approx(1 - 2 * (1 + np.exp(-2)) / 4)


@pytest.mark.parametrize(("rms", "time_constant_s"), some([(0.05, 0.2), (0.04, 3.0), (0.05, 10.0)], 1))
def test_a_wander_is_suggested(rms: float, time_constant_s: float) -> None:
    evidence = evidence_of("static", "G1", {"G1": (BiasInstability((rms,) * 3, time_constant_s),)}, seed=2)
    first, *_ = (trial.effects[0] for trial in CANDIDATES["bias_instability"].guesses(evidence))
    assert isinstance(first, BiasInstability)
    assert is_near(float(np.mean(first.rms)), rms, 2.0)
    assert is_near(first.time_constant_s, time_constant_s, 2.5)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_flicker_noise_is_suggested(seed: int) -> None:
    """The Allan deviation is rms / sqrt(number of processes), for any limits; on one axis alone."""
    effect = BiasInstability((0.0, 0.2, 0.0), 3600.0, 0.05)
    evidence = evidence_of("static", "G1", {"G1": (effect,)}, seed=seed)
    several = [trial.effects[0] for trial in CANDIDATES["bias_instability"].guesses(evidence)]
    flickers = [each for each in several if isinstance(each, BiasInstability) and each.fastest_time_constant_s]
    assert flickers
    assert max(flickers[-1].rms[0], flickers[-1].rms[2]) < flickers[-1].rms[1] / 3
    floors = [each.rms[1] / math.sqrt(len(each.time_constants_s)) for each in (flickers[-1], effect)]
    assert is_near(floors[0], floors[1], 1.5)


def test_a_filter_of_short_averaging_times_does_not_bias_a_level() -> None:
    """A level of 0.01 and white noise 1 / tau whose shortest variance is a fifth too low. Weighted by the numbers of
    terms, half of which it has, the level would be 0.016.
    """
    time_s, terms = 2.0 ** np.arange(8), 1e6 / 2.0 ** np.arange(8)
    variance = np.repeat(1 / time_s + 0.01, 3).reshape(8, 3)
    variance[0] *= 0.8
    allan = Allan(time_s, variance, terms, np.full(3, 0.01), 1e3, 1)
    sizes, _ = size_of(allan, np.ones(8), 1.0)
    assert sizes == pytest.approx([0.01] * 3, rel=0.12)


@pytest.mark.slow
def test_a_wander_as_slow_as_a_run_is_suggested() -> None:
    """Runs are 20 s long: their levels determine its size, changes within them its time constant."""
    evidence = evidence_of("turn-on", "G1", {"G1": (BiasInstability((0.2,) * 3, 60.0),)}, seed=4)
    found = [trial.effects[0] for trial in CANDIDATES["bias_instability"].guesses(evidence)]
    assert any(
        isinstance(one, BiasInstability)
        and is_near(float(np.mean(one.rms)), 0.2, 1.5)
        and is_near(one.time_constant_s, 60.0, 2.0)
        for one in found
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_random_walk_is_suggested(seed: int) -> None:
    evidence = evidence_of("static", "G1", {"G1": (RandomWalk((0.02, 0.0, 0.02)),)}, seed=seed)
    first, *_ = (trial.effects[0] for trial in CANDIDATES["random_walk"].guesses(evidence))
    assert isinstance(first, RandomWalk)
    assert is_near(first.density[0], 0.02, 2.0)
    assert first.density[1] < 0.003
    assert is_near(first.density[2], 0.02, 2.0)


@pytest.mark.slow
def test_a_thermal_drift_suggests_no_wander() -> None:
    """G1's bias has a slope, which the model has too: in a heat pulse the Allan variances are those of white noise,
    rms^2 over the rows, within the scatter of a few terms.
    """
    allan = allan_of(evidence_of("heating", "G1", seed=3))
    white = allan.variance[0] * allan.time_s[0] / allan.time_s[:, None]
    warmed = allan.time_s > 0.5
    assert warmed.any()
    assert (allan.variance[warmed] < 2 * white[warmed]).all()


def test_telegraph_noise_is_suggested() -> None:
    evidence = evidence_of("static", "A1", {"A1": (PopcornNoise((0.01,) * 3, 0.5),)}, seed=1)
    by_moments, *_, by_jumps = (trial.effects[0] for trial in CANDIDATES["popcorn_noise"].guesses(evidence))
    for found in (by_moments, by_jumps):
        assert isinstance(found, PopcornNoise)
        assert np.mean(found.amplitude) == pytest.approx(0.01, rel=0.2)
        assert is_near(found.switches_per_s, 0.5, 2.5)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_telegraph_noise_with_a_rare_level_is_suggested(side: float) -> None:
    """A fifth of a minute at one level, in about twelve intervals: the share within a half of it, the amplitude within
    a quarter, with its sign.
    """
    effect = PopcornNoise((0.0, side * 0.01, 0.0), 0.4, 0.2)
    evidence = evidence_of("static", "A1", {"A1": (effect,)}, seed=1)
    trials = [trial for trial in CANDIDATES["popcorn_noise"].guesses(evidence) if "high_share" in trial.free]
    found = trials[0].effects[0]
    assert isinstance(found, PopcornNoise)
    assert found.amplitude[1] == pytest.approx(side * 0.01, rel=0.25)
    assert found.high_share == pytest.approx(0.2, abs=0.1)
    assert is_near(found.switches_per_s, 0.4, 2.5)


def test_few_jumps_suggest_telegraph_noise() -> None:
    """0.05 per second on one axis: seed 2 has two jumps in a minute."""
    evidence = evidence_of("static", "A1", {"A1": (PopcornNoise((0.01, 0.0, 0.0), 0.05),)}, seed=2)
    found = [trial.effects[0] for trial in CANDIDATES["popcorn_noise"].guesses(evidence)]
    assert any(
        isinstance(one, PopcornNoise)
        and one.amplitude[0] == pytest.approx(0.01, rel=0.1)
        and is_near(one.switches_per_s, 0.05, 2.0)
        for one in found
    )


def common(trials: list[Hypothesis]) -> CommonMode:
    assert trials
    assert all(trial.shared for trial in trials)
    (effect,) = trials[0].effects
    assert isinstance(effect, CommonMode)
    return effect


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "rms", "time_constant_s"), [("static", 0.003, 2.0), ("static", 0.003, 40.0), ("heating", 0.003, 5.0)]
)
def test_a_common_wander_of_all_units_is_suggested(kind: str, rms: float, time_constant_s: float) -> None:
    """Common thermal slopes of the units do not suggest it."""
    both = dict.fromkeys(("A1", "A2"), (CommonMode((rms,) * 3, time_constant_s),))
    found = common(list(CANDIDATES["common_mode"].guesses(evidence_of(kind, "A1", both, seed=7))))
    assert is_near(float(np.mean(found.rms)), rms, 2.0)
    assert is_near(found.time_constant_s, time_constant_s, 4.0)


def test_a_fully_common_wander_is_suggested() -> None:
    """A few values determine a covariance poorly: the full size of the sensor's own wander is tried too."""
    both = dict.fromkeys(("A1", "A2"), (CommonMode((0.003,) * 3, 2.0),))
    evidence = evidence_of("static", "A1", both, seed=7)
    wander = wander_of(evidence)
    assert wander is not None
    apart = slower(evidence, wander)
    effects = [effect for trial in CANDIDATES["common_mode"].guesses(evidence) for effect in trial.effects]
    assert CommonMode(tuple(apart.rms.tolist()), apart.time_constant_s) in effects


def test_a_common_wander_of_different_sizes_is_suggested() -> None:
    """9 mg in one accelerometer and 3 mg in the other, on all axes alike: individual sizes are tried."""
    own, other = (CommonMode((rms,) * 3, 0.5, 1.0, "A1+A2") for rms in (0.009, 0.003))
    trials = CANDIDATES["common_mode"].guesses(evidence_of("static", "A1", {"A1": (own,), "A2": (other,)}, seed=7))
    (first, *_) = [trial for trial in trials if trial.opposite]
    assert (first.sensor, first.others, first.members) == ("A1", ("A2",), ())
    guess, its = first.effects[0], first.opposite[0]
    assert isinstance(guess, CommonMode)
    assert isinstance(its, CommonMode)
    assert float(np.mean(guess.rms) / np.mean(its.rms)) == pytest.approx(3.0, rel=0.15)
    assert guess.group == its.group


def test_a_wander_in_some_intervals_of_a_log_is_suggested() -> None:
    """A quarter of the rows: the size over the whole log is twice as large in them."""
    both = dict.fromkeys(("A1", "A2"), (CommonMode((0.003,) * 3, 2.0),))
    evidence = evidence_of("static", "A1", both, seed=7)
    (phase,) = evidence.still
    quarter = replace(phase, raw=replace(phase.raw, rows=phase.raw.rows // 4))
    when = When((Span(0, 45.0, math.inf),))
    trials = list(CANDIDATES["common_mode"].guesses(replace(evidence, spells=(Spell(when, (quarter,)),))))
    always = [trial for trial in trials if not trial.when.spans]
    late = [trial for trial in trials if trial.when == when]
    assert len(always) == len(late) > 0
    for trial, other in zip(always, late, strict=True):
        (one,), (its,) = trial.effects, other.effects
        assert isinstance(one, CommonMode)
        assert isinstance(its, CommonMode)
        assert its.rms == pytest.approx(tuple(2 * rms for rms in one.rms), rel=1e-3)
        assert its.spans
        assert other.shared


@pytest.mark.slow
def test_a_common_change_between_two_logs_is_suggested() -> None:
    """The whole change is common, or one unit has an additional part."""
    shared = (CommonMode((0.01,) * 3, 1e6),)
    (trial,) = CANDIDATES["common_mode"].guesses(
        evidence_of(("static", "static"), "A1", {"A1": shared, "A2": shared}, seed=5)
    )
    assert trial.whole
    assert trial.needs_both
    assert [effect.name for effect in trial.effects] == ["common_mode"]
    own = (*shared, TurnOnBias((0.004,) * 3))
    alone, both = CANDIDATES["common_mode"].guesses(
        evidence_of(("static", "static"), "A1", {"A1": own, "A2": shared}, seed=5)
    )
    assert alone.effects == both.effects[:1]
    assert [effect.name for effect in both.effects] == ["common_mode", "turn_on_bias"]


def test_nothing_slow_is_suggested_for_white_noise() -> None:
    evidence = evidence_of("static", "A1", seed=9)
    for candidate in (
        CANDIDATES["bias_instability"],
        CANDIDATES["random_walk"],
        CANDIDATES["popcorn_noise"],
        CANDIDATES["common_mode"],
    ):
        assert list(candidate.guesses(evidence)) == []


def levels_of(mean: np.ndarray, error: float) -> Levels:
    """Segments of one log along x; the other axes do not wander."""
    count, axes = len(mean), np.zeros((len(mean), 3))
    one, table = np.zeros(count, int), axes.copy()
    table[:, 0] = mean
    return Levels(one, one, np.arange(count) * 1.0, np.zeros(count), table, axes + error, axes, one * 1.0, one + 1.0)


def test_the_log_ratio_of_two_levels() -> None:
    """Eight values of -1 and eight of 1 with the error 0.1: each has the likelihood 1/2 in units of the density at its
    mean, and exp(-1/2) / 10 by a normal distribution. One further parameter counts half a nat, and the correlation of
    neighbours, 13/16, leaves 1 - (13/16)^2.
    """
    expected = (1 - (13 / 16) ** 2) * (16 * (math.log(10) + 0.5 - math.log(2)) - 0.5)
    assert two_levels(levels_of(np.repeat([-1.0, 1.0], 8), 0.01)) == pytest.approx(expected, rel=1e-6)
    assert two_levels(levels_of(np.repeat([-1.0, 1.0], 7), 0.01)) == 0.0  # too few
    assert two_levels(levels_of(np.repeat([-0.05, 0.05], 8), 0.01)) == 0.0  # no wander
    assert two_levels(levels_of(np.repeat([-1.0, 1.0], 8), 0.0)) == 0.0  # no noise


def test_a_telegraph_has_two_levels_and_a_wander_has_not() -> None:
    """64 segments with noise 1, on levels that are 3 apart and last 5 segments, and with a first-order process of the
    same variance and correlation.
    """
    random = np.random.default_rng(2)
    noise = random.standard_normal((2, 40, 64))
    telegraph = 3.0 * (np.cumsum(random.random((40, 64)) < 0.2, axis=1) % 2)
    steps = random.standard_normal((40, 64))
    wander = np.zeros((40, 64))
    for at in range(64):
        wander[:, at] = 0.6 * wander[:, at - 1] + math.sqrt(1 - 0.36) * 1.5 * steps[:, at]
    by_telegraph = [two_levels(levels_of(mean, 1.0)) for mean in telegraph + noise[0]]
    by_wander = [two_levels(levels_of(mean, 1.0)) for mean in wander + noise[1]]
    assert np.median(by_telegraph) > 1.0
    assert np.median(by_wander) < 0.0
