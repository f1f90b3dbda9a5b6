"""Tracking of the differences between each axis and the blend of all axes: a bias, a scale and a delay.

`Blends` are the weighted means of any set of an array's axes, with the share of each axis's error that is visible with
respect to them. For an axis along ``r`` the residual with respect to the blend B of all axes is ::

    value - r.B = bias + scale (r.B) - delay d(r.B)/dt + noise

A Kalman filter for each axis tracks the three while all sensors are trusted. Rows are summed in segments of `SEGMENT`
frames, counted from the first (`moments`); a frame is corrected by the estimate from the segments before its own. Bias,
scale and delay are random walks, the bias such that the filter's memory is `MEMORY_S` at rest. Motion determines scale
and delay; a segment without enough of it determines the bias alone. At the start the scales of two axes differ by 0 +-
1 %, their delays by 0 +- that of a second-order low-pass of their bandwidth, ``1 / (sqrt(2) pi bandwidth)``.

Weighted by the blend, the residuals add up to zero: only differences between axes are observable, and the blend's own
level is kept. While a sensor is not used its last estimate is kept, and its uncertainty grows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.frames import Axis, directions
from imuarray.fuse.least_squares import whole_gain
from imuarray.fuse.techniques.ranges.fading import UNKNOWN_BANDWIDTH_HZ
from imuarray.kernels import track_differences
from imuarray.units import READABLE_SI


class Blend(NamedTuple):
    """Blend of a set of axes: the gain (3, m), the noise (m,) of its triad `along` each axis, the variance (m,) of the
    residuals, the share of every axis's error in them, `apart` (m, m), with its sums of squares `share` (m,), and
    whether these are not zero, `seen` (m,). `through` (m, m) is the effect of the bias of each axis on the triad along
    each axis; `turned` (m, m) is the same for errors that are proportional to the signal along the axis.
    """

    gain: Floats
    along: Floats
    variance: Floats
    share: Floats
    apart: Floats
    seen: Booleans
    through: Floats
    turned: Floats

    def level(self, differences: Floats) -> Floats:
        """Return the level (..., m, 3) of the blend along each axis for differences (..., m, 3: bias, scale, delay) of
        the axes: zero if they are differences from this blend.
        """
        result = np.empty_like(differences)
        result[..., 0] = differences[..., 0] @ self.through.T
        result[..., 1:] = self.turned @ differences[..., 1:]
        return result


class Blends:
    """The blends of subsets of axes along `rows` (m, 3), with `weights` and `noise` (m,)."""

    def __init__(self, rows: Floats, weights: Floats, noise: Floats) -> None:
        self._rows, self._weights, self._noise = rows, weights, noise
        self._known: dict[bytes, Blend | None] = {}

    def of(self, present: npt.NDArray[np.bool_]) -> Blend | None:
        """Return the blend of the axes `present` (m,); None if they do not span space."""
        key = present.tobytes()
        if key not in self._known:
            spans = present.any() and np.linalg.matrix_rank(self._rows[present], tol=1e-3) == 3
            self._known[key] = self._of(present) if spans else None
        return self._known[key]

    def _of(self, present: npt.NDArray[np.bool_]) -> Blend:
        gain = whole_gain(self._weights * present, self._rows)
        through = self._rows @ gain
        apart = (np.eye(len(through)) - through) * present[:, None] * present
        variance, share = apart**2 @ self._noise**2, (apart**2).sum(axis=1)
        along, turned = np.sqrt(through**2 @ self._noise**2), through * (self._rows @ self._rows.T)
        return Blend(gain, along, variance, share, apart, share > 1e-6, through, turned)


SEGMENT = 64
"""Number of frames that are processed together."""

GAP_S = 0.5
"""Longest time between two frames from which a slope is computed."""

_ENOUGH = 10.0
"""Least mean square of a motion relative to its noise: with less, the noise of the regressor would attenuate the result
by more than a tenth.
"""

_FEWEST = 8


class TrackedFrames(NamedTuple):
    """n frames: time (n,), values and valid (n, m); `steady` (n,) is true if no sensor is fading."""

    time: Times
    values: Floats
    valid: Booleans
    steady: Booleans

    def then(self, other: TrackedFrames) -> TrackedFrames:
        """Return these rows followed by the others."""
        return TrackedFrames(
            np.concatenate([self.time, other.time]),
            np.concatenate([self.values, other.values]),
            np.concatenate([self.valid, other.valid]),
            np.concatenate([self.steady, other.steady]),
        )

    def part(self, rows: slice) -> TrackedFrames:
        """Return some of the rows."""
        return TrackedFrames(self.time[rows], self.values[rows], self.valid[rows], self.steady[rows])


class SegmentMoments(NamedTuple):
    """Moments of k segments: their ends (k,) ns, the axes present (k, m), those that `moved` (k, m) enough to determine
    more than a bias; sums of products of 1, signal and the effect of a delay (k, m, 3, 3), and of these with the
    residual (k, m, 3); all zero without information.
    """

    end_ns: Times
    present: Booleans
    moved: Booleans
    products: Floats
    residual: Floats

    def part(self, segments: slice) -> SegmentMoments:
        """Some of the segments."""
        return SegmentMoments(
            self.end_ns[segments],
            self.present[segments],
            self.moved[segments],
            self.products[segments],
            self.residual[segments],
        )


def moments(rows: TrackedFrames, directions: Floats, blends: Blends) -> SegmentMoments:
    """Return the sums over each whole segment. A frame counts if it and its neighbours are steady, and if no axis that
    is present in the segment is missing in it.
    """
    count, axes = len(rows.time) // SEGMENT, len(directions)
    shape = (count, SEGMENT)
    end_ns = rows.time[SEGMENT - 1 :: SEGMENT]
    if not count:
        none = np.zeros((0, axes), bool)
        return SegmentMoments(end_ns, none, none, np.zeros((0, axes, 3, 3)), np.zeros((0, axes, 3)))
    time_s = ((rows.time - rows.time[0]) * 1e-9).reshape(shape)
    valid, steady = rows.valid.reshape(*shape, axes), rows.steady.reshape(shape)
    present = np.asarray((valid & steady[:, :, None]).any(axis=1))
    used = steady & (valid | ~present[:, None, :]).all(axis=2)
    values = np.where(valid, rows.values.reshape(*shape, axes), 0.0)
    result = [blends.of(some) for some in present]
    gain = np.array([np.zeros((3, axes)) if blend is None else blend.gain for blend in result])
    noise = np.array([np.zeros(axes) if blend is None else blend.along for blend in result])
    triads = values @ gain.transpose(0, 2, 1)
    passed_s = np.maximum(time_s[:, 2:] - time_s[:, :-2], 1e-9)
    used = used[:, 1:-1] & used[:, :-2] & used[:, 2:] & (passed_s <= GAP_S)
    late = -(triads[:, 2:] - triads[:, :-2]) / passed_s[:, :, None] @ directions.T
    along = triads[:, 1:-1] @ directions.T
    moved, products, residual = _sums(along, late, values[:, 1:-1] - along, used, noise, passed_s.mean(axis=1))
    known = np.array([np.zeros(axes, bool) if blend is None else blend.seen for blend in result])
    known &= (used.sum(axis=1) >= _FEWEST)[:, None]
    return SegmentMoments(end_ns, present, moved, products * known[:, :, None, None], residual * known[:, :, None])


def _sums(
    along: Floats, late: Floats, residual: Floats, used: Booleans, noise: Floats, passed_s: Floats
) -> tuple[Booleans, Floats, Floats]:
    """Return which axes moved (k, m), and sums over the `used` frames (k, n) of each segment: products of 1, signal and
    effect of a delay (k, m, 3, 3), and of these with the residual (k, m, 3).

    A signal with little motion compared with its `noise` (k, m) is replaced by its mean, a slope by zero.
    """
    item = used[:, :, None].astype(float)
    count = np.maximum(item.sum(axis=1), 1.0)
    mean = (along * item).sum(axis=1) / count
    moving = ((along - mean[:, None]) ** 2 * item).sum(axis=1) > _ENOUGH * count * noise**2
    along = np.where(moving[:, None], along, mean[:, None])
    jitter = 2 * (noise / passed_s[:, None]) ** 2
    rising = (late**2 * item).sum(axis=1) > _ENOUGH * count * jitter
    late = np.where(rising[:, None], late, 0.0)
    terms = (np.broadcast_to(item, along.shape), along * item, late * item if rising.any() else None)
    products, with_residual = np.zeros((*moving.shape, 3, 3)), np.zeros((*moving.shape, 3))
    for row, term in enumerate(terms):
        if term is None:
            continue
        with_residual[..., row] = _inner(term, residual)
        for column, other in enumerate((None, along, late)[: row + 1]):
            sums = term.sum(axis=1) if other is None else _inner(term, other)
            products[..., row, column] = products[..., column, row] = sums
    return moving, products, with_residual


def _inner(first: Floats, second: Floats) -> Floats:
    """Return the sums (k, m) of the products of two arrays (k, n, m)."""
    return np.asarray(np.einsum("knm,knm->km", first, second))


MEMORY_S = 20.0
"""Memory of the bias at rest."""

BIAS_PRIOR, SCALE_PRIOR = 0.05, 0.01
"""Standard deviations at the start: of the difference of two biases relative to the lowest range, and of two scales."""

_WALK_PER_S = 0.01
"""Random walk of scale and delay in a second, in standard deviations at the start."""

_ONE = np.eye(3)

_DOUBT = 1.0
"""Multiple of its variance that is subtracted from the square of a scale or delay before it is used."""


@dataclass(frozen=True)
class Relative:
    """The difference of one axis from the blend of the array: `bias_si`, relative `scale` and `delay_s`, each with its
    standard error. Only differences between two axes are meaningful.
    """

    label: str
    bias_si: float
    bias_sem_si: float
    scale: float
    scale_sem: float
    delay_s: float
    delay_sem_s: float

    def sentence(self, quantity: str) -> str:
        """Return for example "BMA3 x relative to the blend: +12.300 +- 0.400 mg, +0.12 +- 0.05 %"; `quantity` as in a
        log. A scale or delay below two standard errors is omitted.
        """
        factor, unit = READABLE_SI[quantity]
        words = [f"{factor * self.bias_si:+.3f} +- {factor * self.bias_sem_si:.3f} {unit}"]
        for value, sem, scale, name in (
            (self.scale, self.scale_sem, 1e2, "%"),
            (self.delay_s, self.delay_sem_s, 1e3, "ms"),
        ):
            if abs(value) > 2 * sem:
                words.append(f"{scale * value:+.2f} +- {scale * sem:.2f} {name}")
        return f"{self.label} relative to the blend: {', '.join(words)}"


@dataclass(frozen=True)
class DifferenceStates:
    """States of n frames: frame i has `differences[which[i]]` (k, m, 3): bias, scale, delay of each axis, with the
    `covariances` (k, m, 3, 3) of each axis's own part of them, as if the errors of axes were independent.
    """

    which: npt.NDArray[np.intp]
    differences: Floats
    covariances: Floats

    def variances(self, frames: npt.NDArray[np.intp], along: Floats, slope: Floats) -> Floats:
        """Return the variance (k, m) of the corrections of these frames at signals `along` (k, m) with `slope`
        (k, m).
        """
        terms = np.stack([np.ones_like(along), along, -slope], axis=-1)
        return np.asarray(np.einsum("kmi,kmij,kmj->km", terms, self.covariances[self.which[frames]], terms))


class Tracker:
    """Estimates the differences between the axes of an array over consecutive blocks."""

    def __init__(self, axes: Sequence[Axis], weights: Floats, noise: Floats) -> None:
        """`weights` and `noise` (m,): the blend in which all axes are used."""
        self._axes, self._rows = axes, directions(axes)
        self._blends = Blends(self._rows, weights, noise)
        count = len(axes)
        self._whole = whole = self._blends.of(np.ones(count, bool))
        bandwidths = np.array([axis.bandwidth_hz or UNKNOWN_BANDWIDTH_HZ for axis in axes])
        bias = np.full(count, BIAS_PRIOR * min(axis.range_si for axis in axes))
        delay_s = 1 / (math.sqrt(2) * math.pi * bandwidths)
        # Two axes share a difference.
        own = np.stack([bias, np.full(count, SCALE_PRIOR), delay_s], axis=1) ** 2 / 2
        self._prior = np.zeros((count, 3)) if whole is None else whole.apart**2 @ own
        self._share = np.ones(count) if whole is None else np.where(whole.seen, whole.share, 1.0)
        self._bias_step = np.zeros(count) if whole is None else whole.variance / SEGMENT / MEMORY_S**2
        self._differences = np.zeros((count, 3))
        self._covariances = self._prior[:, :, None] * np.eye(3)
        self._end_ns: int | None = None
        self._held: TrackedFrames | None = None

    def relative(self) -> list[Relative]:
        """Return the current estimate of the difference of each axis from the blend."""
        errors = np.sqrt(np.diagonal(self._covariances, axis1=1, axis2=2))
        return [
            Relative(axis.label, *(float(figure) for pair in zip(result, error, strict=True) for figure in pair))
            for axis, result, error in zip(self._axes, self._differences, errors, strict=True)
        ]

    def follow(self, block: TrackedFrames) -> DifferenceStates:
        """Return the states at each frame of the next block."""
        joined = block if self._held is None else self._held.then(block)
        begin, whole = len(joined.time) - len(block.time), len(joined.time) // SEGMENT * SEGMENT
        segments = moments(joined.part(slice(whole)), self._rows, self._blends)
        self._held = joined.part(slice(whole, None))
        which = np.arange(begin, len(joined.time)) // SEGMENT
        return DifferenceStates(which, *self._corrections(*self._learn(segments)))

    def _corrections(self, differences: Floats, covariances: Floats) -> tuple[Floats, Floats]:
        """Return the differences (k, m, 3) for corrections, and their covariances (k, m, 3, 3) as in
        `DifferenceStates`.

        A scale or delay that is not significant is reduced, or set to zero, so that sensors that agree do not get
        worse; the bias changes with it, and the covariance includes the omitted part.
        """
        if self._whole is None:
            return differences, covariances
        doubt = _DOUBT * np.diagonal(covariances, axis1=2, axis2=3)[..., 1:]
        share = np.minimum(doubt / np.maximum(differences[..., 1:] ** 2, 1e-300), 1.0)
        less = -share * differences[..., 1:]
        # The covariance of scale and delay; that of an axis without a visible difference is zero.
        own = covariances[..., 1:, 1:] + np.where(self._whole.seen, 0.0, 1.0)[:, None, None] * np.eye(2)
        known = np.linalg.solve(own, less[..., None])[..., 0]
        bias = (covariances[..., 0, 1:] * known).sum(axis=-1, keepdims=True)
        omitted = np.concatenate([bias, less], axis=-1)
        result = differences + omitted
        result = result - self._whole.level(result)
        covariances = covariances + omitted[..., :, None] * omitted[..., None, :]
        return result, covariances / self._share[:, None, None]

    def _learn(self, segments: SegmentMoments) -> tuple[Floats, Floats]:
        """Update the filters by k segments; return differences (k + 1, m, 3) and covariances (k + 1, m, 3, 3) before,
        between and after them.
        """
        count, present = len(segments.end_ns), segments.present
        passed_s = np.diff(segments.end_ns, prepend=segments.end_ns[:1] if self._end_ns is None else self._end_ns)
        passed_s = passed_s[:, None] * 1e-9
        walks = self._prior * _WALK_PER_S**2 * passed_s[:, :, None]
        walks[:, :, 0] = self._bias_step * passed_s**2
        changes = np.flatnonzero((present[1:] != present[:-1]).any(axis=1)) + 1
        differences, covariances = [self._differences[None]], [self._covariances[None]]
        for first, last in pairwise([0, *changes.tolist(), count] if count else []):
            run, blend = slice(first, last), self._blends.of(present[first])
            states = _track((differences[-1][-1], covariances[-1][-1]), segments.part(run), walks[run], blend)
            for rows, some in zip((differences, covariances), states, strict=True):
                rows.append(some[1:])
        self._differences, self._covariances = differences[-1][-1], covariances[-1][-1]
        self._end_ns = int(segments.end_ns[-1]) if count else self._end_ns
        return np.concatenate(differences), np.concatenate(covariances)


def _track(
    before: tuple[Floats, Floats], segments: SegmentMoments, walks: Floats, blend: Blend | None
) -> tuple[Floats, Floats]:
    """Return differences (k + 1, m, 3) and covariances (k + 1, m, 3, 3) over segments in which the same axes are
    present, at first those `before`. All states walk, by variances `walks` (k, m, 3), before a segment updates them.
    """
    axes = len(before[0])
    if blend is None:  # such segments have no information
        through = turned = np.zeros((axes, axes))
        weights = np.ones(axes)
    else:
        through, turned = blend.through, blend.turned
        weights = 1 / np.where(blend.seen, blend.variance, 1.0)
    compiled = track_differences(
        before, (segments.products, segments.residual, segments.moved), walks, (through, turned, weights)
    )
    if compiled is not None:
        return compiled
    differences, covariances = [before[0]], [before[1]]
    for moved, products, residual, walk in zip(*segments[2:], walks, strict=True):
        difference, covariance = differences[-1], covariances[-1] + walk[:, :, None] * _ONE
        if blend is not None and products.any():
            # The residual is against the blend of the axes present, which differs from that of all as known before.
            shift = blend.level(difference) - difference
            residual = residual + (products @ shift[:, :, None])[..., 0]
            gain, covariance = _updated(covariance, products * weights[:, None, None], moved)
            difference = difference + (gain @ (residual * weights[:, None])[:, :, None])[..., 0]
        differences.append(difference)
        covariances.append(covariance)
    return np.array(differences), np.array(covariances)


def _updated(covariances: Floats, information: Floats, moved: Booleans) -> tuple[Floats, Floats]:
    """Return the gains (m, 3, 3) and the updated covariances (m, 3, 3).

    For an axis that has not `moved` (m,) only the bias is estimated, with scale and delay uncertain (Schmidt's filter),
    so that a bias that drifts at rest is not mistaken for a scale.
    """
    best = np.linalg.solve(_ONE + covariances @ information, covariances)
    gain = best if moved.all() else best * np.stack([np.ones_like(moved), moved, moved], axis=1)[:, :, None]
    kept = _ONE - gain @ information
    after = kept @ covariances @ kept.transpose(0, 2, 1) + gain @ information @ gain.transpose(0, 2, 1)
    return np.asarray(gain), np.asarray((after + after.transpose(0, 2, 1)) / 2)
