"""Offsets of axes from the array's mean, for frames that lack a reading.

Without a calibration, or with an old one, the mean of an array contains the mean of the biases of its sensors. In a
frame without a reading of one of m axes the mean would therefore jump by about ``(bias - mean bias) / (m - 1)``, and
back in the next frame. That is common where each chip samples by an oscillator of its own: a sensor that is slower than
the frames has none to give from time to time.

For such a frame the mean difference of each axis from the array's mean over the last `RECENT` frames is attached
(`Frames.offsets`); a technique of fixed weights keeps the level of the whole array with it. Only frames before are
used, so the result is the same live and from a log. A step remains where a sensor is silent for longer than `RECENT`
frames, where no recent frame has readings of all sensors of the array, and in frames with a clipped reading: they are
for the technique `ranges`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.fuse.alignment import MARGIN
from imuarray.fuse.frames import Frames
from imuarray.fuse.least_squares import frame_gains

RECENT = MARGIN
"""Frames over which an offset is averaged: its noise is then below a fifth of one reading's, and of the result's far
less. `FusionStream` keeps no more of them.
"""

_AT_ONCE = 256
"""Frames that are computed together: their windows take some megabytes."""


class AxisOffsets:
    """Completes frames of one quantity by `Frames.offsets`; fed with consecutive blocks, on whose lengths the result
    does not depend. `directions` (m, 3) are those of the axes in the box frame.
    """

    def __init__(self, directions: Floats) -> None:
        self._directions = directions
        self._values = np.zeros((0, len(directions)))
        self._valid = np.zeros((0, len(directions)), bool)

    def observe(self, frames: Frames) -> None:
        """Take note of the next block, which needs no offsets."""
        self._values = np.concatenate([self._values, frames.values[-RECENT:]])[-RECENT:]
        self._valid = np.concatenate([self._valid, frames.valid[-RECENT:]])[-RECENT:]

    def __call__(self, frames: Frames) -> Frames:
        """Return the next block, with the offsets of frames that lack a reading if the recent frames tell them."""
        lacking = np.flatnonzero(~frames.valid.all(axis=1) & ~_clipped(frames))
        if not len(lacking):
            self.observe(frames)
            return frames
        values = np.concatenate([np.zeros((RECENT, len(self._directions))), self._values, frames.values])
        valid = np.concatenate([np.zeros((RECENT, len(self._directions)), bool), self._valid, frames.valid])
        before = len(self._values)
        offsets = np.zeros(frames.values.shape)
        for start in range(0, len(lacking), _AT_ONCE):
            some = lacking[start : start + _AT_ONCE]
            windows = some[:, None] + before + np.arange(RECENT)
            offsets[some] = self._of(values[windows], valid[windows], frames.valid[some])
        self.observe(frames)
        return replace(frames, offsets=offsets) if offsets.any() else frames

    def _of(self, values: Floats, valid: Booleans, now: Booleans) -> Floats:
        """(n, m) offsets of n frames from the windows (n, RECENT, m) before them; `now` (n, m): which axes are valid in
        the frames themselves.
        """
        recent: Booleans = np.asarray(valid.any(axis=1))
        complete: Booleans = np.asarray((valid | ~recent[:, None]).all(axis=2))
        offsets = np.zeros(now.shape)
        useful = complete.any(axis=1) & (recent & ~now).any(axis=1)
        patterns, which = np.unique(recent, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            gain, solvable = frame_gains(pattern[None].astype(float), self._directions)
            some = np.flatnonzero((which.reshape(-1) == number) & useful)
            if not solvable[0] or not len(some):
                continue
            counted = complete[some]
            sums = np.where(counted[:, :, None], values[some], 0.0).sum(axis=1)
            mean = sums / counted.sum(axis=1, keepdims=True)
            difference = mean - mean @ gain[0].T @ self._directions.T
            offsets[some] = np.where(pattern, difference, np.where(now[some], 0.0, np.nan))
        return offsets


def _clipped(frames: Frames) -> Booleans:
    """(n,) whether an axis stands at an end of its range."""
    if frames.clipped is None:
        return np.zeros(len(frames.time), bool)
    return np.asarray(frames.clipped.any(axis=1))
