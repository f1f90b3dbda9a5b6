"""What a technique is, and what is asked of the axes that some of them weigh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.errors import FusionError
from imuarray.fuse.axes import Axis
from imuarray.fuse.frames import Estimate, Floats, Frames
from imuarray.fuse.solve import weighted, whole_gain

Technique = Callable[[Frames], Estimate]
"""Frames of one quantity, block after block in order, to their estimate; the result does not depend on the blocks."""


@dataclass(frozen=True)
class FixedWeights:
    """A technique that gives each axis (m,) the same weight in every frame, as long as its reading is valid; `rows`
    (m, 3) are the directions of the axes, `noise` (m,) is theirs.
    """

    rows: Floats
    weights: Floats
    noise: Floats

    def __call__(self, frames: Frames) -> Estimate:
        """Weighted least squares."""
        return weighted(frames.values, self.weights * frames.valid, self.rows, self.noise)

    def whole(self) -> tuple[Floats, Estimate]:
        """The gain (3, m) of frames whose readings are all valid, and the estimate of one of zeros."""
        zeros = np.zeros((1, len(self.weights)))
        nothing = Frames(np.zeros(1, np.int64), zeros, zeros == 0)
        return whole_gain(self.weights, self.rows), self(nothing)


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
            raise FusionError(f"sensor {axis.sensor} axis {'xyz'[axis.index]}: noise {axis.noise_si}: it is stuck")
    return noise_of(axes)
