"""A bench session from another program: poses, temperature, motions, the room, the recorder, labels.

::

    log = session({"name": "tumble", "seconds": 60.0, "poses": [{"up": [0, 0, 1], "hold_s": 20.0}, ...]}, Room(), seed)

Everything is a function of time alone; the tables are those of a file in JSON (`firmware_emulator.cases`).
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import accumulate
from typing import Any, Self

from firmware_emulator.chip import Triple
from firmware_emulator.element import stream
from firmware_emulator.mechanisms.experiments import BenchExperiment
from firmware_emulator.world import (
    FIELD_UPRIGHT,
    ROOM_DEGC,
    STANDARD_GRAVITY,
    WorldPhase,
    WorldStimulus,
    cross,
    scaled,
    seen_after_turn,
)

UPWARDS: Triple = (0.0, 0.0, 1.0)
RAMP_S = 1.0
"""Duration in s of the beginning and of the end of a motion."""
DRAUGHT_PERIODS_S = (23.0, 61.0, 173.0, 431.0)
"""Periods of the temperature swings of a draught; each swing has its own phase."""


def of_table(kind: Callable[..., Any], table: Mapping[str, Any]) -> Any:
    """Return an object of class `kind` with a table's entries, lists as tuples; ValueError for an unknown entry."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := sorted(set(table) - names):
        raise ValueError(f"{unknown[0]}: no entry of a {_words_of(kind)}; allowed are {', '.join(sorted(names))}")
    try:
        return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in table.items()})
    except TypeError as error:
        raise ValueError(f"{_words_of(kind)}: {error}") from None


