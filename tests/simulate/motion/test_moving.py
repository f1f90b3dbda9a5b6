"""Shaken by hand, driven: force and rate compared with the numerical derivatives of attitude and position, and against
a strapdown navigation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imuarray.simulate.motion import HandShake
from imuarray.simulate.motion.kinematics import EulerAngles, RotationVector
from imuarray.simulate.motion.vehicle import Vehicle
from tests.selection import examples

G = 9.80665
S = 10**9
FIELD = np.array([0.2, 0.0, -0.43])
GRAVITY = np.array([0.0, 0.0, G])
PA_PER_M = 1.225 * G  # hydrostatic, standard air

SHAKES = [
    HandShake(still_s=0.5, motion_s=6.0),
    HandShake(peak_g=2.0, peak_dps=2000.0, still_s=0.5, motion_s=4.0, seed=9),
]
DRIVE = Vehicle(still_s=1.0, drive_s=20.0, road_mps2=1.0)


@pytest.mark.parametrize("shake", SHAKES)
def test_shaking_matches_numerical_derivatives(shake: HandShake, rates: Callable[..., Any]) -> None:
    times = np.arange(S // 4, round(shake.seconds * S), 13_345_678)
    stimulus, attitude = shake.stimulus(times), shake.attitude(times)
    assert stimulus.rate_box == pytest.approx(rates(shake.attitude, times).rate_box, abs=1e-4)
    assert stimulus.angular_acceleration_box == pytest.approx(
        rates(shake.attitude, times).angular_acceleration_box, abs=2e-2
    )
    step_ns = 200_000
    before, now, after = (shake.position(times + shift) for shift in (-step_ns, 0, step_ns))
    acceleration = (before - 2 * now + after) / (step_ns * 1e-9) ** 2
    assert stimulus.force_box == pytest.approx(attitude.inv().apply(acceleration + GRAVITY), abs=1e-2)
    assert stimulus.field_box == pytest.approx(attitude.inv().apply(FIELD), abs=1e-12)
    assert stimulus.pressure_pa == pytest.approx(101325 - PA_PER_M * now[:, 2], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("shake", SHAKES)
def test_navigation_of_shaking_returns_to_the_origin(shake: HandShake, navigate: Callable[..., Any]) -> None:
    track = navigate(shake, 100_000)
    assert track.attitude[-1].magnitude() < 1e-5
    assert track.velocity[-1] == pytest.approx(0, abs=1e-4)
    assert track.position[-1] == pytest.approx(0, abs=1e-3)
    assert np.abs(track.position).max() > 0.02  # it did move


@given(
    peak_g=st.floats(0.1, 16),
    peak_dps=st.floats(10, 2000),
    motion_s=st.floats(0.5, 20),
    seed=st.integers(0, 10**6),
)
@settings(deadline=None, max_examples=examples(30))
def test_shaking_stays_within_its_peaks(peak_g: float, peak_dps: float, motion_s: float, seed: int) -> None:
    shake = HandShake(peak_g, peak_dps, 1.0, motion_s, seed)
    stimulus = shake.stimulus(np.linspace(0, shake.seconds * S, 4001).astype(np.int64))
    assert np.linalg.norm(stimulus.rate_box, axis=1).max() <= math.radians(peak_dps) * (1 + 1e-6)
    assert np.linalg.norm(stimulus.force_box, axis=1).max() <= (peak_g + 1) * G * (1 + 1e-6)


@pytest.mark.slow
def test_each_axis_keeps_its_share_of_the_peaks_while_the_motion_swells() -> None:
    """Half a second of motion is nothing but swelling and fading, which adds to the derivatives of every sine. Three
    equal axes share a magnitude: 1 / sqrt(3) each. Of 200 seeds the worst come within a tenth of it.
    """
    worst_g, worst_dps = [], []
    step_ns = 500_000
    times = np.arange(S, S + S // 2, 2 * step_ns)
    for seed in range(200):
        shake = HandShake(peak_g=3.0, peak_dps=60.0, still_s=1.0, motion_s=0.5, seed=seed)
        acceleration = shake.attitude(times).apply(shake.stimulus(times).force_box) - GRAVITY
        before, after = (shake.attitude(times + shift).as_rotvec() for shift in (-step_ns, step_ns))
        worst_g.append(np.abs(acceleration).max() / G)
        worst_dps.append(np.degrees(np.abs(after - before).max()) / (2e-9 * step_ns))
    assert 0.9 < max(worst_g) * math.sqrt(3) / 3.0 <= 1 + 1e-6
    assert 0.9 < max(worst_dps) * math.sqrt(3) / 60.0 <= 1 + 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_shaking_comes_near_its_peaks(seed: int) -> None:
    shake = HandShake(peak_g=6.0, peak_dps=400.0, still_s=1.0, motion_s=60.0, seed=seed)
    times = np.arange(0, round(shake.seconds * S), 4_000_000)
    stimulus = shake.stimulus(times)
    acceleration = shake.attitude(times).apply(stimulus.force_box) - [0, 0, G]
    assert 0.75 * 6 * G < np.linalg.norm(acceleration, axis=1).max() <= 6 * G
    assert 0.7 * 400 < math.degrees(np.linalg.norm(stimulus.rate_box, axis=1).max()) <= 400


def test_seeds_shake_differently_and_rest_outside_the_motion() -> None:
    times = np.arange(0, 50 * S, 10_000_000)
    first, again, other = (HandShake(seed=seed).stimulus(times) for seed in (1, 1, 2))
    assert np.array_equal(first.force_box, again.force_box)
    assert not np.allclose(first.force_box, other.force_box)
    outside = (times <= 10 * S) | (times >= 40 * S)
    assert np.array_equal(first.force_box[outside], np.tile([0, 0, G], (outside.sum(), 1)))
    assert not first.rate_box[outside].any()


@pytest.mark.parametrize("length", [0.0, 1e-9, 1e-4, 0.4, 0.447213, 0.447214, 0.5, 2.0, 3.14159, 6.0, 9.0])
def test_rotation_vectors_of_any_length_match_scipy(length: float) -> None:
    """Against scipy's rotations, on both sides of where series take over (theta^2 = 0.2), and beyond a half turn."""
    axis, speed = np.array([0.6, -0.48, 0.64]), np.array([0.3, 1.1, -0.7])
    phi, gain = length * axis, np.array([2.0, -1.0, 0.5])
    vector = RotationVector(phi[:, None], speed[:, None], gain[:, None])
    rate, acceleration = vector.rates()
    assert vector.seen(FIELD[:, None])[:, 0] == pytest.approx(Rotation.from_rotvec(phi).inv().apply(FIELD), abs=1e-14)

    def path(at: float) -> Rotation:
        return Rotation.from_rotvec(phi + speed * at + gain * at**2 / 2)

    step = 1e-4
    begin, end = (path(-step).inv() * path(0)).as_rotvec(), (path(0).inv() * path(step)).as_rotvec()
    assert rate[:, 0] == pytest.approx((begin + end) / (2 * step), abs=1e-6)
    assert acceleration[:, 0] == pytest.approx((end - begin) / step**2, abs=1e-5)


