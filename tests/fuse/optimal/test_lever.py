"""The size effect: a turning box, accelerometers away from its origin."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.fuse.frames import Axis, Frames, matrices
from imuarray.fuse.optimal import ErrorModel, Optimal
from tests.fuse.optimal.conftest import FORCE, Floats, model_of, times, triad

RATE = "angular_rate"
PERIOD_S = 0.0025
COUNT = 4000
PLACES = [(0.05, 0.0, 0.02), (0.05, 0.06, 0.0), (0.0, 0.05, -0.04), (0.04, 0.0, 0.05)]


def array(places: list[tuple[float, float, float]]) -> tuple[dict[str, list[Axis]], ErrorModel]:
    """Accelerometers at these places, 0.05 m/s2, and two gyroscopes of 0.002 rad/s."""
    force = [
        axis
        for index, place in enumerate(places)
        for axis in triad(f"A{index}", np.eye(3), noise_si=0.05, position_m=place)
    ]
    rate = [axis for index in range(2) for axis in triad(f"G{index}", np.eye(3), "g", noise_si=0.002)]
    return {FORCE: force, RATE: rate}, model_of([*force, *rate])


def turning(axes: dict[str, list[Axis]]) -> tuple[dict[str, Frames], Floats, Floats]:
    """Frames, specific force at the origin and angular acceleration: three sines, up to 10 rad/s and 130 rad/s2."""
    rng = np.random.default_rng(104)
    seconds = times(COUNT, PERIOD_S)[:, None] * 1e-9
    omega = 2 * np.pi * np.array([1.0, 2.0, 1.5])
    rate = 10 * np.sin(omega * seconds)
    acceleration = 10 * omega * np.cos(omega * seconds)
    force = np.array([0.0, 0.0, 9.8]) + 2 * np.sin(3.0 * omega * seconds)
    frames = {}
    for quantity, its in axes.items():
        values = []
        for axis in its:
            place = np.array(axis.position_m)
            felt = force + np.cross(acceleration, place) + np.cross(rate, np.cross(rate, place))
            values.append((felt if quantity == FORCE else rate) @ np.array(axis.direction_box))
            values[-1] = values[-1] + (axis.noise_si or 0.0) * rng.normal(size=COUNT)
        frames[quantity] = Frames(times(COUNT, PERIOD_S), np.stack(values, axis=1), np.ones((COUNT, len(its)), bool))
    return frames, force, acceleration


def test_euler_and_centripetal_terms_are_removed() -> None:
    """They are up to 8 m/s2 here. The remainder has the stated covariance, and is not proportional to the terms: 2 % of
    the terms' rms is 7 times the resolution of 4000 frames.
    """
    axes, model = array(PLACES)
    frames, force, _ = turning(axes)
    estimate = Optimal(axes, model, period_s=PERIOD_S)(frames)[FORCE]
    error = (estimate.triad_box - force)[10:]
    covariance = matrices(estimate.covariance_box)[10:]
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    # 4000 squares of three determine a mean to 1.3 %, 99.9 % of the time within 4.3 %; neighbours correlate a little
    assert squares.mean() == pytest.approx(3.0, rel=0.07)
    values = frames[FORCE].values
    mean = np.stack([values[:, index::3].mean(axis=1) for index in range(3)], axis=1)
    left = (mean - force)[10:]
    assert np.abs(left).max() > 5.0
    assert np.abs(np.sum(error * left, axis=0) / np.sum(left**2, axis=0)).max() < 0.02


def test_accelerometers_determine_angular_acceleration_better_than_gyroscopes() -> None:
    """0.002 / sqrt(2) rad/s over 2.5 ms gives a slope of 1.4 rad/s2; 0.05 m/s2 over lever arms of 5 cm gives less."""
    axes, model = array(PLACES)
    frames, _, acceleration = turning(axes)
    optimal = Optimal(axes, model, period_s=PERIOD_S)
    optimal(frames)
    estimate = optimal.angular_acceleration
    assert estimate is not None
    error = (estimate.triad_box - acceleration)[10:]
    alone = 0.002 / np.sqrt(2) * np.sqrt(6.5) / PERIOD_S
    assert error.std(axis=0).max() < 0.9 * alone
    assert error.std(axis=0) == pytest.approx(np.sqrt(estimate.covariance_box[10:, :3].mean(axis=0)), rel=0.05)


def test_a_single_accelerometer_uses_the_gyroscopes() -> None:
    axes, model = array(PLACES[:1])
    frames, force, _ = turning(axes)
    estimate = Optimal(axes, model, period_s=PERIOD_S)(frames)[FORCE]
    error = (estimate.triad_box - force)[10:]
    assert np.abs(frames[FORCE].values - force).max() > 5.0
    assert error.std(axis=0) == pytest.approx(np.sqrt(estimate.covariance_box[10:, :3].mean(axis=0)), rel=0.06)


def test_a_gap_in_the_rate_is_bridged_by_the_accelerometers() -> None:
    axes, model = array(PLACES)
    frames, force, _ = turning(axes)
    frames[RATE].valid[1000:1004] = False
    estimate = Optimal(axes, model, period_s=PERIOD_S)(frames)[FORCE]
    assert np.isfinite(estimate.triad_box).all()
    assert (estimate.covariance_box[1000:1004, :3] > 1.05 * estimate.covariance_box[999, :3]).any(axis=1).all()
    assert np.abs(estimate.triad_box - force)[1005:1010].max() < 0.3


@pytest.mark.parametrize("without", ["places", "gyroscopes", "a gyroscope axis"])
def test_without_places_or_gyroscopes_no_correction_is_made(without: str) -> None:
    axes, model = array([(0.0, 0.0, 0.0)] * 4 if without == "places" else PLACES)
    if without == "gyroscopes":
        del axes[RATE]
    elif without == "a gyroscope axis":
        axes[RATE] = axes[RATE][:2]
    frames, _, _ = turning(axes)
    optimal = Optimal(axes, model, period_s=PERIOD_S)
    estimate = optimal(frames)[FORCE]
    assert optimal.angular_acceleration is None
    values = frames[FORCE].values
    assert estimate.triad_box == pytest.approx(np.stack([values[:, k::3].mean(axis=1) for k in range(3)], axis=1))
