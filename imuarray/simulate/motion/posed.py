"""A box that rests in one attitude after another, each known by its upward direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import FIELD_LEVEL, GRAVITY_LEVEL, PhaseField, field_at, resting
from imuarray.simulate.motion.stimulus import BoxStimulus, Motion, temperature_at, thermometer_lag_s

if TYPE_CHECKING:  # imported late: it reads logs, which other motions do not need
    from imuarray.simulate.motion.like import SplineColumns


class PoseAttitude(NamedTuple):
    """The attitude of the box in a phase: the upward direction in the box frame, of length 1; and whether it was
    `estimated` from the box's own accelerometers rather than noted by the experimenter.
    """

    phase: Phase
    up_box: tuple[float, float, float]
    estimated: bool


_EDGE_NS, _EDGE_TIMES = 100_000_000, 10
"""Time in ns at the start or end of a movement over which the force is averaged, and the number of instants in it."""

_TURN_STEP_NS = 20_000_000
"""Step in ns by which the attitude is integrated during a movement."""

_MOST_APART_NS = 100_000_000
"""Longest time in ns between a movement and the rest before or after it; the box is assumed not to turn within a tenth
of a second.
"""

_SAME_COSINE = float(np.cos(np.radians(10.0)))
"""Cosine of the largest angle between the two upward directions that are integrated from either end of a movement. If
they differ by more, the rates are clipped, or the box did not turn between these two attitudes.
"""

_LARGEST_STEP = 1.5
"""Largest step of the force, in m/s2, that is attributed to errors of the sensors; their tolerances are less."""


class Movement(NamedTuple):
    """A motion of the box from `start_ns` to `end_ns`: `columns` are the force (3) in m/s2 and the rate (3) in rad/s in
    the box frame.
    """

    start_ns: int
    end_ns: int
    columns: SplineColumns


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """The box rests in `attitudes` and moves by `movements` between them; both are in order of time. The force of a
    movement is shifted so that it begins and ends with that of the attitudes before and after it. Without a movement,
    the box jumps from one attitude to the next half-way between them, because the turn is not known. Temperature and
    pressure are those of `surroundings`, gravity is standard. The field is that of `fields`, if any are given,
    otherwise the earth's field after the shortest turn from upright, because the upward direction does not determine
    the heading. ValueError if there is no attitude, or for an invalid direction.
    """

    attitudes: tuple[PoseAttitude, ...]
    surroundings: Motion
    fields: tuple[PhaseField, ...] = ()
    movements: tuple[Movement, ...] = ()

    def __post_init__(self) -> None:
        if not self.attitudes:
            raise ValueError("attitudes: at least one is required")
        for phase, up, _ in self.attitudes:
            if not np.isclose(np.linalg.norm(up), 1.0):
                raise ValueError(f"phase {phase.name!r}: up_box {up}; a direction of length 1 is required")

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases, one for each attitude."""
        return tuple(attitude.phase for attitude in self.attitudes)

    @property
    def seconds(self) -> float:
        """The duration of the surroundings."""
        return self.surroundings.seconds

    @property
    def lead_s(self) -> float:
        """The time by which the temperature leads the thermometer that it comes from."""
        return thermometer_lag_s(self.surroundings)

    def is_estimated(self, phase: Phase) -> bool:
        """Return whether the attitude in the middle of a phase was estimated."""
        middle_ns = np.array([(phase.start_ns + phase.end_ns) // 2])
        return self.attitudes[int(np.searchsorted(self._turns_ns, middle_ns, side="right")[0])].estimated

    def up_in_movement(self, time_ns: int) -> tuple[float, float, float] | None:
        """Return the upward direction in the box frame at an instant in a movement, or at one of its ends. None outside
        of movements, if the attitude before or after the movement is not known, or if the rates lead to a different
        attitude.

        It is integrated from the rates, forwards from the attitude before and backwards from the attitude after; the
        weight of each result decreases linearly with the time from its attitude.
        """
        for start_ns, end_ns, _ in self.movements:
            if start_ns <= time_ns <= end_ns and start_ns in self._ups_in_movements:
                steps_ns, ups = self._ups_in_movements[start_ns]
                x, y, z = (float(np.interp(time_ns, steps_ns, ups[:, axis])) for axis in range(3))
                return (x, y, z)
        return None

    @cached_property
    def _ups_in_movements(self) -> dict[int, tuple[Integers, Reals]]:
        """Return instants (s,) and upward directions (s, 3) by the start of each movement between known attitudes."""
        ups: dict[int, tuple[Integers, Reals]] = {}
        up_of = {attitude.phase: attitude.up_box for attitude in self.attitudes}
        for movement in self.movements:
            start_ns, end_ns, columns = movement
            adjacent = neighbours(movement, self.phases)
            if adjacent is None:
                continue
            up_before, up_after = (up_of[rest] for rest in adjacent)
            steps_ns = np.linspace(start_ns, end_ns, max(-(-(end_ns - start_ns) // _TURN_STEP_NS), 1) + 1)
            rate = columns.at(((steps_ns[:-1] + steps_ns[1:]) / 2).astype(np.int64))[0][:, None, 3:]
            angles = rate * (steps_ns[1] - steps_ns[0]) * 1e-9
            forth = carry_up(np.array([up_before]), angles)[:, 0]
            back = carry_up(np.array([up_after]), -angles[::-1])[::-1, 0]
            if (forth * back).sum(axis=1).min() < _SAME_COSINE:
                continue
            share = np.linspace(0.0, 1.0, len(steps_ns))[:, None]
            mean = (1 - share) * forth + share * back
            ups[start_ns] = (steps_ns.astype(np.int64), mean / np.linalg.norm(mean, axis=1, keepdims=True))
        return ups

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus: the reaction to gravity in the attitude of that time, or a movement."""
        around = self.surroundings.stimulus(time_ns)
        number = np.searchsorted(self._turns_ns, time_ns, side="right")
        if len(number) and (number == number[0]).all():
            still = resting(time_ns, self._rotations[number[0]], around.temperature_degc)
        else:
            still = replace(
                resting(time_ns, np.eye(3), around.temperature_degc),
                force_box=(GRAVITY_LEVEL @ self._rotations)[number],
                field_box=(FIELD_LEVEL @ self._rotations)[number],
            )
        if self.fields:
            still = replace(still, field_box=field_at(self.fields, time_ns))
        return self._add_movements(replace(still, pressure_pa=around.pressure_pa), time_ns)

    def temperature_at(self, time_ns: Integers) -> Reals:
        """Return the temperature (n,) of the surroundings at times (n,)."""
        return temperature_at(self.surroundings, time_ns)

    def _add_movements(self, still: BoxStimulus, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus at rest with the movements added."""
        moved = [
            (movement, inside)
            for movement in self.movements
            if (inside := (movement.start_ns <= time_ns) & (time_ns < movement.end_ns)).any()
        ]
        if not moved:
            return still
        force, rate, acceleration = (
            np.array(values, float) for values in (still.force_box, still.rate_box, still.angular_acceleration_box)
        )
        for movement, inside in moved:
            values, slopes = movement.columns.at(time_ns[inside])
            force[inside] = values[:, :3] + self._shifts(movement, time_ns[inside])
            rate[inside], acceleration[inside] = values[:, 3:], slopes[:, 3:]
        return replace(still, force_box=force, rate_box=rate, angular_acceleration_box=acceleration)

    def _shifts(self, movement: Movement, time_ns: Integers) -> Reals:
        """Return (n, 3) the correction that is added to the force of a movement. The force is the mean of several
        sensors; without the correction, their scale factors and biases would cause steps between movement and rest.
        """
        share = (time_ns - movement.start_ns) / (movement.end_ns - movement.start_ns)
        begin, end = self._steps[movement.start_ns]
        return np.asarray(begin + share[:, None] * (end - begin))

    @cached_property
    def _steps(self) -> dict[int, tuple[Reals, Reals]]:
        """Return, by the beginning of each movement, the steps (3,) of the force from its beginning and end to the
        attitudes before and after it; 0 if there is no such attitude, or if the step is too large to be an error of the
        sensors because the box is already moving.
        """
        forces = GRAVITY_LEVEL @ self._rotations
        edge_ns = np.arange(0, _EDGE_NS, _EDGE_NS // _EDGE_TIMES, dtype=np.int64)
        steps = {}
        for start_ns, end_ns, columns in self.movements:
            before = [number for number, phase in enumerate(self.phases) if phase.end_ns <= start_ns][-1:]
            after = [number for number, phase in enumerate(self.phases) if phase.start_ns >= end_ns][:1]
            edges = []
            for numbers, time_ns in ((before, start_ns + edge_ns), (after, end_ns - 1 - edge_ns)):
                step = forces[numbers].sum(axis=0) - columns.at(time_ns)[0][:, :3].mean(axis=0)
                is_step = bool(numbers) and np.abs(step).max() < _LARGEST_STEP
                edges.append(step if is_step else np.zeros(3))
            steps[start_ns] = (edges[0], edges[1])
        return steps

    @cached_property
    def _turns_ns(self) -> Integers:
        """Return (k - 1,) the times at which the box jumps to the next attitude."""
        pairs = zip(self.phases[:-1], self.phases[1:], strict=True)
        return np.array([(before.end_ns + after.start_ns) // 2 for before, after in pairs], np.int64)

    @cached_property
    def _rotations(self) -> Reals:
        """Return (k, 3, 3) from the box to the level frame."""
        return upright_from([attitude.up_box for attitude in self.attitudes])


def neighbours(turn: Phase | Movement, rests: Sequence[Phase]) -> tuple[Phase, Phase] | None:
    """Return the rests immediately before and after a turn; None unless there are both."""
    before = [rest for rest in rests if 0 <= turn.start_ns - rest.end_ns <= _MOST_APART_NS]
    after = [rest for rest in rests if 0 <= rest.start_ns - turn.end_ns <= _MOST_APART_NS]
    return (before[-1], after[0]) if before and after else None


def carry_up(up_box: Reals, angles: Reals) -> Reals:
    """Return (s + 1, m, 3) the upward directions in the box frame, beginning with `up_box` (m, 3), while the box turns
    by `angles` (s, m, 3) in rad, one after the other: du/dt = u x w.
    """
    ups = [np.asarray(up_box, float)]
    for angle in angles:
        size = np.linalg.norm(angle, axis=1, keepdims=True)
        axis = angle / np.maximum(size, _LEAST_SINE)
        along = (ups[-1] * axis).sum(axis=1, keepdims=True) * axis
        ups.append(along + (ups[-1] - along) * np.cos(size) + np.cross(ups[-1], axis) * np.sin(size))
    return np.array(ups)


_LEAST_SINE = float(np.finfo(float).tiny)
"""Smallest sine that determines a direction; a smaller one is subnormal and has too few digits."""


def upright_from(up_box: Sequence[tuple[float, float, float]]) -> Reals:
    """Return (k, 3, 3) the attitudes in which these directions of the box are up, reached by the shortest turn from
    upright (half a turn is about X).
    """
    from scipy.spatial.transform import Rotation  # imported late because SciPy takes long to load

    ups = np.asarray(up_box, float)
    sines = np.hypot(ups[:, 0], ups[:, 1])
    axes = np.stack([ups[:, 1], -ups[:, 0], np.zeros(len(ups))], axis=1)
    sure = sines[:, None] > _LEAST_SINE
    units = np.divide(axes, sines[:, None], out=np.tile([1.0, 0.0, 0.0], (len(ups), 1)), where=sure)
    return np.asarray(Rotation.from_rotvec(units * np.arctan2(sines, ups[:, 2])[:, None]).as_matrix())
