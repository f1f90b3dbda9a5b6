"""The blend of measuring ranges: inverse-variance weights; the low range fades out, the rest keeps its level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats
from imuarray.fuse.frames import Axis, Estimate, Frames, directions, entries
from imuarray.fuse.least_squares import SlowErrors, frame_gains, solve_frames, weighted
from imuarray.fuse.techniques.ranges.fading import Fading, has_low_range
from imuarray.fuse.techniques.ranges.relative import GAP_S, DifferenceStates, TrackedFrames, Tracker
from imuarray.fuse.techniques.technique import WORTH_WEIGHING, FixedWeights, Technique, known_noise_of

FOLLOWED_PERIODS = 3
"""Longest time between two frames from which the slope of the motion is computed, in periods of the sensors' bandwidth.
"""


def ranges(axes: Sequence[Axis]) -> Technique:
    """Return a `RangeBlend`: low and high measuring ranges blended by inverse variance (paper, section 2.3; there of
    one design, here also of designs with one range each).
    """
    return RangeBlend(axes)


class RangeBlend:
    """Weights by `range_weights`; a low range fades out before its end and returns when it has settled (`Fading`).

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
        share = self._fading(frames, solve_frames(frames.values, wide, self._rows) @ self._rows.T)
        weights = self._weights * share * frames.valid
        steady = np.asarray((share == 1).all(axis=1))
        states = self.tracker.follow(TrackedFrames(frames.time, frames.values, frames.valid, steady))
        bias, scale, delay = np.moveaxis(states.differences, -1, 0)[:, states.which]
        level = (frames.values - bias) / (1 + scale)
        first = solve_frames(level, weights, self._rows)
        slope = self._slope(frames.time, first)
        level += delay / (1 + scale) * (slope @ self._rows.T)
        estimate = weighted(level, weights, self._rows, self._noise, self._slow)
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
