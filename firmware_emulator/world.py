"""Stimulus of the box as a function of time.

A world is a callable ``at_ns -> WorldStimulus`` plus the phases that a person with a stopwatch would note. Any callable
of this form is a world, so a simulated or a recorded motion can also drive the emulated array. Vectors are in the box
frame: specific force in m/s2 (+g along +Z for a box at rest on its -Z face), angular rate in rad/s, magnetic flux
density in gauss.

The worlds of this module begin at 0 ns and keep their last state without end.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple, Protocol

from firmware_emulator.chip import Triple

UP: dict[str, Triple] = {
    "+X": (1.0, 0.0, 0.0),
    "-X": (-1.0, 0.0, 0.0),
    "+Y": (0.0, 1.0, 0.0),
    "-Y": (0.0, -1.0, 0.0),
    "+Z": (0.0, 0.0, 1.0),
    "-Z": (0.0, 0.0, -1.0),
}
"""The upward direction in the frame of a box of which this axis points up."""


def cross(a: Triple, b: Triple) -> Triple:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def scaled(vector: Triple, factor: float) -> Triple:
    """Return `factor` times `vector`."""
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def seen_after_turn(vector: Triple, axis: Triple, cosine: float, sine: float) -> Triple:
    """Return an earth-fixed vector in the frame of a box turned about its unit `axis` by an angle (Rodrigues)."""
    projection = (axis[0] * vector[0] + axis[1] * vector[1] + axis[2] * vector[2]) * (1.0 - cosine)
    aside = cross(vector, axis)
    x, y, z = (vector[i] * cosine + aside[i] * sine + axis[i] * projection for i in range(3))
    return x, y, z


def turn_between(up_before: str, up_after: str) -> tuple[Triple, float]:
    """Return axis (box) and angle (rad) of the shortest turn that brings `up_after` up; half a turn is about X or Y."""
    start, end = UP[up_before], UP[up_after]
    axis = cross(end, start)
    if any(axis):
        return axis, math.pi / 2
    return UP["+Y" if up_before[1] == "X" else "+X"], 0.0 if start == end else math.pi


STANDARD_GRAVITY = 9.80665
"""m/s2; conventional value of the 3rd CGPM (1901)."""
FOREVER_NS = 1 << 62
ROOM_DEGC = 25.0
FIELD_UPRIGHT: Triple = (0.2, 0.0, -0.43)
"""The earth's field in gauss, in the frame of a box that stands on its -Z face."""


class WorldStimulus(NamedTuple):
    """The stimulus of the box at one instant."""

    force_box: Triple = (0.0, 0.0, STANDARD_GRAVITY)
    rate_box: Triple = (0.0, 0.0, 0.0)
    temperature_degc: float = ROOM_DEGC
    pressure_pa: float = 101325.0
    field_box: Triple = FIELD_UPRIGHT


class WorldPhase(NamedTuple):
    """A stretch of time that the experimenter notes by name; `up` is the box axis that points up ("+Z"), or ""."""

    start_ns: int
    end_ns: int
    name: str
    up: str = ""


UPRIGHT = WorldStimulus()
"""Stimulus at rest on the -Z face."""

World = Callable[[int], WorldStimulus]