def _words_of(kind: Callable[..., Any]) -> str:
    """Return the name of a class in lower-case words."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", kind.__name__).lower()


@dataclass(frozen=True)
class RestPose:
    """The box at rest for `hold_s`; `up` is the upward unit vector in the box frame."""

    up: Triple
    hold_s: float


@dataclass(frozen=True)
class TemperatureStretch:
    """A stretch of `seconds` in which the temperature approaches `towards_degc` with a time constant."""

    seconds: float
    towards_degc: float
    constant_s: float


@dataclass(frozen=True)
class Rocking:
    """A motion: from `start_s` to `end_s` the box is rocked by `angle_rad` about `axis`, and shaken along it by
    `peak_g`, at `rock_hz` and `shake_hz`, within an envelope that rises and falls as 1 - cos within `RAMP_S`. The
    direction of gravity in the box follows the rotation.
    """

    start_s: float
    end_s: float
    axis: Triple
    angle_rad: float
    rock_hz: float
    peak_g: float
    shake_hz: float

    def stimulus(self, at_s: float, still: WorldStimulus) -> WorldStimulus:
        """Return the stimulus of a box whose stimulus at rest would be `still`."""
        if not self.start_s < at_s < self.end_s:
            return still
        passed_s, left_s = at_s - self.start_s, self.end_s - at_s
        ramp_s = min(RAMP_S, (self.end_s - self.start_s) / 2)
        near_s, sign = (passed_s, 1.0) if passed_s <= left_s else (left_s, -1.0)
        phase, slope = math.pi * min(near_s, ramp_s) / ramp_s, 0.0
        if near_s < ramp_s:
            slope = sign * 0.5 * math.pi / ramp_s * math.sin(phase)
        envelope, turn = 0.5 - 0.5 * math.cos(phase), 2 * math.pi * self.rock_hz
        sine, cosine = math.sin(turn * passed_s), math.cos(turn * passed_s)
        angle = self.angle_rad * envelope * sine
        rate = self.angle_rad * (slope * sine + envelope * turn * cosine)
        c, s = math.cos(angle), math.sin(angle)
        x, y, z = seen_after_turn(still.force_box, self.axis, c, s)
        pushed = envelope * self.peak_g * STANDARD_GRAVITY * math.sin(2 * math.pi * self.shake_hz * passed_s)
        return still._replace(
            force_box=(x + pushed * self.axis[0], y + pushed * self.axis[1], z + pushed * self.axis[2]),
            rate_box=scaled(self.axis, rate),
            field_box=seen_after_turn(still.field_box, self.axis, c, s),
        )


@dataclass(frozen=True)
class TableVibration:
    """The vibration of a table by a fridge or a fan: a line at `hz` with `peak_g` along and `peak_dps` about each axis,
    multiplied by `direction`. It runs for `share` of every `cycle_s`.
    """

    hz: float
    direction: Triple
    peak_g: float
    peak_dps: float
    cycle_s: float = 0.0
    share: float = 1.0

    def is_on(self, at_s: float) -> bool:
        """Return whether the vibration is on."""
        return not self.cycle_s or at_s % self.cycle_s < self.share * self.cycle_s


@dataclass(frozen=True)
class Room:
    """A room: temperature at the start, its drift, swings of `draught_degc` rms, and vibrations of the table."""

    degc: float = ROOM_DEGC
    drift_degc_per_s: float = 0.0
    draught_degc: float = 0.0
    vibrations: tuple[TableVibration, ...] = ()
    """At most four."""

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> Self:
        """Return the room of a table; ValueError for an unknown key."""
        vibrations = [of_table(TableVibration, entry) for entry in table.get("vibrations", ())]
        return cls(**{**table, "vibrations": tuple(vibrations)})


@dataclass(frozen=True)
class Recorder:
    """A recording program. A share of its transactions waits, exponentially distributed with mean `mean_ms`;
    `stalls_per_min` times per minute it reads nothing for `stall_s`. The flags state whether it reads the chips'
    thermometers, and whether it stores the commanded motion (`reference`).
    """

    rate_hz: float
    share: float = 0.0
    mean_ms: float = 0.0
    stalls_per_min: float = 0.0
    stall_s: float = 0.0
    thermometers: bool = True
    reference: bool = True

    def waits_ns(self, seed: int, run: int, transactions_per_s: float) -> Callable[[], int]:
        """Return a function that draws the wait before each transaction."""
        random = stream(seed, f"recorder, run {run}")
        stall = self.stalls_per_min / 60.0 / transactions_per_s

        def wait_ns() -> int:
            draw = random.random()
            if draw < stall:
                return round(self.stall_s * 1e9)
            return round(random.exponential(self.mean_ms * 1e6)) if draw < stall + self.share else 0

        return wait_ns


@dataclass(frozen=True)
class Course:
    """A world in which the box turns from pose to pose, in `turn_s` each, is heated and moved, in a room whose random
    phases follow from the seed.
    """

    poses: tuple[RestPose, ...]
    turn_s: float
    stretches: tuple[TemperatureStretch, ...]
    motions: tuple[Rocking, ...]
    room: Room
    seed: int
    phases: tuple[WorldPhase, ...] = ()

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the stimulus of the box at `at_ns`."""
        at_s = max(at_ns, 0) * 1e-9
        return self.shaken(at_s, self.commanded(at_ns))

    def commanded(self, at_ns: int) -> WorldStimulus:
        """Return the commanded motion and the temperature of the bench, without the vibration of the table: what a
        reference instrument measures.
        """
        at_s = max(at_ns, 0) * 1e-9
        stimulus = self.posed(at_s)._replace(temperature_degc=self.temperature_degc(at_s))
        for motion in self.motions:
            stimulus = motion.stimulus(at_s, stimulus)
        return stimulus

    def posed(self, at_s: float) -> WorldStimulus:
        """Return the stimulus at rest in a pose, or during the turn to the next; forces of the turn are omitted."""
        index = min(bisect_right(self._starts_s, at_s) - 1, len(self.poses) - 1)
        since_s = at_s - self._starts_s[index]
        if since_s <= self.poses[index].hold_s or index == len(self.poses) - 1:
            return self._still[index]
        share = (since_s - self.poses[index].hold_s) / self.turn_s
        axis, angle = self._turns[index]
        phase, still = 2 * math.pi * share, self._still[index]
        turned = angle * (share - math.sin(phase) / (2 * math.pi))
        cosine, sine = math.cos(turned), math.sin(turned)
        return still._replace(
            force_box=seen_after_turn(still.force_box, axis, cosine, sine),
            rate_box=scaled(axis, angle / self.turn_s * (1 - math.cos(phase))),
            field_box=seen_after_turn(still.field_box, axis, cosine, sine),
        )

    def temperature_degc(self, at_s: float) -> float:
        """Return the temperature of the box: the heating plus the variation of the room."""
        room = self.room
        degc = room.drift_degc_per_s * at_s
        if room.draught_degc:
            swings = (
                math.sin(2 * math.pi * at_s / p + f) for p, f in zip(DRAUGHT_PERIODS_S, self._phases, strict=True)
            )
            degc += room.draught_degc * math.sqrt(2 / len(DRAUGHT_PERIODS_S)) * sum(swings)
        if not self.stretches:
            return degc + room.degc
        index = min(bisect_right(self._begin_s, at_s) - 1, len(self.stretches) - 1)
        stretch = self.stretches[index]
        remaining = math.exp(-(at_s - self._begin_s[index]) / stretch.constant_s)
        return degc + stretch.towards_degc + (self._begin_degc[index] - stretch.towards_degc) * remaining

    def shaken(self, at_s: float, stimulus: WorldStimulus) -> WorldStimulus:
        """Add the vibration of the table."""
        for vibration, phase in zip(self.room.vibrations, self._phases, strict=False):
            if vibration.is_on(at_s):
                wave = math.sin(2 * math.pi * vibration.hz * at_s + phase)
                (x, y, z), (a, b, c), (dx, dy, dz) = stimulus.force_box, stimulus.rate_box, vibration.direction
                push, rock = vibration.peak_g * STANDARD_GRAVITY * wave, math.radians(vibration.peak_dps) * wave
                stimulus = stimulus._replace(
                    force_box=(x + push * dx, y + push * dy, z + push * dz),
                    rate_box=(a + rock * dy, b + rock * dz, c + rock * dx),
                )
        return stimulus

    @cached_property
    def _starts_s(self) -> list[float]:
        return list(accumulate((pose.hold_s + self.turn_s for pose in self.poses[:-1]), initial=0.0))

    @cached_property
    def _turns(self) -> list[tuple[Triple, float]]:
        return [turn_to(before.up, after.up) for before, after in zip(self.poses, self.poses[1:], strict=False)]

    @cached_property
    def _still(self) -> list[WorldStimulus]:
        axis, angle = turn_to(UPWARDS, self.poses[0].up)
        field = seen_after_turn(FIELD_UPRIGHT, axis, math.cos(angle), math.sin(angle))
        stimuli = [WorldStimulus(scaled(self.poses[0].up, STANDARD_GRAVITY), field_box=field)]
        for (axis, angle), pose in zip(self._turns, self.poses[1:], strict=True):
            field = seen_after_turn(field, axis, math.cos(angle), math.sin(angle))
            stimuli.append(WorldStimulus(scaled(pose.up, STANDARD_GRAVITY), field_box=field))
        return stimuli

    @cached_property
    def _begin_s(self) -> list[float]:
        return list(accumulate((stretch.seconds for stretch in self.stretches[:-1]), initial=0.0))

    @cached_property
    def _begin_degc(self) -> list[float]:
        reached = [self.room.degc]
        for stretch in self.stretches[:-1]:
            reached.append(
                stretch.towards_degc
                + (reached[-1] - stretch.towards_degc) * math.exp(-stretch.seconds / stretch.constant_s)
            )
        return reached

    @cached_property
    def _phases(self) -> list[float]:
        phases: list[float] = stream(self.seed, "room").uniform(0, 2 * math.pi, len(DRAUGHT_PERIODS_S)).tolist()
        return phases


