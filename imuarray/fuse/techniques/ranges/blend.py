"""The blend of measuring ranges: inverse-variance weights, the low range fading out, the rest staying on its level."""

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
"""Two frames further apart than this many periods of the sensors' bandwidth don't tell how the motion changes."""


def ranges(axes: Sequence[Axis]) -> Technique:
    """Low and high measuring ranges blended by inverse variance (paper, section 2.3; there of one design, here also of
    designs that have a range each): a `RangeBlend`.
    """
    return RangeBlend(axes)


class RangeBlend:
    """Weights by `range_weights`; a low range fades out before its end and comes back settled (`Fading`).

    What the axes read differently (`Tracker`) is taken out of each of them: nobody knows which of them is right, so
    that the level of the whole blend is kept, and where the low range is out the others are brought to that level. The
    corrections cancel in the weighted mean of all axes; at the hand-over they leave no step. They stay as long as the
    low range is out: the last is the best known, though the covariance then holds its growing uncertainty.
    """

    def __init__(self, axes: Sequence[Axis]) -> None:
        """FusionError where the noise of an axis is not known."""
        self._rows, self._noise, self._slow = directions(axes), known_noise_of(axes), SlowErrors(axes)
        self._weights = range_weights(axes)
        self._fading = Fading(axes) if changes(axes) else None
        self.tracker = Tracker(axes, self._weights, self._noise)
        """The estimated differences between the axes (empty for an array without a low range)."""
        self._followed_s = min([GAP_S, *(FOLLOWED_PERIODS / axis.bandwidth_hz for axis in axes if axis.bandwidth_hz)])
        self._last_time = np.zeros(0, np.int64)
        self._last_triad = np.zeros((0, 3))

    def __call__(self, frames: Frames) -> Estimate:
        """The estimate of the next block."""
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
        """(n, 3) change per second over the last two frames, so that nothing of the future is needed; zero where that
        is not known, or where the motion can be another one within two frames: a delay is then left in.
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
        """(n, 6) covariance of what the corrections may be wrong, where they don't cancel: by how far the gains are
        from those of the whole blend.
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
    """(m,) Within a design of several measuring ranges each weighs by its inverse variance, a mean over its units and
    axes; so do the ranges of the designs that have but one, taken together.

    Ranges that scatter too much alike for a gain weigh as in the average, and no design gains on another of the same
    range. FusionError where the noise of an axis is not known.
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
    """The axes (indices) of every design of several ranges, and those of all other designs together."""
    ranges_of: dict[str, set[float]] = {}
    for axis in axes:
        ranges_of.setdefault(axis.chip, set()).add(axis.range_si)
    families: dict[str, list[int]] = {}
    for index, axis in enumerate(axes):
        families.setdefault(axis.chip if len(ranges_of[axis.chip]) > 1 else "", []).append(index)
    return list(families.values())


def changes(axes: Sequence[Axis]) -> list[str]:
    """Name the sensors whose low range it fades out."""
    return list(dict.fromkeys(axis.sensor for axis in axes if has_low_range(axis, axes)))
