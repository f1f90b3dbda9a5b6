"""The size effect: specific force at accelerometers away from the origin of the box frame while the box turns.

A sensor at r feels f + alpha x r + omega x (omega x r) (rigid-body kinematics). The last term is removed with the
angular rate of the gyroscopes, and the angular acceleration alpha adds three unknowns to every frame, along s of a
sensor alpha . (r x s). The angular rate of three neighbouring frames gives an additional reading of alpha: the slope,
at the last of them, of the parabola through them, which unlike a plain difference does not lag behind a steady change
of alpha.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats, Times
from imuarray.fuse.axes import Axis
from imuarray.fuse.optimal.geometry import Bounds, FrameReadings, Geometry, hold_last

FASTEST = 300.0
"""rad/s2, standard deviation of the angular acceleration of anything: a turn at 1000 dps reversed in 0.1 s has 350."""

ROWS = 6
"""Rows that stand behind the axes: the three of the slopes, and three that say `FASTEST`."""

_PARABOLA = 6.5
"""Variance of the slope of the parabola through three points at its last one, over theirs, in periods: 1.5^2 + 2^2 +
0.5^2.
"""

_JITTER = 0.25
"""Share of the period within which frames are neighbours whose slope has that variance, more or less."""


def placed(axes: Sequence[Axis]) -> bool:
    """Return whether any sensor is known to sit away from the origin."""
    return any(any(axis.position_m) for axis in axes)


def with_lever(geometry: Geometry, axes: Sequence[Axis], rate_covariance: Floats, period_s: float) -> Geometry:
    """The geometry with angular acceleration as unknowns 3 to 5; `rate_covariance` (3, 3) of a frame's angular rate,
    noise alone.
    """
    places = np.array([axis.position_m for axis in axes])
    whitening = _whitening(rate_covariance, period_s)
    rows = np.zeros((len(axes) + ROWS, 6))
    rows[: len(axes), :3] = geometry.rows
    rows[: len(axes), 3:] = np.cross(places, geometry.rows)
    rows[len(axes) : -3, 3:] = whitening
    rows[-3:, 3:] = np.eye(3) / FASTEST
    ones, never = np.ones(ROWS), np.full(ROWS, np.inf)
    return Geometry(
        rows,
        np.concatenate([geometry.noise, ones]),
        np.concatenate([geometry.noise_of_means, ones]),
        np.concatenate([geometry.end, never]),
        np.concatenate([geometry.timing, np.zeros(ROWS)]),
        len(axes),
    )


@dataclass
class Lever:
    """Turns accelerometer readings into those of a geometry `with_lever`, block after block."""

    axes: Sequence[Axis]
    whitening: Floats
    period_s: float

    def __post_init__(self) -> None:
        self._places = np.array([axis.position_m for axis in self.axes])
        self._directions = np.array([axis.direction_box for axis in self.axes])
        self.forget()

    def forget(self) -> None:
        """Begin anew: nothing is known of the rate before the next frame."""
        self._time, self._rate = np.zeros(2, np.int64), np.full((2, 3), np.nan)
        self._held = np.zeros(3)

    def __call__(self, readings: FrameReadings, rate: Floats) -> FrameReadings:
        """`readings` at the origin but for the angular acceleration, and that; `rate` (n, 3) rad/s, NaN where unknown:
        then it is taken to be the last one known, and there is no slope.
        """
        time, rates = np.concatenate([self._time, readings.time]), np.concatenate([self._rate, rate])
        acceleration = self._slopes(time, rates)
        lasting = hold_last(np.concatenate([self._held[None], rate]))[1:]
        self._time, self._rate, self._held = time[-2:], rates[-2:], (lasting[-1] if len(lasting) else self._held)
        known = np.asarray(np.isfinite(acceleration).all(axis=1))
        turning = self._centripetal(lasting)
        values = np.where(readings.valid, readings.values - turning, 0.0)
        reported = np.where(known[:, None], acceleration, 0.0) @ self.whitening.T
        others = np.concatenate([np.repeat(known[:, None], 3, axis=1), np.ones((len(known), 3), bool)], axis=1)
        return FrameReadings(
            readings.time,
            np.concatenate([values, reported, np.zeros((len(known), 3))], axis=1),
            np.concatenate([readings.valid, others], axis=1),
            None if readings.bounds is None else Bounds(readings.bounds.ends, readings.bounds.at - turning),
            readings.alike and bool((known == known[:1]).all()),
        )

    def _centripetal(self, rate: Floats) -> Floats:
        """(n, m) s . (omega x (omega x r)) = (s . omega) (r . omega) - (s . r) |omega|^2."""
        across = (rate @ self._directions.T) * (rate @ self._places.T)
        return np.asarray(across - (rate**2).sum(axis=1)[:, None] * (self._directions * self._places).sum(axis=1))

    def _slopes(self, time: Times, rate: Floats) -> Floats:
        """(n, 3) rad/s2 from n + 2 frames; NaN where they are no neighbours."""
        steps_s = np.diff(time) * 1e-9
        steps_s[np.abs(steps_s - self.period_s) > _JITTER * self.period_s] = np.nan
        slopes = np.diff(rate, axis=0) / steps_s[:, None]
        share = steps_s[1:] / (steps_s[1:] + steps_s[:-1])
        return np.asarray(slopes[1:] + share[:, None] * np.diff(slopes, axis=0))


def lever_of(axes: Sequence[Axis], rate_covariance: Floats, period_s: float) -> Lever:
    """The lever that goes with the geometry of `with_lever`."""
    return Lever(axes, _whitening(rate_covariance, period_s), period_s)


def _whitening(rate_covariance: Floats, period_s: float) -> Floats:
    """(3, 3) that makes the slopes of the angular rate of unit variance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(_PARABOLA * rate_covariance / period_s**2)))
