"""Conversion of an attitude as a function of time into the stimulus of the box, with exact rates and angular
accelerations.

Everything is laid out as (3, n), one row for each axis, which is much faster than (n, 3). An attitude R turns the box
frame into the level frame: ``vector_level = R @ vector_box``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.simulate.motion.faces import AIR_PRESSURE_PA, FIELD_LEVEL, PA_PER_M
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.units import STANDARD_GRAVITY

_SMALL = 0.2
"""Squared angle in rad2 below which series are used; the terms beyond x^7 are then smaller than the last bit."""


class Attitude(Protocol):
    """An attitude at n instants and its derivatives."""

    def seen(self, vector_level: Reals) -> Reals:
        """Transform a vector (3, n) or (3, 1) from the level frame to the box frame, (3, n)."""

    def rates(self) -> tuple[Reals, Reals]:
        """Return the angular rate in rad/s and the angular acceleration in rad/s2, each (3, n), in the box frame."""


def rigid_body_stimulus(
    time_ns: Integers, attitude: Attitude, acceleration_level: Reals, height_m: Reals, temperature_degc: float
) -> BoxStimulus:
    """Return the stimulus of a moving box: `acceleration_level` (3, n) of its origin in m/s2, its height (n,)."""
    rate, angular_acceleration = attitude.rates()
    force_level = acceleration_level + np.array([[0.0], [0.0], [STANDARD_GRAVITY]])
    return BoxStimulus(
        time_ns,
        np.ascontiguousarray(attitude.seen(force_level).T),
        np.ascontiguousarray(rate.T),
        np.ascontiguousarray(angular_acceleration.T),
        np.ascontiguousarray(attitude.seen(FIELD_LEVEL[:, None]).T),
        np.broadcast_to(temperature_degc, (len(time_ns),)),
        AIR_PRESSURE_PA - PA_PER_M * height_m,
    )


def cross(a: Reals, b: Reals) -> Reals:
    """Return (3, n) vector products."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product[i] = a[j] * b[k] - a[k] * b[j]
    return product


@dataclass(frozen=True, eq=False)
class RotationVector:
    """R = exp([phi]x), from phi (3, n) in rad and its derivatives `speed` and `gain`.

    With theta = |phi|, sinc = sin(theta) / theta, versine = (1 - cos(theta)) / theta^2, rest = (1 - sinc) / theta^2:
    rate = phi' - versine phi x phi' + rest phi x (phi x phi'), the right Jacobian of the rotation group. It shortens
    the component of phi' perpendicular to phi, so the rate never exceeds |phi'|.
    """

    phi: Reals
    speed: Reals
    gain: Reals

    def seen(self, vector_level: Reals) -> Reals:
        """Implement `Attitude.seen` by Rodrigues' formula."""
        sinc, versine = self._coefficients[:2]
        once = cross(self.phi, vector_level)
        vector_box: Reals = vector_level - sinc * once + versine * cross(self.phi, once)
        return vector_box

    def rates(self) -> tuple[Reals, Reals]:
        """Implement `Attitude` by the derivative of the rate, term by term."""
        phi, speed, gain = self.phi, self.speed, self.gain
        _, versine, rest, versine_slope, rest_slope = self._coefficients
        once, bent = cross(phi, speed), cross(phi, gain)
        twice = cross(phi, once)
        growth = np.sum(phi * speed, axis=0)
        rate = speed - versine * once + rest * twice
        acceleration = gain - versine * bent + rest * (cross(phi, bent) + cross(speed, once))
        return rate, acceleration + growth * (rest_slope * twice - versine_slope * once)

    @cached_property
    def _coefficients(self) -> tuple[Reals, ...]:
        """Return (n,) sinc, versine, rest, and the derivatives of the last two in theta, divided by theta."""
        square = np.sum(self.phi * self.phi, axis=0)
        small = square < _SMALL
        x = np.where(small, 1.0, square)
        half = np.sqrt(x) / 2
        sinc = np.sin(2 * half) / (2 * half)
        versine = 0.5 * (np.sin(half) / half) ** 2
        rest = (1 - sinc) / x
        closed = (sinc, versine, rest, (sinc - 2 * versine) / x, (versine - 3 * rest) / x)
        near = np.minimum(square, _SMALL)
        return tuple(np.where(small, np.polyval(a, near), b) for a, b in zip(_SERIES, closed, strict=True))


def _series(offset: int) -> Reals:
    """Return the coefficients of sum of (-x)^k / (2 k + offset)!, highest power first. With x = theta^2 the sum is
    sin(theta) / theta, (1 - cos(theta)) / theta^2, (theta - sin(theta)) / theta^3 for offset 1, 2, 3.
    """
    return np.array([(-1.0) ** k / math.factorial(2 * k + offset) for k in range(8)])[::-1]


_SERIES = (*map(_series, (1, 2, 3)), 2 * np.polyder(_series(2)), 2 * np.polyder(_series(3)))


@dataclass(frozen=True, eq=False)
class EulerAngles:
    """R = Rz(yaw) Ry(pitch) Rx(roll), each angle (3, n): its value in rad and its first two derivatives.

    rate = (roll' - yaw' sin(pitch), pitch' cos(roll) + yaw' cos(pitch) sin(roll), yaw' cos(pitch) cos(roll) - pitch'
    sin(roll)), whether the level frame's z points up or down.
    """

    roll: Reals
    pitch: Reals
    yaw: Reals

    def seen(self, vector_level: Reals) -> Reals:
        """Implement `Attitude.seen` by one plane rotation after the other."""
        roll_sine, roll_cosine, pitch_sine, pitch_cosine = self._sines
        x, y, z = vector_level
        yaw_sine, yaw_cosine = np.sin(self.yaw[0]), np.cos(self.yaw[0])
        x, y = x * yaw_cosine + y * yaw_sine, y * yaw_cosine - x * yaw_sine
        x, z = x * pitch_cosine - z * pitch_sine, z * pitch_cosine + x * pitch_sine
        return np.array([x, y * roll_cosine + z * roll_sine, z * roll_cosine - y * roll_sine])

    def rates(self) -> tuple[Reals, Reals]:
        """Implement `Attitude` by the derivative of the rate, term by term."""
        roll_sine, roll_cosine, pitch_sine, pitch_cosine = self._sines
        _, roll, roll_gain = self.roll
        _, pitch, pitch_gain = self.pitch
        _, yaw, yaw_gain = self.yaw
        level = yaw * pitch_cosine
        level_gain = yaw_gain * pitch_cosine - yaw * pitch * pitch_sine
        y = pitch * roll_cosine + level * roll_sine
        z = level * roll_cosine - pitch * roll_sine
        gain_x = roll_gain - yaw_gain * pitch_sine - yaw * pitch * pitch_cosine
        gain_y = pitch_gain * roll_cosine + level_gain * roll_sine + roll * z
        gain_z = level_gain * roll_cosine - pitch_gain * roll_sine - roll * y
        return np.array([roll - yaw * pitch_sine, y, z]), np.array([gain_x, gain_y, gain_z])

    @cached_property
    def _sines(self) -> tuple[Reals, Reals, Reals, Reals]:
        roll, pitch = self.roll[0], self.pitch[0]
        return np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
