"""A box on its faces, level and tilted, turning from one to the next, warm."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from firmware_emulator.world import TumbleWorld as EmulatedTumble
from imuarray.simulate.motion import Heating, Still, Tumble

G = 9.80665
S = 10**9


@pytest.mark.parametrize(
    ("up", "force", "field"),
    [  # a quarter turn from upright exchanges two axes; half a turn is about X
        ("+Z", (0, 0, G), (0.2, 0, -0.43)),
        ("-Z", (0, 0, -G), (0.2, 0, 0.43)),
        ("+X", (G, 0, 0), (-0.43, 0, -0.2)),
        ("-X", (-G, 0, 0), (0.43, 0, 0.2)),
        ("+Y", (0, G, 0), (0.2, -0.43, 0)),
        ("-Y", (0, -G, 0), (0.2, 0.43, 0)),
    ],
)
def test_a_box_at_rest_has_gravity_and_field_of_its_face(
    up: str, force: tuple[float, ...], field: tuple[float, ...]
) -> None:
    stimulus = Still(up, temperature_degc=31.0).stimulus(np.array([0, 5 * S]))
    assert np.array_equal(stimulus.force_box, [force, force])
    assert np.array_equal(stimulus.field_box, [field, field])
    assert not stimulus.rate_box.any()
    assert stimulus.temperature_degc.tolist() == [31.0, 31.0]
    assert stimulus.pressure_pa.tolist() == [101325.0, 101325.0]


def test_a_box_at_rest_takes_no_memory() -> None:
    stimulus = Still().stimulus(np.arange(1000))
    assert stimulus.force_box.strides[0] == stimulus.temperature_degc.strides[0] == 0


def test_drift_is_linear_until_the_end() -> None:
    stimulus = Still(seconds=7200.0, drift_degc_per_h=1.5).stimulus(np.array([0, 1800, 3600, 7200, 9000]) * S)
    assert stimulus.temperature_degc == pytest.approx([25.0, 25.75, 26.5, 28.0, 28.0], abs=1e-12)


@pytest.mark.parametrize("up", ["+X", "-X", "+Y", "-Y", "+Z", "-Z"])
def test_a_tilted_table_turns_gravity_and_field_together(up: str) -> None:
    """The angle between the force and the face's axis is the tilt; the angle between force and field does not change,
    for both are turned together.
    """
    level, leaning = (Still(up, tilt_deg=tilt).stimulus(np.array([0])) for tilt in ((0.0, 0.0), (0.6, 0.8)))
    cosine = (level.force_box[0] @ leaning.force_box[0]) / G**2
    assert math.degrees(math.acos(cosine)) == pytest.approx(1.0, abs=1e-9)  # 0.6, 0.8, 1
    assert leaning.force_box[0] @ leaning.field_box[0] == pytest.approx(G * -0.43, rel=1e-12)


def test_a_positive_tilt_raises_the_axis() -> None:
    """Turned by +1 degree about level x, the box's y axis rises: the reaction to gravity has a part along +y."""
    force = Still(tilt_deg=(1.0, 0.0)).stimulus(np.array([0])).force_box[0]
    assert force == pytest.approx([0, G * math.sin(math.radians(1)), G * math.cos(math.radians(1))], abs=1e-12)
    force = Still(tilt_deg=(0.0, 1.0)).stimulus(np.array([0])).force_box[0]
    assert force == pytest.approx([-G * math.sin(math.radians(1)), 0, G * math.cos(math.radians(1))], abs=1e-12)


def test_a_tumble_equals_that_of_the_emulator() -> None:
    """Implemented a second time, in scalars, for the emulated array."""
    mine, other = Tumble(face_s=2.0, turn_s=1.5), EmulatedTumble(face_s=2.0, turn_s=1.5)
    times = np.arange(-S, 26 * S, 31_234_567)
    stimulus, expected = mine.stimulus(times), [other(at) for at in times.tolist()]
    assert stimulus.force_box == pytest.approx(np.array([e.force_box for e in expected]), abs=1e-12)
    assert stimulus.rate_box == pytest.approx(np.array([e.rate_box for e in expected]), abs=1e-12)
    assert stimulus.field_box == pytest.approx(np.array([e.field_box for e in expected]), abs=1e-12)
    assert [tuple(phase) for phase in mine.phases] == [tuple(phase) for phase in other.phases]


TILTED = Tumble(2.0, 1.5, (20.0, 21.0, 21.0, 22.0, 22.0, 22.0, 25.0), tuple((k - 3.0, 0.5 * k) for k in range(7)))


def test_faces_are_exactly_level() -> None:
    tumble = Tumble(face_s=2.0, turn_s=1.5)
    for phase in tumble.phases:
        force = tumble.stimulus(np.array([phase.start_ns, phase.end_ns - 1])).force_box
        assert sorted(np.abs(force[0])) == [0.0, 0.0, G]
        assert np.array_equal(force[0], force[1])


