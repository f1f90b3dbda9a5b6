"""Geometry and readings of an array: the sensitivity of its rows to the unknowns of a frame, their noise and validity.

`readings_of` prepares frames: it decides which readings are values, which are only bounds (clipped axes), and which are
ignored. A reading near the end of the range that the chip did not flag is a bound only while axes of a wider range
determine the same direction. Otherwise it is a value: without it, the direction would follow from the small components
of the other axes alone, whose errors are a hundred times larger at a misalignment of 10 mrad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.frames import Axis, Frames, directions
from imuarray.fuse.least_squares import spans
from imuarray.fuse.optimal.prior import ErrorModel

AT_END = 0.98
"""Share of the measuring range above which a reading is a bound: the truth is there or beyond."""

_LEAST = 0.25
"""Least sum of the squared cosines between a direction and the axes in use that determines it: one axis at 60 degrees.
"""

_WIDER = 1.05
"""Least ratio of two ranges of which the larger one counts as wider."""

_NEAR = 3.0
"""Distance from the bound, in standard deviations, within which readings are not used to estimate slow errors: there,
the readings that are not clipped are biased.
"""


_KEPT = 1024
"""Number of cached sets of axes."""


@dataclass(frozen=True)
class Geometry:
    """r rows: the m axes, and then other information on the k unknowns. `rows` (r, k) are the sensitivities to the
    unknowns, the first three of which are the triad in the box frame; `noise` (r,) are standard deviations, also of
    means over many frames; `end` (r,) is the value at which a reading becomes a bound, infinite for rows that are not
    axes; `timing` (r,) is the standard deviation of the time of a reading, in s.
    """

    rows: Floats
    noise: Floats
    noise_of_means: Floats
    end: Floats
    timing: Floats
    axes: int
    _spanning: dict[bytes, bool] = field(default_factory=dict, init=False, repr=False, compare=False)
    _lacking: dict[bytes, Booleans] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def fair(self) -> Floats:
        """Largest stimulus (r,) along the axis at which its readings are used to estimate slow errors."""
        return self.end - _NEAR * self.noise

    @cached_property
    def fair_square(self) -> float:
        """Square of the stimulus up to which the readings of all axes are used to estimate slow errors."""
        return float(max(self.fair.min(), 0.0)) ** 2

    def spans(self, valid: Booleans) -> bool:
        """Return whether the valid axes (r,) span space."""
        key = valid[: self.axes].tobytes()
        if key not in self._spanning:
            if len(self._spanning) >= _KEPT:
                self._spanning.clear()
            rows = self.rows[: self.axes, :3][valid[: self.axes]]
            self._spanning[key] = bool(spans(rows.T @ rows))
        return self._spanning[key]

    def lacking(self, valid: Booleans) -> Booleans:
        """Return the axes (m,) along directions that the valid axes (m,) do not determine (`_LEAST`)."""
        key = valid.tobytes()
        if key not in self._lacking:
            if len(self._lacking) >= _KEPT:
                self._lacking.clear()
            rows = self.rows[: self.axes, :3]
            squares, directions_box = np.linalg.eigh(rows[valid].T @ rows[valid])
            self._lacking[key] = np.asarray(((rows @ directions_box[:, squares < _LEAST]) ** 2).sum(axis=1) > _LEAST)
        return self._lacking[key]

    def parity(self, valid: Booleans) -> Floats:
        """Return the parity matrix (p, r) of the rows in use, which depends on their errors only, whitened for means:
        ``parity @ readings`` has unit variance without slow errors.
        """
        rows = self.rows[valid] / self.noise_of_means[valid, None]
        remaining, sizes, _ = np.linalg.svd(rows)
        rank = int((sizes > 1e-9 * max(float(sizes.max(initial=0.0)), 1e-300)).sum())
        parity = np.zeros((len(rows) - rank, len(self.noise)))
        parity[:, valid] = remaining[:, rank:].T / self.noise_of_means[valid]
        return parity


def geometry_of(axes: Sequence[Axis], model: ErrorModel) -> Geometry:
    """Return the geometry of the axes alone, with three unknowns."""
    errors = model.of(axes)
    return Geometry(
        rows=directions(axes),
        noise=np.array([error.noise for error in errors]),
        noise_of_means=np.array([error.noise_of_means for error in errors]),
        end=AT_END * np.array([axis.range_si for axis in axes]),
        timing=np.array([error.timing_s for error in errors]),
        axes=len(axes),
    )


Signs = npt.NDArray[np.int8]


class Bounds(NamedTuple):
    """`ends` (n, m) is +1 where an axis is known to be above the bound `at` (n, m), -1 where below, else 0."""

    ends: Signs
    at: Floats


Patterns = list[tuple[Booleans, npt.NDArray[np.intp] | slice]]
"""Distinct rows of flags, each with the frames that have it."""


class FrameReadings(NamedTuple):
    """n frames of r rows: `values` (n, r), 0 where not `valid` (n, r), and bounds if there are any; `same_rows` is true
    if all frames have the same valid rows.
    """

    time: Times
    values: Floats
    valid: Booleans
    bounds: Bounds | None = None
    same_rows: bool = False

    def part(self, frames: slice) -> FrameReadings:
        """Return some of the frames."""
        bounds = None if self.bounds is None else Bounds(self.bounds.ends[frames], self.bounds.at[frames])
        return FrameReadings(self.time[frames], self.values[frames], self.valid[frames], bounds, self.same_rows)

    def patterns(self) -> Patterns:
        """Return the distinct sets of valid rows."""
        return [(self.valid[0], slice(None))] if self.same_rows and len(self.valid) else patterns(self.valid)


def patterns(flags: Booleans) -> Patterns:
    """Return the distinct rows of `flags` (n, r), each with the frames that have it."""
    if len(flags) == 0:
        return []
    if (flags == flags[0]).all():
        return [(flags[0], slice(None))]
    packed = np.packbits(flags, axis=1)
    width, content = packed.shape[1], packed.tobytes()
    first: dict[bytes, int] = {}
    rows = (first.setdefault(content[width * row : width * (row + 1)], row) for row in range(len(flags)))
    pattern = np.fromiter(rows, np.intp, len(flags))  # a dictionary is faster than the sorting of `np.unique`
    return [(flags[first[key]], np.flatnonzero(pattern == first[key])) for key in sorted(first)]


def hold_last(triad: Floats) -> Floats:
    """Replace NaN in triads (n, 3) by the last known triad; NaN remains before the first one."""
    is_finite = np.isfinite(triad).all(axis=1)
    return triad if is_finite.all() else triad[np.maximum.accumulate(np.where(is_finite, np.arange(len(triad)), 0))]


def readings_of(frames: Frames, geometry: Geometry) -> FrameReadings:
    """Return the axes' readings: a clipped one is a bound, and so is one near the end of its range if axes of a wider
    range determine its direction; stale ones are ignored unless the others do not span space.
    """
    valid, bounds = frames.valid, None
    limits = geometry.end[: geometry.axes]
    clipped = frames.clipped if frames.clipped is not None and frames.clipped.any() else None
    if clipped is not None or _any_beyond(frames.values, limits):
        beyond = _redundant(valid & (np.abs(frames.values) > limits), valid, geometry)
        signs = np.sign(np.nan_to_num(frames.values))
        ends = np.where(beyond, signs, 0 if clipped is None else clipped).astype(np.int8)
        bounds_at = ends * np.minimum(np.abs(np.nan_to_num(frames.values, nan=np.inf)), limits)
        bounds = Bounds(ends, np.asarray(bounds_at, float))
        valid = valid & (ends == 0)
    if frames.stale is not None and (valid & frames.stale).any():
        valid = _drop_stale(valid, frames.stale, geometry)
    whole = bool(valid.all())
    values = frames.values if whole else np.where(valid, frames.values, 0.0)
    return FrameReadings(frames.time, values, valid, bounds, whole or bool((valid == valid[:1]).all()))


def _redundant(beyond: Booleans, valid: Booleans, geometry: Geometry) -> Booleans:
    """Return those of the readings (n, m) near the end of the range whose directions are determined by valid axes of a
    wider range.
    """
    frames = np.flatnonzero(beyond.any(axis=1))
    valid_within, ends = (valid & ~beyond)[frames], geometry.end[: geometry.axes]
    for end in np.unique(ends[beyond.any(axis=0)]):
        for pattern, pattern_frames in patterns(valid_within & (ends > _WIDER * end)):
            beyond[frames[pattern_frames]] &= ~(geometry.lacking(pattern) & (ends == end))
    return beyond


def _any_beyond(values: Floats, limits: Floats) -> bool:
    """Return whether any value is beyond the limits, or NaN."""
    return len(values) > 0 and not bool(((values.max(axis=0) <= limits) & (values.min(axis=0) >= -limits)).all())


def _drop_stale(valid: Booleans, stale: Booleans, geometry: Geometry) -> Booleans:
    fresh = valid & ~stale
    for pattern, pattern_frames in patterns(fresh):
        if not geometry.spans(pattern):
            fresh[pattern_frames] = valid[pattern_frames]
    return fresh
