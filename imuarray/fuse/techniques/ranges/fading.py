"""Fading of low-range sensors, frame by frame: near the end of the range, and until their filters have settled.

A reading near the end of the range is less linear, and one at the end is no measurement. For a while after it the
output of the sensor's low-pass still depends on the input that was clipped: an input that was too small by up to the
difference of the ranges. The response of a second-order low-pass (damping 1/sqrt 2) to it decays at least as fast as
``exp(-sqrt(2) pi bandwidth t)``; that of a first-order one decays faster (``exp(-2 pi bandwidth t)``). A BMA180's own
figures are not longer: 7.5 ms at 150 Hz (BMA-85), where this formula gives 14 ms for an excess of 14.5 g.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.frames import Axis, Frames

TAPER = (0.75, 0.95)
"""Share of the measuring range at which a low-range sensor begins to be trusted less, and at which it is not used at
all.
"""

SETTLED = 0.1
"""Share of a reading's noise below which what is left of a clipped input does not matter any more."""

UNKNOWN_BANDWIDTH_HZ = 10.0
"""Taken for a sensor whose bandwidth is not known: the slowest low-pass of a BMA180 (BMA-81)."""

OTHER_RANGE = 0.9
"""Share of the widest range from which on a range is as wide: two chips' full scales of 2000 and 2048 are one range."""

_NEVER = np.iinfo(np.int64).min // 2


def widest(axes: Sequence[Axis]) -> float:
    """The widest measuring range, whatever chip has it."""
    return max(axis.range_si for axis in axes)


def has_low_range(axis: Axis, axes: Sequence[Axis]) -> bool:
    """Return whether another of the axes goes on where this one ends."""
    return axis.range_si < OTHER_RANGE * widest(axes)


def settling_s(bandwidth_hz: float | None, excess_si: float, noise_si: float) -> float:
    """Seconds until a second-order low-pass has forgotten an input `excess_si` beyond its range to `SETTLED` times the
    noise; no less than one time constant.
    """
    decay_per_s = math.sqrt(2) * math.pi * (bandwidth_hz or UNKNOWN_BANDWIDTH_HZ)
    return max(1.0, math.log(max(excess_si, 1e-300) / (SETTLED * noise_si))) / decay_per_s


class Fading:
    """The share (n, m) of its weight that each axis keeps; fed with consecutive blocks.

    A sensor's three axes, which follow each other as `axes_of` gives them, fade together, by the largest of them,
    smoothly to exactly zero at `TAPER[1]` of its range. Once it was there, or clipped, or the wide ranges felt more
    than it can, it stays out for its settling time (`settling_s`), counted from the middle between the last frame out
    and the first one in, and comes in again over another such time. The widest range never fades.

    A sensor clips before its low-pass: of a step steeper than the filter, the few frames until the wide ranges,
    filtered too, show that it was too much are not known for what they are.
    """

    def __init__(self, axes: Sequence[Axis]) -> None:
        sensors = axes[::3]
        self.fades = np.array([has_low_range(axis, axes) for axis in sensors])
        self._span = np.array([axis.range_si for axis in sensors])
        self._settling_ns = 1e9 * np.array(
            [
                settling_s(
                    axis.bandwidth_hz,
                    widest(axes) - axis.range_si,
                    min(its.noise_si or math.inf for its in axes[3 * index : 3 * index + 3]),
                )
                if fades
                else 1.0
                for index, (axis, fades) in enumerate(zip(sensors, self.fades, strict=True))
            ]
        )
        self._out_ns = np.full(len(sensors), _NEVER)
        self._was_at_end = np.zeros(len(sensors), bool)
        self._last_ns: Times | None = None

    def __call__(self, frames: Frames, felt: Floats) -> Floats:
        """The shares of the next block; `felt` (n, m): what each axis should read by the wide ranges (NaN: unknown)."""
        count = len(frames.time)
        level = np.abs(frames.values).reshape(count, -1, 3).max(axis=2) / self._span
        beyond = (np.abs(felt).reshape(count, -1, 3) > self._span[:, None]).any(axis=2)
        at_end = np.asarray((level >= TAPER[1]) | beyond)
        if frames.clipped is not None:
            at_end |= (frames.clipped != 0).reshape(count, -1, 3).any(axis=2)
        inside = np.minimum(_smooth((TAPER[1] - level) / (TAPER[1] - TAPER[0])), self._settled(frames, at_end))
        share = np.where(self.fades, np.where(at_end, 0.0, inside), 1.0)
        return np.asarray(share.repeat(3, axis=1))

    def _settled(self, frames: Frames, at_end: Booleans) -> Floats:
        """(n, s) from 0 while a sensor is settling to 1."""
        before = np.concatenate([self._was_at_end[None], at_end[:-1]])
        times = np.concatenate([frames.time[:1] if self._last_ns is None else self._last_ns, frames.time])
        came_back = times[1:] - np.diff(times) // 2  # some time between two frames: in the middle of them, on average
        seen = np.where(at_end, frames.time[:, None], np.where(before, came_back[:, None], _NEVER))
        out_ns = np.maximum(np.maximum.accumulate(seen, axis=0), self._out_ns)
        self._out_ns, self._was_at_end, self._last_ns = out_ns[-1], at_end[-1], frames.time[-1:]
        return _smooth((frames.time[:, None] - out_ns) / self._settling_ns - 1)


def _smooth(share: Floats) -> Floats:
    """A cubic from 0 at 0 to 1 at 1, flat at both ends and beyond."""
    inside = np.clip(share, 0, 1)
    return np.asarray(inside * inside * (3 - 2 * inside))
