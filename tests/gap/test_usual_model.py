"""The usual model of sensors: the data sheets' figures where available, the same for every caller."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from imuarray.gap.model.base_model import Base, FittedParameters
from imuarray.gap.model.populations import printed_noise, usual_model
from imuarray.log.format import SensorHeader
from imuarray.simulate.model import Model, Part, parse_model
from imuarray.simulate.population import Spread
from tests.gap.small_campaign import header

FITTED = FittedParameters(*((0.0,) * 3,) * 3)
HEADERS = {
    "A1": header("A1"),
    "A2": header("A2", range=2.0),
    "G1": header("G1", chip="l3g4200d"),
}


def test_noise_is_that_of_the_data_sheet() -> None:
    """150 ug in 1 Hz (BMA-110), 0.03 dps in 1 Hz; an unknown bandwidth has no noise."""
    one = replace(HEADERS["A1"], bandwidth_hz=600.0)
    assert printed_noise(one) == pytest.approx((150e-6 * 600**0.5,) * 3, rel=1e-4)
    assert printed_noise(replace(HEADERS["G1"], bandwidth_hz=50.0)) == pytest.approx((0.03 * 50**0.5,) * 3, rel=1e-3)
    assert printed_noise(replace(one, bandwidth_hz=0.0)) is None


def recipes(model: Model, one: SensorHeader) -> dict[str, object]:
    return {kind: part.effects[kind] for kind, part in model.parts(one).items()}


def test_figures_are_of_the_chip_at_its_range() -> None:
    """BMA180: +-2 % at 4 g, 1.5 % at 2 g (BMA-70, BMA-72), two sigma; for gyroscopes the data sheet has no figure of
    scale and alignment, but of the slope of the scale (L3G-72) and of nonlinearity (L3G-73).
    """
    model = usual_model(HEADERS.values())
    assert recipes(model, HEADERS["A1"])["scale"] == ({"error": Spread(sigma=0.01, limit=0.02)},)
    assert recipes(model, HEADERS["A2"])["scale"] == ({"error": Spread(sigma=0.0075, limit=0.015)},)
    assert recipes(model, HEADERS["G1"]).keys() == {
        "own_clock",
        "scale",
        "misalignment",
        "g_sensitivity",
        "turn_on_bias",
        "thermal_bias",
        "thermal_scale",
        "nonlinearity",
    }
    for one in HEADERS.values():
        assert recipes(model, one)["misalignment"] == ({"angles_deg": Spread(sigma=0.7)},)
        ((clock,),) = (recipes(model, one)["own_clock"],)  # type: ignore[misc]
        assert clock.keys() == {"phase_deg"}
        assert math.isnan(clock["phase_deg"])


def test_the_usual_model_can_be_written_and_read() -> None:
    model = replace(usual_model([*HEADERS.values(), replace(header("X"), chip="other")]), name="usual")
    assert [part.chip for part in parse_model(model.to_toml()).designs] == [part.chip for part in model.designs]


@pytest.mark.parametrize("number", [0, 7])
def test_an_additional_effect_does_not_change_the_units(number: int) -> None:
    """So that its removal gives the initial model of a diagnosis without a model."""
    usual = usual_model(HEADERS.values())
    extra = Part("l3g4200d", name="G1", effects={"tone": ({"amplitude_dps": 0.3, "frequency_hz": 17.0},)})
    fitted = dict.fromkeys(HEADERS, FITTED)
    plain, more = (Base(HEADERS, fitted, one, 3).drawn(number) for one in (None, replace(usual, sensors=(extra,))))
    assert [one.name for one in more["G1"] if one.name == "tone"]
    without = {name: tuple(one for one in effects if one.name != "tone") for name, effects in more.items()}
    assert repr(without) == repr(plain)  # nan is not equal to itself
