"""A box shaken by hand: position and attitude are sums of sines under an envelope that rises and falls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.simulate.motion.faces import UPRIGHT, resting
from imuarray.simulate.motion.kinematics import RotationVector, rigid_body_stimulus
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.motion.timeline import MotionBetweenRests, finite, positive, smooth_step
from imuarray.units import STANDARD_GRAVITY

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

RAMP_S = 1.0
SHARES = (0.6, 0.4)
"""Shares of the slow and the fast sine of an axis in its peak amplitude."""

PLACE_HZ = ((1.5, 3.0), (3.5, 6.0))
TURN_HZ = ((0.8, 1.6), (2.0, 5.0))
"""Ranges in Hz from which the frequencies of the slow and the fast sine are drawn."""


@dataclass(frozen=True)
class _Sines:
    """x = envelope(t) sum of amplitude sin(2 pi hertz t + phase), for three axes; all (3, 2)."""

    hertz: Reals
    phase: Reals
    amplitude: Reals

    def at(self, seconds: Reals, envelope: tuple[Reals, Reals, Reals]) -> tuple[Reals, Reals, Reals]:
        """Return (3, n) value, first and second derivative."""
        free, slope, bend = np.zeros((3, 3, len(seconds)))
        for axis, sine in np.ndindex(self.hertz.shape):
            pace, amplitude = 2 * math.pi * self.hertz[axis, sine], self.amplitude[axis, sine]
            angle = pace * seconds + self.phase[axis, sine]
            wave = amplitude * np.sin(angle)
            free[axis] += wave
            slope[axis] += pace * amplitude * np.cos(angle)
            bend[axis] -= pace**2 * wave
        swell, swelling, swelling_more = envelope
        return (
            swell * free,
            swelling * free + swell * slope,
            swelling_more * free + 2 * swelling * slope + swell * bend,
        )


@dataclass(frozen=True)
class HandShake(MotionBetweenRests):
    """A box at rest upright for `still_s`, shaken for `motion_s`, at rest again in the same place; phases static,
    motion, static.

    Position (level frame) and rotation vector of the attitude are two sines an axis, frequencies and phases drawn from
    `seed`, under an envelope that rises and falls within a second. The magnitude of the acceleration never exceeds
    `peak_g`, that of the angular rate never `peak_dps`; both come close to these limits. ValueError for invalid values.
    """

    peak_g: float = 8.0
    peak_dps: float = 500.0
    still_s: float = 10.0
    motion_s: float = 30.0
    seed: int = 0
    temperature_degc: float = 25.0

    def __post_init__(self) -> None:
        positive(peak_g=self.peak_g, peak_dps=self.peak_dps, still_s=self.still_s, motion_s=self.motion_s)
        finite(temperature_degc=self.temperature_degc)
        if self.seed < 0:
            raise ValueError(f"seed: {self.seed}; allowed are 0, 1, 2, ...")

    @property
    def _moving_s(self) -> float:
        return self.motion_s

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus, at rest or in motion."""
        seconds = self.moved_s(time_ns)
        if not ((seconds > 0) & (seconds < self.motion_s)).any():
            return resting(time_ns, UPRIGHT, self.temperature_degc)
        envelope = self._envelope(seconds)
        place, _, acceleration = self._place_sines.at(seconds, envelope)
        attitude = RotationVector(*self._turn_sines.at(seconds, envelope))
        return rigid_body_stimulus(time_ns, attitude, acceleration, place[2], self.temperature_degc)

    def position(self, time_ns: Integers) -> Reals:
        """Return (n, 3) of the box's origin in the level frame, in m."""
        seconds = self.moved_s(time_ns)
        return self._place_sines.at(seconds, self._envelope(seconds))[0].T

    def attitude(self, time_ns: Integers) -> Rotation:
        """Return n rotations from the box to the level frame."""
        from scipy.spatial.transform import Rotation  # imported late because SciPy takes long to load

        seconds = self.moved_s(time_ns)
        return Rotation.from_rotvec(self._turn_sines.at(seconds, self._envelope(seconds))[0].T)

    @property
    def _ramp_s(self) -> float:
        return min(RAMP_S, self.motion_s / 2)

    def _envelope(self, seconds: Reals) -> tuple[Reals, Reals, Reals]:
        """Return the envelope (n,) of the motion and its first two derivatives."""
        left_s = self.motion_s - seconds
        swell, slope, bend, _ = smooth_step(np.minimum(seconds, left_s) / self._ramp_s)
        return swell, np.where(seconds < left_s, slope, -slope) / self._ramp_s, bend / self._ramp_s**2

    @cached_property
    def _place_sines(self) -> _Sines:
        return self._draw_sines(PLACE_HZ, self.peak_g * STANDARD_GRAVITY, 2)

    @cached_property
    def _turn_sines(self) -> _Sines:
        return self._draw_sines(TURN_HZ, math.radians(self.peak_dps), 1)

    def _draw_sines(self, bands_hz: tuple[tuple[float, float], ...], peak: float, order: int) -> _Sines:
        """Return sines whose derivative of this order has a magnitude of at most `peak`. The rising envelope adds to
        the derivatives of a sine, so the amplitude is chosen for the worst instant.
        """
        generator = np.random.default_rng([self.seed, order])
        low, high = np.transpose(bands_hz)
        hertz = low * (high / low) ** generator.random((3, 2))
        swell, slope, bend, _ = smooth_step(np.linspace(0, 1, 2001)[:, None, None])
        pace = 2 * math.pi * hertz
        slope, bend = slope / (self._ramp_s * pace), bend / (self._ramp_s * pace) ** 2
        worst = np.hypot(swell, slope) if order == 1 else np.hypot(swell - bend, 2 * slope)
        amplitude = peak / math.sqrt(3) * np.array(SHARES) / (worst.max(axis=0) * pace**order)
        return _Sines(hertz, 2 * math.pi * generator.random((3, 2)), amplitude)
