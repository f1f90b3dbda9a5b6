"""Fading of low-range sensors, frame by frame: near the end of the range, and until their filters have settled.

A reading near the end of the range is less linear, and one at the end is not a measurement. For some time after it the
output of the sensor's low-pass still depends on the clipped input, which was too small by up to the difference of the
ranges. The response of a second-order low-pass (damping 1/sqrt 2) to it decays at least as fast as ``exp(-sqrt(2) pi
bandwidth t)``; that of a first-order one decays faster (``exp(-2 pi bandwidth t)``). The BMA180's data sheet states a
shorter time: 7.5 ms at 150 Hz (BMA-85), for which this formula gives 14 ms with an excess of 14.5 g.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.frames import Axis, Frames

TAPER = (0.75, 0.95)
"""Shares of the measuring range at which the weight of a low-range sensor begins to decrease, and at which it is zero.
"""

SETTLED = 0.1
"""Largest remaining effect of a clipped input on a settled sensor, relative to the noise of a reading."""

UNKNOWN_BANDWIDTH_HZ = 10.0
"""Assumed bandwidth of a sensor whose bandwidth is not known: the slowest low-pass of a BMA180 (BMA-81)."""

OTHER_RANGE = 0.9
"""Least share of the widest range for a range to count as equally wide: full scales of 2000 and 2048 are one range."""

_NEVER = np.iinfo(np.int64).min // 2


def widest(axes: Sequence[Axis]) -> float:
    """Return the widest measuring range of all chips."""
    return max(axis.range_si for axis in axes)


def has_low_range(axis: Axis, axes: Sequence[Axis]) -> bool:
    """Return whether another axis has a wider range."""
    return axis.range_si < OTHER_RANGE * widest(axes)


def settling_s(bandwidth_hz: float | None, excess_si: float, noise_si: float) -> float:
    """Return the seconds until the response of a second-order low-pass to an input `excess_si` beyond its range has
    decayed to `SETTLED` times the noise; at least one time constant.
    """
    decay_per_s = math.sqrt(2) * math.pi * (bandwidth_hz or UNKNOWN_BANDWIDTH_HZ)
    return max(1.0, math.log(max(excess_si, 1e-300) / (SETTLED * noise_si))) / decay_per_s


class Fading:
    """The factor (n, m) of each axis's weight, over consecutive blocks.

    The three axes of a sensor, in the order of `axes_of`, fade together, by the largest of them, smoothly to exactly
    zero at `TAPER[1]` of its range. After it was there, or clipped, or the wide ranges measured more than its range, it
    is not used for its settling time (`settling_s`), counted from the middle between the last frame out of range and
    the first one within, and fades in over another such time. The widest range never fades.

    A sensor clips before its low-pass: at a step steeper than the filter, some frames are wrong until the wide ranges,
    which are filtered too, show the excess.
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

    def __call__(self, frames: Frames, expected: Floats) -> Floats:
        """Return the factors of the next block; `expected` (n, m) are the readings of each axis predicted by the wide
        ranges (NaN: unknown).
        """
        count = len(frames.time)
        if self._is_calm(frames, expected):
            self._last_ns = frames.time[-1:] if count else self._last_ns
            return np.ones(frames.values.shape)
        level = np.abs(frames.values).reshape(count, -1, 3).max(axis=2) / self._span
        beyond = (np.abs(expected).reshape(count, -1, 3) > self._span[:, None]).any(axis=2)
        at_end = np.asarray((level >= TAPER[1]) | beyond)
        if frames.clipped is not None:
            at_end |= (frames.clipped != 0).reshape(count, -1, 3).any(axis=2)
        inside = np.minimum(_smooth((TAPER[1] - level) / (TAPER[1] - TAPER[0])), self._settled(frames, at_end))
        share = np.where(self.fades, np.where(at_end, 0.0, inside), 1.0)
        return np.asarray(share.repeat(3, axis=1))

    def _is_calm(self, frames: Frames, expected: Floats) -> bool:
        """Return whether no low range is, or was, near its end: all factors are one then."""
        fades = self.fades
        if self._was_at_end[fades].any() or (self._out_ns[fades] != _NEVER).any():
            return False
        if frames.clipped is not None and frames.clipped.any():
            return False
        ends = np.where(fades, self._span, np.inf).repeat(3)
        return not ((np.abs(frames.values) > TAPER[0] * ends).any() or (np.abs(expected) > ends).any())

    def _settled(self, frames: Frames, at_end: Booleans) -> Floats:
        """Return the factor (n, s): 0 while a sensor settles, then rising to 1."""
        before = np.concatenate([self._was_at_end[None], at_end[:-1]])
        times = np.concatenate([frames.time[:1] if self._last_ns is None else self._last_ns, frames.time])
        returned = times[1:] - np.diff(times) // 2  # in the middle between two frames, on average
        seen = np.where(at_end, frames.time[:, None], np.where(before, returned[:, None], _NEVER))
        out_ns = np.maximum(np.maximum.accumulate(seen, axis=0), self._out_ns)
        self._out_ns, self._was_at_end, self._last_ns = out_ns[-1], at_end[-1], frames.time[-1:]
        return _smooth((frames.time[:, None] - out_ns) / self._settling_ns - 1)


def _smooth(share: Floats) -> Floats:
    """Return a cubic from 0 at 0 to 1 at 1, with zero slope at both ends and constant beyond."""
    inside = np.clip(share, 0, 1)
    return np.asarray(inside * inside * (3 - 2 * inside))
