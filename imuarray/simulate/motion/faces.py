"""A box that stands on one of its faces, and its environment: gravity, air, and a magnetic field, which is the earth's
or is given in the box frame for each phase.

Frames: ``level`` has z up, ``box`` is the box; an attitude is the rotation R with ``vector_level = R @ vector_box``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.axes import up_vector
from imuarray.log.format import Phase
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.motion.timeline import consecutive, finite, nanoseconds, positive
from imuarray.units import STANDARD_GRAVITY

GRAVITY_LEVEL = np.array([0.0, 0.0, STANDARD_GRAVITY])
"""Specific force of a box at rest in the level frame, in m/s2. It points up, because the table supports the box."""

FIELD_LEVEL = np.array([0.2, 0.0, -0.43])
"""Magnetic field in gauss, x to magnetic north, with the inclination of central Europe."""

AIR_PRESSURE_PA = 101325.0
"""Air pressure at height 0; ISO 2533, the standard atmosphere."""

ROOM_DEGC = 25.0
"""Temperature of a motion that states none."""

PA_PER_M = 1.225 * STANDARD_GRAVITY
"""Decrease of pressure per metre of height; density of air at sea level, ISO 2533."""

UPRIGHT = np.eye(3)
"""The attitude of a box on its -Z face."""


class PhaseField(NamedTuple):
    """A magnetic field `field_box` in gauss that holds from `start_ns` until the next one begins."""

    start_ns: int
    field_box: tuple[float, float, float]


def field_at(fields: Sequence[PhaseField], time_ns: Integers) -> Reals:
    """Return the field (n, 3) in gauss at times (n,), as one broadcast row (read-only) if it is constant. `fields` has
    at least one; before the first of them, the first holds.
    """
    starts_ns = np.array([field.start_ns for field in fields])
    number = np.clip(np.searchsorted(starts_ns, time_ns, side="right") - 1, 0, None)
    box = np.array([field.field_box for field in fields])
    if len(number) == 0 or (number == number[0]).all():
        return np.broadcast_to(box[number[0] if len(number) else 0], (len(number), 3))
    return np.asarray(box[number])


def shortest_turn(up_before: str, up_after: str) -> Reals:
    """Return (3,) rotation vector (rad, box frame) of the shortest turn that brings `up_after` up; half a turn is about
    X, or about Y if X is upright. ValueError unless both are box axes ("+X").
    """
    before, after = np.array(up_vector(up_before)), np.array(up_vector(up_after))
    axis = np.cross(after, before)
    if axis.any():
        return axis * (math.pi / 2)
    aside = up_vector("+Y" if up_before[1] == "X" else "+X")
    return np.array(aside) * (0.0 if up_before == up_after else math.pi)


def turned(attitude: Reals, turn: Reals) -> Reals:
    """Return the attitude (3, 3) after quarter turns (rotation vector in the box frame), without rounding errors."""
    if not np.any(turn):
        return attitude + 0.0
    from scipy.spatial.transform import Rotation  # imported late because SciPy takes long to load

    quarters: Reals = attitude @ np.rint(Rotation.from_rotvec(turn).as_matrix()) + 0.0
    return quarters


def tilted(attitude: Reals, tilt_deg: tuple[float, float]) -> Reals:
    """Return the attitude (3, 3) on a table that is tilted by these small angles about the level x and y axes."""
    if not np.isfinite(tilt_deg).all() or len(tilt_deg) != 2:
        raise ValueError(f"tilt_deg: {tilt_deg}; two angles are required, about the level x and y axes")
    if not np.any(tilt_deg):
        return attitude.copy()
    from scipy.spatial.transform import Rotation  # imported late because SciPy takes long to load

    leaning: Reals = Rotation.from_rotvec([*tilt_deg, 0.0], degrees=True).as_matrix() @ attitude
    return leaning


def standing_on(up: str, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> Reals:
    """Return the attitude (3, 3) of a box whose axis `up` ("+X") points up, after the shortest turn from upright."""
    return tilted(turned(UPRIGHT, shortest_turn("+Z", up)), tilt_deg)


def resting(time_ns: Integers, attitude: Reals, temperature_degc: float | Reals) -> BoxStimulus:
    """Return the stimulus of a box at rest in this attitude (3, 3); `temperature_degc` is a number or (n,)."""
    count = len(time_ns)
    zero = np.broadcast_to(np.zeros(3), (count, 3))
    return BoxStimulus(
        time_ns,
        np.broadcast_to(GRAVITY_LEVEL @ attitude, (count, 3)),
        zero,
        zero,
        np.broadcast_to(FIELD_LEVEL @ attitude, (count, 3)),
        np.broadcast_to(np.asarray(temperature_degc, float), (count,)),
        np.broadcast_to(AIR_PRESSURE_PA, (count,)),
    )


@dataclass(frozen=True)
class Still:
    """A box at rest for `seconds` with the box axis `up` upwards; one phase, `name`.

    The temperature begins at `temperature_degc` and changes by `drift_degc_per_h`. `tilt_deg` are small angles by which
    box and table are turned about the level x and y axes, because no table is exactly level and no box exactly square.
    ValueError for invalid values.
    """

    up: str = "+Z"
    seconds: float = 600.0
    temperature_degc: float = 25.0
    name: str = "static"
    drift_degc_per_h: float = 0.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        positive(seconds=self.seconds)
        finite(temperature_degc=self.temperature_degc, drift_degc_per_h=self.drift_degc_per_h)
        standing_on(self.up, self.tilt_deg)

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The phase: the whole log."""
        return consecutive((self.name, nanoseconds(self.seconds), self.up))

    @cached_property
    def attitude(self) -> Reals:
        """The attitude (3, 3) from the box to the level frame."""
        return standing_on(self.up, self.tilt_deg)

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the reaction to gravity."""
        if self.drift_degc_per_h == 0:
            return resting(time_ns, self.attitude, self.temperature_degc)
        hours = np.clip(time_ns, 0, nanoseconds(self.seconds)) / 3.6e12
        return resting(time_ns, self.attitude, self.temperature_degc + self.drift_degc_per_h * hours)


def turn_on_run(k: int = 1, seconds: float = 300.0, temperature_degc: float = 25.0) -> Still:
    """Run `k` (1, 2, ...) of a turn-on series: the box stands still, five minutes as in the paper's section 4."""
    if k < 1:
        raise ValueError(f"k: {k}; runs are counted 1, 2, ...")
    return Still("+Z", seconds, temperature_degc, f"run {k}")
