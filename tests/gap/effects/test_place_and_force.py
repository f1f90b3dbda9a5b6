"""Undue responses of a sensor to force and rotation, and readings of another sensor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from imuarray.arrays import Floats
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.channel_swap import _Course, _gains_of_exchange, _when
from imuarray.gap.inference.effects.motion import CHANGE, FORCE, REFERENCE, Moments, _products, _unbalance
from imuarray.simulate.active_spans import spans_of
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.response import GSensitivity, Nonlinearity, Scale, SizeEffect
from tests.gap.effects.evidence_of import TWO_FACES, evidence_of
from tests.selection import some


@pytest.mark.slow
def test_a_displacement_is_suggested() -> None:
    evidence = evidence_of("motion", "A1", {"A1": (SizeEffect((0.0, 50.0, -20.0)),)}, seed=7)
    (trial,) = CANDIDATES["size_effect"].guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, SizeEffect)
    np.testing.assert_allclose(effect.position_mm, (0.0, 50.0, -20.0), atol=6.0)


@pytest.mark.slow
def test_a_displacement_from_the_configured_place_is_suggested() -> None:
    """The sensor is at (0, 50, -120) mm, and its header states (0, 0, -100): the others are at the origin."""
    evidence = evidence_of("motion", "A1", {"A1": (SizeEffect((0.0, 50.0, -120.0)),)}, seed=7)
    phases = []
    for phase in evidence.phases:
        if phase.cross is not None:
            headers = tuple(
                replace(header, position_mm=(0.0, 0.0, -100.0)) if header.name == "A1" else header
                for header in phase.cross.sensors
            )
            phases.append(replace(phase, cross=replace(phase.cross, sensors=headers)))
        else:
            phases.append(phase)
    (trial,) = CANDIDATES["size_effect"].guesses(replace(evidence, phases=tuple(phases)))
    (effect,) = trial.effects
    assert isinstance(effect, SizeEffect)
    np.testing.assert_allclose(effect.position_mm, (0.0, 50.0, -20.0), atol=8.0)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "size", "tolerance"), some([("tumble", 1.0, 0.005), ("motion", 10.0, 0.05)], 1))
def test_a_g_sensitivity_is_suggested(kind: str, size: float, tolerance: float) -> None:
    response = size * np.array([0.05, 0.02, 0.0, 0.0, -0.05, 0.0, 0.01, 0.0, 0.03])
    evidence = evidence_of(kind, "G1", {"G1": (GSensitivity(tuple(response.tolist())),)}, seed=7)
    trials = list(CANDIDATES["g_sensitivity"].guesses(evidence))[: 2 if kind == "tumble" else 1]
    for trial in trials:
        (effect,) = trial.effects
        assert isinstance(effect, GSensitivity)
        np.testing.assert_allclose(effect.response, response, atol=2 * tolerance)
        assert trial.rarity == np.count_nonzero(effect.response)  # a nat each, the cost of a refined number
    np.testing.assert_allclose(trials[0].effects[0].response, response, atol=tolerance)
    assert len(trials) == (2 if kind == "tumble" else 1)


@pytest.mark.slow
def test_a_g_sensitivity_is_suggested_from_delays_of_a_rocking_box() -> None:
    """Gravity turns in step with the change of the rate about a fixed axis. m x f with m of 13 dps/g gives delays of
    milliseconds, by least squares; the suggestion gives the same delays, by a smaller m.
    """
    rng = np.random.default_rng(3)
    axis, gravity, unbalance = np.array([0.6, 0.3, -0.7]), np.array([0.4, -0.2, 0.2]), np.array([2.0, -12.0, 4.0])
    angle = np.sin(np.arange(600) * 0.2)[:, None]
    change, force = angle * axis * 5000, angle * gravity + rng.normal(0, 0.01, (600, 3))
    products = np.zeros((CHANGE.stop, CHANGE.stop))
    both = np.hstack([change, force])
    places = np.r_[CHANGE, FORCE]
    products[np.ix_(places, places)] = both.T @ both / 600
    products[REFERENCE, REFERENCE] = np.eye(3)
    table = Moments(products, 600)

    def delay_s(response: Floats) -> Floats:
        return -(change * (force @ response.T)).sum(axis=0) / (change**2).sum(axis=0)

    late_s = delay_s(np.cross(unbalance, np.eye(3)).T)
    assert np.abs(late_s).max() > 1e-3
    evidence = replace(
        evidence_of("motion", "G1", seed=7),
        values={"motion_delay": late_s[None] + 0.002},
        expected={"motion_delay": np.full((1, 3), 0.002)},
        scores={"motion_delay": late_s[None] / 5e-5},
    )
    guess = _unbalance(evidence, table)
    np.testing.assert_allclose(guess, -guess.T)
    np.testing.assert_allclose(delay_s(guess), late_s, atol=1e-4)
    assert np.abs(guess).max() < 13


@pytest.mark.slow
def test_changes_are_per_second_for_any_window_length() -> None:
    """In windows twice as long a slow motion changes twice as much from one to the next."""
    (cross,) = [phase.cross for phase in evidence_of("motion", "G1", seed=7).phases if not phase.is_still]
    assert cross is not None
    weights = np.eye(CHANGE.start, cross.fast.shape[0])
    longer = replace(cross, window_s=2 * cross.window_s, turning=2 * cross.turning, changes=4 * cross.changes)
    np.testing.assert_allclose(_products(longer, weights), _products(cross, weights))
    assert _products(cross, weights)[CHANGE, CHANGE].any()


@pytest.mark.slow
def test_only_significant_responses_to_force_are_suggested() -> None:
    """One of nine responses, each with its own error."""
    alone = GSensitivity((0.0,) * 5 + (0.05,) + (0.0,) * 3)
    *_, trial = CANDIDATES["g_sensitivity"].guesses(evidence_of("tumble", "G1", {"G1": (alone,)}, seed=7))
    (effect,) = trial.effects
    assert isinstance(effect, GSensitivity)
    assert np.flatnonzero(effect.response).tolist() == [5]
    assert effect.response[5] == pytest.approx(0.05, abs=0.005)
    assert trial.rarity == 1.0


@pytest.mark.slow
def test_a_nonlinearity_is_suggested_from_faces() -> None:
    evidence = evidence_of("tumble", "A1", {"A1": (Nonlinearity(quadratic=(0.005,) * 3),)}, seed=7)
    (trial,) = CANDIDATES["nonlinearity"].guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, Nonlinearity)
    assert effect.quadratic == pytest.approx((0.005,) * 3, rel=0.1)


@pytest.mark.slow
def test_a_nonlinearity_of_a_gyroscope_is_not_suggested_from_faces() -> None:
    """A response to the square of force, in dps/g^2, is not a coefficient of the square of a rate."""
    evidence = evidence_of("tumble", "G1", {"G1": (GSensitivity((0.05, 0.02, 0.0) * 3),)}, seed=7)
    odd = replace(evidence, scores={**evidence.scores, "force_square": np.full((1, 3), 9.0)})
    assert list(CANDIDATES["nonlinearity"].guesses(odd)) == []


@pytest.mark.parametrize(
    ("sensor", "put_in"), [("A1", Nonlinearity(cubic=(0.005,) * 3)), ("G1", Nonlinearity(quadratic=(0.0005,) * 3))]
)
def test_a_nonlinearity_is_suggested_from_motion(sensor: str, put_in: Nonlinearity) -> None:
    """Clipped at 4 g and 250 dps."""
    evidence = evidence_of("motion", sensor, {sensor: (put_in,)}, seed=7)
    first, *_ = (trial.effects[0] for trial in CANDIDATES["nonlinearity"].guesses(evidence))
    assert isinstance(first, Nonlinearity)
    assert np.mean(first.cubic) == pytest.approx(np.mean(put_in.cubic), rel=0.5)
    assert np.mean(first.quadratic) == pytest.approx(np.mean(put_in.quadratic), rel=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["G1", "G2"])
def test_a_cubic_nonlinearity_is_suggested(sensor: str) -> None:
    """A cubic response on y alone: 1 dps at 80 dps. G2 has the opposite orientation. The windows average the motion
    before its cubes are taken: the value, which is refined later, is right within a factor of two.
    """
    evidence = evidence_of("motion", sensor, {sensor: (Nonlinearity(cubic=(0.0, 2e-6, 0.0)),)}, seed=7)
    effects = [trial.effects[0] for trial in CANDIDATES["nonlinearity"].guesses(evidence) if trial.free == ("cubic",)]
    assert isinstance(effects[0], Nonlinearity)
    x, y, z = effects[0].cubic
    assert (x, z) == (0.0, 0.0)
    assert 1e-6 < y < 4e-6


@pytest.mark.parametrize(("kind", "sensor"), some([("static", "G1"), ("tumble", "A1"), ("motion", "G1")], 1))
def test_readings_of_another_sensor_are_suggested(kind: str, sensor: str) -> None:
    other = sensor[0] + "2"
    evidence = evidence_of(kind, sensor, {sensor: (ChannelSwap(other),)}, seed=7)
    assert [trial.effects for trial in CANDIDATES["channel_swap"].guesses(evidence)] == [(ChannelSwap(other),)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", some(["data", "place"], 1))
def test_an_exchange_is_suggested_from_its_axes(kind: str) -> None:
    """One sensor has the data of the other, or both are exchanged."""
    both = {"A1": (ChannelSwap("A2", kind),), "A2": (ChannelSwap("A1", kind),)}
    for sensor, other in (("A1", "A2"), ("A2", "A1")):
        evidence = evidence_of("tumble", sensor, both, seed=7)
        one, exchange = CANDIDATES["channel_swap"].guesses(evidence)
        assert (one.effects, one.opposite) == ((ChannelSwap(other),), ())
        assert exchange.effects == (ChannelSwap(other, "place"),)
        assert exchange.opposite == (ChannelSwap(sensor, "place"),)
        assert (exchange.sensor, exchange.others) == (sensor, (other,))


@pytest.mark.slow
def test_two_opposite_faces_suggest_an_exchange_by_a_level() -> None:
    """They determine no response; an axis reads 1 g in the place of another."""
    both = {"A1": (ChannelSwap("A2", "place"),), "A2": (ChannelSwap("A1", "place"),)}
    (exchange,) = CANDIDATES["channel_swap"].guesses(evidence_of(TWO_FACES, "A1", both, seed=7))
    assert (exchange.sensor, exchange.others) == ("A1", ("A2",))
    assert (exchange.effects, exchange.opposite) == ((ChannelSwap("A2", "place"),), (ChannelSwap("A1", "place"),))
    assert (
        list(CANDIDATES["channel_swap"].guesses(evidence_of(TWO_FACES, "A1", {"A1": (Bias((0.4, 0.0, 0.0)),)}, seed=7)))
        == []
    )


@pytest.mark.slow
def test_no_exchange_or_response_is_suggested_without_one() -> None:
    for kind in ("tumble", "static"):
        for sensor in ("A1", "G1"):
            evidence = evidence_of(kind, sensor, seed=5)
            for candidate in (
                CANDIDATES["channel_swap"],
                CANDIDATES["size_effect"],
                CANDIDATES["g_sensitivity"],
                CANDIDATES["nonlinearity"],
            ):
                assert list(candidate.guesses(evidence)) == []


@pytest.mark.parametrize(
    ("kind", "spans"),
    some(
        [
            ("static", ((0, 35.0, math.inf),)),
            ("static", ((0, 12.0, 30.0),)),
            ("turn-on", ((1, 0.0, math.inf), (4, 0.0, math.inf))),
        ],
        1,
    ),
)
@pytest.mark.parametrize("is_exchange", some([True, False], 1, 0))
def test_temporary_readings_of_another_sensor_are_suggested(
    kind: str, spans: tuple[tuple[int, float, float], ...], is_exchange: bool
) -> None:
    """G1 reads 0.5 dps, G2 -1 dps: in two boots, from a moment on, or temporarily, G1 has the readings of G2, and G2
    those of G1 or its own. Biases are those of the rest of the log.
    """
    acting = spans_of(spans)
    effects = {"G1": (ChannelSwap("G2", spans=acting),)}
    if is_exchange:
        effects["G2"] = (ChannelSwap("G1", spans=acting),)
    *_, trial = CANDIDATES["channel_swap"].guesses(evidence_of(kind, "G1", effects, seed=7))
    assert (trial.sensor, trial.others, trial.name) == ("G1", ("G2",), "channel_swap")
    assert [effect.sensor for effect in trial.opposite if isinstance(effect, ChannelSwap)] == ["G1"] * is_exchange
    np.testing.assert_allclose([span[:2] for span in trial.when.triples], [span[:2] for span in spans], atol=0.5)
    np.testing.assert_allclose([span[2] for span in trial.when.triples], [span[2] for span in spans], atol=0.5)
    assert trial.fitted is not None
    assert trial.fitted.offset == pytest.approx((0.5,) * 3, abs=0.02)
    assert (trial.opposite_fitted is not None) == is_exchange
    if trial.opposite_fitted is not None:
        assert trial.opposite_fitted.offset == pytest.approx((-1.0,) * 3, abs=0.02)


@pytest.mark.campaign
def test_an_exchange_from_a_moment_of_a_tumble_is_suggested() -> None:
    """Each face occurs once, so that no level is repeated; both logs after the moment are exchanged."""
    acting = spans_of(((0, 70.0, math.inf), (1, 0.0, math.inf)))
    effects = {"A1": (ChannelSwap("A2", spans=acting),), "A2": (ChannelSwap("A1", spans=acting),)}
    trials = list(CANDIDATES["channel_swap"].guesses(evidence_of(("tumble", "static"), "A1", effects, seed=7)))
    trial = next(trial for trial in trials if len(trial.when.spans) == 2)
    assert (trial.effects[0].name, trial.opposite[0].name) == ("channel_swap", "channel_swap")
    first, after = trial.when.triples
    assert (first[0], after[:2]) == (0, (1, 0.0))
    assert first[1] == pytest.approx(70.0, abs=5.0)


@pytest.mark.campaign
def test_an_exchange_in_any_log_is_suggested() -> None:
    """Each segment of two accelerometers of different orientation identifies its sensor: the whole log at rest and the
    end of the tumble, in any order of the logs.
    """
    acting = spans_of(((0, 0.0, math.inf), (1, 40.0, math.inf)))
    effects = {"A1": (ChannelSwap("A2", spans=acting),), "A2": (ChannelSwap("A1", spans=acting),)}
    trial, *_ = CANDIDATES["channel_swap"].guesses(evidence_of(("static", "tumble"), "A1", effects, seed=7))
    assert (trial.effects[0].name, trial.opposite[0].name) == ("channel_swap", "channel_swap")
    whole, after = trial.when.triples
    assert whole == (0, 0.0, math.inf)
    assert (after[0], after[2]) == (1, math.inf)
    assert after[1] == pytest.approx(40.0, abs=1.0)


def test_a_step_to_no_level_of_another_suggests_no_exchange() -> None:
    """Halfway, or to the other's level on one axis only."""
    for offset in ((-0.75,) * 3, (-1.5, 0.0, 0.0)):
        step = Bias(offset, spans=(0.0, 35.0, 1e9))
        assert list(CANDIDATES["channel_swap"].guesses(evidence_of("static", "G1", {"G1": (step,)}, seed=7))) == []


