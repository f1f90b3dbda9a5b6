"""`planes`: in-plane against out-of-plane axes, by their measured noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.frames import Floats
from imuarray.fuse.solve import weighted
from imuarray.fuse.techniques.technique import WORTH_WEIGHING, Technique, known_noise_of


def planes(axes: Sequence[Axis]) -> Technique:
    """In-plane and out-of-plane axes by their measured noise (paper, section 2.2); see `plane_weights`."""
    rows, weights, noise = directions(axes), plane_weights(axes), known_noise_of(axes)
    return lambda frames: weighted(frames.values, weights * frames.valid, rows, noise)


def changes(axes: Sequence[Axis]) -> list[str]:
    """The designs whose axes it weighs otherwise than the average does."""
    weights = plane_weights(axes)
    return sorted({axis.chip for axis, weight in zip(axes, weights, strict=True) if not np.isclose(weight, 1.0)})


def plane_weights(axes: Sequence[Axis]) -> Floats:
    """(m,) Within a design the better kind of axis weighs 1 and the other the ratio of the variances.

    Kinds that scatter too much alike for a gain weigh as in the average. The variances are means over the design's
    units and ranges, each unit's relative to its own three axes, so that only the plane matters here. FusionError
    where the noise of an axis is not known.
    """
    noise = known_noise_of(axes)
    weights = np.ones(len(axes))
    for chip in {axis.chip for axis in axes}:
        variance = {kind: np.mean(_relative_variances(axes, noise, chip, kind)) for kind in (True, False)}
        best = min(variance.values())
        for index, axis in enumerate(axes):
            if axis.chip == chip and max(variance.values()) > WORTH_WEIGHING * best:
                weights[index] = best / variance[axis.in_plane]
    return weights


def _relative_variances(axes: Sequence[Axis], noise: Floats, chip: str, in_plane: bool) -> list[float]:
    """Variances of one kind of axis of a design, each relative to the mean of its own triad."""
    relative = []
    for index, axis in enumerate(axes):
        if axis.chip == chip and axis.in_plane == in_plane:
            triad = [noise[other] ** 2 for other, its in enumerate(axes) if its.sensor == axis.sensor]
            relative.append(float(noise[index] ** 2 / np.mean(triad)))
    return relative
