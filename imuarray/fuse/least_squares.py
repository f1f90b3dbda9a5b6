"""Weighted least squares of axis values, frame by frame; techniques of fixed weights (`FixedWeights`), of which `mean`
is one; and a robust mean of the sensors (`consensus`).

The model is ``values = directions @ truth_box + errors``. Errors are noise and the remaining errors of a calibration:
biases, and errors of the responses times the stimulus.

The robust mean is the value on which the sensors agree before any of them has been tested for faults; a sensor that
differs much from the others has little influence on it. If all readings of a frame are near the values that their mean
predicts, it is that mean. Otherwise each sensor's difference from the median of the triads is limited, on its worst
axis, to `TOLERATED_SI` plus a multiple of the median of all differences (in a fast motion, sensors that are read in
sequence differ in proportion to the time between their readings), and the mean is that of the limited readings:
Huber's estimator of location, one step from the median (P. J. Huber, Annals of Mathematical Statistics 35, 1964). A
distant reading is limited and not discarded, so that the result does not jump when a reading passes the limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats
from imuarray.errors import FusionError
from imuarray.fuse import compiled_frames
from imuarray.fuse.frames import Axis, Estimate, Frames, directions, entries
from imuarray.products import multiply_rows
from imuarray.units import STANDARD_GRAVITY

BLOCK_BYTES = 1 << 19
"""Size in bytes of a block of counts that fits the processor's cache."""