def test_a_scale_error_from_a_moment_of_a_motion_is_suggested() -> None:
    """The first half of the motion, 5 to 15 s, has no error, the second a tenth on the only axis that moves."""
    evidence = evidence_of("motion", "G1", seed=7)
    shift = np.array([[0.001, 0.0, 0.0], [0.1, 0.001, 0.0]])
    odd = replace(
        evidence,
        values={"motion_along": 1.0 + shift},
        expected={"motion_along": np.ones((2, 3))},
        scores={"motion_along": shift / 0.01},
        rows_of={"motion_along": (0, 0)},
    )
    every, one = [trial for trial in CANDIDATES["scale"].guesses(odd) if trial.when.spans]
    assert isinstance(every.effects[0], Scale)
    assert isinstance(one.effects[0], Scale)
    assert one.effects[0].error == pytest.approx((0.1, 0.0, 0.0))
    assert every.effects[0].error == pytest.approx((0.1,) * 3)
    assert [trial.when.triples for trial in (every, one)] == [[(0, 15.0, math.inf)]] * 2
    assert every.begin_bounds_s == one.begin_bounds_s == (5.0, 25.0)
    steady = replace(odd, values={"motion_along": 1.0 + shift[[1, 1]]}, scores={"motion_along": shift[[1, 1]] / 0.01})
    assert not [trial for trial in CANDIDATES["scale"].guesses(steady) if trial.when.spans]