class PhasedWorld(Protocol):
    """A world that knows its own phases."""

    @property
    def phases(self) -> tuple[WorldPhase, ...]:
        """Return the phases in order of time, without overlap."""

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the stimulus of the box at `at_ns`."""


def positive(**durations: float) -> None:
    """Raise ValueError that names the first of the arguments that is not above zero."""
    for name, value in durations.items():
        if not value > 0:
            raise ValueError(f"{name}: {value}; allowed is anything above 0")


def resting(up: str, field_box: Triple, temperature_degc: float = ROOM_DEGC) -> WorldStimulus:
    """Return the stimulus of a box at rest with this axis up."""
    return WorldStimulus(scaled(UP[up], STANDARD_GRAVITY), temperature_degc=temperature_degc, field_box=field_box)


@dataclass(frozen=True)
class StillWorld:
    """A box at rest with the axis `up` upwards, at one temperature."""

    up: str = "+Z"
    temperature_degc: float = ROOM_DEGC

    def __post_init__(self) -> None:
        if self.up not in UP:
            raise ValueError(f"up: {self.up!r}; allowed are {', '.join(UP)}")

    @property
    def phases(self) -> tuple[WorldPhase, ...]:
        """Return one phase without end."""
        return (WorldPhase(0, FOREVER_NS, "static", self.up),)

    @cached_property
    def stimulus(self) -> WorldStimulus:
        """Return the constant stimulus."""
        axis, angle = turn_between("+Z", self.up)
        field = seen_after_turn(FIELD_UPRIGHT, axis, round(math.cos(angle)), round(math.sin(angle)))
        return resting(self.up, field, self.temperature_degc)

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the same stimulus at any time."""
        return self.stimulus


