"""Input and output of techniques: aligned readings, and estimates with their covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.axes import Axis

_Kind = TypeVar("_Kind", bound=np.generic)

ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Columns of a covariance as it is kept: the six entries that differ."""


@dataclass(frozen=True)
class Frames:
    """n frames of m axes: time (n,) ns, values (n, m) in SI along each axis, valid (n, m): there is a reading, no
    flag throws doubt on it, and its triad is off the ends of its range (a clipped reading is a bound, not a
    value).

    `clipped` (n, m) is +1 where an axis stands at the upper end of its range, -1 at the lower one, else 0; `stale`
    (n, m) where the chip had nothing newer than the reading before. None: nowhere.

    `offsets` (n, m): in frames that lack a reading, how far each axis has recently been from the array's mean, NaN for
    axes without a recent reading; 0 in all other frames (`imuarray.fuse.stream`). None: not known.
    """

    time: Times
    values: Floats
    valid: Booleans
    clipped: npt.NDArray[np.int8] | None = None
    stale: Booleans | None = None
    offsets: Floats | None = None

    def part(self, rows: slice) -> Frames:
        """Some of the frames."""
        clipped = None if self.clipped is None else self.clipped[rows]
        stale = None if self.stale is None else self.stale[rows]
        offsets = None if self.offsets is None else self.offsets[rows]
        return Frames(self.time[rows], self.values[rows], self.valid[rows], clipped, stale, offsets)

    def without(self, excluded: Booleans) -> Frames:
        """The frames without the axes `excluded` (n, m), whose offsets are forgotten, too."""
        offsets = None if self.offsets is None else np.where(excluded, np.nan, self.offsets)
        return replace(self, valid=self.valid & ~excluded, offsets=offsets)

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """Frames of the same axes one after the other, of one part at least."""
        return Frames(
            np.concatenate([part.time for part in parts]),
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.valid for part in parts]),
            _flags([part.clipped for part in parts], parts, np.int8),
            _flags([part.stale for part in parts], parts, np.bool_),
            _flags([part.offsets for part in parts], parts, np.float64),
        )


def _flags(
    columns: Sequence[npt.NDArray[_Kind] | None], parts: Sequence[Frames], kind: type[_Kind]
) -> npt.NDArray[_Kind] | None:
    """Booleans of all parts, 0 in those that have none; None if no part has any."""
    if all(column is None for column in columns):
        return None
    pairs = zip(columns, parts, strict=True)
    return np.concatenate([np.zeros(part.valid.shape, kind) if column is None else column for column, part in pairs])


@dataclass(frozen=True)
class Estimate:
    """n frames of one quantity in SI in the box frame.

    `triad_box` (n, 3), NaN where the axes used don't span space; `covariance_box` (n, 6), the entries `ENTRIES` of its
    error's covariance, NaN where a noise is not known; `used` (n, m): which axes went into it.
    """

    triad_box: Floats
    covariance_box: Floats
    used: Booleans


@dataclass(frozen=True)
class FusedBlock:
    """n frames: time (n,) ns and, per quantity, the fused triad (n, 3) in SI in the box frame (NaN where too few axes
    were valid).

    `covariances` (n, 6), per quantity, are the entries `ENTRIES` of its error's covariance; `used` (n, s), per
    quantity, says which axes of each of its s sensors went into it: 1 x, 2 y, 4 z. Both are missing where nobody
    worked them out.
    """

    time: Times
    triads: Mapping[str, Floats]
    covariances: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    used: Mapping[str, npt.NDArray[np.uint8]] = field(default_factory=lambda: MappingProxyType({}))

    def part(self, rows: slice) -> FusedBlock:
        """Some of the frames."""
        return FusedBlock(
            self.time[rows],
            {name: column[rows] for name, column in self.triads.items()},
            {name: column[rows] for name, column in self.covariances.items()},
            {name: column[rows] for name, column in self.used.items()},
        )

    @staticmethod
    def joined(blocks: Sequence[FusedBlock]) -> FusedBlock:
        """Frames of the same quantities one after the other, of one block at least."""
        return FusedBlock(
            np.concatenate([block.time for block in blocks]),
            _columns([block.triads for block in blocks]),
            _columns([block.covariances for block in blocks]),
            _columns([block.used for block in blocks]),
        )


def _columns(parts: Sequence[Mapping[str, npt.NDArray[_Kind]]]) -> dict[str, npt.NDArray[_Kind]]:
    """The rows of all parts, by name."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def entries(covariance_box: Floats) -> Floats:
    """(..., 6) the entries `ENTRIES` of covariances (..., 3, 3)."""
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return np.asarray(covariance_box[..., rows, columns])


def matrices(covariance_entries: Floats) -> Floats:
    """(..., 3, 3) covariances from their entries (..., 6)."""
    return np.asarray(covariance_entries[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]])


def axis_bits(used: Booleans, axes: Sequence[Axis]) -> npt.NDArray[np.uint8]:
    """(n, s) from (n, m): for every sensor of `axes`, in order, the sum of 1 x, 2 y, 4 z over its axes in use."""
    sensors = list(dict.fromkeys(axis.sensor for axis in axes))
    table = np.zeros((len(axes), len(sensors)), np.uint8)
    for index, axis in enumerate(axes):
        table[index, sensors.index(axis.sensor)] = 1 << axis.index
    if len(used) and (used == used[0]).all():
        return np.broadcast_to(used[0].astype(np.uint8) @ table, (len(used), len(sensors)))
    return np.asarray(used.astype(np.uint8) @ table)
