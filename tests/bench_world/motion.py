"""What the box goes through: its angular rate, specific force and temperature on a grid of 400 Hz."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.bench_world.chips import Array
from tests.bench_world.rotation import Quaternion, matrices_of, product, quaternion_of

GRID_HZ = 400.0
STEP_S = 1 / GRID_HZ
STANDARD_GRAVITY = 9.80665
"""m/s² in a g."""
LOCAL_GRAVITY = 9.8121
"""m/s² where the bench is."""


@dataclass(frozen=True)
class Phase:
    """A labelled part of a log, in s; `up` is the axis of the box that points up, or empty."""

    start_s: float
    end_s: float
    name: str
    up: str


@dataclass(frozen=True)
class Course:
    """What is done with the box: (n, 3) angular rate in rad/s in the box's axes and acceleration in m/s² in the level
    frame, (n,) temperature in degC, from the attitude `level_box` on.
    """

    duration_s: float
    level_box: Array
    rate_box: Array
    acceleration_level: Array
    temperature_c: Array
    phases: tuple[Phase, ...]
    has_reference: bool = False


@dataclass(frozen=True)
class Motion:
    """What is felt in the middle of the box, (n, 3) in its axes: rad/s, rad/s² and m/s²; `temperature_c` (n,)."""

    duration_s: float
    time_s: Array
    rate_box: Array
    angular_acceleration_box: Array
    force_box: Array
    temperature_c: Array
    phases: tuple[Phase, ...]
    has_reference: bool


def grid(duration_s: float) -> Array:
    """Return the times (n,) s at which a motion is known."""
    return np.arange(int(duration_s * GRID_HZ)) / GRID_HZ


def motion_of(course: Course) -> Motion:
    """Return the motion of a box on this course."""
    turned = matrices_of(_attitudes(course))
    up_level = course.acceleration_level + np.array([0, 0, LOCAL_GRAVITY])
    return Motion(
        duration_s=course.duration_s,
        time_s=grid(course.duration_s),
        rate_box=course.rate_box,
        angular_acceleration_box=np.gradient(course.rate_box, STEP_S, axis=0),
        force_box=np.einsum("jin,nj->ni", turned, up_level),
        temperature_c=course.temperature_c,
        phases=course.phases,
        has_reference=course.has_reference,
    )


def lever_arm_force(rate: Array, angular_acceleration: Array, position_m: Array) -> Array:
    """Return the specific force (n, 3) m/s² at a position that the middle of rotation does not have."""
    return np.cross(angular_acceleration, position_m) + np.cross(rate, np.cross(rate, position_m))


def _attitudes(course: Course) -> Array:
    """Return the quaternions (n, 4) of `level_box`, integrated with the rate in the middle of each step."""
    attitude = quaternion_of(course.level_box)
    attitudes = [attitude]
    for step in _steps(course.rate_box)[:-1]:
        attitude = product(attitude, step)
        attitudes.append(attitude)
    return np.array(attitudes)


def _steps(rate_box: Array) -> list[Quaternion]:
    middle = rate_box.copy()
    middle[:-1] = 0.5 * (rate_box[:-1] + rate_box[1:])
    x, y, z = middle.T
    angle = np.sqrt(x * x + y * y + z * z) * STEP_S
    turns = angle > 1e-12
    share = np.divide(np.sin(angle / 2), angle / STEP_S, out=np.zeros_like(angle), where=turns)
    real = np.where(turns, np.cos(angle / 2), 1.0)
    return [tuple(row) for row in np.stack([real, x * share, y * share, z * share], 1).tolist()]
