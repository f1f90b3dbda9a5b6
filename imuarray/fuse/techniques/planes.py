"""`planes`: in-plane and out-of-plane axes, weighted by measured noise and stability; the worse ones serve as a check.

Noise and slow error require different weights unless their ratios are equal. The weights minimise the error in the mean
of `AVERAGED` readings: ``noise^2 / AVERAGED + stability^2``, with the stability (from run to run and within a run) if
the calibration contains it for every axis of a design, otherwise by the noise alone. In any case the weight of the
noisier kind is limited so that one axis of each kind together are not noisier than the quieter one alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.fuse.frames import Axis, Estimate, Frames, directions
from imuarray.fuse.least_squares import (
    WORTH_WEIGHING,
    FixedWeights,
    SlowErrors,
    known_noise_of,
    solve_frames,
)
from imuarray.units import READABLE_SI

AVERAGED = 100
"""Number of readings in the mean whose error is minimised: a second at 100 Hz. With one reading the weights depend on
noise, with very many on stability."""

_REMARKABLE_SIGMAS = 3.0
"""Least difference of a reported axis, in standard errors."""

_MOST_DILUTION = 3.0
"""Largest factor from the noise of one axis to that of the comparison value, from all axes that weigh in full. With
more, no such axis lies near the direction (a flat board has none along its normal), and their small misalignments
would be compared instead.
"""

_KINDS = {True: "x and y", False: "z"}


@dataclass(frozen=True)
class Monitor:
    """An axis of lower weight, compared with the axes of full weight: the mean difference over `frames` frames in SI,
    its standard error by the scatter between frames, and the difference in standard errors (`sigmas`, which include
    the slow errors in the calibration). NaN without comparable frames.
    """

    label: str
    difference_si: float
    sem_si: float
    sigmas: float
    frames: int

    def sentence(self, quantity: str) -> str:
        """Return for example "BMA2 z differs from the in-plane axes by 3.1 mg, 8 sigma"; `quantity` as in a log."""
        if not self.frames:
            return f"{self.label} has no axis to compare with"
        factor, unit = READABLE_SI[quantity]
        kind = "out-of-plane" if self.label[-1] in "xy" else "in-plane"
        size = f"{factor * self.difference_si:.2g} {unit}, {abs(self.sigmas):.2g} sigma"
        return f"{self.label} differs from the {kind} axes by {size}"


class PlaneBlend:
    """Weights of in-plane and out-of-plane axes by noise and stability (paper, section 2.2), `plane_weights`; axes with
    a weight below 1 are compared with the result of the others.
    """

    def __init__(self, axes: Sequence[Axis]) -> None:
        """FusionError if the noise of an axis is not known."""
        self._axes, self._rows = axes, directions(axes)
        weights = plane_weights(axes)
        self._mean = FixedWeights(self._rows, weights, known_noise_of(axes), SlowErrors(axes))
        self._watched = np.flatnonzero(weights < 1 - 1e-9)
        full_rows = self._rows[weights >= 1 - 1e-9]
        self._comparable = dilution(self._rows[self._watched], full_rows) <= _MOST_DILUTION
        self._sums = np.zeros((3, len(self._watched)))

    def __call__(self, frames: Frames) -> Estimate:
        """Estimate the next block."""
        if len(self._watched):
            self._watch(frames)
        return self._mean(frames)

    def monitors(self) -> list[Monitor]:
        """Return the comparisons of the axes of lower weight."""
        watched = zip(self._watched.tolist(), self._sums.T, strict=True)
        return [self._monitor(self._axes[index], *sums) for index, sums in watched]

    def remarks(self, quantity: str) -> list[str]:
        """Describe how the axes that weigh less differ from the others, and count those that do not."""
        monitors = self.monitors()
        result = [monitor for monitor in monitors if monitor.frames]
        remarkable = [monitor for monitor in result if not abs(monitor.sigmas) < _REMARKABLE_SIGMAS]
        sentences = [monitor.sentence(quantity) for monitor in remarkable]
        if agreed := len(result) - len(remarkable):
            more = "more " if remarkable else ""
            axes = (
                f"1 {more}axis of lower weight differs"
                if agreed == 1
                else f"{agreed} {more}axes of lower weight differ"
            )
            sentences.append(f"{axes} by less than {_REMARKABLE_SIGMAS:g} sigma")
        if alone := len(monitors) - len(result):
            axes = "1 axis" if alone == 1 else f"{alone} axes"
            sentences.append(
                f"{axes} of lower weight cannot be compared: no axis of full weight lies near their direction"
            )
        return sentences

    def _watch(self, frames: Frames) -> None:
        """Add up the differences of the watched axes from the others: frames, sum, sum of squares. Stale readings are
        ignored.
        """
        full = np.ones(len(self._axes))
        full[self._watched] = 0.0
        reference = solve_frames(frames.values, full * frames.valid, self._rows)
        difference = frames.values[:, self._watched] - reference @ self._rows[self._watched].T
        comparable = np.isfinite(difference) & frames.valid[:, self._watched] & self._comparable
        if frames.stale is not None:
            comparable &= ~frames.stale[:, self._watched]
        difference = np.where(comparable, difference, 0.0)
        self._sums += np.array([comparable.sum(axis=0), difference.sum(axis=0), (difference**2).sum(axis=0)])

    def _monitor(self, axis: Axis, count: float, total: float, squares: float) -> Monitor:
        if count < 2:
            return Monitor(axis.label, math.nan, math.nan, math.nan, 0)
        mean = total / count
        sem = math.sqrt(max(squares / count - mean**2, 0.0) / (count - 1))
        slow = 0.0 if axis.stability_si is None else axis.stability_si
        tolerance = math.hypot(sem, slow)
        return Monitor(axis.label, mean, sem, mean / tolerance if tolerance > 0 else math.nan, int(count))


def dilution(watched: Floats, others: Floats) -> Floats:
    """Return the noise (k,) along `watched` directions (k, 3) of a solution from the axes `others` (m, 3), relative to
    the noise of one axis; inf where these axes do not determine it.
    """
    u, size, _ = np.linalg.svd(others.T @ others)
    with np.errstate(divide="ignore"):
        variance = np.where(size > 1e-9 * max(len(others), 1), 1 / size, np.inf)
    along = (watched @ u) ** 2
    return np.asarray(np.sqrt(np.where(along > 1e-12, along * np.where(along > 1e-12, variance, 0.0), 0.0).sum(axis=1)))


def changes(axes: Sequence[Axis]) -> list[str]:
    """Return the designs whose weights differ from those of the average, with the weights and their reason."""
    weights = plane_weights(axes)
    words = []
    for chip in sorted({axis.chip for axis in axes}):
        share = {axis.in_plane: float(weight) for axis, weight in zip(axes, weights, strict=True) if axis.chip == chip}
        worse = min(share, key=lambda kind: share[kind])
        if len(share) > 1 and not math.isclose(share[worse], 1.0):
            by = "noise and stability" if _stability(axes, chip) is not None else "noise"
            words.append(f"{chip} ({_KINDS[worse]} weigh{'s' * (not worse)} {share[worse]:.2g} of full, by {by})")
    return words


def plane_weights(axes: Sequence[Axis]) -> Floats:
    """Return the weights (m,): within a design 1 for the better kind of axis and the ratio of the mean squared errors
    for the other.

    Kinds with similar errors have the weight 1, because weights would gain little. The squares are means over the
    design's units and ranges, each relative to the three axes of its unit, so that only the plane has an effect.
    FusionError if the noise of an axis is not known.
    """
    noise = known_noise_of(axes)
    weights = np.ones(len(axes))
    for chip in {axis.chip for axis in axes}:
        stability = _stability(axes, chip)
        error = noise**2 if stability is None else noise**2 / AVERAGED + stability**2
        share = _shares(_kind_means(axes, error, chip), _kind_means(axes, noise**2, chip))
        for index, axis in enumerate(axes):
            if axis.chip == chip:
                weights[index] = share[axis.in_plane]
    return weights


def _shares(error: dict[bool, float], variance: dict[bool, float]) -> dict[bool, float]:
    """Return the weight of each kind by its squared error, limited by its variance from reading to reading.

    The variance of the mean of a quiet axis (variance 1) and one of variance k with weight r is ``(1 + r^2 k) / (1 +
    r)^2``, which is at most 1 for ``r <= 2 / (k - 1)``.
    """
    best = min(error.values())
    similar = max(error.values()) <= WORTH_WEIGHING * best
    quiet = min(variance.values())
    share = {}
    for kind, square in error.items():
        ratio = variance[kind] / quiet
        bound = 2 / (ratio - 1) if ratio > 1 else math.inf
        share[kind] = min(1.0 if similar else best / square, bound)
    return share


def _stability(axes: Sequence[Axis], chip: str) -> Floats | None:
    """Return the slow errors (m,) of a design's axes (others: zero); None if one of them is not known."""
    figures = [axis.stability_si for axis in axes if axis.chip == chip]
    if None in figures:
        return None
    return np.array([(axis.stability_si or 0.0) if axis.chip == chip else 0.0 for axis in axes])


def _kind_means(axes: Sequence[Axis], square: Floats, chip: str) -> dict[bool, float]:
    """Return the mean squares of in-plane and out-of-plane axes of a design, relative to the mean of each triad."""
    relative: dict[bool, list[float]] = {}
    for index, axis in enumerate(axes):
        if axis.chip == chip:
            triad = [square[index] for index, other in enumerate(axes) if other.sensor == axis.sensor]
            relative.setdefault(axis.in_plane, []).append(float(square[index] / np.mean(triad)))
    return {kind: float(np.mean(squares)) for kind, squares in relative.items()}
