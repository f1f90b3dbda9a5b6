"""The experiments: still, six faces by hand, tumbled, vehicle, rate table, heating."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.bench_world.chips import Array
from tests.bench_world.filters import lag
from tests.bench_world.motion import STEP_S, Course, Motion, Phase, grid, lever_arm_force, motion_of
from tests.bench_world.rotation import DIRECTIONS, RADIANS, draw_attitude, matrix_of, vector_of

FACES = {"+Z": "z_up", "+X": "x_up", "+Y": "y_up", "-X": "x_down", "-Y": "y_down", "-Z": "z_down"}
"""The names of phases, by the axis that points up."""
PAUSE_S = 0.5
"""Before and after a turn from face to face."""
OFFSET_MM = 4.0
"""How far the middle of the box is from the axis of a rate table, standard deviation along each axis."""
HEATER_TIME_CONSTANTS_S = (7, 55)
"""Of the hair dryer and of the box."""

Experiment = Callable[[np.random.Generator], Motion]


@dataclass(frozen=True)
class Room:
    """The temperature of the room (n,) degC and the vibration of its floor (n, 3) m/s²."""

    temperature_c: Array
    vibration_level: Array


@dataclass(frozen=True)
class Heat:
    """How long the box is at the temperature of the room, heated and cooling, in s, and the rise of the air in K."""

    room_s: float = 30.0
    heat_s: float = 70.0
    cool_s: float = 110.0
    rise_k: float = 26.0


HAIR_DRYER = Heat()


def static(stream: np.random.Generator, duration_s: float, name: str = "static") -> Motion:
    """Return a box that lies still."""
    level_box = draw_attitude("+Z", stream)
    room = _draw_room(grid(duration_s), stream)
    phase = Phase(0.0, duration_s, name, "+Z")
    still = np.zeros_like(room.vibration_level)
    return motion_of(Course(duration_s, level_box, still, room.vibration_level, room.temperature_c, (phase,)))


def faces(
    stream: np.random.Generator,
    order: Sequence[str] = ("+Z", "+X", "+Y", "-X", "-Y", "-Z"),
    hold_s: float = 8.0,
    turn_s: float = 2.5,
    check: bool = False,
) -> Motion:
    """Return a box that is laid on its faces by hand; with `check`, on the underside again at the end."""
    order = [*order, "+Z"] if check else list(order)
    duration_s = len(order) * hold_s + (len(order) - 1) * (turn_s + 2 * PAUSE_S) + 0.5
    time_s, start_s = grid(duration_s), 0.2
    level_box = attitude = draw_attitude(order[0], stream)
    room = _draw_room(time_s, stream)
    rate, acceleration = np.zeros((len(time_s), 3)), room.vibration_level.copy()
    phases = []
    for index, up in enumerate(order):
        is_check = check and index == len(order) - 1
        phases.append(Phase(start_s, start_s + hold_s, FACES[up] + ("_check" if is_check else ""), up))
        start_s += hold_s
        if index + 1 == len(order):
            break
        angle = vector_of(attitude.T @ draw_attitude(order[index + 1], stream))
        start_s += PAUSE_S
        rows = (time_s >= start_s) & (time_s < start_s + turn_s)
        share = (time_s[rows] - start_s) / turn_s
        rate[rows] += np.outer((1 - np.cos(2 * np.pi * share)) / turn_s, angle)
        acceleration[rows] += _draw_hand(share, turn_s, stream)
        attitude = attitude @ matrix_of(angle)
        start_s += turn_s + PAUSE_S
    return motion_of(Course(duration_s, level_box, rate, acceleration, room.temperature_c, tuple(phases)))


def tumble(
    stream: np.random.Generator, moved_s: float, rate_dps: float, acceleration: float, rest_s: float = 6.0
) -> Motion:
    """Return a box that is turned by hand between two rests; `rate_dps` and `acceleration` (m/s²) are root mean
    squares.
    """
    time_s = grid(moved_s + 2 * rest_s)
    level_box = draw_attitude("+Z", stream)
    room = _draw_room(time_s, stream)
    strength = ramp(time_s, rest_s, rest_s + moved_s, 1.5)
    rate, accelerations = np.zeros((len(time_s), 3)), room.vibration_level.copy()
    for axis in range(3):
        rate[:, axis] = rate_dps * RADIANS * _draw_sines(time_s, (0.08, 1.4), 12, stream) * strength
        accelerations[:, axis] += acceleration * strength * _draw_sines(time_s, (0.4, 3.5), 10, stream)
    phases = (Phase(0.2, rest_s - 0.3, "static", "+Z"), Phase(rest_s, rest_s + moved_s, "motion", ""))
    return motion_of(Course(moved_s + 2 * rest_s, level_box, rate, accelerations, room.temperature_c, phases))


def vehicle(stream: np.random.Generator, driven_s: float) -> Motion:
    """Return a box on the floor of a car that drives after 8 s: bends, acceleration, bumps and the engine."""
    time_s = grid(driven_s + 8)
    level_box = draw_attitude("+Z", stream, 0.8)
    room = _draw_room(time_s, stream)
    strength = ramp(time_s, 8, driven_s + 8, 2)[:, None]
    bend = 15 * RADIANS * _draw_sines(time_s, (0.02, 0.15), 8, stream)
    roll = 2.5 * RADIANS * _draw_sines(time_s, (0.3, 2), 10, stream)
    pitch = 2 * RADIANS * _draw_sines(time_s, (0.3, 2.5), 10, stream)
    yaw = bend + 0.6 * RADIANS * _draw_sines(time_s, (0.5, 3), 6, stream)
    along = _draw_sines(time_s, (0.03, 0.3), 8, stream) + 0.12 * _draw_sines(time_s, (3, 14), 25, stream)
    across = _draw_sines(time_s, (0.03, 0.25), 8, stream) + 0.12 * _draw_sines(time_s, (3, 14), 25, stream)
    bumps = 0.25 * _draw_sines(time_s, (0.8, 2), 8, stream) + 0.25 * _draw_sines(time_s, (5, 14), 30, stream)
    return motion_of(
        Course(
            duration_s=driven_s + 8,
            level_box=level_box,
            rate_box=np.stack([roll, pitch, yaw], 1) * strength,
            acceleration_level=room.vibration_level + np.stack([along, across, bumps], 1) * strength,
            temperature_c=room.temperature_c,
            phases=(Phase(0.2, 7.5, "static", "+Z"), Phase(8.0, driven_s + 8.0, "motion", "")),
        )
    )


def spin(
    stream: np.random.Generator, up: str, rates_dps: Sequence[float] = (60, -60, 150, -150), plateau_s: float = 5.0
) -> Motion:
    """Return a box on a rate table about a vertical axis, with the table's track as reference; the middle of the box
    is not quite on the axis.
    """
    duration_s = 6 + len(rates_dps) * (plateau_s + 3) + 1
    time_s = grid(duration_s)
    level_box = draw_attitude(up, stream, 0.05)
    room = _draw_room(time_s, stream)
    axis_box = np.array(DIRECTIONS[up], float) + stream.normal(0, 0.0015, 3)
    rate = np.zeros((len(time_s), 3))
    for index, rate_dps in enumerate(rates_dps):
        start_s = 6 + index * (plateau_s + 3)
        rate += np.outer(ramp(time_s, start_s, start_s + plateau_s + 2, 1.0) * rate_dps * RADIANS, axis_box)
    phases = (Phase(0.2, 5.5, "static", up), Phase(6.0, duration_s - 0.2, "motion", ""))
    motion = motion_of(Course(duration_s, level_box, rate, room.vibration_level, room.temperature_c, phases, True))
    offset_m = stream.normal(0, OFFSET_MM / 1000, 3)
    offset_force = lever_arm_force(motion.rate_box, motion.angular_acceleration_box, offset_m)
    return replace(motion, force_box=motion.force_box + offset_force)


def heating(stream: np.random.Generator, up: str = "+Z", heat: Heat = HAIR_DRYER) -> Motion:
    """Return a box that a hair dryer heats, and that cools again."""
    start_s, end_s = heat.room_s, heat.room_s + heat.heat_s
    duration_s = end_s + heat.cool_s
    time_s = grid(duration_s)
    level_box = draw_attitude(up, stream)
    room = _draw_room(time_s, stream, 0.1)
    air_k = np.where((time_s > start_s) & (time_s < end_s), heat.rise_k * 1.5, 0.0) * (1 + 0.08 * np.sin(time_s / 4.7))
    dryer_s, box_s = HEATER_TIME_CONSTANTS_S
    rise_k = lag(lag(air_k, STEP_S, dryer_s), STEP_S, box_s)
    phases = (
        Phase(0.2, start_s, "room", up),
        Phase(start_s, end_s, "heat", up),
        Phase(end_s, duration_s - 0.2, "cool", up),
    )
    still = np.zeros_like(room.vibration_level)
    return motion_of(
        Course(duration_s, level_box, still, room.vibration_level, room.temperature_c + rise_k, phases),
    )


def ramp(time_s: Array, start_s: float, end_s: float, edge_s: float) -> Array:
    """Return 1 between two times, 0 outside, with edges that are squares of sines."""
    rise = np.clip((time_s - start_s) / edge_s, 0, 1) * np.clip((end_s - time_s) / edge_s, 0, 1)
    return np.asarray(np.sin(np.pi / 2 * np.clip(rise, 0, 1)) ** 2)


def _draw_room(time_s: Array, stream: np.random.Generator, swing_k: float = 0.25) -> Room:
    """A room near 22 degC that swings and drifts, on a floor with four faint lines that every sensor feels."""
    temperature_c = 22.0 + stream.uniform(-2, 3) + np.zeros_like(time_s)
    temperature_c += swing_k * np.sin(2 * np.pi * time_s / stream.uniform(300, 900) + stream.uniform(0, 6))
    temperature_c += stream.normal(0, 0.1) * time_s / 300
    vibration = np.zeros((len(time_s), 3))
    for frequency_hz in stream.uniform(8, 35, 4):
        line = np.sin(2 * np.pi * frequency_hz * time_s + stream.uniform(0, 6))
        vibration += np.outer(line, stream.normal(0, 3e-4, 3))
    return Room(temperature_c, vibration)


def _draw_hand(share: Array, turn_s: float, stream: np.random.Generator) -> Array:
    """The acceleration (n, 3) m/s² of a hand that turns the box; `share` (n,) is how much of the turn is done."""
    strength = np.sin(np.pi * share) ** 2
    acceleration = np.zeros((len(share), 3))
    for frequency_hz in stream.uniform(0.5, 2.5, 3):
        shake = strength * np.sin(2 * np.pi * frequency_hz * share * turn_s + stream.uniform(0, 6))
        acceleration += np.outer(shake, stream.normal(0, 0.4, 3))
    return acceleration


def _draw_sines(time_s: Array, span_hz: tuple[float, float], count: int, stream: np.random.Generator) -> Array:
    """A sum (n,) of `count` sines with frequencies within the span, whose root mean square is about 1."""
    total = np.zeros_like(time_s)
    for frequency_hz in stream.uniform(*span_hz, count):
        total += stream.normal() * np.sin(2 * np.pi * frequency_hz * time_s + stream.uniform(0, 6))
    return np.asarray(total / np.sqrt(count / 2))
