"""The interface of a technique, the noise of its axes, and `mean`, the technique with equal weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import FusionError
from imuarray.fuse.frames import Axis, Estimate, Frames, directions, entries
from imuarray.fuse.least_squares import AxisNoise, SlowErrors, gains_of, solve_frames, weighted, whole_gain

Technique = Callable[[Frames], Estimate]
"""Maps consecutive blocks of frames of one quantity to their estimates; the result does not depend on the blocks."""


@dataclass(frozen=True)
class FixedWeights:
    """A technique with the same weight (m,) of an axis in every frame in which its reading is valid; `rows` (m, 3) are
    the directions of the axes, `noise` (m,) their noise, `slow` the remaining errors of their calibrations.
    """

    rows: Floats
    weights: Floats
    noise: Floats
    slow: SlowErrors | None = None

    def __call__(self, frames: Frames) -> Estimate:
        """Solve weighted least squares of the valid axes. A frame that lacks a reading keeps the level of the whole
        array if its offsets are known: they are removed first, and their own weighted mean is added. The noise of the
        offsets is that of as many readings as were averaged.
        """
        weights = self.weights[None] if frames.valid.all() else self.weights * frames.valid
        noise = AxisNoise(self.rows, self.noise, frames.delay_noise)
        if frames.offsets is None or frames.averaged is None:
            return weighted(frames.values, weights, noise, self.slow)
        offsets, some = np.nan_to_num(frames.offsets), np.flatnonzero(frames.averaged)
        estimate = weighted(frames.values - offsets, weights, noise)
        known = np.isfinite(frames.offsets) & (frames.averaged > 0)[:, None]
        whole = self.weights * (frames.valid | known)
        estimate.triad_box[some] += solve_frames(offsets[some], whole[some], self.rows)
        covariance = np.array(estimate.covariance_box)
        apart = (gains_of(whole[some], self.rows) - gains_of(weights[some], self.rows)) * self.noise
        covariance[some] += entries(apart @ np.swapaxes(apart, 1, 2)) / frames.averaged[some, None]
        if self.slow is not None and self.slow.known:  # those of the whole array, whose level is kept
            covariance += self.slow.covariance(gains_of(whole, self.rows), estimate.triad_box)
        return replace(estimate, covariance_box=covariance)

    def whole(self) -> tuple[Floats, Callable[[Floats], Estimate]]:
        """Return the gain (3, m) of frames whose readings are all valid, and the function from their triads to their
        estimate.
        """
        zeros = np.zeros((1, len(self.weights)))
        alone = weighted(zeros, self.weights[None], AxisNoise(self.rows, self.noise))
        gain = whole_gain(self.weights, self.rows)

        def of(triads: Floats) -> Estimate:
            count = len(triads)
            covariance = np.broadcast_to(alone.covariance_box[0], (count, 6))
            if self.slow is not None and self.slow.known:
                covariance = covariance + self.slow.covariance(gain[None], triads)
            return Estimate(triads, covariance, np.broadcast_to(alone.used[0], (count, len(self.weights))))

        return gain, of


Maker = Callable[[Sequence[Axis]], Technique]
"""Creates a technique for the axes of one quantity; FusionError if they are not sufficient."""

WORTH_WEIGHING = 1.25
"""Least ratio of variances for inverse-variance weights; below it they would gain less than 1 % over equal weights."""


def noise_of(axes: Sequence[Axis]) -> Floats:
    """Return the noise (m,) of each axis, NaN if not known."""
    return np.array([np.nan if axis.noise_si is None else axis.noise_si for axis in axes])


def known_noise_of(axes: Sequence[Axis]) -> Floats:
    """Return the noise (m,) of each axis; FusionError if it is not known or zero."""
    for axis in axes:
        if axis.noise_si is None:
            raise FusionError(
                f"sensor {axis.sensor}: its noise is not known; run `imuarray calibrate noise` and pass the file"
            )
        if not axis.noise_si > 0:
            raise FusionError(
                f"sensor {axis.sensor} axis {'xyz'[axis.index]}: noise {axis.noise_si}: its readings never change"
            )
    return noise_of(axes)


def mean(axes: Sequence[Axis]) -> Technique:
    """Return the simple average of the literature (paper, section 2), with which the others are compared."""
    return FixedWeights(directions(axes), np.ones(len(axes)), noise_of(axes), SlowErrors(axes))
