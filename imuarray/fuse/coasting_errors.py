"""Effect of errors of rate and of specific force on a coasting navigator: heading and velocity after a minute.

The box stands still for some seconds, in which the mean errors are removed; after that nothing is corrected. Over a
minute the small errors of a strapdown navigator obey, in the level frame in which the box stood (Titterton and Weston,
Strapdown Inertial Navigation Technology, 2nd edition, chapter 12; the Earth's rate and curvature and the change of
gravity with height, which add less than 1 % in a minute, are neglected)::

    d tilt / dt     = C rate_error
    d velocity / dt = C force_error + tilt x (C force)

with C the true attitude from box to that frame and `tilt` the small rotation from the true attitude to that of the
navigator. At rest C is the identity and C force is gravity's reaction g upwards, so that a constant rate error b about
a level axis gives a tilt b t and a velocity g b t^2 / 2. Heading is the tilt about the vertical: about box Z of a box
that stood upright.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
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
"""Step in s to the next window if a window does not begin at rest or contains a pause."""

_PAUSE_S = 0.5

_FIRST_FRAMES = 64
"""Number of frames from which the period is determined."""


@dataclass(frozen=True)
class Coasting:
    """Errors at the end of w coasts: heading in degrees (w,), horizontal velocity in m/s (w,), and the start of each
    coast in s since the log's epoch (w,).
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
        """Return some of the frames."""
        return Errors(*(getattr(self, name)[rows] for name in ("time", "rate_error", "force_error", "rate", "force")))


def coasting(errors: Errors | Iterable[Errors], still_s: float = STILL_S, coast_s: float = COAST_S) -> Coasting:
    """Evaluate every coast of `coast_s` that fits, in sequence, each after `still_s` in which the true motion is rest.

    With `still_s` 0 no mean errors are removed and no rest is required. For errors in blocks, those of one coast are in
    memory; the result does not depend on the blocks.
    """
    frames = _FrameBuffer([errors] if isinstance(errors, Errors) else errors)
    if len(frames.seconds) < 2:
        return Coasting(np.zeros(0), np.zeros(0), np.zeros(0))
    result, start_s = [], 0.0
    length_s, period_s = still_s + coast_s, frames.period_s
    while True:
        frames.extend(start_s + length_s + period_s)
        if start_s + length_s > frames.seconds[-1] + 1.5 * period_s:
            break
        frames.forget(start_s - period_s)
        seconds = frames.seconds
        first, go, last = np.searchsorted(seconds, np.array([0, still_s, length_s]) + start_s - period_s / 2)
        window, rest = frames.errors[first : last + 1], frames.errors[first:go]
        if (still_s > 0 and not _is_still(rest)) or np.diff(seconds[first:last]).max(initial=0.0) > _PAUSE_S:
            start_s += _STEP_S
            continue
        offsets = [part.mean(axis=0) if still_s > 0 else 0.0 for part in (rest.rate_error, rest.force_error)]
        upwards = (rest if still_s > 0 else window[:1]).force.mean(axis=0)
        tilt, velocity = propagate(window[go - first :], *offsets)
        upwards /= np.linalg.norm(upwards)
        level = velocity - velocity @ upwards * upwards
        result.append((np.degrees(tilt @ upwards), np.linalg.norm(level), start_s + still_s + frames.start_ns * 1e-9))
        start_s += length_s
    heading, velocity, starts_s = np.array(result, float).reshape(-1, 3).T
    return Coasting(heading, velocity, starts_s)


class _FrameBuffer:
    """The part of a stream of frames that is in memory; the stream begins at `start_ns` and has a frame every
    `period_s`.
    """

    def __init__(self, blocks: Iterable[Errors]) -> None:
        self._blocks = iter(blocks)
        self.errors = Errors(np.zeros(0, np.int64), *(np.zeros((0, 3)) for _ in range(4)))
        self._extend(lambda count, newest_ns: count >= _FIRST_FRAMES)
        self.start_ns = int(self.errors.time[0]) if len(self.errors.time) else 0
        steps = np.diff(self.seconds[:_FIRST_FRAMES])
        self.period_s = float(np.median(steps)) if len(steps) else float("nan")

    @property
    def seconds(self) -> Floats:
        """Return the times since the first frame of all."""
        return np.asarray((self.errors.time - self.start_ns) * 1e-9)

    def extend(self, until_s: float) -> None:
        """Read blocks until a frame is later than `until_s`, or to the end."""
        self._extend(lambda count, newest_ns: (newest_ns - self.start_ns) * 1e-9 > until_s)

    def _extend(self, is_enough: Callable[[int, int], bool]) -> None:
        """Read blocks until `is_enough`, of the number of frames and the newest time, is true."""
        parts = [self.errors]
        count = len(self.errors.time)
        while not (count and is_enough(count, int(parts[-1].time[-1]))):
            block = next(self._blocks, None)
            if block is None:
                break
            if len(block.time):
                parts.append(block)
                count += len(block.time)
        if len(parts) > 1:
            names = [item.name for item in fields(Errors)]
            self.errors = Errors(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def forget(self, before_s: float) -> None:
        """Drop the frames before a time."""
        first = int(np.searchsorted(self.seconds, before_s))
        self.errors = self.errors[first:]


def propagate(
    errors: Errors, rate_offset: Floats | float = 0.0, force_offset: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Integrate errors less their offsets; return the final tilt (3,) in rad and velocity (3,) in m/s, in the box frame
    of the first frame.
    """
    seconds = (errors.time - errors.time[0]) * 1e-9
    turned = _attitudes(seconds, errors.rate).apply if errors.rate.any() else np.asarray
    tilt_rate = turned(errors.rate_error - rate_offset)
    steps = np.diff(seconds)[:, None] * (tilt_rate[1:] + tilt_rate[:-1]) / 2
    tilt = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    acceleration = turned(errors.force_error - force_offset) + np.cross(tilt, turned(errors.force))
    return np.asarray(tilt[-1]), np.asarray(np.trapezoid(acceleration, seconds, axis=0))


def _attitudes(seconds: Floats, rate: Floats) -> Rotation:
    """Return n rotations from the box to the box frame of the first frame.

    They are the prefix products of the steps between frames, by doubling (Hillis and Steele, 1986).
    """
    from scipy.spatial.transform import Rotation

    middle = (rate[1:] + rate[:-1]) / 2 * np.diff(seconds)[:, None]
    turns = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), middle]))
    reach, count = 1, len(rate)
    while reach < count:
        turns = Rotation.concatenate([turns[:reach], turns[:-reach] * turns[reach:]])
        reach *= 2
    return turns


def _is_still(rest: Errors) -> bool:
    """Return whether the true motion is rest."""
    if len(rest.time) == 0:
        return False
    turning = np.linalg.norm(rest.rate, axis=1).max()
    shaken = np.linalg.norm(rest.force - rest.force[0], axis=1).max()
    return bool(turning < _STILL_RAD_PER_S and shaken < _STILL_MPS2)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