class ConstantGain:
    """Triads from counts: ``gain @ (counts - bias)``, with the bias subtracted from the triad and not from every count.

    `gain` (3, m) in SI per count, `bias` (m,) in counts.
    """

    def __init__(self, gain: Floats, bias: Floats) -> None:
        self._gain, self._of_bias = gain, gain @ bias
        self._factors = np.ascontiguousarray(np.pad(gain.T, ((0, 0), (0, 1))))
        self._rows = max(1, BLOCK_BYTES // (8 * len(bias)))

    def __call__(self, counts: Sequence[npt.NDArray[Any]]) -> Floats:
        """Return triads (n, 3) from arrays of counts (n, k) with m columns in total."""
        compiled = compiled_frames.combine(counts, self._factors, self._of_bias)
        if compiled is not None:
            return compiled.T
        triads = np.empty((3, len(counts[0])))  # one row per axis: BLAS takes a third longer for rows of three
        for start in range(0, triads.shape[1], self._rows):
            rows = slice(start, start + self._rows)
            block = np.concatenate([part[rows] for part in counts], axis=1, dtype=np.float64)
            triads[:, rows] = self._gain @ block.T - self._of_bias[:, None]
        return triads.T


def _pairs(triads: Floats) -> Floats:
    """Return the products (16, n) of (1, X, Y, Z) of triads (n, 3) with each other."""
    ones = np.concatenate([np.ones((1, len(triads))), triads.T])
    return np.asarray((ones[:, None] * ones).reshape(16, len(triads)))


_FIRST, _SECOND = [0, 1, 2, 3, 5, 10, 15, 6, 7, 11], [0, 4, 8, 12, 5, 10, 15, 9, 13, 14]
"""Positions of 1, X, Y, Z, XX, YY, ZZ, XY, XZ, YZ among the 16 products of (1, X, Y, Z) with each other, and positions
of the same products with the factors exchanged.
"""

_TWICE = np.array([0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
"""1 for products of two different factors, which occur twice, else 0."""


class SlowErrors:
    """Remaining errors of calibrated axes, and the covariance of triads that they cause."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        m = len(axes)
        terms = np.zeros((4, 4, m, m))  # factors of the products of (1, X, Y, Z) of the stimulus
        for i, axis in enumerate(axes):
            for j, other in enumerate(axes):
                if axis.errors is not None and axis.sensor == other.sensor:
                    terms[0, 0, i, j] = axis.errors.bias_si2[axis.index, other.index]
                    terms[1:, 1:, i, j] = axis.errors.response[axis.index, :, other.index]
        self._terms = terms.reshape(16, m, m)
        self.known = bool(terms.any())
        """True if the covariance of any slow error is known."""

    def covariance(self, gains: Floats, triads: Floats) -> Floats:
        """Return covariances (n, 6) (`frames.ENTRIES`) of triads (n, 3) computed with `gains` (n, 3, m), or (1, 3, m)
        for all.
        """
        if len(gains) == 1:
            factors = entries(gains[0] @ self._terms @ gains[0].T)
            compiled = compiled_frames.quadratic(factors[_FIRST].T + factors[_SECOND].T * _TWICE, triads.T)
            if compiled is not None:
                return compiled.T
            return (factors.T @ _pairs(triads)).T
        pairs = _pairs(triads)
        errors = (pairs.T @ self._terms.reshape(16, -1)).reshape(len(triads), *self._terms.shape[1:])
        return entries(gains @ errors @ np.swapaxes(gains, 1, 2))


@dataclass(frozen=True)
class AxisNoise:
    """Noise of m axes along `rows` (m, 3): `rms` (m,) in SI, and the noise of their mean that the correction of
    delays subtracts (`Frames.delay_noise`; None: no delays).
    """

    rows: Floats
    rms: Floats
    delay_noise: npt.NDArray[np.float32] | None = None

    def covariance(self, gains: Floats, used: Booleans) -> Floats:
        """Return covariances (n, 6) by noise of triads with `gains` (n, 3, m) of the axes `used` (n, m); (1, 6) if
        there is one gain for all frames, and no delay.
        """
        scatter = np.where(used[:, None, :], gains * self.rms, 0.0)
        covariance = entries(np.einsum("nim,njm->nij", scatter, scatter))
        return covariance if self.delay_noise is None else covariance + self.by_delays(gains)

    def by_delays(self, gains: Floats) -> Floats:
        """Return the change (n, 6) of the covariances of triads with `gains` (n, 3, m), or (1, 3, m) for all, by the
        correction of delays.

        A triad becomes ``gains @ readings - M @ (noise of the slope)``, where M is the gain for readings along `rows`
        that are as large as the shares of the noise. The first shares are the weights of the frame's own readings in
        the slope.
        """
        plain = whole_gain(np.ones(len(self.rows)), self.rows) * self.rms
        if self.delay_noise is None or not np.isfinite(plain).all():
            return np.zeros((len(gains), 6))
        own, every = np.split(self.delay_noise.T, 2)  # one row per sensor, which is fastest in numpy
        together = (gains * self.rms) @ plain.T
        root = np.asarray(np.linalg.qr(plain.T, "r")).T
        if len(gains) == 1:
            each = gains[0].reshape(3, -1, 3).transpose(1, 0, 2) @ self.rows.reshape(-1, 3, 3)
            across = each @ together[0].T
            by_own = entries(across + np.swapaxes(across, 1, 2)).T @ own
            columns = ((each @ root).reshape(-1, 9).T @ every).reshape(3, 3, -1)
        else:
            of_own, of_every = (
                (gains * np.repeat(shares, 3, axis=0).T[:, None]) @ self.rows for shares in (own, every)
            )
            across = of_own @ np.swapaxes(together, 1, 2)
            by_own = entries(across + np.swapaxes(across, 1, 2)).T
            columns = np.moveaxis(of_every @ root, 0, -1)
        result = -by_own
        for row, (first, second) in zip(result, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), strict=True):
            for x, y in zip(columns[first], columns[second], strict=True):
                row += x * y
        return result.T


def weighted(values: Floats, weights: Floats, noise: AxisNoise, slow: SlowErrors | None = None) -> Estimate:
    """Solve weighted least squares for each frame, with weights (n, m), or (1, m) for all; the covariance includes the
    `noise` and the `slow` errors of the axes.
    """
    used = weights > 0
    triad, gains, solvable = _solve(values, weights, noise.rows)
    covariance = noise.covariance(gains, used[: len(gains)])
    if not solvable.all():
        covariance = np.where(solvable[:, None], covariance, np.nan)
    if slow is not None and slow.known:
        covariance = covariance + slow.covariance(gains, triad)
    return Estimate(triad, np.broadcast_to(covariance, (len(values), 6)), np.broadcast_to(used, values.shape))


def whole_gain(weights: Floats, rows: Floats) -> Floats:
    """Return the gain (3, m) of weighted least squares with weights (m,); NaN if the axes do not span space."""
    gain, solvable = frame_gains(weights[None], rows)
    return gain[0] if solvable[0] else np.full((3, len(weights)), np.nan)


def solve_frames(values: Floats, weights: Floats, rows: Floats) -> Floats:
    """Solve ``values = rows @ truth_box`` by weighted least squares for each frame: (n, 3), NaN where the axes do not
    span space.
    """
    return _solve(values, weights, rows)[0]


def _solve(values: Floats, weights: Floats, rows: Floats) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Solve as `solve_frames`; return also the gains and whether the axes span space, of every frame, or once if all
    frames have the same weights.
    """
    gains, solvable = frame_gains(_distinct(weights), rows)
    if len(gains) == 1:
        triad = multiply_rows(values, gains[0].T) if solvable[0] else np.full((len(values), 3), np.nan)
        return triad, gains, solvable
    solution = np.einsum("nim,nm->ni", gains, values)
    solution[~solvable] = np.nan
    return np.asarray(solution), gains, solvable


def gains_of(weights: Floats, rows: Floats) -> Floats:
    """Return the gains (n, 3, m) of frames with `weights` (n, m), or (1, 3, m) if all frames have the same weights."""
    return frame_gains(_distinct(weights), rows)[0]


def _distinct(weights: Floats) -> Floats:
    """Return the weights (n, m) of frames, or (1, m) if all frames have the same, which is usual."""
    return weights[:1] if len(weights) and (weights == weights[0]).all() else weights


def frame_gains(weights: Floats, rows: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the gains (n, 3, m) from axis values to a triad, and whether the weighted axes span space."""
    if len(weights) == 1:  # often the same weights as in the block before
        return _gain_of(np.asarray(weights, float).tobytes(), np.asarray(rows, float).tobytes())
    return _solve_gains(weights, rows)


@lru_cache(maxsize=64)
def _gain_of(weights: bytes, rows: bytes) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the read-only gain of one set of weights (bytes of float64)."""
    gains, solvable = _solve_gains(np.frombuffer(weights)[None], np.frombuffer(rows).reshape(-1, 3))
    gains.flags.writeable = solvable.flags.writeable = False
    return gains, solvable


def _solve_gains(weights: Floats, rows: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Solve as `frame_gains` does, for every set of weights (n, m)."""
    squares = (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), 9)
    normal: Floats = (weights @ squares).reshape(-1, 3, 3)
    solvable = spans(normal)
    normal[~solvable] = np.eye(3)
    return np.asarray(np.linalg.solve(normal, rows.T * weights[:, None])), solvable


def spans(normal: Floats) -> npt.NDArray[np.bool_]:
    """Return (...) whether axes with these normal matrices (..., 3, 3) determine a triad."""
    size = np.maximum(np.trace(normal, axis1=-2, axis2=-1), 1e-300)
    return np.asarray(np.linalg.det(normal) > 1e-9 * size**3)


TOLERATED_SI: Mapping[str, float] = MappingProxyType(
    {"specific_force": 0.25 * STANDARD_GRAVITY, "angular_rate": np.radians(2.0)}
)
"""Tolerated difference from the mean in SI, by quantity: five times the noise of an ADXL345's z axis, ten times that of
an L3G4200D. An axis with a larger bias adds a constant to the mean, which does not affect its slope.
"""

_TIMES_USUAL = 4.0

_CONSENSUS_BYTES = 1 << 18
"""Size in bytes of the readings that are processed at once, so that they and the intermediate results fit the cache."""


def consensus(values: Floats, valid: Booleans, rows: Floats, quantity: str) -> Floats:
    """Return the robust mean (n, 3) of the valid `values` (n, m) in SI of axes along `rows` (m, 3), in triads; NaN
    where they do not span space.
    """
    gains, solvable = frame_gains(np.ones((1, len(rows))), rows)
    if solvable[0] and len(values):
        sound = np.asarray(valid.all(axis=1))
        every = bool(sound.all())
        some = slice(None) if every else np.flatnonzero(sound)
        compiled = compiled_frames.find_consensus(values[some].T, rows, gains[0], TOLERATED_SI[quantity])
        if compiled is not None and every:
            return compiled.T
        if compiled is not None:
            result = np.empty((3, len(values)))
            result[:, some] = compiled
            others = np.flatnonzero(~sound)
            result[:, others] = _consensus_of(values[others], valid[others], rows, TOLERATED_SI[quantity]).T
            return result.T
    return _consensus_of(values, valid, rows, TOLERATED_SI[quantity])


def _consensus_of(values: Floats, valid: Booleans, rows: Floats, tolerated: float) -> Floats:
    """Return the `consensus` (n, 3) with NumPy."""
    mean = np.empty((3, len(values)))
    at_once = max(1, _CONSENSUS_BYTES // (8 * len(rows)))
    for start in range(0, len(values), at_once):
        part = slice(start, start + at_once)
        columns, sound = np.ascontiguousarray(values[part].T), np.ascontiguousarray(valid[part].T)
        mean[:, part] = _robust_mean(columns, sound, rows, tolerated)
    return mean.T


def _robust_mean(values: Floats, valid: Booleans, rows: Floats, tolerated: float) -> Floats:
    """Return the `consensus` (3, n) of a few frames (m, n); one row per axis is fastest in numpy."""
    mean = _mean(values, valid, rows)
    doubtful: Booleans = (np.abs(values - rows @ mean) > tolerated / 2) & valid
    if not doubtful.any():
        return mean
    whole: Booleans = valid[0::3] & valid[1::3] & valid[2::3]
    checked: Booleans = np.asarray(whole.sum(axis=0) > 2)  # two sensors don't show which one is wrong
    some = np.flatnonzero(doubtful.any(axis=0) & checked)
    if len(some):
        mean[:, some] = _limit_differences(values[:, some], valid[:, some], whole[:, some], rows, tolerated)
    return mean


def _limit_differences(values: Floats, valid: Booleans, whole: Booleans, rows: Floats, tolerated: float) -> Floats:
    """Return the mean (3, n) of the readings with the differences of sensors from their median limited."""
    inverse = np.zeros((len(rows), len(rows)))  # block diagonal of all sensors' inverses: one product for all of them
    for first, own in zip(range(0, len(rows), 3), np.linalg.inv(rows.reshape(-1, 3, 3)), strict=True):
        inverse[first : first + 3, first : first + 3] = own
    triads = (inverse @ values).reshape(-1, 3, values.shape[1])
    middle = _medians(np.where(whole[:, None], triads, np.nan))
    apart = values - rows @ middle
    usual = _medians(np.where(valid, np.abs(apart), np.nan))
    far = np.where(valid, np.abs(apart), 0.0)
    most = np.maximum(np.maximum(far[0::3], far[1::3]), far[2::3])
    share = np.minimum(1.0, (tolerated + _TIMES_USUAL * usual) / np.maximum(most, 1e-300))
    return middle + _mean(apart * np.repeat(share, 3, axis=0), valid, rows)


def _mean(values: Floats, valid: Booleans, rows: Floats) -> Floats:
    """Return least squares (3, n) of the valid ones of values (m, n), all with the same weight."""
    return solve_frames(values.T, valid.T.astype(float), rows).T


def _medians(values: Floats) -> Floats:
    """Return medians along the first axis, ignoring NaN."""
    ordered = np.sort(np.moveaxis(values, 0, -1), axis=-1)  # numpy sorts contiguous numbers faster
    if np.isfinite(ordered[..., -1]).all():  # NaN is sorted to the end
        count = len(values)
        return np.asarray((ordered[..., (count - 1) // 2] + ordered[..., count // 2]) / 2)
    known = np.isfinite(values).sum(axis=0)[..., None]
    low, high = (np.take_along_axis(ordered, middle, axis=-1) for middle in ((known - 1) // 2, known // 2))
    return np.asarray((low + high)[..., 0] / 2)


Technique = Callable[[Frames], Estimate]
"""Maps consecutive blocks of frames of one quantity to their estimates; the result does not depend on the blocks."""


@dataclass(frozen=True)
class FixedWeights:
    """A technique with the same weight (m,) of an axis in every frame in which its reading is valid; `rows` (m, 3) are
    the directions of the axes, `noise` (m,) their noise, `slow` the remaining errors of their calibrations.
    """

    rows: Floats
    weights: Floats
    noise: Floats
    slow: SlowErrors | None = None

    def __call__(self, frames: Frames) -> Estimate:
        """Solve weighted least squares of the valid axes. A frame that lacks a reading keeps the level of the whole
        array if its offsets are known: they are subtracted first, and their own weighted mean is added. An offset has
        the noise of a mean of `averaged` readings.
        """
        weights = self.weights[None] if frames.valid.all() else self.weights * frames.valid
        noise = AxisNoise(self.rows, self.noise, frames.delay_noise)
        if frames.offsets is None or frames.averaged is None:
            return weighted(frames.values, weights, noise, self.slow)
        offsets, some = np.nan_to_num(frames.offsets), np.flatnonzero(frames.averaged)
        estimate = weighted(frames.values - offsets, weights, noise)
        known = np.isfinite(frames.offsets) & (frames.averaged > 0)[:, None]
        whole = self.weights * (frames.valid | known)
        estimate.triad_box[some] += solve_frames(offsets[some], whole[some], self.rows)
        covariance = np.array(estimate.covariance_box)
        apart = (gains_of(whole[some], self.rows) - gains_of(weights[some], self.rows)) * self.noise
        covariance[some] += entries(apart @ np.swapaxes(apart, 1, 2)) / frames.averaged[some, None]
        if self.slow is not None and self.slow.known:  # errors of the whole array, because its level is kept
            covariance += self.slow.covariance(gains_of(whole, self.rows), estimate.triad_box)
        return replace(estimate, covariance_box=covariance)

    def whole(self) -> tuple[Floats, Callable[[Floats], Estimate]]:
        """Return the gain (3, m) of frames whose readings are all valid, and the function from their triads to their
        estimate.
        """
        zeros = np.zeros((1, len(self.weights)))
        alone = weighted(zeros, self.weights[None], AxisNoise(self.rows, self.noise))
        gain = whole_gain(self.weights, self.rows)

        def of(triads: Floats) -> Estimate:
            count = len(triads)
            covariance = np.broadcast_to(alone.covariance_box[0], (count, 6))
            if self.slow is not None and self.slow.known:
                covariance = covariance + self.slow.covariance(gain[None], triads)
            return Estimate(triads, covariance, np.broadcast_to(alone.used[0], (count, len(self.weights))))

        return gain, of


Maker = Callable[[Sequence[Axis]], Technique]
"""Creates a technique for the axes of one quantity; FusionError if they are not sufficient."""

WORTH_WEIGHING = 1.25
"""Least ratio of variances for inverse-variance weights; below it they would gain less than 1 % over equal weights."""


def noise_of(axes: Sequence[Axis]) -> Floats:
    """Return the noise (m,) of each axis, NaN if not known."""
    return np.array([np.nan if axis.noise_si is None else axis.noise_si for axis in axes])


def known_noise_of(axes: Sequence[Axis]) -> Floats:
    """Return the noise (m,) of each axis; FusionError if it is not known or zero."""
    for axis in axes:
        if axis.noise_si is None:
            raise FusionError(
                f"sensor {axis.sensor}: its noise is not known; run `imuarray calibrate noise` and pass the file"
            )
        if not axis.noise_si > 0:
            raise FusionError(
                f"sensor {axis.sensor} axis {'xyz'[axis.index]}: noise {axis.noise_si}: its readings never change"
            )
    return noise_of(axes)


def mean(axes: Sequence[Axis]) -> Technique:
    """Return the simple average of the literature (paper, section 2), with which the others are compared."""
    return FixedWeights(directions(axes), np.ones(len(axes)), noise_of(axes), SlowErrors(axes))