def session(table: Mapping[str, Any], room: Room, seed: int) -> BenchExperiment:
    """Return one log from its `name`, `seconds`, `poses`, `turn_s`, `stretches`, `motions` and `phases` (start_s,
    end_s, name, up), as a person notes them; `reference_hz` as in `BenchExperiment`.
    """
    phases = [
        WorldPhase(round(start_s * 1e9), round(end_s * 1e9), str(name), str(up))
        for start_s, end_s, name, up in table.get("phases", ())
    ]
    try:
        course = Course(
            tuple(of_table(RestPose, entry) for entry in table["poses"]),
            float(table.get("turn_s", 2.0)),
            tuple(of_table(TemperatureStretch, entry) for entry in table.get("stretches", ())),
            tuple(of_table(Rocking, entry) for entry in table.get("motions", ())),
            room,
            seed,
            tuple(phases),
        )
        return BenchExperiment(
            str(table["name"]), course, float(table["seconds"]), reference_hz=table.get("reference_hz", 0.0)
        )
    except KeyError as error:
        raise ValueError(f"session: {error} is missing") from None


def turn_to(start: Triple, end: Triple) -> tuple[Triple, float]:
    """Return unit axis and angle (rad) of the shortest turn from `start` to `end`; half a turn is about any
    perpendicular axis.
    """
    axis = cross(end, start)
    sine = math.sqrt(sum(part * part for part in axis))
    cosine = sum(a * b for a, b in zip(start, end, strict=True))
    if sine > 1e-9:
        return scaled(axis, 1 / sine), math.atan2(sine, cosine)
    if cosine > 0:
        return UPWARDS, 0.0
    x, y, z = start
    across = (0.0, z, -y) if abs(x) < 0.9 else (-z, 0.0, x)
    length = math.sqrt(sum(part * part for part in across))
    return scaled(across, 1 / length), math.pi


def sessions(table: Sequence[Mapping[str, Any]], room: Room, seed: int) -> tuple[BenchExperiment, ...]:
    """Return all logs of a case, in this order; the random phases of the room differ between them."""
    return tuple(session(entry, room, seed * 1000 + run) for run, entry in enumerate(table))
