"""What each axis reads otherwise than the blend of all: a bias, a scale and a delay, tracked while all are trusted.

Of an axis along ``r`` the residual against the blend B of all axes is ::

    value - r.B = bias + scale (r.B) - delay d(r.B)/dt + noise

A Kalman filter for each axis follows the three. Rows are gathered in segments of `SEGMENT` frames, counted from the
first; a frame is corrected by what the segments before its own have told. Bias, scale and delay walk at random, the
bias so that the filter's memory is `MEMORY_S` at rest. Motion tells scale and delay; a segment without enough of it
tells the bias alone, and at the start the scales of two axes differ by 0 +- 1 %, their delays by 0 +- that of a
second-order low-pass of their bandwidth, ``1 / (sqrt(2) pi bandwidth)``. Weighted by the blend, the residuals add up to
nothing: only differences between axes can be seen, and the blend's own level is kept. While a sensor is out nothing is
learned; what was known stays, and grows uncertain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.techniques.ranges.blends import Blends
from imuarray.fuse.techniques.ranges.fading import UNKNOWN_BANDWIDTH_HZ
from imuarray.fuse.techniques.ranges.moments import SEGMENT, Moments, Rows, moments
from imuarray.units import READABLE_SI

MEMORY_S = 20.0
"""How far back the bias looks."""

BIAS_PRIOR, SCALE_PRIOR = 0.05, 0.01
"""Standard deviations at the start: of the difference of two biases as a share of the lowest range, of two scales."""

_WALK_PER_S = 0.01
"""Random walk of scale and delay in a second, in standard deviations at the start."""

_DOUBT = 1.0
"""Times its variance that is taken from the square of a scale or delay before it is used."""


@dataclass(frozen=True)
class Relative:
    """How one axis differs from the blend of the array: `bias_si`, `scale` (a share) and `delay_s` (it is late by so
    much), each with its standard error. Differences between two axes are what has a meaning.
    """

    label: str
    bias_si: float
    bias_sem_si: float
    scale: float
    scale_sem: float
    delay_s: float
    delay_sem_s: float

    def sentence(self, quantity: str) -> str:
        """ "BMA3 x beside the blend: +12.300 +- 0.400 mg, +0.12 +- 0.05 %"; `quantity` as in the log.

        A scale or a delay that is told from none by less than two standard errors is not said.
        """
        factor, unit = READABLE_SI[quantity]
        words = [f"{factor * self.bias_si:+.3f} +- {factor * self.bias_sem_si:.3f} {unit}"]
        for value, sem, scale, name in (
            (self.scale, self.scale_sem, 1e2, "%"),
            (self.delay_s, self.delay_sem_s, 1e3, "ms"),
        ):
            if abs(value) > 2 * sem:
                words.append(f"{scale * value:+.2f} +- {scale * sem:.2f} {name}")
        return f"{self.label} beside the blend: {', '.join(words)}"


@dataclass(frozen=True)
class States:
    """What held in each of n frames: frame i has `differences[which[i]]` (k, m, 3): bias, scale, delay of each axis,
    with `covariances` (k, m, 3, 3) of each axis' own share of them, as if the errors of axes were independent.
    """

    which: npt.NDArray[np.intp]
    differences: Floats
    covariances: Floats

    def variances(self, frames: npt.NDArray[np.intp], along: Floats, slope: Floats) -> Floats:
        """(k, m) variance of the corrections of these frames at signals `along` (k, m) with `slope` (k, m)."""
        terms = np.stack([np.ones_like(along), along, -slope], axis=-1)
        return np.asarray(np.einsum("kmi,kmij,kmj->km", terms, self.covariances[self.which[frames]], terms))


class Tracker:
    """The differences between the axes of an array; fed with consecutive blocks."""

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
        self._held: Rows | None = None

    def relative(self) -> list[Relative]:
        """How each axis differs from the blend, as far as is known by now."""
        errors = np.sqrt(np.diagonal(self._covariances, axis1=1, axis2=2))
        return [
            Relative(axis.label, *(float(figure) for pair in zip(found, error, strict=True) for figure in pair))
            for axis, found, error in zip(self._axes, self._differences, errors, strict=True)
        ]

    def follow(self, block: Rows) -> States:
        """What was known at each frame of the next block."""
        joined = block if self._held is None else self._held.then(block)
        begin, whole = len(joined.time) - len(block.time), len(joined.time) // SEGMENT * SEGMENT
        differences, covariances = [self._differences], [self._covariances]
        for told in moments(joined.part(slice(whole)), self._rows, self._blends):
            self._learn(told)
            differences.append(self._differences)
            covariances.append(self._covariances)
        self._held = joined.part(slice(whole, None))
        which = np.arange(begin, len(joined.time)) // SEGMENT
        return States(which, *self._corrections(np.array(differences), np.array(covariances)))

    def _corrections(self, differences: Floats, covariances: Floats) -> tuple[Floats, Floats]:
        """The differences (k, m, 3) as they are corrected, and their covariances (k, m, 3, 3) as `States` has them.

        A scale or delay that is hardly told from none counts for less, or nothing, so that sensors that agree lose
        nothing; the bias is then what goes with it, and what was left out is in the covariance.
        """
        if self._whole is None:
            return differences, covariances
        doubt = _DOUBT * np.diagonal(covariances, axis1=2, axis2=3)[..., 1:]
        share = np.minimum(doubt / np.maximum(differences[..., 1:] ** 2, 1e-300), 1.0)
        less = -share * differences[..., 1:]
        # The covariance of scale and delay; of an axis that can't be seen there is none.
        own = covariances[..., 1:, 1:] + np.where(self._whole.seen, 0.0, 1.0)[:, None, None] * np.eye(2)
        told = np.linalg.solve(own, less[..., None])[..., 0]
        bias = (covariances[..., 0, 1:] * told).sum(axis=-1, keepdims=True)
        left_out = np.concatenate([bias, less], axis=-1)
        found = differences + left_out
        found = found - self._whole.level(found, self._rows)
        covariances = covariances + left_out[..., :, None] * left_out[..., None, :]
        return found, covariances / self._share[:, None, None]

    def _learn(self, told: Moments) -> None:
        """One step of the filters: everything walks, then the segment is taken in."""
        passed_s = 0.0 if self._end_ns is None else (told.end_ns - self._end_ns) * 1e-9
        self._end_ns = told.end_ns
        walk = self._prior * _WALK_PER_S**2 * passed_s
        walk[:, 0] = self._bias_step * passed_s**2
        self._covariances = self._covariances + walk[:, :, None] * np.eye(3)
        blend = self._blends.of(told.present)
        if blend is None or not told.products.any():
            return
        # Against the blend of those present; what these differ from the blend of all is known from before.
        shift = blend.level(self._differences, self._rows) - self._differences
        residual = told.residual + np.einsum("mij,mj->mi", told.products, shift)
        weight = 1 / np.where(blend.seen, blend.variance, 1.0)[:, None]
        gain, self._covariances = _taken_in(self._covariances, told.products * weight[:, :, None], told.moved)
        self._differences = self._differences + np.einsum("mij,mj->mi", gain, residual * weight)


def _taken_in(covariances: Floats, information: Floats, moved: Flags) -> tuple[Floats, Floats]:
    """Gains (m, 3, 3) and the covariances (m, 3, 3) after them.

    Where an axis has not `moved` (m,) only the bias is told, though scale and delay are as uncertain as they are
    (Schmidt's filter): a bias that drifts at rest must not be taken for a scale.
    """
    best = np.linalg.solve(np.eye(3) + covariances @ information, covariances)
    gain = best * np.stack([np.ones_like(moved), moved, moved], axis=1)[:, :, None]
    kept = np.eye(3) - gain @ information
    after = kept @ covariances @ kept.transpose(0, 2, 1) + gain @ information @ gain.transpose(0, 2, 1)
    return np.asarray(gain), np.asarray((after + after.transpose(0, 2, 1)) / 2)
