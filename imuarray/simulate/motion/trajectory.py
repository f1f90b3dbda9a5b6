"""Motions given row by row: a box's path, or directly what it felt; smooth in between."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Floats, Integers, Reals
from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import AIR_PRESSURE_PA, FIELD_LEVEL, GRAVITY_LEVEL, PA_PER_M
from imuarray.simulate.motion.felt import Felt

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows at `time_ns` (n,), the first at 0, and `temperature_degc` (n,); one phase, motion."""

    time_ns: Integers
    temperature_degc: Floats

    @property
    def phases(self) -> tuple[Phase, ...]:
        """One, from the first row to the last."""
        return (Phase(0, int(self.time_ns[-1]), "motion"),)

    @property
    def seconds(self) -> float:
        """The time of the last row."""
        return int(self.time_ns[-1]) * 1e-9

    @property
    def _row_s(self) -> Reals:
        return self.time_ns * 1e-9

    def _within_s(self, time_ns: Integers) -> Reals:
        """(n,) the times, before the first row that of the first, after the last that of the last."""
        return np.clip(time_ns, 0, self.time_ns[-1]) * 1e-9

    def _temperature_degc(self, seconds: Reals) -> Reals:
        return np.interp(seconds, self._row_s, self.temperature_degc)


@dataclass(frozen=True, eq=False)
class Trajectory(_Rows):
    """Position `place_m` (n, 3) in the level frame and `attitudes` (n, from the box to the level frame), joined by
    cubic splines (a rotation spline for the attitude: angular acceleration without jumps).

    Less than half a turn may lie between one row and the next. Temperature is linear between rows.
    """

    place_m: Floats
    attitudes: Rotation

    def felt(self, time_ns: Integers) -> Felt:
        """Return the stimulus, from the second derivative of the place and two of the attitude."""
        if len(time_ns) == 0:  # no rotations at all are an error in SciPy below 1.16
            first = self.felt(np.zeros(1, np.int64))
            return Felt(*(getattr(first, item.name)[:0] for item in fields(Felt)))
        seconds = self._within_s(time_ns)
        to_box = self.attitude(time_ns).inv()
        return Felt(
            time_ns,
            to_box.apply(self._place(seconds, 2) + GRAVITY_LEVEL),
            self._attitude(seconds, 1),
            self._attitude(seconds, 2),
            to_box.apply(FIELD_LEVEL),
            self._temperature_degc(seconds),
            AIR_PRESSURE_PA - PA_PER_M * self._place(seconds)[:, 2],
        )

    def position(self, time_ns: Integers) -> Reals:
        """(n, 3) of the box's origin in the level frame, in m."""
        return np.asarray(self._place(self._within_s(time_ns)))

    def attitude(self, time_ns: Integers) -> Rotation:
        """n rotations from the box to the level frame."""
        return self._attitude(self._within_s(time_ns))

    @cached_property
    def _place(self) -> CubicSpline:
        return _spline(self._row_s, self.place_m)

    @cached_property
    def _attitude(self) -> RotationSpline:
        from scipy.spatial.transform import RotationSpline  # its weight is for those who turn anything

        return RotationSpline(self._row_s, self.attitudes)


@dataclass(frozen=True, eq=False)
class FeltRows(_Rows):
    """Specific force `force_box` (n, 3) in m/s2 and angular rate `rate_box` (n, 3) in rad/s, joined by cubic splines.

    Nothing is known of attitude and height: field and pressure are those of a box that stands upright.
    """

    force_box: Floats
    rate_box: Floats

    def felt(self, time_ns: Integers) -> Felt:
        """The rows themselves; the angular acceleration is the derivative of the rate."""
        seconds = self._within_s(time_ns)
        return Felt(
            time_ns,
            self._force(seconds),
            self._rate(seconds),
            self._rate(seconds, 1),
            np.broadcast_to(FIELD_LEVEL, (len(time_ns), 3)),
            self._temperature_degc(seconds),
            np.broadcast_to(AIR_PRESSURE_PA, (len(time_ns),)),
        )

    @cached_property
    def _force(self) -> CubicSpline:
        return _spline(self._row_s, self.force_box)

    @cached_property
    def _rate(self) -> CubicSpline:
        return _spline(self._row_s, self.rate_box)


def _spline(row_s: Reals, rows: Floats) -> CubicSpline:
    """The cubic spline through rows (n, k) at times (n,)."""
    from scipy.interpolate import CubicSpline  # its weight is for those who move rows

    return CubicSpline(row_s, rows)
