"""`ranges`: low and high measuring ranges blended, of one design or several, without a step at the low range's end.

`Fading` determines how far a low-range sensor may be trusted (away from the end of its range, its filter settled),
`Tracker` tracks the differences between each axis and the blend of all axes (a bias, a scale and a delay) while all of
them are trusted, and `RangeBlend` combines the two with inverse-variance weights: the low range fades out, the rest
keeps its level.

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

A low-range sensor fades near the end of the range, and until its filter has settled. A reading near the end of the
range is less linear, and one at the end is not a measurement. For some time after it the output of the sensor's
low-pass still depends on the clipped input, which was too small by up to the difference of the ranges. The response of
a second-order low-pass (damping 1/sqrt 2) to it decays at least as fast as ``exp(-sqrt(2) pi bandwidth t)``; that of a
first-order one decays faster (``exp(-2 pi bandwidth t)``). The BMA180's data sheet states a shorter time: 7.5 ms at 150
Hz (BMA-85), for which this formula gives 14 ms with an excess of 14.5 g.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.fuse.frames import Axis, Estimate, Frames, directions, entries
from imuarray.fuse.least_squares import (
    WORTH_WEIGHING,
    AxisNoise,
    FixedWeights,
    SlowErrors,
    frame_gains,
    known_noise_of,
    solve_frames,
    weighted,
    whole_gain,
)
from imuarray.kernels import track_differences
from imuarray.products import multiply_rows
from imuarray.units import READABLE_SI

TAPER = (0.75, 0.95)
"""Shares of the measuring range at which the weight of a low-range sensor begins to decrease, and at which it is zero.
"""

SETTLED = 0.1
"""Largest remaining effect of a clipped input on a settled sensor, relative to the noise of a reading."""

UNKNOWN_BANDWIDTH_HZ = 10.0
"""Assumed bandwidth of a sensor whose bandwidth is not known: the slowest low-pass of a BMA180 (BMA-81)."""

OTHER_RANGE = 0.9
"""Least share of the widest range for a range to count as equally wide: full scales of 2000 and 2048 are one range."""

_NEVER = np.iinfo(np.int64).min // 2


def widest(axes: Sequence[Axis]) -> float:
    """Return the widest measuring range of all chips."""
    return max(axis.range_si for axis in axes)


def has_low_range(axis: Axis, axes: Sequence[Axis]) -> bool:
    """Return whether another axis has a wider range."""
    return axis.range_si < OTHER_RANGE * widest(axes)


def settling_s(bandwidth_hz: float | None, excess_si: float, noise_si: float) -> float:
    """Return the seconds until the response of a second-order low-pass to an input `excess_si` beyond its range has
    decayed to `SETTLED` times the noise; at least one time constant.
    """
    decay_per_s = math.sqrt(2) * math.pi * (bandwidth_hz or UNKNOWN_BANDWIDTH_HZ)
    return max(1.0, math.log(max(excess_si, 1e-300) / (SETTLED * noise_si))) / decay_per_s


class Fading:
    """The factor (n, m) of each axis's weight, over consecutive blocks.

    The three axes of a sensor, in the order of `axes_of`, fade together, by the largest of them, smoothly to exactly
    zero at `TAPER[1]` of its range. After it was there, or clipped, or the wide ranges measured more than its range, it
    is not used for its settling time (`settling_s`), counted from the middle between the last frame out of range and
    the first one within, and fades in over another such time. The widest range never fades.

    A sensor clips before its low-pass: at a step steeper than the filter, some frames are wrong until the wide ranges,
    which are filtered too, show the excess.
    """

    def __init__(self, axes: Sequence[Axis]) -> None:
        sensors = axes[::3]
        self.fades = np.array([has_low_range(axis, axes) for axis in sensors])
        self._span = np.array([axis.range_si for axis in sensors])
        self._settling_ns = 1e9 * np.array(
            [
                settling_s(
                    axis.bandwidth_hz,
                    widest(axes) - axis.range_si,
                    min(its.noise_si or math.inf for its in axes[3 * index : 3 * index + 3]),
                )
                if fades
                else 1.0
                for index, (axis, fades) in enumerate(zip(sensors, self.fades, strict=True))
            ]
        )
        self._out_ns = np.full(len(sensors), _NEVER)
        self._was_at_end = np.zeros(len(sensors), bool)
        self._last_ns: Times | None = None

    def __call__(self, frames: Frames, expected: Floats) -> Floats:
        """Return the factors of the next block; `expected` (n, m) are the readings of each axis predicted by the wide
        ranges (NaN: unknown).
        """
        count = len(frames.time)
        if self._is_calm(frames, expected):
            self._last_ns = frames.time[-1:] if count else self._last_ns
            return np.ones(frames.values.shape)
        level = np.abs(frames.values).reshape(count, -1, 3).max(axis=2) / self._span
        beyond = (np.abs(expected).reshape(count, -1, 3) > self._span[:, None]).any(axis=2)
        at_end = np.asarray((level >= TAPER[1]) | beyond)
        if frames.clipped is not None:
            at_end |= (frames.clipped != 0).reshape(count, -1, 3).any(axis=2)
        inside = np.minimum(_smooth((TAPER[1] - level) / (TAPER[1] - TAPER[0])), self._settling_factor(frames, at_end))
        share = np.where(self.fades, np.where(at_end, 0.0, inside), 1.0)
        return np.asarray(share.repeat(3, axis=1))

    def _is_calm(self, frames: Frames, expected: Floats) -> bool:
        """Return whether no low range is, or was, near its end: all factors are one then."""
        fades = self.fades
        if self._was_at_end[fades].any() or (self._out_ns[fades] != _NEVER).any():
            return False
        if frames.clipped is not None and frames.clipped.any():
            return False
        ends = np.where(fades, self._span, np.inf).repeat(3)
        return not ((np.abs(frames.values) > TAPER[0] * ends).any() or (np.abs(expected) > ends).any())

    def _settling_factor(self, frames: Frames, at_end: Booleans) -> Floats:
        """Return the factor (n, s): 0 while a sensor settles, then rising to 1."""
        before = np.concatenate([self._was_at_end[None], at_end[:-1]])
        times = np.concatenate([frames.time[:1] if self._last_ns is None else self._last_ns, frames.time])
        returned = times[1:] - np.diff(times) // 2  # in the middle between two frames, on average
        seen = np.where(at_end, frames.time[:, None], np.where(before, returned[:, None], _NEVER))
        out_ns = np.maximum(np.maximum.accumulate(seen, axis=0), self._out_ns)
        self._out_ns, self._was_at_end, self._last_ns = out_ns[-1], at_end[-1], frames.time[-1:]
        return _smooth((frames.time[:, None] - out_ns) / self._settling_ns - 1)


def _smooth(share: Floats) -> Floats:
    """Return a cubic from 0 at 0 to 1 at 1, with zero slope at both ends and constant beyond."""
    inside = np.clip(share, 0, 1)
    return np.asarray(inside * inside * (3 - 2 * inside))


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
            self._known[key] = self._make_blend(present) if spans else None
        return self._known[key]

    def _make_blend(self, present: npt.NDArray[np.bool_]) -> Blend:
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

    def followed_by(self, other: TrackedFrames) -> TrackedFrames:
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
        """Return some of the segments."""
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
    readings = np.where(rows.valid, rows.values, 0.0).reshape(*shape, axes)
    values = np.ascontiguousarray(readings.transpose(0, 2, 1))  # sums are faster along rows of frames
    result = [blends.of(some) for some in present]
    gain = np.array([np.zeros((3, axes)) if blend is None else blend.gain for blend in result])
    noise = np.array([np.zeros(axes) if blend is None else blend.along for blend in result])
    triads = gain @ values
    passed_s = np.maximum(time_s[:, 2:] - time_s[:, :-2], 1e-9)
    used = used[:, 1:-1] & used[:, :-2] & used[:, 2:] & (passed_s <= GAP_S)
    late = directions @ ((triads[..., :-2] - triads[..., 2:]) / passed_s[:, None])
    along = directions @ triads[..., 1:-1]
    moved, products, residual = _sums(along, late, values[..., 1:-1] - along, used, noise, passed_s.mean(axis=1))
    known = np.array([np.zeros(axes, bool) if blend is None else blend.seen for blend in result])
    known &= (used.sum(axis=1) >= _FEWEST)[:, None]
    return SegmentMoments(end_ns, present, moved, products * known[:, :, None, None], residual * known[:, :, None])


def _sums(
    along: Floats, late: Floats, residual: Floats, used: Booleans, noise: Floats, passed_s: Floats
) -> tuple[Booleans, Floats, Floats]:
    """Return which axes moved (k, m), and sums over the `used` frames (k, n) of each segment: products of 1, signal and
    effect of a delay (k, m, 3, 3), and of these with the residual (k, m, 3). All series are (k, m, n).

    A signal with little motion compared with its `noise` (k, m) is replaced by its mean, a slope by zero.
    """
    item = used[:, None].astype(float)
    count = np.maximum(item.sum(axis=2), 1.0)
    mean = (along * item).sum(axis=2) / count
    apart = (along - mean[..., None]) * item
    moving = _inner(apart, apart) > _ENOUGH * count * noise**2
    along = np.where(moving[..., None], along, mean[..., None])
    jitter = 2 * (noise / passed_s[:, None]) ** 2
    late = late * item
    rising = _inner(late, late) > _ENOUGH * count * jitter
    late = np.where(rising[..., None], late, 0.0)
    terms = (np.broadcast_to(item, along.shape), along * item, late if rising.any() else None)
    products, with_residual = np.zeros((*moving.shape, 3, 3)), np.zeros((*moving.shape, 3))
    for row, term in enumerate(terms):
        if term is None:
            continue
        with_residual[..., row] = _inner(term, residual)
        for column, other in enumerate((None, along, late)[: row + 1]):
            sums = term.sum(axis=2) if other is None else _inner(term, other)
            products[..., row, column] = products[..., column, row] = sums
    return moving, products, with_residual


def _inner(first: Floats, second: Floats) -> Floats:
    """Return the sums (k, m) of the products of two arrays (k, m, n)."""
    return np.asarray(np.einsum("kmn,kmn->km", first, second))


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
        """Return variance (k, m) of the corrections of these frames at signals `along` (k, m) with `slope` (k, m)."""
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
        joined = block if self._held is None else self._held.followed_by(block)
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
            gain, covariance = _update(covariance, products * weights[:, None, None], moved)
            difference = difference + (gain @ (residual * weights[:, None])[:, :, None])[..., 0]
        differences.append(difference)
        covariances.append(covariance)
    return np.array(differences), np.array(covariances)


def _update(covariances: Floats, information: Floats, moved: Booleans) -> tuple[Floats, Floats]:
    """Return the gains (m, 3, 3) and the updated covariances (m, 3, 3).

    For an axis that has not `moved` (m,) only the bias is estimated, with scale and delay uncertain (Schmidt's filter),
    so that a bias that drifts at rest is not mistaken for a scale.
    """
    best = np.linalg.solve(_ONE + covariances @ information, covariances)
    gain = best if moved.all() else best * np.stack([np.ones_like(moved), moved, moved], axis=1)[:, :, None]
    kept = _ONE - gain @ information
    after = kept @ covariances @ kept.transpose(0, 2, 1) + gain @ information @ gain.transpose(0, 2, 1)
    return np.asarray(gain), np.asarray((after + after.transpose(0, 2, 1)) / 2)


FOLLOWED_PERIODS = 3
"""Longest time between two frames from which the slope of the motion is computed, in periods of the sensors' bandwidth.
"""


class RangeBlend:
    """Low and high measuring ranges blended by inverse variance (paper, section 2.3; there of one design, here also of
    designs with one range each), `range_weights`; a low range fades out before its end and returns when it has settled
    (`Fading`).

    The differences between the axes (`Tracker`) are removed from each of them. Which axis is right is unknown, so the
    level of the whole blend is kept, and while the low range is out the others are corrected to that level. The
    corrections cancel in the weighted mean of all axes, so that the transition has no step. While the low range is out
    the last corrections are used, and their growing uncertainty is part of the covariance.
    """

    def __init__(self, axes: Sequence[Axis]) -> None:
        """FusionError if the noise of an axis is not known."""
        self._rows, self._noise, self._slow = directions(axes), known_noise_of(axes), SlowErrors(axes)
        self._weights = range_weights(axes)
        self._fading = Fading(axes) if changes(axes) else None
        self.tracker = Tracker(axes, self._weights, self._noise)
        """The estimated differences between the axes (empty for an array without a low range)."""
        self._followed_s = min([GAP_S, *(FOLLOWED_PERIODS / axis.bandwidth_hz for axis in axes if axis.bandwidth_hz)])
        self._last_time = np.zeros(0, np.int64)
        self._last_triad = np.zeros((0, 3))

    def __call__(self, frames: Frames) -> Estimate:
        """Estimate the next block."""
        if self._fading is None:
            return FixedWeights(self._rows, self._weights, self._noise, self._slow)(frames)
        wide = self._weights * ~self._fading.fades.repeat(3) * frames.valid
        share = self._fading(frames, multiply_rows(solve_frames(frames.values, wide, self._rows), self._rows.T))
        weights = self._weights * share * frames.valid
        steady = np.asarray((share == 1).all(axis=1))
        states = self.tracker.follow(TrackedFrames(frames.time, frames.values, frames.valid, steady))
        bias, scale, delay = np.moveaxis(states.differences, -1, 0)[:, states.which]
        level = (frames.values - bias) / (1 + scale)
        first = solve_frames(level, weights, self._rows)
        slope = self._slope(frames.time, first)
        level += delay / (1 + scale) * multiply_rows(slope, self._rows.T)
        estimate = weighted(level, weights, AxisNoise(self._rows, self._noise, frames.delay_noise), self._slow)
        extra = self._uncertainty(states, weights, frames.valid, share, estimate.triad_box, slope)
        return replace(estimate, covariance_box=estimate.covariance_box + extra)

    def remarks(self, quantity: str) -> list[str]:
        """Describe how the sensors of low ranges differ from the blend of all."""
        if self._fading is None:
            return []
        fades = self._fading.fades.repeat(3)
        result = zip(self.tracker.relative(), fades, strict=True)
        return [relative.sentence(quantity) for relative, low in result if low]

    def _slope(self, time: npt.NDArray[np.int64], triad: Floats) -> Floats:
        """Return the change per second (n, 3) over the last two frames, which is causal; zero if not known, or if the
        motion may have changed within two frames: delays are then not corrected.
        """
        times, triads = np.concatenate([self._last_time, time]), np.concatenate([self._last_triad, triad])
        slope = np.zeros_like(triads)
        passed_s = (times[2:] - times[:-2])[:, None] * 1e-9
        near = passed_s <= self._followed_s
        slope[2:] = np.where(near, (triads[2:] - triads[:-2]) / np.maximum(passed_s, 1e-9), 0.0)
        self._last_time, self._last_triad = times[-2:], triads[-2:]
        return np.asarray(np.nan_to_num(slope[len(times) - len(time) :]))

    def _uncertainty(
        self, states: DifferenceStates, weights: Floats, valid: Booleans, share: Floats, triad: Floats, slope: Floats
    ) -> Floats:
        """Return the covariance (n, 6) by errors of the corrections where they do not cancel, from the difference of
        the gains from those of the whole blend.
        """
        extra = np.zeros((len(triad), 6))
        off = np.flatnonzero((share < 1).any(axis=1) & np.isfinite(triad).all(axis=1))
        if len(off):
            whole = self._weights * (valid[off] | (share[off] < 1))
            apart = frame_gains(weights[off], self._rows)[0] - frame_gains(whole, self._rows)[0]
            variance = states.variances(off, triad[off] @ self._rows.T, slope[off] @ self._rows.T)
            extra[off] = entries(np.einsum("nim,nm,njm->nij", apart, variance, apart))
        return extra


def range_weights(axes: Sequence[Axis]) -> Floats:
    """Return the weights (m,): within a design of several measuring ranges, the inverse variance of each range, a mean
    over its units and axes; likewise for the ranges of all designs with a single range together.

    Ranges with similar variances have equal weights, because weights would gain little, and designs of the same range
    have equal weights. FusionError if the noise of an axis is not known.
    """
    noise = known_noise_of(axes)
    weights = np.ones(len(axes))
    for members in _families(axes):
        spans = {axes[index].range_si for index in members}
        variance = {span: np.mean([noise[i] ** 2 for i in members if axes[i].range_si == span]) for span in spans}
        if max(variance.values()) > WORTH_WEIGHING * min(variance.values()):
            weights[members] = [1 / variance[axes[index].range_si] for index in members]
            weights[members] *= len(members) / weights[members].sum()
    return weights


def _families(axes: Sequence[Axis]) -> list[list[int]]:
    """Return the axes (indices) of every design of several ranges, and those of all other designs together."""
    ranges_of: dict[str, set[float]] = {}
    for axis in axes:
        ranges_of.setdefault(axis.chip, set()).add(axis.range_si)
    families: dict[str, list[int]] = {}
    for index, axis in enumerate(axes):
        families.setdefault(axis.chip if len(ranges_of[axis.chip]) > 1 else "", []).append(index)
    return list(families.values())


def changes(axes: Sequence[Axis]) -> list[str]:
    """Return the sensors whose low range fades out."""
    return list(dict.fromkeys(axis.sensor for axis in axes if has_low_range(axis, axes)))