@dataclass(frozen=True)
class TumbleWorld:
    """Each face is up for `face_s` in the paper's order (section 4), with smooth turns of `turn_s` between them.

    The rate of a turn rises and falls as 1 - cos. The phases cover only the parts at rest. A turn causes no additional
    force, because the box turns about its own origin.
    """

    face_s: float = 60.0
    turn_s: float = 2.0

    ORDER = (
        ("z_up", "+Z"),
        ("x_up", "+X"),
        ("y_up", "+Y"),
        ("x_down", "-X"),
        ("y_down", "-Y"),
        ("z_down", "-Z"),
        ("z_up_check", "+Z"),
    )

    def __post_init__(self) -> None:
        positive(face_s=self.face_s, turn_s=self.turn_s)

    @cached_property
    def face_ns(self) -> int:
        """Return the length of a part at rest."""
        return round(self.face_s * 1e9)

    @cached_property
    def turn_ns(self) -> int:
        """Return the length of a turn."""
        return round(self.turn_s * 1e9)

    @cached_property
    def phases(self) -> tuple[WorldPhase, ...]:
        """Return the seven parts at rest."""
        starts = [index * (self.face_ns + self.turn_ns) for index in range(len(self.ORDER))]
        stops = [start + self.face_ns for start in starts]
        return tuple(WorldPhase(a, b, *face) for a, b, face in zip(starts, stops, self.ORDER, strict=True))

    @cached_property
    def turns(self) -> tuple[tuple[Triple, float], ...]:
        """Return axis and angle between each face and the next."""
        ups = [up for _, up in self.ORDER]
        return tuple(turn_between(before, after) for before, after in pairwise(ups))

    @cached_property
    def faces(self) -> tuple[WorldStimulus, ...]:
        """Return the stimulus of the box on each face."""
        fields = [FIELD_UPRIGHT]
        for axis, angle in self.turns:
            fields.append(seen_after_turn(fields[-1], axis, round(math.cos(angle)), round(math.sin(angle))))
        return tuple(resting(up, field) for (_, up), field in zip(self.ORDER, fields, strict=True))

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the stimulus on a face, or during the turn to the next."""
        index, since_ns = divmod(max(at_ns, 0), self.face_ns + self.turn_ns)
        if index >= len(self.turns) or since_ns < self.face_ns:
            return self.faces[min(index, len(self.turns))]
        return self.turning(index, (since_ns - self.face_ns) / self.turn_ns)

    def turning(self, index: int, share: float) -> WorldStimulus:
        """Return the stimulus in the turn after face `index`, when `share` of its time has elapsed."""
        axis, angle = self.turns[index]
        phase = 2 * math.pi * share
        turned = angle * (share - math.sin(phase) / (2 * math.pi))
        rate = angle / (self.turn_ns * 1e-9) * (1 - math.cos(phase))
        stimulus, cosine, sine = self.faces[index], math.cos(turned), math.sin(turned)
        return WorldStimulus(
            seen_after_turn(stimulus.force_box, axis, cosine, sine),
            scaled(axis, rate),
            field_box=seen_after_turn(stimulus.field_box, axis, cosine, sine),
        )


class ProfileStretch(NamedTuple):
    """A part of a temperature profile: name of its phase, minutes, final temperature in degC, time constant in min."""

    name: str
    minutes: float
    towards_degc: float
    constant_min: float


def heating_to(degc: float, from_degc: float, minutes: float, constant_min: float) -> ProfileStretch:
    """Return a stretch of heating that ends at exactly `degc`."""
    remaining = math.exp(-minutes / constant_min)
    return ProfileStretch("heat", minutes, (degc - from_degc * remaining) / (1 - remaining), constant_min)


COOLING_MIN = 20.0
HEATING_MIN = 2.0
PROFILE_START_DEGC = 24.0
WARM_DEGC = 24.0 + (42.5 - 24.0) * math.exp(-5.0 / COOLING_MIN)
"""Temperature after five minutes of cooling from 42.5 degC."""
PROFILE = (
    ProfileStretch("room", 5.0, PROFILE_START_DEGC, COOLING_MIN),
    heating_to(42.5, PROFILE_START_DEGC, 5.0, HEATING_MIN),
    ProfileStretch("cool", 5.0, 24.0, COOLING_MIN),
    heating_to(52.0, WARM_DEGC, 5.0, HEATING_MIN),
    ProfileStretch("cool", 90.0, 25.0, COOLING_MIN),
)
"""Temperature profile with the times and peaks of the paper's section 5.2.5, which ends slightly warmer than it begins.
The time constants are our assumption.
"""


@dataclass(frozen=True)
class HeatingWorld:
    """A box on its -Z face that is warmed twice by a hairdryer and cools; `scale` below 1 shortens all times."""

    scale: float = 1.0

    def __post_init__(self) -> None:
        positive(scale=self.scale)

    @cached_property
    def starts_ns(self) -> tuple[int, ...]:
        """Return the start of each stretch, and the end of the last one."""
        minutes = [sum(stretch.minutes for stretch in PROFILE[:index]) for index in range(len(PROFILE) + 1)]
        return tuple(round(self.scale * passed * 60e9) for passed in minutes)

    @cached_property
    def starts_degc(self) -> tuple[float, ...]:
        """Return the temperature at the start of each stretch."""
        reached = [PROFILE_START_DEGC]
        for _, minutes, towards, constant in PROFILE:
            reached.append(towards + (reached[-1] - towards) * math.exp(-minutes / constant))
        return tuple(reached)

    @cached_property
    def phases(self) -> tuple[WorldPhase, ...]:
        """Return the phases room, heat, cool, heat, cool."""
        ends = zip(self.starts_ns, self.starts_ns[1:], PROFILE, strict=False)
        return tuple(WorldPhase(start, end, stretch.name, "+Z") for start, end, stretch in ends)

    @cached_property
    def constants_ns(self) -> tuple[float, ...]:
        """Return the time constant of each stretch."""
        return tuple(self.scale * stretch.constant_min * 60e9 for stretch in PROFILE)

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the stimulus at rest, at the temperature of that time."""
        index = min(max(bisect_right(self.starts_ns, at_ns) - 1, 0), len(PROFILE) - 1)
        towards = PROFILE[index].towards_degc
        passed_ns = max(at_ns - self.starts_ns[index], 0)
        distance = (self.starts_degc[index] - towards) * math.exp(-passed_ns / self.constants_ns[index])
        return WorldStimulus(UPRIGHT.force_box, UPRIGHT.rate_box, towards + distance)


