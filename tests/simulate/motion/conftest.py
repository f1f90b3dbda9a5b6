"""Independent derivations: numerical derivatives of an attitude, and a strapdown navigation.

No function of the package is used here: rotations are scipy's, the rest is finite differences and sums.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from imuarray.simulate.motion.stimulus import BoxStimulus, Motion

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

S = 10**9
G = 9.80665
FIELD = np.array([0.2, 0.0, -0.43])


class Attitude(Protocol):
    def __call__(self, time_ns: Times) -> Rotation: ...


class Rates(NamedTuple):
    rate_box: Floats
    angular_acceleration_box: Floats


class Track(NamedTuple):
    """The result of a strapdown navigation from rest at the origin."""

    attitude: Rotation
    velocity: Floats
    position: Floats


def _rates(attitude: Attitude, time_ns: Times, step_ns: int = 100_000) -> Rates:
    before, now, after = (attitude(time_ns + shift) for shift in (-step_ns, 0, step_ns))
    step_s = step_ns * 1e-9
    first, second = (before.inv() * now).as_rotvec(), (now.inv() * after).as_rotvec()
    return Rates((before.inv() * after).as_rotvec() / (2 * step_s), (second - first) / step_s**2)


def _navigated(stimulus: BoxStimulus, step_s: float) -> Track:
    """`stimulus` at the middles of equal steps; attitude before each step and after the last (n + 1)."""
    path = Rotation.from_rotvec(stimulus.rate_box * step_s)
    shift = 1
    while shift < len(stimulus.time_ns):  # running product, doubling its reach
        path = Rotation.concatenate([path[:shift], path[:-shift] * path[shift:]])
        shift *= 2
    half = path * Rotation.from_rotvec(-stimulus.rate_box * step_s / 2)
    acceleration = half.apply(stimulus.force_box) - [0, 0, G]
    velocity = np.cumsum(acceleration, axis=0) * step_s
    return Track(path, velocity, np.cumsum(velocity - acceleration * step_s / 2, axis=0) * step_s)


@pytest.fixture
def rates() -> Callable[..., Rates]:
    """``rates(attitude, time_ns)``: central differences of an attitude."""
    return _rates


@pytest.fixture
def navigate() -> Callable[[Motion, int], Track]:
    """``navigate(motion, step_ns)`` from time 0 to the motion's end."""

    def run(motion: Motion, step_ns: int) -> Track:
        middles = np.arange(step_ns // 2, round(motion.seconds * S), step_ns)
        return _navigated(motion.stimulus(middles), step_ns * 1e-9)

    return run
