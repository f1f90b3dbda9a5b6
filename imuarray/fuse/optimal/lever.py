"""The size effect: accelerometers away from the origin of the box frame feel it turn.

A sensor at r feels f + alpha x r + omega x (omega x r) (rigid-body kinematics): the last term is taken out with the
angular rate of the gyroscopes, and the angular acceleration alpha is three unknowns more in every frame, along s of a
sensor alpha . (r x s). The differences of the angular rate from frame to frame are readings of it, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.fuse.axes import Axis
from imuarray.fuse.frames import Floats, Times
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.readings import Bounds, Readings

FASTEST = 300.0
"""rad/s2, standard deviation of the angular acceleration of anything: a turn at 1000 dps reversed in 0.1 s has 350."""

ROWS = 6
"""Rows that stand behind the axes: the three of the differences, and three that say `FASTEST`."""


def placed(axes: Sequence[Axis]) -> bool:
    """Whether any sensor is known to sit away from the origin."""
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
        self._time, self._rate = 0, np.full(3, np.nan)

    def __call__(self, readings: Readings, rate: Floats) -> Readings:
        """`readings` at the origin but for the angular acceleration, and that; `rate` (n, 3) rad/s, NaN where unknown:
        then it is taken to be the last one known, and its difference is not used.
        """
        acceleration = self._differences(readings.time, rate)
        held = _held(rate, self._rate)
        self._time, self._rate = int(readings.time[-1]), held[-1]
        known = np.asarray(np.isfinite(acceleration).all(axis=1))
        turning = self._centripetal(np.nan_to_num(held))
        values = np.where(readings.valid, readings.values - turning, 0.0)
        told = np.where(known[:, None], acceleration, 0.0) @ self.whitening.T
        others = np.concatenate([np.repeat(known[:, None], 3, axis=1), np.ones((len(known), 3), bool)], axis=1)
        return Readings(
            readings.time,
            np.concatenate([values, told, np.zeros((len(known), 3))], axis=1),
            np.concatenate([readings.valid, others], axis=1),
            None if readings.bounds is None else Bounds(readings.bounds.ends, readings.bounds.at - turning),
        )

    def _centripetal(self, rate: Floats) -> Floats:
        """(n, m) s . (omega x (omega x r)) = (s . omega) (r . omega) - (s . r) |omega|^2."""
        across = (rate @ self._directions.T) * (rate @ self._places.T)
        return np.asarray(across - (rate**2).sum(axis=1)[:, None] * (self._directions * self._places).sum(axis=1))

    def _differences(self, time: Times, rate: Floats) -> Floats:
        """(n, 3) rad/s2; NaN after a gap, where the noise is not that of neighbours."""
        before = np.concatenate([self._rate[None], rate[:-1]])
        steps_s = np.diff(np.concatenate([[self._time], time])) * 1e-9
        change = (rate - before) / np.maximum(steps_s, 1e-9)[:, None]
        change[np.abs(steps_s - self.period_s) > 0.5 * self.period_s] = np.nan
        return np.asarray(change)


def lever_of(axes: Sequence[Axis], rate_covariance: Floats, period_s: float) -> Lever:
    """The lever that goes with the geometry of `with_lever`."""
    return Lever(axes, _whitening(rate_covariance, period_s), period_s)


def _whitening(rate_covariance: Floats, period_s: float) -> Floats:
    """(3, 3) that makes differences of the angular rate of neighbouring frames, over their time, of unit variance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(2 * rate_covariance / period_s**2)))


def _held(rate: Floats, last: Floats) -> Floats:
    """(n, 3) with the last known rate in place of NaN."""
    known = np.isfinite(rate).all(axis=1)
    if known.all():
        return rate
    source = np.maximum.accumulate(np.where(known, np.arange(len(rate)), -1))
    return np.where(source[:, None] >= 0, rate[np.maximum(source, 0)], last)