def test_a_turn_rotates_gravity_and_field() -> None:
    """A vector v that is fixed to the earth changes in the box by v' = -rate x v; rates change by the acceleration."""
    step_ns, times = 20_000, np.arange(50_000, 24 * S, 17_654_321)
    before, now, after = (TILTED.stimulus(times + shift) for shift in (-step_ns, 0, step_ns))
    for name in ("force_box", "field_box"):
        slope = (getattr(after, name) - getattr(before, name)) / (2e-9 * step_ns)
        assert slope == pytest.approx(-np.cross(now.rate_box, getattr(now, name)), abs=1e-5)
    slope = (after.rate_box - before.rate_box) / (2e-9 * step_ns)
    assert slope == pytest.approx(now.angular_acceleration_box, abs=1e-3)  # its own slope jumps where a turn begins
    assert np.linalg.norm(now.force_box, axis=1) == pytest.approx(G, rel=1e-12)


def test_rates_lead_from_each_tilted_face_to_the_next(navigate: Callable[..., Any]) -> None:
    """Integrated from the first face; a box that turns about its own origin does not move."""
    step_ns = 2_000_000
    track = navigate(TILTED, step_ns)
    start = Rotation.from_matrix(TILTED.attitudes[0])
    for phase, attitude in zip(TILTED.phases[1:], TILTED.attitudes[1:], strict=True):
        reached = start * track.attitude[phase.start_ns // step_ns]
        assert (Rotation.from_matrix(attitude).inv() * reached).magnitude() < 1e-5


def test_each_face_has_its_temperature() -> None:
    starts = np.array([phase.start_ns for phase in TILTED.phases])
    stimulus = TILTED.stimulus(starts + S)
    assert stimulus.temperature_degc.tolist() == [20.0, 21.0, 21.0, 22.0, 22.0, 22.0, 25.0]
    for row, (phase, (x, y)) in enumerate(zip(TILTED.phases, TILTED.tilts_deg, strict=True)):
        sign = 1 if phase.up[0] == "+" else -1
        upright = sign * stimulus.force_box[row, "XYZ".index(phase.up[1])] / G
        assert upright == pytest.approx(math.cos(math.radians(math.hypot(x, y))), abs=1e-12)
    turning = TILTED.stimulus(starts[:-1] + 2 * S + 750_000_000)  # half way
    assert turning.temperature_degc.tolist() == pytest.approx([20.5, 21.0, 21.5, 22.0, 22.0, 23.5])
    quarter = TILTED.stimulus(np.array([2 * S + 375_000_000])).temperature_degc[0]
    assert quarter == pytest.approx(20 + 0.25 - 1 / (2 * math.pi))  # the integral of 1 - cos


def test_heating_has_the_phases_of_the_paper() -> None:
    """Section 5.2.5: 24 degC for 5 minutes, 42 to 43 after 5 of heat, 5 to cool, 52 after 5 more, 90 to cool, not quite
    to the beginning.
    """
    heating = Heating()
    minutes = np.array([0, 4.9, 10, 15, 20, 110])
    degc = heating.stimulus((minutes * 60 * S).astype(np.int64)).temperature_degc
    assert degc[:3] == pytest.approx([24.0, 24.0, 42.5], abs=1e-9)
    assert 24.0 < degc[3] < 42.5
    assert degc[4] == pytest.approx(52.0, abs=1e-9)
    assert 24.2 < degc[5] < 26.0
    assert [(phase.name, phase.start_ns / 60 / S, phase.end_ns / 60 / S, phase.up) for phase in heating.phases] == [
        ("room", 0, 5, "+Z"),
        ("heat", 5, 10, "+Z"),
        ("cool", 10, 15, "+Z"),
        ("heat", 15, 20, "+Z"),
        ("cool", 20, 110, "+Z"),
    ]


def test_heating_is_exponential_and_continuous() -> None:
    """Equal steps of time take away equal shares of the distance that is left: 1 / e in 2 minutes (heat), 20 (cool)."""
    heating = Heating(peaks_degc=(45.0, 60.0), room_degc=20.0, last_room_degc=20.5)
    profile = heating.stimulus(np.arange(0, 110 * 60 * S, S)).temperature_degc
    for first_min, last_min, constant_min in ((5, 10, 2), (10, 15, 20), (15, 20, 2), (20, 110, 20)):
        steps = np.diff(profile[first_min * 60 : last_min * 60])
        assert steps[1:] / steps[:-1] == pytest.approx(math.exp(-1 / (60 * constant_min)), rel=1e-6)
    assert np.abs(np.diff(profile)).max() < 0.35
    assert profile.max() == pytest.approx(60.0, abs=0.3)


def test_heating_can_be_shortened() -> None:
    minutes = np.linspace(0, 110, 300)
    slow, quick = Heating(), Heating(scale=0.01)
    assert quick.seconds == pytest.approx(66.0)
    expected = slow.stimulus((minutes * 60 * S).astype(np.int64)).temperature_degc
    assert quick.stimulus((minutes * 0.6 * S).astype(np.int64)).temperature_degc == pytest.approx(expected, abs=1e-6)
