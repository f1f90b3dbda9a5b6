"""The interface of a technique, the noise of its axes, and `mean`, the technique that weighs every axis the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import FusionError
from imuarray.fuse.frames import Axis, Estimate, Frames, directions
from imuarray.fuse.least_squares import SlowErrors, solve_frames, weighted, whole_gain

Technique = Callable[[Frames], Estimate]
"""Frames of one quantity, block after block in order, to their estimate; the result does not depend on the blocks."""


@dataclass(frozen=True)
class FixedWeights:
    """A technique that gives each axis (m,) the same weight in every frame, as long as its reading is valid; `rows`
    (m, 3) are the directions of the axes, `noise` (m,) is theirs, `slow` what their calibrations leave unknown.
    """

    rows: Floats
    weights: Floats
    noise: Floats
    slow: SlowErrors | None = None

    def __call__(self, frames: Frames) -> Estimate:
        """Weighted least squares of the valid axes. A frame that lacks a reading keeps the level of the whole array, as
        far as the frame's offsets are known: they are removed before, and their own weighted mean is added.
        """
        weights = self.weights * frames.valid
        if frames.offsets is None:
            return weighted(frames.values, weights, self.rows, self.noise, self.slow)
        offsets = np.nan_to_num(frames.offsets)
        estimate = weighted(frames.values - offsets, weights, self.rows, self.noise, self.slow)
        some = np.flatnonzero(offsets.any(axis=1))
        if len(some):
            level = solve_frames(offsets[some], self.weights * np.isfinite(frames.offsets[some]), self.rows)
            estimate.triad_box[some] += level
        return estimate

    def whole(self) -> tuple[Floats, Callable[[Floats], Estimate]]:
        """The gain (3, m) of frames whose readings are all valid, and what makes their estimate of their triads."""
        zeros = np.zeros((1, len(self.weights)))
        alone = weighted(zeros, self.weights[None], self.rows, self.noise)
        gain = whole_gain(self.weights, self.rows)

        def of(triads: Floats) -> Estimate:
            count = len(triads)
            covariance = np.broadcast_to(alone.covariance_box[0], (count, 6))
            if self.slow is not None and self.slow.known:
                covariance = covariance + self.slow.covariance(gain[None], triads)
            return Estimate(triads, covariance, np.broadcast_to(alone.used[0], (count, len(self.weights))))

        return gain, of


Maker = Callable[[Sequence[Axis]], Technique]
"""The axes of one quantity to a technique for them; FusionError if they can't feed it."""

WORTH_WEIGHING = 1.25
"""Ratio of variances below which inverse-variance weights would gain less than 1 % over equal ones, and are left
alone.
"""


def noise_of(axes: Sequence[Axis]) -> Floats:
    """(m,) the noise of each axis, NaN where it is not known."""
    return np.array([np.nan if axis.noise_si is None else axis.noise_si for axis in axes])


def known_noise_of(axes: Sequence[Axis]) -> Floats:
    """(m,) the noise of each axis; FusionError where it is not known or there is none."""
    for axis in axes:
        if axis.noise_si is None:
            raise FusionError(
                f"sensor {axis.sensor}: its noise is not known; run `imuarray calibrate noise` and give the file"
            )
        if not axis.noise_si > 0:
            raise FusionError(
                f"sensor {axis.sensor} axis {'xyz'[axis.index]}: noise {axis.noise_si}: its readings never change"
            )
    return noise_of(axes)


def mean(axes: Sequence[Axis]) -> Technique:
    """The simple average of the literature (paper, section 2): the yardstick."""
    return FixedWeights(directions(axes), np.ones(len(axes)), noise_of(axes), SlowErrors(axes))
