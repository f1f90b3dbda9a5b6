"""A simplified drive in a car: start, a left and a right bend, braking, and vibrations from the road."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.simulate.motion.faces import UPRIGHT, resting
from imuarray.simulate.motion.kinematics import EulerAngles, rigid_body_stimulus
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.motion.timeline import (
    MotionBetweenRests,
    finite,
    positive,
    smooth_step,
    smooth_step_area,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

GOING_SHARE = 0.2
BRAKING_SHARE = 0.15
BENDS = ((0.15, 0.45, 1.0), (0.50, 0.88, -1.0))
"""Beginning and end of each bend as shares of the drive, and its direction: 1 is left. The vehicle still accelerates in
the first bend, and brakes in the second.
"""

BEND_RAMP = 0.3
"""Share of a bend during which its curvature increases; it decreases during an equal share at the end."""

LEAN_RAD_PER_MPS2 = math.radians(0.4)
"""Angles per acceleration by which the body rolls in a bend, pitches up when accelerating and down when braking."""

ROAD_HZ = np.geomspace(1.0, 15.0, 9)
"""Edges in Hz of the bands, each with one sine, from the motion of the sprung body to that of the wheels."""

LEVERS_M = (1.0, 0.75, 1.3)
"""Lever arms in m that convert heave to angles: half the track for roll, half the wheelbase for pitch."""


class _Drive(NamedTuple):
    """The speed in m/s with three derivatives and the yaw in rad with three derivatives, each (n,)."""

    speed: tuple[Reals, Reals, Reals, Reals]
    yaw: tuple[Reals, Reals, Reals, Reals]


@dataclass(frozen=True)
class Vehicle(MotionBetweenRests):
    """The vehicle stands for `still_s`, drives for `drive_s`, and stands again; phases static, motion, static.

    It reaches `speed_mps`, takes its bends with `lateral_mps2`, brakes to a stop. Box X points forward, Y left, Z up.
    The body rolls and pitches in proportion to its acceleration. The road adds heave, roll and pitch: eight sines from
    1 to 15 Hz, drawn from `seed`, in proportion to the speed, `road_mps2` rms of vertical acceleration at full speed.
    The shape of the drive is our assumption, not that of a recorded drive. ValueError for invalid values.
    """

    speed_mps: float = 15.0
    lateral_mps2: float = 2.5
    road_mps2: float = 0.5
    still_s: float = 10.0
    drive_s: float = 60.0
    seed: int = 0
    temperature_degc: float = 25.0

    def __post_init__(self) -> None:
        positive(speed_mps=self.speed_mps, still_s=self.still_s, drive_s=self.drive_s)
        finite(lateral_mps2=self.lateral_mps2, temperature_degc=self.temperature_degc)
        if not 0 <= self.road_mps2 < math.inf or self.seed < 0:
            raise ValueError(f"road_mps2: {self.road_mps2}, seed: {self.seed}; allowed are 0 and more")

    @property
    def _moving_s(self) -> float:
        return self.drive_s

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus, at rest or while driving."""
        seconds = self.moved_s(time_ns)
        if not seconds.any():
            return resting(time_ns, UPRIGHT, self.temperature_degc)
        drive = self._drive(seconds)
        heave, angles = self._body(seconds, drive)
        speed, gain, *_ = drive.speed
        yaw, yaw_rate, *_ = drive.yaw
        sine, cosine, inwards = np.sin(yaw), np.cos(yaw), speed * yaw_rate
        acceleration = np.array([gain * cosine - inwards * sine, gain * sine + inwards * cosine, heave[2]])
        return rigid_body_stimulus(time_ns, angles, acceleration, heave[0], self.temperature_degc)

    def velocity(self, time_ns: Integers) -> Reals:
        """Return (n, 3) of the box's origin in the level frame, in m/s."""
        seconds = self.moved_s(time_ns)
        drive = self._drive(seconds)
        (speed, *_), (yaw, *_) = drive
        return np.stack([speed * np.cos(yaw), speed * np.sin(yaw), self._body(seconds, drive)[0][1]], axis=1)

    def attitude(self, time_ns: Integers) -> Rotation:
        """Return n rotations from the box to the level frame."""
        from scipy.spatial.transform import Rotation  # imported late because SciPy takes long to load

        seconds = self.moved_s(time_ns)
        _, angles = self._body(seconds, self._drive(seconds))
        return Rotation.from_euler("ZYX", np.stack([angles.yaw[0], angles.pitch[0], angles.roll[0]], axis=1))

    def _drive(self, seconds: Reals) -> _Drive:
        going_s, braking_s = GOING_SHARE * self.drive_s, BRAKING_SHARE * self.drive_s
        going = _derivatives(smooth_step(seconds / going_s), going_s)
        braking = _derivatives(smooth_step((seconds - self.drive_s) / braking_s + 1), braking_s)
        v, v1, v2, v3 = (self.speed_mps * (a - b) for a, b in zip(going, braking, strict=True))
        yaw_rate = self.lateral_mps2 / self.speed_mps
        edges = [(edge, way) for bend in BENDS for edge, way in _edges(*bend)]
        yaw = np.zeros((4, len(seconds)))
        for (begin, end), way in edges:
            length_s = (end - begin) * self.drive_s
            share = (seconds - begin * self.drive_s) / length_s
            step, slope, bend, _ = _derivatives(smooth_step(share), length_s)
            yaw += way * yaw_rate * np.array([length_s * smooth_step_area(share), step, slope, bend])
        return _Drive((v, v1, v2, v3), (yaw[0], yaw[1], yaw[2], yaw[3]))

    def _body(self, seconds: Reals, drive: _Drive) -> tuple[Reals, EulerAngles]:
        """Return the heave (3, n) in m with two derivatives, and the attitude."""
        v, v1, v2, v3 = drive.speed
        yaw, w, w1, w2 = drive.yaw
        lean = LEAN_RAD_PER_MPS2 * np.array([v * w, v1 * w + v * w1, v2 * w + 2 * v1 * w1 + v * w2])
        back = LEAN_RAD_PER_MPS2 * np.array([v1, v2, v3])
        heave, roll, pitch = self._road(seconds, v / self.speed_mps, v1 / self.speed_mps, v2 / self.speed_mps)
        return heave, EulerAngles(roll + lean, pitch - back, np.array([yaw, w, w1]))

    def _road(self, seconds: Reals, pace: Reals, pace1: Reals, pace2: Reals) -> Reals:
        """Return (3, 3, n): heave in m, roll and pitch in rad, each with two derivatives, scaled by `pace` (n,)."""
        hertz, sines, cosines = self._sines
        free, slope, bend = np.zeros((3, 3, len(seconds)))
        for number, omega in enumerate(2 * math.pi * hertz):
            sine, cosine = np.sin(omega * seconds), np.cos(omega * seconds)
            for part in range(3):
                a, b = sines[part, number], cosines[part, number]
                wave = a * sine + b * cosine
                free[part] += wave
                slope[part] += (omega * a) * cosine - (omega * b) * sine
                bend[part] -= omega**2 * wave
        return np.stack([pace * free, pace1 * free + pace * slope, pace2 * free + 2 * pace1 * slope + pace * bend], 1)

    @cached_property
    def _sines(self) -> tuple[Reals, Reals, Reals]:
        """Return (8,) frequencies in Hz and (3, 8) amplitudes of the sines and of the cosines, with heave in m, roll
        and pitch in rad.
        """
        generator = np.random.default_rng([self.seed, 3])
        low, high = ROAD_HZ[:-1], ROAD_HZ[1:]
        hertz = low * (high / low) ** generator.random(len(low))
        phase = 2 * math.pi * generator.random((3, len(low)))
        peak = self.road_mps2 * math.sqrt(2 / len(low)) / (2 * math.pi * hertz) ** 2 / np.array(LEVERS_M)[:, None]
        return hertz, peak * np.cos(phase), peak * np.sin(phase)


def _derivatives(steps: tuple[Reals, Reals, Reals, Reals], length_s: float) -> tuple[Reals, ...]:
    """Return a step and its derivatives with respect to time, from those with respect to its share."""
    return tuple(step / length_s**order for order, step in enumerate(steps))


def _edges(begin: float, end: float, way: float) -> tuple[tuple[tuple[float, float], float], ...]:
    """Return the edges at which the curvature of a bend increases, and at which it decreases."""
    ramp = BEND_RAMP * (end - begin)
    return ((begin, begin + ramp), way), ((end - ramp, end), -way)
