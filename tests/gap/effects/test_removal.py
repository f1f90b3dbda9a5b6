"""Removal of effects that only the model has."""

from __future__ import annotations

import pytest

from imuarray.gap.inference.effects.candidate import Hypothesis, with_removal
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.bias import RandomWalk
from imuarray.simulate.effects.temperature import ThermalBias
from tests.gap.effects.evidence_of import evidence_of

NEW = Hypothesis((RandomWalk((1e-3,) * 3),), ("density",))


def test_an_effect_absent_from_the_model_is_only_added() -> None:
    evidence = evidence_of("static", "A1", seed=5)
    assert list(with_removal(evidence, "random_walk", [NEW])) == [NEW]


@pytest.mark.parametrize(("several", "actions"), [(False, ["remove", "replace"]), (True, ["remove", "replace", "add"])])
def test_an_effect_of_the_model_is_removed_or_replaced(several: bool, actions: list[str]) -> None:
    evidence = evidence_of("static", "A1", seed=5, modelled=(RandomWalk((1e-2,) * 3), Bandwidth(10.0)))
    trials = list(with_removal(evidence, "random_walk", [NEW], several=several))
    assert [trial.action for trial in trials] == actions
    assert {trial.name for trial in trials} == {"random_walk"}


def test_an_effect_of_every_sensor_is_not_removed() -> None:
    evidence = evidence_of("static", "A1", seed=5, modelled=(ThermalBias(quadratic=(1e-3,) * 3),))
    for name in ("white_noise", "bias", "thermal_bias", "scale", "misalignment", "own_clock"):
        assert list(with_removal(evidence, name, [])) == []
