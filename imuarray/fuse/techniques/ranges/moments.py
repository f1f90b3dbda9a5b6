"""Sums over segments of frames that tell what each axis reads otherwise than the blend of all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imuarray.fuse.frames import Flags, Floats, Times
from imuarray.fuse.techniques.ranges.blends import Blends

SEGMENT = 64
"""Frames that are looked at together."""

GAP_S = 0.5
"""Two frames further apart than this tell no slope."""

_ENOUGH = 10.0
"""Times its noise that a motion's mean square must have: with less, the noise of the regressor would weaken the result
by more than a tenth.
"""

_FEWEST = 8


class Rows(NamedTuple):
    """n frames to learn from: time (n,), values and valid (n, m); `steady` (n,): no sensor is on its way out or in."""

    time: Times
    values: Floats
    valid: Flags
    steady: Flags

    def then(self, other: Rows) -> Rows:
        """These rows and then the others."""
        return Rows(
            np.concatenate([self.time, other.time]),
            np.concatenate([self.values, other.values]),
            np.concatenate([self.valid, other.valid]),
            np.concatenate([self.steady, other.steady]),
        )

    def part(self, rows: slice) -> Rows:
        """Some of the rows."""
        return Rows(self.time[rows], self.values[rows], self.valid[rows], self.steady[rows])


class Moments(NamedTuple):
    """Of one segment: when it ended (ns), the axes present (m,), which of them moved enough to tell more than a bias
    (m,); sums of products of 1, signal and the effect of a delay (m, 3, 3), and of these with the residual (m, 3); all
    zero where it tells nothing.
    """

    end_ns: int
    present: Flags
    moved: Flags
    products: Floats
    residual: Floats


def moments(rows: Rows, directions: Floats, blends: Blends) -> Iterator[Moments]:
    """The sums over each whole segment. A frame counts if it is steady, as its neighbours are, and no axis that is
    present in the segment is missing in it.
    """
    count = len(rows.time) // SEGMENT
    if not count:
        return
    shape, axes = (count, SEGMENT), len(directions)
    time_s = ((rows.time - rows.time[0]) * 1e-9).reshape(shape)
    valid, steady = rows.valid.reshape(*shape, axes), rows.steady.reshape(shape)
    present = np.asarray((valid & steady[:, :, None]).any(axis=1))
    taken = steady & (valid | ~present[:, None, :]).all(axis=2)
    values = np.where(valid, rows.values.reshape(*shape, axes), 0.0)
    found = [blends.of(some) for some in present]
    gain = np.array([np.zeros((3, axes)) if blend is None else blend.gain for blend in found])
    noise = np.array([np.zeros(axes) if blend is None else blend.along for blend in found])
    triads = values @ gain.transpose(0, 2, 1)
    passed_s = np.maximum(time_s[:, 2:] - time_s[:, :-2], 1e-9)
    taken = taken[:, 1:-1] & taken[:, :-2] & taken[:, 2:] & (passed_s <= GAP_S)
    late = -(triads[:, 2:] - triads[:, :-2]) / passed_s[:, :, None] @ directions.T
    along = triads[:, 1:-1] @ directions.T
    moved, products, residual = _sums(along, late, values[:, 1:-1] - along, taken, noise, passed_s.mean(axis=1))
    for index, blend in enumerate(found):
        told = np.zeros(axes) if blend is None or taken[index].sum() < _FEWEST else blend.seen * 1.0
        end_ns = int(rows.time[(index + 1) * SEGMENT - 1])
        sums = products[index] * told[:, None, None], residual[index] * told[:, None]
        yield Moments(end_ns, present[index], moved[index], *sums)


def _sums(
    along: Floats, late: Floats, residual: Floats, taken: Flags, noise: Floats, passed_s: Floats
) -> tuple[Flags, Floats, Floats]:
    """Which axes moved (k, m); sums over the frames `taken` (k, n) of each segment: products of 1, signal and effect of
    a delay (k, m, 3, 3), and of these with the residual (k, m, 3).

    A signal that moves too little against its `noise` (k, m) is as good as its mean, a slope as good as none.
    """
    one = taken[:, :, None].astype(float)
    count = np.maximum(one.sum(axis=1), 1.0)
    mean = (along * one).sum(axis=1) / count
    moving = ((along - mean[:, None]) ** 2 * one).sum(axis=1) > _ENOUGH * count * noise**2
    along = np.where(moving[:, None], along, mean[:, None])
    jitter = 2 * (noise / passed_s[:, None]) ** 2
    rising = (late**2 * one).sum(axis=1) > _ENOUGH * count * jitter
    late = np.where(rising[:, None], late, 0.0)
    columns = (np.broadcast_to(one, along.shape), along * one, late * one)
    plain = (np.ones_like(along), along, late, residual)
    sums = np.array([[(left * right).sum(axis=1) for right in plain] for left in columns])
    return moving, np.moveaxis(sums[:, :3], (0, 1), (2, 3)), np.moveaxis(sums[:, 3], 0, 2)
