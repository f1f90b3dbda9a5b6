"""Effect of errors of rate and of specific force on a navigator that coasts: heading and velocity after a minute.

The box stands still for some seconds, in which the mean errors are taken out; then nothing is corrected any more. Over
a minute the small errors of a strapdown navigator follow, in the level frame in which the box stood (Titterton and
Weston, Strapdown Inertial Navigation Technology, 2nd edition, chapter 12; the Earth's rate and curvature and the
change of gravity with height are left out, which add less than 1 % in a minute)::

    d tilt / dt     = C rate_error
    d velocity / dt = C force_error + tilt x (C force)

with C the true attitude from box to that frame and `tilt` the small rotation from the true attitude to that of the
navigator. At rest C is one and C force is gravity's reaction g upwards, so that a constant rate error b about a level
axis gives b t of tilt and g b t^2 / 2 of velocity. Heading is the tilt about the vertical: about box Z of a box that
stood upright.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Floats, Times
from imuarray.units import STANDARD_GRAVITY

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


STILL_S, COAST_S = 10.0, 60.0

_STILL_RAD_PER_S = np.radians(0.1)
_STILL_MPS2 = 0.01 * STANDARD_GRAVITY
_STEP_S = 1.0
"""By how much a window is put off whose beginning is not still, or that holds a pause."""

_PAUSE_S = 0.5


@dataclass(frozen=True)
class Coasting:
    """Errors at the end of w coasts: heading in degrees (w,), horizontal velocity in m/s (w,), and when each coast
    begins, in s of the log (w,).
    """

    heading_deg: Floats
    velocity_mps: Floats
    begins_s: Floats

    @property
    def heading_rms_deg(self) -> float:
        """The rms of the heading error over all coasts; nan if there is none."""
        return _rms(self.heading_deg)

    @property
    def velocity_rms_mps(self) -> float:
        """The rms of the velocity error over all coasts; nan if there is none."""
        return _rms(self.velocity_mps)


@dataclass(frozen=True)
class Errors:
    """n frames: time (n,) ns; errors and truth of angular rate (rad/s) and specific force (m/s2), (n, 3), box frame."""

    time: Times
    rate_error: Floats
    force_error: Floats
    rate: Floats
    force: Floats

    def __getitem__(self, rows: slice) -> Errors:
        """Some of the frames."""
        return Errors(*(getattr(self, name)[rows] for name in ("time", "rate_error", "force_error", "rate", "force")))


def coasting(errors: Errors, still_s: float = STILL_S, coast_s: float = COAST_S) -> Coasting:
    """Every coast of `coast_s` that fits, one after the other, each after `still_s` in which the box truly stood still.

    With `still_s` 0 nothing is taken out before, and no stillness is asked for.
    """
    if len(errors.time) < 2:
        return Coasting(np.zeros(0), np.zeros(0), np.zeros(0))
    seconds = (errors.time - errors.time[0]) * 1e-9
    result, begin = [], 0.0
    period_s = float(np.median(np.diff(seconds)))
    while begin + still_s + coast_s <= seconds[-1] + 1.5 * period_s:
        first, go, last = np.searchsorted(seconds, np.array([0, still_s, still_s + coast_s]) + begin - period_s / 2)
        window, rest = errors[first : last + 1], errors[first:go]
        if (still_s > 0 and not _is_still(rest)) or np.diff(seconds[first:last]).max(initial=0.0) > _PAUSE_S:
            begin += _STEP_S
            continue
        offsets = [part.mean(axis=0) if still_s > 0 else 0.0 for part in (rest.rate_error, rest.force_error)]
        upwards = (rest if still_s > 0 else window[:1]).force.mean(axis=0)
        tilt, velocity = propagated(window[go - first :], *offsets)
        upwards /= np.linalg.norm(upwards)
        level = velocity - velocity @ upwards * upwards
        result.append((np.degrees(tilt @ upwards), np.linalg.norm(level), begin + still_s + errors.time[0] * 1e-9))
        begin += still_s + coast_s
    heading, velocity, begins = np.array(result, float).reshape(-1, 3).T
    return Coasting(heading, velocity, begins)


def propagated(
    errors: Errors, rate_offset: Floats | float = 0.0, force_offset: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Tilt (3,) in rad and velocity (3,) in m/s that errors less their offsets grow to, in the box frame of the first
    frame.
    """
    seconds = (errors.time - errors.time[0]) * 1e-9
    attitude = _attitudes(seconds, errors.rate)
    turned = attitude.apply(errors.rate_error - rate_offset)
    steps = np.diff(seconds)[:, None] * (turned[1:] + turned[:-1]) / 2
    tilt = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    pushed = attitude.apply(errors.force_error - force_offset) + np.cross(tilt, attitude.apply(errors.force))
    return np.asarray(tilt[-1]), np.asarray(np.trapezoid(pushed, seconds, axis=0))


def _attitudes(seconds: Floats, rate: Floats) -> Rotation:
    """n rotations from the box to the box frame of the first frame.

    Products of the steps between frames, all prefixes at once by doubling (Hillis and Steele, 1986).
    """
    from scipy.spatial.transform import Rotation

    middle = (rate[1:] + rate[:-1]) / 2 * np.diff(seconds)[:, None]
    turns = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), middle]))
    if not rate.any():
        return turns
    reach, count = 1, len(rate)
    while reach < count:
        turns = Rotation.concatenate([turns[:reach], turns[:-reach] * turns[reach:]])
        reach *= 2
    return turns


def _is_still(rest: Errors) -> bool:
    """Return whether the truth neither turns nor shakes."""
    if len(rest.time) == 0:
        return False
    turning = np.linalg.norm(rest.rate, axis=1).max()
    shaken = np.linalg.norm(rest.force - rest.force[0], axis=1).max()
    return bool(turning < _STILL_RAD_PER_S and shaken < _STILL_MPS2)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