@dataclass(frozen=True)
class Shaking:
    """A box upright, at rest for `still_s`, shaken for `motion_s`, at rest again for `still_s`.

    Force along each axis and rate about it are each a sum of two sines of incommensurate frequencies (hertz), bounded
    by `peak_g` on top of gravity and by `peak_dps`, under an envelope that rises and falls as 1 - cos within `RAMP_S`.
    Force and rate are independent: the attitude is not simulated, and gravity stays along +Z.
    """

    peak_g: float = 8.0
    peak_dps: float = 500.0
    still_s: float = 10.0
    motion_s: float = 30.0

    RAMP_S = 1.0
    SHARES = (0.6, 0.4)
    FORCE_HZ = ((1.31, 4.17), (1.73, 5.39), (2.29, 6.71))
    RATE_HZ = ((0.91, 3.13), (1.13, 3.71), (1.51, 4.33))

    def __post_init__(self) -> None:
        positive(peak_g=self.peak_g, peak_dps=self.peak_dps, still_s=self.still_s, motion_s=self.motion_s)

    @cached_property
    def edges_ns(self) -> tuple[int, int, int, int]:
        """Return beginning, beginning of the motion, end of the motion, and end, in ns."""
        still_ns, motion_ns = round(self.still_s * 1e9), round(self.motion_s * 1e9)
        return 0, still_ns, still_ns + motion_ns, 2 * still_ns + motion_ns

    @property
    def phases(self) -> tuple[WorldPhase, ...]:
        """Return the phases static, motion, static."""
        start, shaken, calm, end = self.edges_ns
        return (
            WorldPhase(start, shaken, "static", "+Z"),
            WorldPhase(shaken, calm, "motion"),
            WorldPhase(calm, end, "static", "+Z"),
        )

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the stimulus: at rest, or during the motion."""
        _, begin_ns, end_ns, _ = self.edges_ns
        if not begin_ns < at_ns < end_ns:
            return UPRIGHT
        moved_s, left_s = (at_ns - begin_ns) * 1e-9, (end_ns - at_ns) * 1e-9
        ramp_s = min(self.RAMP_S, self.motion_s / 2)
        envelope = 0.5 - 0.5 * math.cos(math.pi * min(moved_s, left_s, ramp_s) / ramp_s)
        force_x, force_y, force_z = self.swings(self.FORCE_HZ, moved_s, envelope * self.peak_g * STANDARD_GRAVITY)
        rate = self.swings(self.RATE_HZ, moved_s, envelope * math.radians(self.peak_dps))
        return WorldStimulus((force_x, force_y, force_z + STANDARD_GRAVITY), rate)

    def swings(self, frequencies_hz: tuple[tuple[float, float], ...], at_s: float, bound: float) -> Triple:
        """Return one sum of sines for each axis, none above `bound`."""
        first_bound, second_bound = bound * self.SHARES[0], bound * self.SHARES[1]
        angle = 2 * math.pi * at_s
        x, y, z = [
            first_bound * math.sin(angle * first) + second_bound * math.sin(angle * last)
            for first, last in frequencies_hz
        ]
        return x, y, z


@dataclass(frozen=True)
class DelayedWorld:
    """A world whose time 0 is `start_ns` of the clock."""

    world: World
    start_ns: int

    @property
    def phases(self) -> tuple[WorldPhase, ...]:
        """Return the world's own phases, by the clock."""
        phases: tuple[WorldPhase, ...] = getattr(self.world, "phases", ())
        return tuple(
            WorldPhase(start + self.start_ns, end + self.start_ns, name, up) for start, end, name, up in phases
        )

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the stimulus of the world at `at_ns` of the clock."""
        return self._latest(at_ns - self.start_ns)

    @property
    def constant(self) -> WorldStimulus | None:
        """Return the stimulus of a world in which it never changes; None for others."""
        return self.world.stimulus if isinstance(self.world, StillWorld) else None

    @cached_property
    def _latest(self) -> World:
        """Return a cached function for the world's stimulus, because all elements of a die request the same instant."""
        return self.world if isinstance(self.world, StillWorld) else lru_cache(maxsize=4)(self.world)


WorldKind = type[StillWorld] | type[TumbleWorld] | type[HeatingWorld] | type[Shaking]

WORLDS: dict[str, WorldKind] = {
    "still": StillWorld,
    "tumble": TumbleWorld,
    "heating": HeatingWorld,
    "shaking": Shaking,
}
"""Worlds by the name that a bus URL uses: ``emulated:?world=tumble&face_s=10``."""
