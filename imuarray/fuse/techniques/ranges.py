"""`ranges`: low and high measuring ranges of one design blended, the low one fading out before it clips."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.frames import Estimate, Floats, Frames
from imuarray.fuse.solve import weighted
from imuarray.fuse.techniques.technique import WORTH_WEIGHING, Technique, known_noise_of

TAPER = (0.75, 0.95)
"""Share of the measuring range at which a low-range sensor begins to be trusted less, and at which it is not used at
all.
"""


def ranges(axes: Sequence[Axis]) -> Technique:
    """Low and high measuring ranges of one design blended by inverse variance (paper, section 2.3).

    The low range's weight falls smoothly to exactly zero before the end of its range, by the largest axis of its own
    triad; the high range then carries on alone. Weights otherwise as in `range_weights`.
    """
    rows, weights, noise = directions(axes), range_weights(axes), known_noise_of(axes)
    span = np.array([axis.range_si for axis in axes])
    tapered = np.array([axis.range_si < _widest(axes, axis.chip) for axis in axes])

    def fused(frames: Frames) -> Estimate:
        use = np.abs(frames.values / span).reshape(len(frames.values), -1, 3).max(axis=2).repeat(3, axis=1)
        share = np.clip((TAPER[1] - use) / (TAPER[1] - TAPER[0]), 0, 1)
        smooth = np.where(tapered, share * share * (3 - 2 * share), 1.0)
        return weighted(frames.values, weights * smooth * frames.valid, rows, noise)

    return fused


def range_weights(axes: Sequence[Axis]) -> Floats:
    """(m,) Within a design each measuring range weighs by its inverse variance, a mean over its units and axes.

    A design with one range, or whose ranges scatter too much alike for a gain, weighs as in the average, and no design
    gains on another. FusionError where the noise of an axis is not known.
    """
    noise = known_noise_of(axes)
    weights = np.ones(len(axes))
    for chip in {axis.chip for axis in axes}:
        members = [index for index, axis in enumerate(axes) if axis.chip == chip]
        spans = {axes[index].range_si for index in members}
        variance = {span: np.mean([noise[i] ** 2 for i in members if axes[i].range_si == span]) for span in spans}
        if max(variance.values()) > WORTH_WEIGHING * min(variance.values()):
            weights[members] = [1 / variance[axes[index].range_si] for index in members]
            weights[members] *= len(members) / weights[members].sum()
    return weights


def changes(axes: Sequence[Axis]) -> list[str]:
    """The designs of which it fades out a low range."""
    return sorted({axis.chip for axis in axes if axis.range_si < _widest(axes, axis.chip)})


def _widest(axes: Sequence[Axis], chip: str) -> float:
    """The widest measuring range of a design."""
    return max(axis.range_si for axis in axes if axis.chip == chip)
