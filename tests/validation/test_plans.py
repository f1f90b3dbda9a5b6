"""The planned cases, and the independence of both halves."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from imuarray.errors import ConfigError
from imuarray.simulate.effect import from_table
from imuarray.simulate.effects import EFFECTS
from imuarray.validation import plans
from imuarray.validation.bench import CHIPS, HIDDEN, LIMITS, PLANS, limit
from imuarray.validation.case import Case
from imuarray.validation.generator import mechanisms
from imuarray.validation.plans import EXTRAS, SIZES, Size, cases, hidden_in, restrict, shuffle
from imuarray.validation.worlds import draw_world

BENCH = Size(controls=200, singles=20, others=4, withheld=4, unnamed=20, pairs=100, removals=12)
UNITS = {"adxl345": "g", "bma180": "g", "l3g4200d": "dps"}


@pytest.mark.slow
def test_every_plan_has_every_mechanism_and_extra_effect() -> None:
    """On the bench: each mechanism with a name at five severities, each other mechanism, each extra effect."""
    planned = cases("sealed", BENCH)
    kinds = Counter(case.kind for case in planned)
    assert kinds["none"] == 200 * len(PLANS)
    assert kinds["pair"] == 200
    assert kinds["removal"] == 12 * len(EXTRAS)
    of_bench = {name: facts for name, facts in mechanisms().items() if set(facts["touches"]) & set(CHIPS.values())}
    named = {name for name, facts in of_bench.items() if facts["resembles"]}
    for kind, expected in (("single", named), ("withheld", named), ("unnamed", set(of_bench) - named)):
        assert {put.mechanism for case in planned if case.kind == kind for put in case.puts} == expected
    assert {case.plan for case in planned if case.kind == "none"} == set(PLANS)
    limits = {case.puts[0].limits for case in planned if case.kind == "single"}
    assert {limit for limit in limits if not math.isnan(limit)} == {0.5, 1.0, 2.0, 5.0, 20.0}


@pytest.mark.slow
def test_halves_and_sets_have_different_seeds() -> None:
    size = Size(controls=4, singles=1, severities=(5.0,))
    halves = [cases(half, size, seed) for half in ("development", "sealed") for seed in (0, 1, 99)]
    seeds = [case.seed for half in halves for case in half]
    assert len(set(seeds)) == len(seeds)
    assert cases("sealed", size) == cases("sealed", size)
    with pytest.raises(ValueError, match="seed 100; allowed is 0 to 99"):
        cases("sealed", size, 100)


@pytest.mark.slow
def test_the_name_of_a_case_hides_its_truth_and_json_keeps_it() -> None:
    for case in cases("development", replace(SIZES["bench"], controls=1)):
        assert case.name == f"development-{case.number:05d}"
        again = Case.of_table(case.table())
        assert repr(again) == repr(case)  # nan is not equal to itself


@pytest.mark.slow
def test_mechanisms_are_put_on_suitable_sensors() -> None:
    """On sensors that they affect; pairs on different sensors, or on one."""
    planned = cases("development", BENCH)
    for case in planned:
        for put in case.puts:
            facts = mechanisms()[put.mechanism]
            assert {CHIPS[name] for name in put.sensors} <= set(facts["touches"])
            assert len(put.sensors) == {"sensor": 1, "pair": 2}.get(facts["place"], 0)
    pairs = Counter(case.puts[0].sensors == case.puts[1].sensors for case in planned if case.kind == "pair")
    assert pairs[True] > 80
    assert pairs[False] > 80
    withheld = [case for case in planned if case.kind == "withheld"]
    assert all(case.without == case.resembles[0] for case in withheld)


@pytest.mark.slow
def test_severity_is_in_detection_limits() -> None:
    (case,) = cases("development", Size(singles=1, severities=(5.0,), mechanisms=("mains_ripple",)))
    assert case.puts[0].severity == pytest.approx(5 * limit("mains_ripple", CHIPS[case.puts[0].sensors[0]]))


@pytest.mark.slow
def test_limits_exist_for_graded_mechanisms_only() -> None:
    graded = {name for name, facts in mechanisms().items() if facts["graded"]}
    assert set(LIMITS) <= graded
    assert all(value > 0 for limits in LIMITS.values() for value in limits.values() if not math.isnan(value))


def test_extra_effects_are_valid_effects() -> None:
    """With existing parameters, in the unit of their sensor."""
    for extra in EXTRAS:
        effect = from_table(EFFECTS[extra["effect"]], extra["parameters"], UNITS[extra["chip"]], "extra")
        assert effect != EFFECTS[extra["effect"]]()
    assert set(HIDDEN) == set(PLANS) - {"full"}
    assert all(names <= set(EFFECTS) for names in HIDDEN.values())


@pytest.mark.slow
def test_a_short_run_has_every_mechanism_in_random_worlds() -> None:
    """At least 400 cases; every mechanism and every kind; each in its own world that can show it."""
    planned = cases("sealed", SIZES["short"])
    assert len(planned) >= 400
    assert {case.kind for case in planned} == {"none", "single", "withheld", "unnamed", "pair", "removal"}
    of_worlds = {name for name, facts in mechanisms().items() if set(facts["touches"]) & set(CHIPS.values())}
    nuisances = {"scheduler_latency", "carrier_shot_noise"}  # of a busy recorder, and of any part
    assert {put.mechanism for case in planned for put in case.puts} == of_worlds - nuisances
    assert set(mechanisms()) - of_worlds == {"adaptive_range"}  # of a chip that no world has
    assert {case.world for case in planned} == {"emulator"}
    assert len({case.draw for case in planned}) == len(planned)
    assert sum(case.is_hidden for case in planned) >= 15
    for case in planned:
        for put in case.puts:
            facts = mechanisms()[put.mechanism]
            assert {case.chips[name] for name in put.sensors} <= set(facts["touches"])
            assert len(put.sensors) == {"sensor": 1, "pair": 2}.get(facts["place"], 0)
            chip = case.chips[put.sensors[0]] if put.sensors else ""
            if put.sensors and facts["resembles"]:
                hidden = hidden_in(draw_world(case.draw), chip, for_sure=case.is_hidden)
                assert (set(facts["resembles"]) <= hidden) == case.is_hidden
        if case.kind == "removal":
            assert case.chips[case.extra["sensor"]] == case.extra["chip"]


@pytest.mark.slow
def test_a_run_is_restricted_to_effects_severities_and_repeats() -> None:
    """Three mechanisms resemble glitches, and one extra effect is glitches."""
    size = restrict(SIZES["bench"], ["glitches"], [20.0, 0.5], 3)
    planned = cases("development", size)
    by_kind = Counter(case.kind for case in planned)
    names = {"cable_bit_errors", "torn_reads", "mux_hang"}
    assert {put.mechanism for case in planned for put in case.puts} == names
    on_full = [case.puts[0] for case in planned if case.kind == "single" and case.plan == "full"]
    assert Counter(put.mechanism for put in on_full) == dict.fromkeys(names, 2 * 3)
    assert {put.limits for put in on_full if not math.isnan(put.limits)} == {0.5, 20.0}
    assert by_kind["none"] == 3 * 20 * len(PLANS)
    assert by_kind["withheld"] == 3 * len(names)
    assert by_kind["removal"] == 3
    assert by_kind["unnamed"] == 0
    assert all("glitches" in names for case in planned for names in case.resembles)


@pytest.mark.slow
def test_an_effect_replaces_the_mechanisms_of_a_size() -> None:
    size = restrict(SIZES["glance"], ["bistable_bias"], repeats=2)
    assert [case.puts[0].mechanism for case in cases("development", size)] == ["bias_current_dac"] * 2
    assert restrict(SIZES["full"]) == SIZES["full"]


def test_fewer_repeats_keep_cases_of_each_kind() -> None:
    size = restrict(SIZES["short"], repeats=1)
    assert (size.controls, size.singles, size.hidden, size.withheld, size.unnamed, size.pairs) == (75, 1, 1, 1, 2, 10)


def test_a_pair_needs_two_mechanisms() -> None:
    planned = cases("development", restrict(SIZES["bench"], ["tone"]))
    assert "pair" not in {case.kind for case in planned}


@pytest.mark.parametrize(
    ("size", "given", "message"),
    [
        ("bench", {"effects": ["tine"]}, "effect 'tine': no case of this size has it; .*; did you mean tone?"),
        ("short", {"effects": ["jitter"]}, "effect 'jitter': no case of this size has it; allowed are axis_error, "),
        ("bench", {"severities": [3.0]}, "severity 3 detection limits; allowed are 0.5, 1, 2, 5, 20$"),
    ],
)
def test_an_unknown_restriction_is_refused(size: str, given: dict[str, list[Any]], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        restrict(SIZES[size], **given)


def test_consecutive_sets_of_cases_have_different_seeds() -> None:
    with pytest.raises(ConfigError, match=r"^10001 cases are planned; allowed are at most 10000$"):
        cases("development", Size(controls=10_001, worlds=True))


def test_halves_have_different_worlds() -> None:
    size = Size(controls=30, worlds=True)
    drawn = [{case.draw for case in cases(half, size, seed)} for half in ("development", "sealed") for seed in (0, 1)]
    assert len(set.union(*drawn)) == sum(map(len, drawn))


def test_mechanisms_within_tolerance_are_not_cases() -> None:
    """A chip that warms its own thermometer is normal for parts."""
    assert "self_heating" not in mechanisms()
    assert all("thermometer" not in facts["resembles"] for facts in mechanisms().values())


def test_worlds_are_shuffled_together() -> None:
    planned = cases("development", Size(controls=20, worlds=True))
    foreign = [replace(case, world="foreign", number=case.number + 20) for case in planned]
    first = [case.world for case in shuffle([*planned, *foreign], 0)[:20]]
    assert 5 < first.count("foreign") < 15
    assert shuffle(planned, 0) == planned


@pytest.mark.parametrize("page", ["docs/how_to/validate.md", "VALIDATION.md"])
def test_the_pages_state_the_number_of_cases(page: str) -> None:
    text = (Path(__file__).parents[2] / page).read_text(encoding="utf-8")
    counts = {name: sum(1 for _ in plans._all(size)) for name, size in SIZES.items()}
    told = {"short": f"{counts['short']} cases", "full": f"{counts['full']}"}
    if page == "VALIDATION.md":
        told = {name: f"`{name}` ({count}" for name, count in counts.items() if name != "none"}
    for name, message in told.items():
        assert message in text, name


@pytest.mark.slow
def test_unobservable_mechanisms_are_not_cases() -> None:
    """Twins of the same mounting, and the orientation of a single accelerometer without a noted level."""
    worlds = [draw_world(seed) for seed in range(1_000_000, 1_000_400)]
    pairs = [(world, pair) for world in worlds for pair in world.twins()]
    assert pairs
    assert all(world.sensors[first].axes != world.sensors[second].axes for world, (first, second) in pairs)
    for world in worlds:
        alone = sum(chip != "l3g4200d" for chip in world.inertial.values()) == 1
        for chip in {"adxl345", "bma180"} & set(world.inertial.values()):
            is_level_known = not alone or world.strata["labels"] != "missing"
            assert {"axis_error", "channel_swap"}.isdisjoint(hidden_in(world, chip)) == is_level_known


@pytest.mark.slow
def test_a_gain_that_follows_temperature_needs_several_faces() -> None:
    """An accelerometer that is heated on a single face reads a constant force, a gyroscope at rest nothing."""
    heated = [world for seed in range(1_000_000, 1_000_100) if "heating" in (world := draw_world(seed)).kinds]
    for world in heated:
        assert "thermal_scale" in hidden_in(world, "l3g4200d", for_sure=True)
        (heating,) = (session for session in world.sessions if session["name"] == "heating")
        faces = {phase[3] for phase in heating["phases"]}
        if world.strata["labels"] == "noted":
            assert ("thermal_scale" in hidden_in(world, "bma180")) == (len(faces) == 1)
    assert {world.heated_faces for world in heated} == {1, 2, 3}


@pytest.mark.slow
def test_a_mux_hang_needs_two_sensors_at_the_same_address() -> None:
    hung = [case for case in cases("development", SIZES["short"]) if "mux_hang" in {put.mechanism for put in case.puts}]
    assert hung
    for case in hung:
        world = draw_world(case.draw)
        places = [(chip, world.sensors[name].address) for name, chip in world.inertial.items()]
        assert max(places.count(place) for place in places) > 1
