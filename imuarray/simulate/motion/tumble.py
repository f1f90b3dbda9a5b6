"""The tumbling cube (paper, section 4): every face is up once, with smooth turns in between."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import FIELD_LEVEL, GRAVITY_LEVEL, UPRIGHT, resting, shortest_turn, tilted, turned
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.motion.timeline import finite, nanoseconds, positive

ORDER = (
    ("z_up", "+Z"),
    ("x_up", "+X"),
    ("y_up", "+Y"),
    ("x_down", "-X"),
    ("y_down", "-Y"),
    ("z_down", "-Z"),
    ("z_up_check", "+Z"),
)
"""Phases and the box axis that is up in them, in the order of the paper's Table 10."""

LAST = len(ORDER) - 1


class _TurningVector(NamedTuple):
    """A vector that is fixed in the level frame, expressed in the box frame of each face (7, 3); its component
    perpendicular to the axis of the turn that follows; and the vector product of that axis and the vector.
    """

    start: Reals
    across: Reals
    aside: Reals


@dataclass(frozen=True)
class Tumble:
    """Each face is up for `face_s`. Between them the box turns about its origin for `turn_s`, by the shortest rotation;
    its rate follows 1 - cos.

    Phases cover only the still parts. `temperatures_degc` and `tilts_deg` (see `Still`), if given, have one entry for
    each of the seven; the temperature changes during the turn. ValueError for invalid values.
    """

    face_s: float = 900.0
    turn_s: float = 5.0
    temperatures_degc: tuple[float, ...] = (25.0,) * len(ORDER)
    tilts_deg: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * len(ORDER)

    def __post_init__(self) -> None:
        positive(face_s=self.face_s, turn_s=self.turn_s)
        for name, values in (("temperatures_degc", self.temperatures_degc), ("tilts_deg", self.tilts_deg)):
            if len(values) != len(ORDER):
                raise ValueError(f"{name}: {len(values)} given; one for each of {', '.join(name for name, _ in ORDER)}")
        faces = zip(ORDER, self.temperatures_degc, strict=True)
        finite(**{f"temperatures_degc, {name}": value for (name, _), value in faces})
        _ = self.attitudes  # raises ValueError for invalid tilts

    @property
    def seconds(self) -> float:
        """The duration: seven faces, six turns."""
        return len(ORDER) * self.face_s + LAST * self.turn_s

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The seven parts at rest."""
        starts = [index * self._period_ns for index in range(len(ORDER))]
        return tuple(Phase(at, at + self._face_ns, name, up) for at, (name, up) in zip(starts, ORDER, strict=True))

    @cached_property
    def attitudes(self) -> Reals:
        """The attitudes (7, 3, 3) from the box to the level frame, one for each face."""
        square: list[Reals] = [UPRIGHT]
        for before, after in pairwise(up for _, up in ORDER):
            square.append(turned(square[-1], shortest_turn(before, after)))
        return np.array([tilted(attitude, tilt) for attitude, tilt in zip(square, self.tilts_deg, strict=True)])

    @cached_property
    def turns(self) -> Reals:
        """Return (7, 3) rotation vectors in the box frame from each face to the next; zeros after the last."""
        from scipy.spatial.transform import Rotation  # imported late because SciPy takes long to load

        pairs = [before.T @ after for before, after in pairwise(self.attitudes)]
        return np.concatenate([Rotation.from_matrix(pairs).as_rotvec(), np.zeros((1, 3))])

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus, on a face or during a turn to the next."""
        face = self._only_face(time_ns)
        if face is not None:
            return resting(time_ns, self.attitudes[face], self.temperatures_degc[face])
        index, share = self._progress(time_ns)
        turned = share - np.sin(2 * math.pi * share) / (2 * math.pi)
        speed = (1 - np.cos(2 * math.pi * share)) / self._turn_s
        gain = 2 * math.pi * np.sin(2 * math.pi * share) / self._turn_s**2
        turns = self.turns[index]
        angle = self._angles[index] * turned
        sine, less = np.sin(angle)[:, None], (np.cos(angle) - 1)[:, None]
        degc = np.array(self.temperatures_degc)
        return replace(
            resting(time_ns, UPRIGHT, degc[index] + turned * np.append(np.diff(degc), 0.0)[index]),
            force_box=_turn_vector(self._gravity, index, sine, less),
            rate_box=turns * speed[:, None],
            angular_acceleration_box=turns * gain[:, None],
            field_box=_turn_vector(self._field, index, sine, less),
        )

    @cached_property
    def _face_ns(self) -> int:
        return nanoseconds(self.face_s)

    @cached_property
    def _period_ns(self) -> int:
        return self._face_ns + nanoseconds(self.turn_s)

    @property
    def _turn_s(self) -> float:
        return (self._period_ns - self._face_ns) * 1e-9

    def _progress(self, time_ns: Integers) -> tuple[Integers, Reals]:
        """Return (n,) the number of the face that is or was last up, and (n,) the share of the turn away from it."""
        since_ns = np.clip(time_ns, 0, LAST * self._period_ns)
        index = since_ns // self._period_ns
        turning_ns = since_ns - index * self._period_ns - self._face_ns
        return index, np.maximum(turning_ns, 0) / (self._period_ns - self._face_ns)

    def _only_face(self, time_ns: Integers) -> int | None:
        """Return the face that is up at all these times; None if they are not all on one face."""
        if len(time_ns) == 0:
            return 0
        index, share = self._progress(np.array([time_ns.min(), time_ns.max()]))
        return int(index[0]) if index[0] == index[1] and not share.any() else None

    @cached_property
    def _angles(self) -> Reals:
        return np.asarray(np.linalg.norm(self.turns, axis=1))

    @cached_property
    def _gravity(self) -> _TurningVector:
        return self._as_turned(GRAVITY_LEVEL)

    @cached_property
    def _field(self) -> _TurningVector:
        return self._as_turned(FIELD_LEVEL)

    def _as_turned(self, vector_level: Reals) -> _TurningVector:
        axes = self.turns / np.where(self._angles == 0, 1.0, self._angles)[:, None]
        start = vector_level @ self.attitudes
        along = axes * np.sum(axes * start, axis=1)[:, None]
        return _TurningVector(start, start - along, np.cross(axes, start))


def _turn_vector(vector: _TurningVector, index: Integers, sine: Reals, less: Reals) -> Reals:
    """Return the vector (n, 3) in a box turned by an angle, given its sine and cosine - 1, both (n, 1) (Rodrigues)."""
    vector_box: Reals = vector.start[index] + less * vector.across[index] - sine * vector.aside[index]
    return vector_box