def test_angles_of_any_size_match_numerical_derivatives(rates: Callable[..., Any]) -> None:
    """Quadratics in time with all of roll, pitch and yaw large and turning."""
    terms = np.array([[0.9, 1.3, -2.0], [-0.7, 0.8, 1.5], [2.5, -1.1, 0.6]])  # value, speed, gain of roll, pitch, yaw
    angles = EulerAngles(*terms[:, :, None])

    def attitude(time_ns: np.ndarray) -> Rotation:
        t = time_ns[:, None] * 1e-9
        value, speed, gain = terms.T
        return Rotation.from_euler("ZYX", (value + speed * t + gain * t**2 / 2)[:, ::-1])

    rate, acceleration = angles.rates()
    expected = rates(attitude, np.array([0]))
    assert rate[:, 0] == pytest.approx(expected.rate_box[0], abs=1e-6)
    assert acceleration[:, 0] == pytest.approx(expected.angular_acceleration_box[0], abs=1e-5)
    seen = angles.seen(FIELD[:, None])[:, 0]
    assert seen == pytest.approx(attitude(np.array([0])).inv().apply(FIELD)[0], abs=1e-14)


def test_driving_matches_numerical_derivatives(rates: Callable[..., Any]) -> None:
    times = np.arange(S // 4, round(DRIVE.seconds * S), 23_345_678)
    stimulus, attitude = DRIVE.stimulus(times), DRIVE.attitude(times)
    assert stimulus.rate_box == pytest.approx(rates(DRIVE.attitude, times).rate_box, abs=1e-5)
    assert stimulus.angular_acceleration_box == pytest.approx(
        rates(DRIVE.attitude, times).angular_acceleration_box, abs=1e-3
    )
    step_ns = 50_000
    acceleration = (DRIVE.velocity(times + step_ns) - DRIVE.velocity(times - step_ns)) / (2e-9 * step_ns)
    assert stimulus.force_box == pytest.approx(attitude.inv().apply(acceleration + GRAVITY), abs=1e-4)
    assert stimulus.field_box == pytest.approx(attitude.inv().apply(FIELD), abs=1e-12)


def test_driving_without_the_road_matches_numerical_derivatives(rates: Callable[..., Any]) -> None:
    """Without the road's shaking what bends and changes of speed do together shows to the fifth digit."""
    drive = Vehicle(road_mps2=0.0, still_s=1.0, drive_s=20.0, lateral_mps2=6.0)
    times = np.arange(S // 4, round(drive.seconds * S), 23_345_678)
    stimulus, expected = drive.stimulus(times), rates(drive.attitude, times)
    assert stimulus.rate_box == pytest.approx(expected.rate_box, abs=1e-6)
    assert stimulus.angular_acceleration_box == pytest.approx(expected.angular_acceleration_box, abs=1e-5)


@pytest.mark.slow
def test_driving_navigates_to_a_stop(navigate: Callable[..., Any]) -> None:
    """Force and rate alone determine speed, distance and height."""
    step_ns = 500_000
    track = navigate(DRIVE, step_ns)
    middles = np.arange(0, len(track.velocity), 2000)
    ends = (middles + 1) * step_ns
    assert track.velocity[middles] == pytest.approx(DRIVE.velocity(ends), abs=2e-3)
    speed = np.linalg.norm(track.velocity, axis=1)
    assert speed.max() == pytest.approx(15.0, rel=1e-2)
    assert speed[-1] == pytest.approx(0.0, abs=1e-3)
    # 20 s at 15 m/s, of which speeding up (a fifth) and braking (0.15) are symmetric steps of half that speed.
    travelled = np.abs(np.diff(track.position[:, :2], axis=0)).max(axis=1).sum()
    way = np.linalg.norm(np.diff(track.position, axis=0), axis=1).sum()
    assert travelled < way == pytest.approx(15 * 20 * (1 - 0.2 / 2 - 0.15 / 2), rel=1e-2)
    height = track.position[middles, 2]
    assert DRIVE.stimulus(ends).pressure_pa == pytest.approx(101325 - PA_PER_M * height, abs=1e-2)


def test_the_nose_rises_in_acceleration_and_dips_in_braking() -> None:
    """Steepest slope of the step: 35 / 16. A lifted nose adds a part of gravity's reaction along +X."""
    drive = Vehicle(road_mps2=0.0, drive_s=100.0)
    force = drive.stimulus(np.arange(drive.phases[1].start_ns, drive.phases[1].end_ns, S // 10)).force_box[:, 0]
    for extreme, gain in ((force.max(), 35 / 16 * 15 / 20), (force.min(), -35 / 16 * 15 / 15)):
        lift = math.radians(0.4) * gain
        assert extreme == pytest.approx(gain * math.cos(lift) + G * math.sin(lift), rel=1e-4)


def test_bends_have_the_requested_lateral_force() -> None:
    """Left first: force along +Y; the body leans out of the bend, which adds gravity's part."""
    drive = Vehicle(road_mps2=0.0, drive_s=100.0, lateral_mps2=3.0)
    stimulus = drive.stimulus(np.arange(drive.phases[1].start_ns, drive.phases[1].end_ns, S // 10))
    lean = math.radians(0.4) * 3.0
    expected = 3.0 * math.cos(lean) + G * math.sin(lean)
    assert stimulus.force_box[:, 1].max() == pytest.approx(expected, rel=1e-6)
    assert stimulus.force_box[:, 1].min() == pytest.approx(-expected, rel=1e-6)
    assert stimulus.force_box[:, 1].argmax() < stimulus.force_box[:, 1].argmin()
    assert stimulus.rate_box[:, 2].max() == pytest.approx(3.0 / 15.0 * math.cos(lean), rel=1e-6)


def vertical(drive: Vehicle, begin_s: float, end_s: float) -> np.ndarray:
    """Vertical acceleration in m/s2 at 100 Hz, in seconds since the drive began."""
    times = drive.phases[1].start_ns + np.arange(round(begin_s * 100), round(end_s * 100)) * (S // 100)
    level: np.ndarray = drive.attitude(times).apply(drive.stimulus(times).force_box)
    return level[:, 2] - G


def test_vibration_of_the_road_has_its_rms_and_band_and_grows_with_speed() -> None:
    """Eight sines between 1 and 15 Hz. Full speed is reached after a fifth of the drive, half of it at a tenth."""
    drive = Vehicle(drive_s=4000.0, lateral_mps2=0.0, road_mps2=0.8)
    road = vertical(drive, 1000, 1200)
    assert road.std() == pytest.approx(0.8, rel=0.02)
    power = np.abs(np.fft.rfft(road * np.hanning(len(road)))) ** 2
    hertz = np.fft.rfftfreq(len(road), 0.01)
    assert power[(hertz < 0.9) | (hertz > 15.1)].sum() < 1e-3 * power.sum()
    assert vertical(drive, 390, 410).std() == pytest.approx(0.4, rel=0.1)
    smooth = Vehicle(drive_s=4000.0, lateral_mps2=0.0, road_mps2=0.0)
    assert vertical(smooth, 1000, 1001) == pytest.approx(0, abs=1e-12)
