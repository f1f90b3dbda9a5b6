"""The worlds: inputs of a box at rest, turning, heated and shaken."""

from __future__ import annotations

import itertools
import math

import pytest

from firmware_emulator.world import (
    WORLDS,
    DelayedWorld,
    HeatingWorld,
    Shaking,
    StillWorld,
    TumbleWorld,
    WorldPhase,
    WorldStimulus,
)

G = 9.80665
S = 10**9


@pytest.mark.parametrize(
    ("up", "force", "field"),
    [
        ("+Z", (0, 0, G), (0.2, 0, -0.43)),
        ("-Z", (0, 0, -G), (0.2, 0, 0.43)),  # turned about X
        ("+X", (G, 0, 0), (-0.43, 0, -0.2)),
        ("-X", (-G, 0, 0), (0.43, 0, 0.2)),
        ("+Y", (0, G, 0), (0.2, -0.43, 0)),
        ("-Y", (0, -G, 0), (0.2, 0.43, 0)),
    ],
)
def test_a_still_world_is_constant(up: str, force: tuple[float, ...], field: tuple[float, ...]) -> None:
    world = StillWorld(up, 30.0)
    for at_ns in (-S, 0, 10**18):
        assert world(at_ns) == WorldStimulus(force, (0, 0, 0), 30.0, 101325.0, field)
    assert [phase[2:] for phase in world.phases] == [("static", up)]


def test_tumble_visits_every_face_in_the_papers_order() -> None:
    world = TumbleWorld(face_s=10.0, turn_s=2.0)
    expected = {
        "z_up": ("+Z", (0, 0, G)),
        "x_up": ("+X", (G, 0, 0)),
        "y_up": ("+Y", (0, G, 0)),
        "x_down": ("-X", (-G, 0, 0)),
        "y_down": ("-Y", (0, -G, 0)),
        "z_down": ("-Z", (0, 0, -G)),
        "z_up_check": ("+Z", (0, 0, G)),
    }
    assert [phase.name for phase in world.phases] == list(expected)
    for index, (start_ns, end_ns, name, up) in enumerate(world.phases):
        assert (start_ns, end_ns) == (index * 12 * S, (index * 12 + 10) * S)
        for at_ns in (start_ns, (start_ns + end_ns) // 2, end_ns - 1):
            stimulus = world(at_ns)
            assert (up, stimulus.force_box) == expected[name]
            assert stimulus.rate_box == (0, 0, 0)
    assert world(10**15).force_box == (0, 0, G)
    assert world(-S).force_box == (0, 0, G)


def cross(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@pytest.mark.parametrize("turn", range(6))
def test_rates_of_a_turn_match_the_change_of_gravity_and_field(turn: int) -> None:
    """A vector v that is fixed to the earth changes in the box by v' = -rate x v."""
    world = TumbleWorld(face_s=10.0, turn_s=2.0)
    begin_ns, step_ns = (turn * 12 + 10) * S, 10_000
    for at_ns in range(begin_ns + 50_000_000, begin_ns + 2 * S, 190_000_000):
        before, now, after = world(at_ns - step_ns), world(at_ns), world(at_ns + step_ns)
        for vector in ("force_box", "field_box"):
            pair = zip(getattr(before, vector), getattr(after, vector), strict=True)
            slope = [(b - a) / (2 * step_ns * 1e-9) for a, b in pair]
            expected = [-component for component in cross(now.rate_box, getattr(now, vector))]
            assert slope == pytest.approx(expected, abs=1e-5)
        assert math.hypot(*now.force_box) == pytest.approx(G)


def test_turns_begin_and_end_at_rate_zero_and_cover_their_angle() -> None:
    world = TumbleWorld(face_s=1.0, turn_s=2.0)
    for turn, degrees in enumerate((90, 90, 90, 90, 90, 180)):
        begin_ns = (turn * 3 + 1) * S
        rates = [math.hypot(*world(begin_ns + i * 2_000_000).rate_box) for i in range(1001)]
        assert math.degrees(sum(rates) * 2e-3) == pytest.approx(degrees, rel=1e-3)
        assert rates[0] == pytest.approx(0, abs=1e-9)
        assert rates[-1] == pytest.approx(0, abs=1e-9)


def test_heating_follows_the_papers_profile() -> None:
    world = HeatingWorld()
    minutes = {0: 24.0, 4.99: 24.0, 10: 42.5, 20: 52.0}  # section 5.2.5
    for minute, degc in minutes.items():
        assert world(round(minute * 60 * S)).temperature_degc == pytest.approx(degc, abs=0.01)
    assert 24.0 < world(110 * 60 * S).temperature_degc < 26.0
    assert [(phase.name, phase.start_ns // S // 60, phase.end_ns // S // 60) for phase in world.phases] == [
        ("room", 0, 5),
        ("heat", 5, 10),
        ("cool", 10, 15),
        ("heat", 15, 20),
        ("cool", 20, 110),
    ]
    profile = [world(second * S).temperature_degc for second in range(110 * 60)]
    assert max(abs(b - a) for a, b in itertools.pairwise(profile)) < 0.2
    quick = HeatingWorld(scale=0.1)
    assert quick(60 * S).temperature_degc == pytest.approx(42.5, abs=0.01)
    assert quick.phases[-1].end_ns == 11 * 60 * S


def test_shaking_reaches_and_keeps_its_bounds() -> None:
    world = Shaking(peak_g=6.0, peak_dps=400.0, still_s=5.0, motion_s=40.0)
    assert [phase.name for phase in world.phases] == ["static", "motion", "static"]
    assert world.phases[-1].end_ns == 50 * S
    motion = [world(5 * S + i * 5_000_000) for i in range(8001)]
    for axis in range(3):
        force = max(abs(stimulus.force_box[axis] - (G if axis == 2 else 0)) for stimulus in motion) / G
        rate = math.degrees(max(abs(stimulus.rate_box[axis]) for stimulus in motion))
        assert 5.4 < force <= 6.0
        assert 360 < rate <= 400.0
    for at_ns in (0, 5 * S, 45 * S, 60 * S):
        assert world(at_ns) == WorldStimulus()
    steps = [math.dist(a.force_box, b.force_box) for a, b in itertools.pairwise(motion)]
    assert max(steps) < 25.0  # no jump: 6 g at 6.7 Hz change by less within 5 ms


def test_a_delayed_world_begins_later() -> None:
    world = DelayedWorld(TumbleWorld(face_s=10.0, turn_s=2.0), 100 * S)
    assert world(113 * S).force_box == TumbleWorld(face_s=10.0, turn_s=2.0)(13 * S).force_box
    assert world.phases[1] == WorldPhase(112 * S, 122 * S, "x_up", "+X")
    assert DelayedWorld(lambda at_ns: WorldStimulus(), 5).phases == ()


def test_worlds_have_phases_in_order() -> None:
    for kind in WORLDS.values():
        phases = kind().phases
        assert phases
        assert all(phase.start_ns < phase.end_ns for phase in phases)
        assert all(a.end_ns <= b.start_ns for a, b in itertools.pairwise(phases))


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: StillWorld("up"), "up"),
        (lambda: TumbleWorld(face_s=0.0), "face_s"),
        (lambda: HeatingWorld(scale=-1.0), "scale"),
        (lambda: Shaking(peak_g=float("nan")), "peak_g"),
    ],
)
def test_impossible_worlds_are_refused(make: object, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        make()  # type: ignore[operator]
