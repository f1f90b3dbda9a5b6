"""What a sensor shows of force and rotation that it shouldn't, and readings that are another sensor's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects.channel_swap import CHANNEL_SWAP
from imuarray.gap.inference.effects.g_sensitivity import G_SENSITIVITY
from imuarray.gap.inference.effects.nonlinearity import NONLINEARITY
from imuarray.gap.inference.effects.size_effect import SIZE_EFFECT
from imuarray.simulate.effects.channel_swap import ChannelSwap
from imuarray.simulate.effects.g_sensitivity import GSensitivity
from imuarray.simulate.effects.nonlinearity import Nonlinearity
from imuarray.simulate.effects.size_effect import SizeEffect
from tests.gap.effects.evidence_of import evidence_of
from tests.selection import some


def test_a_place() -> None:
    evidence = evidence_of("motion", "A1", {"A1": (SizeEffect((0.0, 50.0, -20.0)),)}, seed=7)
    (trial,) = SIZE_EFFECT.guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, SizeEffect)
    np.testing.assert_allclose(effect.position_mm, (0.0, 50.0, -20.0), atol=6.0)


@pytest.mark.parametrize(("kind", "size", "tolerance"), [("tumble", 1.0, 0.005), ("motion", 10.0, 0.05)])
def test_a_gyroscope_that_feels_force(kind: str, size: float, tolerance: float) -> None:
    response = size * np.array([0.05, 0.02, 0.0, 0.0, -0.05, 0.0, 0.01, 0.0, 0.03])
    evidence = evidence_of(kind, "G1", {"G1": (GSensitivity(tuple(response.tolist())),)}, seed=7)
    (trial,) = G_SENSITIVITY.guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, GSensitivity)
    np.testing.assert_allclose(effect.response, response, atol=tolerance)
    assert trial.rarity == np.count_nonzero(effect.response)  # a nat each, as numbers cost that are refined


def test_a_curve_on_faces() -> None:
    evidence = evidence_of("tumble", "A1", {"A1": (Nonlinearity(quadratic=(0.005,) * 3),)}, seed=7)
    (trial,) = NONLINEARITY.guesses(evidence)
    (effect,) = trial.effects
    assert isinstance(effect, Nonlinearity)
    assert effect.quadratic == pytest.approx((0.005,) * 3, rel=0.1)


def test_a_gyroscope_on_a_face_has_no_rate_to_square() -> None:
    """What the square of force adds, in dps/g^2, is no coefficient of the square of a rate."""
    evidence = evidence_of("tumble", "G1", {"G1": (GSensitivity((0.05, 0.02, 0.0) * 3),)}, seed=7)
    odd = replace(evidence, scores={**evidence.scores, "force_square": np.full((1, 3), 9.0)})
    assert list(NONLINEARITY.guesses(odd)) == []


@pytest.mark.parametrize(
    ("sensor", "put_in"), [("A1", Nonlinearity(cubic=(0.005,) * 3)), ("G1", Nonlinearity(quadratic=(0.0005,) * 3))]
)
def test_a_curve_in_motion(sensor: str, put_in: Nonlinearity) -> None:
    """Clipped at 4 g and 250 dps."""
    evidence = evidence_of("motion", sensor, {sensor: (put_in,)}, seed=7)
    first, *_ = (trial.effects[0] for trial in NONLINEARITY.guesses(evidence))
    assert isinstance(first, Nonlinearity)
    assert np.mean(first.cubic) == pytest.approx(np.mean(put_in.cubic), rel=0.5)
    assert np.mean(first.quadratic) == pytest.approx(np.mean(put_in.quadratic), rel=0.5)


@pytest.mark.parametrize(("kind", "sensor"), [("static", "G1"), ("tumble", "A1"), ("motion", "G1")])
def test_readings_of_another(kind: str, sensor: str) -> None:
    other = sensor[0] + "2"
    evidence = evidence_of(kind, sensor, {sensor: (ChannelSwap(other),)}, seed=7)
    assert [trial.effects for trial in CHANNEL_SWAP.guesses(evidence)] == [(ChannelSwap(other),)]


@pytest.mark.parametrize("kind", some(["data", "place"], 1))
def test_an_exchange_shows_by_its_axes(kind: str) -> None:
    """Either has the other's data, or both sit in each other's place."""
    both = {"A1": (ChannelSwap("A2", kind),), "A2": (ChannelSwap("A1", kind),)}
    for sensor, other in (("A1", "A2"), ("A2", "A1")):
        evidence = evidence_of("tumble", sensor, both, seed=7)
        one, exchange = CHANNEL_SWAP.guesses(evidence)
        assert (one.effects, one.opposite) == ((ChannelSwap(other),), ())
        assert exchange.effects == (ChannelSwap(other, "place"),)
        assert exchange.opposite == (ChannelSwap(sensor, "place"),)
        assert (exchange.sensor, exchange.others) == (sensor, (other,))


@pytest.mark.slow
def test_nothing_is_shared_or_felt() -> None:
    for kind in ("tumble", "static"):
        for sensor in ("A1", "G1"):
            evidence = evidence_of(kind, sensor, seed=5)
            for candidate in (CHANNEL_SWAP, SIZE_EFFECT, G_SENSITIVITY, NONLINEARITY):
                assert list(candidate.guesses(evidence)) == []
