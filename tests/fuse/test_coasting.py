"""Coasting against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imuarray.fuse.coasting_errors import Coasting, Errors, coasting, propagate
from tests.fuse.conftest import Floats, G
from tests.selection import some

RATE_HZ = 50
UP = np.array([0.0, 0.0, G])


def errors(
    rate_error: Floats | None = None,
    force_error: Floats | None = None,
    *,
    seconds: float = 60.0,
    rate: Floats | None = None,
    force: Floats | None = None,
) -> Errors:
    """Frames of `seconds`, the last included, of a box at rest unless a motion is given; omitted errors are zero."""
    count = round(seconds * RATE_HZ) + 1
    whole = lambda value: np.zeros((count, 3)) + (0.0 if value is None else value)  # noqa: E731
    time = np.arange(count, dtype=np.int64) * (1_000_000_000 // RATE_HZ)
    felt = np.tile(UP, (count, 1)) if force is None else force
    return Errors(time, whole(rate_error), whole(force_error), whole(rate), felt)


def times(seconds: float) -> Floats:
    return np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ


def end(found: Coasting) -> tuple[float, float]:
    """Heading and velocity of the only coast."""
    assert len(found.begins_s) == 1
    return float(found.heading_deg[0]), float(found.velocity_mps[0])


def test_a_constant_rate_error_turns_the_heading() -> None:
    """b t: 0.01 dps for a minute."""
    heading, velocity = end(coasting(errors(np.radians([0, 0, 0.01])), still_s=0))
    assert heading == pytest.approx(0.6)
    assert velocity == pytest.approx(0.0, abs=1e-12)


def test_a_ramp_of_the_rate_error() -> None:
    """r t^2 / 2."""
    ramp = np.outer(times(60), np.radians([0, 0, 0.001]))
    assert end(coasting(errors(ramp), still_s=0))[0] == pytest.approx(0.001 * 60**2 / 2)


def test_a_constant_force_error() -> None:
    """a t, level parts only: the vertical part adds no horizontal velocity."""
    assert end(coasting(errors(None, np.array([0.03, 0.04, 0.5])), still_s=0))[1] == pytest.approx(0.05 * 60)


def test_a_level_rate_error_projects_gravity_into_velocity() -> None:
    """g b t^2 / 2, along -y for a turn about x: the up direction tilts towards -y."""
    b = 1e-5
    tilt, velocity = propagate(errors(np.array([b, 0, 0])))
    assert tilt == pytest.approx([60 * b, 0, 0])
    assert velocity == pytest.approx([0, -G * b * 60**2 / 2, 0], abs=1e-9)


@pytest.mark.slow
def test_white_noise_gives_a_random_walk() -> None:
    """N sqrt(t), and after a rest of tau N sqrt(t + t^2 / tau): 200 coasts determine an rms to 5 %; four of these.
    Velocity from the level rates, without a rest: g N sqrt(t^3 / 3) along each of two axes.
    """
    rng = np.random.default_rng(3)
    density = 1e-4
    headings, velocities, rested = [], [], []
    for _ in range(200):
        noise = rng.normal(0, density * np.sqrt(RATE_HZ), (round(70 * RATE_HZ) + 1, 3))
        heading, velocity = end(coasting(errors(noise[: 60 * RATE_HZ + 1]), still_s=0))
        headings.append(heading)
        velocities.append(velocity)
        rested.append(end(coasting(errors(noise, seconds=70)))[0])
    rms = [float(np.sqrt(np.mean(np.square(values)))) for values in (headings, rested, velocities)]
    expected = [
        np.degrees(density * np.sqrt(60)),
        np.degrees(density * np.sqrt(60 + 60**2 / 10)),
        np.sqrt(2) * G * density * np.sqrt(60**3 / 3),
    ]
    assert np.divide(rms, expected) == pytest.approx([1.0] * 3, abs=4 * 0.05)


def test_a_rest_removes_constants_and_the_mean_of_a_ramp() -> None:
    """A ramp from the start of ten seconds at rest: mean 5 r; then r (t^2 / 2 + 10 t) - 5 r t."""
    constant = errors(np.array([0.01, 0.02, 0.03]), np.array([0.1, 0.2, 0.3]), seconds=70)
    assert end(coasting(constant)) == pytest.approx((0, 0), abs=1e-9)
    ramp = errors(np.outer(times(70), np.radians([0, 0, 0.001])), seconds=70)
    assert end(coasting(ramp))[0] == pytest.approx(0.001 * (60**2 / 2 + 5 * 60), rel=2e-3)


def test_errors_turn_with_the_box() -> None:
    """A box that turns about its vertical z once a minute: a constant error about its x turns in a circle and ends at
    0; after half a turn it is 2 b / w along y.
    """
    omega, b = 2 * np.pi / 60, 1e-4
    whole = propagate(errors(np.array([b, 0, 0]), rate=np.array([0, 0, omega])))[0]
    half = propagate(errors(np.array([b, 0, 0]), rate=np.array([0, 0, omega]), seconds=30))[0]
    assert whole == pytest.approx([0, 0, 0], abs=1e-8)
    assert half == pytest.approx([0, 2 * b / omega, 0], rel=1e-4, abs=1e-8)


def test_coasting_equals_the_difference_of_two_navigators() -> None:
    """A tumbling, shaken box: the difference of navigators with and without errors, integrated step by step."""
    seconds = times(20)
    rate = np.stack([0.5 * np.sin(seconds), 0.4 * np.cos(0.7 * seconds), 0.3 * np.sin(0.3 * seconds)], axis=1)
    force = UP + np.stack([np.sin(2 * seconds), np.cos(3 * seconds), np.sin(seconds)], axis=1)
    given = errors(np.array([1e-5, -2e-5, 3e-5]), np.array([2e-4, 1e-4, -3e-4]), seconds=20, rate=rate, force=force)

    def navigated(turning: Floats, pushing: Floats) -> tuple[Rotation, Floats]:
        attitude, velocity = Rotation.identity(), np.zeros(3)
        before = attitude.apply(pushing[0])
        for k in range(1, len(seconds)):
            attitude = attitude * Rotation.from_rotvec((turning[k] + turning[k - 1]) / 2 / RATE_HZ)
            after = attitude.apply(pushing[k])
            velocity = velocity + (before + after) / 2 / RATE_HZ
            before = after
        return attitude, velocity

    true, plain = navigated(rate, force)
    result, wrong = navigated(rate + given.rate_error, force + given.force_error)
    tilt, velocity = propagate(given)
    assert tilt == pytest.approx((result * true.inv()).as_rotvec(), rel=0.01, abs=1e-6)
    assert velocity == pytest.approx(wrong - plain, rel=0.01, abs=1e-5)


def test_a_coast_begins_after_a_rest() -> None:
    """It turns for the first five seconds: the coast begins ten seconds after that. In 200 s there is room for two."""
    rate = np.where(times(200)[:, None] < 5, [0, 0, 0.1], 0.0)
    result = coasting(errors(seconds=200, rate=rate))
    assert result.begins_s == pytest.approx([15, 85], abs=0.05)
    assert len(coasting(errors(seconds=60)).begins_s) == 0
    assert np.isnan(coasting(errors(seconds=60)).heading_rms_deg)


@pytest.mark.slow
@pytest.mark.parametrize("cut", some([1, 63, 500, 4001], 2))
def test_results_do_not_depend_on_blocks(cut: int) -> None:
    """With a turn, which delays a window, and a pause."""
    rng = np.random.default_rng(6)
    rate = np.zeros((300 * RATE_HZ + 1, 3))
    rate[100 * RATE_HZ : 105 * RATE_HZ, 2] = 0.5
    whole = errors(rng.normal(0, 1e-3, rate.shape), rng.normal(0, 1e-2, rate.shape), seconds=300, rate=rate)
    whole.time[170 * RATE_HZ :] += 700_000_000
    wanted = coasting(whole)
    assert len(wanted.begins_s) > 1
    result = coasting(whole[first : first + cut] for first in range(0, len(whole.time), cut))
    for name in ("heading_deg", "velocity_mps", "begins_s"):
        np.testing.assert_array_equal(getattr(result, name), getattr(wanted, name))
