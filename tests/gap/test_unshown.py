"""Effects that campaigns cannot show, with artificial candidates."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.findings.diagnosis import Cause, Unobservable
from imuarray.gap.findings.experiment_design import (
    Facts,
    facts_of,
    uncertain_domains,
    unobservable_effects,
    with_unobservable_rivals,
)
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.candidate import Candidate, Kind
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.probes import PROBES
from imuarray.log.format import SensorHeader
from tests.gap.small_campaign import campaign_of, header
from tests.selection import some

SENSORS = {
    "A1": header("A1"),
    "A2": header("A2"),
    "G1": header("G1", chip="l3g4200d"),
    "P": header("P", columns=("pressure",)),
}
ONE_FACE = Facts(faces=1, span_degc=1.5, runs=0, has_turned=False, rest_s=3600.0)
NEVER_TOLD = (
    "scale",
    "misalignment",
    "nonlinearity",
    "saturation",
    "g_sensitivity",
    "thermal_bias",
    "thermal_scale",
    "thermal_lag",
    "turn_on_bias",
    "bistable_bias",
)


def candidates(**shown_by: dict[Kind, str]) -> dict[str, Candidate]:
    """Candidates of the sensors that can have them; with their experiments."""
    return {effect: replace(CANDIDATES[effect], shown_by=kinds) for effect, kinds in shown_by.items()}


def all_found(kinds: tuple[str, ...], facts: Facts, **shown_by: dict[Kind, str]) -> tuple[Unobservable, ...]:
    return unobservable_effects(kinds, facts, candidates(**shown_by), SENSORS)


def found(kinds: tuple[str, ...], facts: Facts, **shown_by: dict[Kind, str]) -> dict[str, Unobservable]:
    """The last entry of each effect."""
    return {one.effect: one for one in all_found(kinds, facts, **shown_by)}


@given(st.dictionaries(st.sampled_from(("static", "tumble", "heating", "turn-on", "motion")), st.just("this or that")))
def test_one_face_at_rest_does_not_show_some_effects(shown_by: dict[Kind, str]) -> None:
    """For any statement of the candidates."""
    told = all_found(("static",), ONE_FACE, **dict.fromkeys(NEVER_TOLD, shown_by))
    assert tuple(dict.fromkeys(one.effect for one in told)) == NEVER_TOLD
    for effect in NEVER_TOLD:
        sensors = [name for one in told if one.effect == effect for name in one.sensors]
        assert sensors == (["G1"] if effect == "g_sensitivity" else ["A1", "A2", "G1"])
    assert all(one.record for one in told)


def test_the_recording_to_make_is_stated() -> None:
    told = found(("static",), ONE_FACE, scale={"tumble": "six faces"}, turn_on_bias={}, tone={"static": "a minute"})
    assert all_found(("static",), ONE_FACE, scale={"tumble": "six faces"}) == (
        Unobservable("scale", ("A1", "A2"), "tumble: six faces"),
        Unobservable("scale", ("G1",), "motion: turns to and fro about every axis, 1 minute"),
    )
    assert told["turn_on_bias"].record == "turn-on: a dozen short logs, switched off in between"
    assert "tone" not in told


@pytest.mark.parametrize("kinds", [("static",), ("tumble",), ("heating",)])
def test_a_minute_at_rest_in_any_log_shows_noise_lines_and_filters(kinds: tuple[str, ...]) -> None:
    still: dict[str, dict[Kind, str]] = {name: {"static": "rest"} for name in ("white_noise", "tone", "bandwidth")}
    assert not found(kinds, Facts(6, 20.0, 0, False, 60.0), **still)
    assert found(kinds, Facts(6, 20.0, 0, False, 59.0), **still).keys() == still.keys()


def test_faces_show_effects_of_accelerometers_and_turns_of_gyroscopes() -> None:
    tumble: dict[str, dict[Kind, str]] = {
        "scale": {"tumble": "six faces", "motion": "turn it"},
        "saturation": {"tumble": "six faces", "motion": "turn it"},
        "g_sensitivity": {"tumble": "six faces"},
    }
    faces = Facts(6, 0.0, 0, False, 70.0)
    gyroscopes = {name: Unobservable(name, ("G1",), "motion: turn it") for name in ("scale", "saturation")}
    assert found(("tumble",), faces, **tumble) == gyroscopes
    assert found(("static",), faces, **tumble).keys() == gyroscopes.keys()  # logs at rest on six faces are a tumble
    assert not found(("tumble", "motion"), faces, **tumble)
    assert not found(("tumble",), Facts(6, 0.0, 0, True, 70.0), **tumble)
    assert found(("tumble",), Facts(1, 0.0, 0, False, 10.0), **tumble).keys() == set(tumble)


def test_thermal_scale_needs_several_faces_or_turns_when_warm() -> None:
    """Warm on one face alone it looks like a slope of the bias, with any other faces at one temperature; a gyroscope
    has to turn while it is cool and while it is warm.
    """
    heat: dict[str, dict[Kind, str]] = {"thermal_scale": {"heating": "warm it on two faces"}}
    tumbled = Facts(6, 30.0, 0, True, 600.0, warm_faces=1)
    turns = "motion: turns to and fro about every axis, 1 minute, and again when it is warmer by 10 degC or more"
    assert all_found(("heating", "tumble", "motion"), tumbled, **heat) == (
        Unobservable("thermal_scale", ("A1", "A2"), "heating: warm it on two faces"),
        Unobservable("thermal_scale", ("G1",), turns),
    )
    (faces,) = found(("heating",), replace(tumbled, warm_faces=2), **heat).values()
    assert faces.sensors == ("G1",)
    (turned,) = found(("heating",), replace(tumbled, has_turned_warm=True), **heat).values()
    assert turned.sensors == ("A1", "A2")
    assert not found(("heating",), replace(tumbled, warm_faces=2, has_turned_warm=True), **heat)


def test_effects_that_cannot_be_separated_are_confusable() -> None:
    """For the sensors concerned; a cause with another name, or a separated one, is unchanged."""
    hidden = [
        Unobservable("thermal_scale", ("A1", "A2"), "heating: warm it on two faces"),
        Unobservable("scale", ("A1",), ""),
    ]
    causes = [
        Cause(effect, "add", (sensor,), (), 0.9, {}, 0.9, (0.8, 1.0), ("thermal_lag",))
        for effect, sensor in (("thermal_bias", "A1"), ("thermal_bias", "G1"), ("bias", "A1"))
    ]
    first, *others = with_unobservable_rivals(causes, hidden)
    assert first == replace(causes[0], confusable_with=("thermal_lag", "thermal_scale"))
    assert others == causes[1:]
    assert with_unobservable_rivals(causes, hidden[1:]) == tuple(causes)


def test_insufficient_experiments_are_not_accepted() -> None:
    one: dict[str, dict[Kind, str]] = {"thermal_lag": {"heating": "heat"}, "turn_on_bias": {"turn-on": "boots"}}
    assert found(("heating", "turn-on"), Facts(1, 2.0, 3, False, 60.0), **one).keys() == one.keys()
    assert not found(("heating", "turn-on"), Facts(1, 8.0, 4, False, 60.0), **one)
    assert "tone" in found(("static",), Facts(1, 0.0, 0, False, 20.0), tone={"static": "a minute"})


def test_other_effects_follow_the_statement_of_their_candidates() -> None:
    told = found(("tumble",), Facts(6, 0.0, 0, False, 600.0), bias_instability={"static": "an hour"}, bias={})
    assert told == {"bias_instability": Unobservable("bias_instability", ("A1", "A2", "G1"), "static: an hour")}


def test_positions_concern_accelerometers() -> None:
    assert found(("static",), ONE_FACE, size_effect={"motion": "swing"})["size_effect"].sensors == ("A1", "A2")


def test_an_effect_of_one_chip_concerns_no_other() -> None:
    assert found(("static",), ONE_FACE, adaptive_range={"motion": "turn"}) == {}
    gyroscope = replace(SENSORS["G1"], name="I1", chip="icm42688_gyro")
    (effect,) = unobservable_effects(
        ("static",), ONE_FACE, candidates(adaptive_range={"motion": "turn"}), {**SENSORS, "I1": gyroscope}
    )
    assert effect.sensors == ("I1",)


@pytest.mark.parametrize(
    ("kind", "faces", "runs", "has_turned", "rest_s"),
    some(
        [
            ("static", 1, 0, False, 60.0),
            ("tumble", 6, 0, False, 70.0),
            ("turn-on", 1, 8, False, 160.0),
            ("motion", 1, 0, True, 10.0),
        ],
        2,
    ),
)
def test_facts_of_each_kind_of_campaign(kind: str, faces: int, runs: int, has_turned: bool, rest_s: float) -> None:
    assert facts_of(campaign_of(kind)) == Facts(faces, 0.0, runs, has_turned, pytest.approx(rest_s))  # type: ignore[arg-type]


def test_the_temperature_change_is_that_of_one_log() -> None:
    """The emulated heat pulse of the paper warms by some 30 degC (Figure 9)."""
    facts = facts_of(campaign_of("heating"))
    assert 20 < facts.span_degc < 40
    assert (facts.warm_faces, facts.has_turned_warm) == (1, False)


def key(probe: str, sensor: str = "A1", axis: str = "x") -> Key:
    return Key(0, sensor, axis, "static", 0, PROBES[probe].domain, probe)


def doubts(
    scales: list[float], keys: list[Key], seconds: float, sensors: dict[str, SensorHeader] = SENSORS
) -> tuple[Unobservable, ...]:
    """With margins of 1.96."""
    return uncertain_domains(np.array(scales), np.full(len(scales), 1.96), keys, seconds, sensors)


def test_wide_intervals_are_grouped_by_domain_and_chip() -> None:
    """Scales of 2 and 3 need 4 and 9 times as long: 6.5 minutes of one, rounded up."""
    keys = [key("band_1"), key("band_2", "A2"), key("band_3"), key("band_1", "G1"), key("noise"), key("line")]
    told = doubts([2.0, 3.0, 0.9, 2.0, 0.99, math.nan], keys, 60.0)
    assert told == (
        Unobservable("differences of spectrum", ("A1", "A2"), "7 minutes"),
        Unobservable("differences of spectrum", ("G1",), "4 minutes"),
    )


def test_required_lengths_are_those_of_each_log() -> None:
    scales, margins = np.array([2.0, 2.0, 2.0]), np.full(3, 1.96)
    told = uncertain_domains(
        scales, margins, [key("noise", axis=axis) for axis in "xyz"], np.array([10.0, 60.0, 900.0]), SENSORS
    )
    assert [one.record for one in told] == ["4 minutes"]


def test_differences_that_longer_logs_cannot_determine() -> None:
    assert doubts([100.0], [key("noise")], 60.0)[0].record == "a longer log is not enough"
    assert doubts([100.0], [key("mean")], 60.0)[0].record.startswith("a longer log is not enough; tumble: ")
    assert doubts([2.0], [key("run_spread")], 60.0)[0].record == "turn-on: 4.0 times as many runs"
    assert doubts([5.0], [key("run_spread")], 60.0)[0].record == "no series is long enough"
    assert doubts([0.5], [key("mean")], 60.0) == ()