def test_a_constant_axis_suggests_no_exchange() -> None:
    """A sensor at the limit of its range; without a warning of NumPy, which is an error here."""
    rng = np.random.default_rng(2)
    own, exchanged = rng.normal(0, 1, (2, 40, 6))
    own[:, 2] = exchanged[:, 2] = 0.0
    floor = np.array([0.1, 0.1, 0.0, 0.1, 0.1, 0.1])
    gains = _gains_of_exchange(own, exchanged, np.full(40, 40), floor)
    others = [0, 1, 3, 4, 5]
    without = _gains_of_exchange(own[:, others], exchanged[:, others], np.full(40, 40), floor[others])
    np.testing.assert_allclose(gains, without)


@pytest.mark.parametrize(("share", "expected"), [(1.0, [(0, 15.0, 25.0)]), (0.4, [])])
def test_a_single_segment_with_a_part_of_the_step_is_not_an_interval(share: float, expected: list[object]) -> None:
    """Only one segment of 10 s has readings of the other sensor: all of them, or too few."""
    time_s, shares = np.arange(0.0, 50.0, 10.0), np.array([0.0, 0.0, share, 0.0, 0.0])
    nothing = np.zeros(5, np.int64)
    course = _Course(nothing, time_s, nothing, np.zeros((5, 3)), np.zeros((5, 3)), np.ones(3))
    assert _when(course, shares > 0, shares).triples == expected
