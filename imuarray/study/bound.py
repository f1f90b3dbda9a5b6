"""How well any estimator can know what the box feels: the Bayesian Cramer-Rao bound of an array whose errors are known
in law.

Reading i of axis k is ``d_k . u(t_i) + c_k(t_i) + w_k(t_i)``. About u, anything may happen from frame to frame (a flat
prior, independent in time); the slow errors c are jointly normal, the noise w is white. All is linear and normal, so
the bound (Van Trees, Detection, Estimation, and Modulation Theory, Part I, 1968, section 2.4) is the posterior
covariance itself, and it is reached.

With noise whitened, N = R^-1/2, the columns of V an orthonormal basis of what N D can't reach (the parity space: m - 3
directions), and G = (D' R^-1 D)^-1 D' R^-1 the weights of one frame alone::

    y = V' N z = V' N c + unit noise           tells of c whatever u is, and nothing else does
    cov u(t)   = (D' R^-1 D)^-1 + G cov(c(t) | y) G'

for G w and V' N w are uncorrelated. Over a stretch in which c stays as it is, L frames of y are as good as their mean
with noise 1 / L: the white noise is aggregated without loss, whatever the log's rate. c at all stretches is one normal
vector (T m,), conditioned on one stretch after the other by dense linear algebra; no state-space form, no filter.

Causal: at each stretch after its own readings (all of them, so that the bound is below what a filter reaches within
it); smoothed: after all readings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.errors import FusionError

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SlowError:
    """``loading x(t)`` on the m axes, x ~ N(0, 1) at any time, loading (m,) in SI: on one axis its own, on several one
    that they share.

    x forgets itself as ``exp(-|t| / time_constant_s)`` (first-order Gauss-Markov; inf: a constant, as turn-on). With
    `per_degc` it is a slope: x times the temperature's distance from that reference, in degC.
    """

    loading: Floats
    time_constant_s: float = math.inf
    per_degc: float | None = None


@dataclass(frozen=True)
class ErrorLaw:
    """The law of m axes of one quantity: directions_box (m, 3) unit vectors, noise_si (m,) white noise of a reading
    (rounding in it), and their slow errors, independent of each other.
    """

    directions_box: Floats
    noise_si: Floats
    slow: tuple[SlowError, ...] = ()


@dataclass(frozen=True)
class Seen:
    """`frames` frames of one stretch in which the same axes `known` (m,) had a reading; `mean_si` (m,), if wanted, the
    mean of what they read.
    """

    known: Flags
    frames: int
    mean_si: Floats | None = None


@dataclass(frozen=True)
class Stretch:
    """Frames about `time_s` in which slow errors are taken as constant, at a temperature."""

    time_s: float
    seen: tuple[Seen, ...]
    temperature_degc: float = 25.0


@dataclass(frozen=True)
class Bound:
    """Covariances of what is known of u, means over the frames of each of T stretches: causal and smoothed (T, 3, 3)
    in SI; `frames` (T,). What is known of the slow errors: their posterior means (T, m), zero if no readings came.
    """

    causal: Floats
    smoothed: Floats
    frames: npt.NDArray[np.int64]
    slow_causal: Floats
    slow_smoothed: Floats

    @property
    def causal_rms(self) -> Floats:
        """(3,) the least rms error about each box axis of an estimator that does not see the future."""
        return _rms(self.causal, self.frames)

    @property
    def smoothed_rms(self) -> Floats:
        """(3,) the least rms error of any estimator."""
        return _rms(self.smoothed, self.frames)


def bound(law: ErrorLaw, stretches: Sequence[Stretch]) -> Bound:
    """The bound over a log; FusionError if the axes known in some frame don't span space."""
    axes, count = len(law.noise_si), len(stretches)
    covariance = slow_covariance(law, stretches)
    mean = np.zeros(count * axes)
    causal, past = np.empty((count, 3, 3)), np.empty((count, axes))
    for number, stretch in enumerate(stretches):
        here = slice(number * axes, (number + 1) * axes)
        for seen in stretch.seen:
            _condition(covariance, mean, here, law, seen)
        causal[number] = _of_motion(law, stretch.seen, covariance[here, here])
        past[number] = mean[here]
    blocks = [slice(k * axes, (k + 1) * axes) for k in range(count)]
    smoothed = [_of_motion(law, stretch.seen, covariance[b, b]) for b, stretch in zip(blocks, stretches, strict=True)]
    frames = np.array([sum(seen.frames for seen in stretch.seen) for stretch in stretches])
    return Bound(causal, np.array(smoothed), frames, past, mean.reshape(count, axes))


def slow_covariance(law: ErrorLaw, stretches: Sequence[Stretch]) -> Floats:
    """(T m, T m) prior covariance of the slow errors, stretch after stretch."""
    time_s = np.array([stretch.time_s for stretch in stretches])
    degc = np.array([stretch.temperature_degc for stretch in stretches])
    size = len(time_s) * len(law.noise_si)
    total = np.zeros((size, size))
    for slow in law.slow:
        kernel = np.exp(-np.abs(time_s[:, None] - time_s) / slow.time_constant_s)
        if slow.per_degc is not None:
            kernel *= np.outer(degc - slow.per_degc, degc - slow.per_degc)
        total += np.kron(kernel, np.outer(slow.loading, slow.loading))
    return total


def frame_weights(law: ErrorLaw, known: Flags) -> tuple[Floats, Floats]:
    """The weights G (3, m) of one frame alone, zero for axes without a reading, and its covariance (3, 3); FusionError
    if the axes don't span space.
    """
    rows = law.directions_box / law.noise_si[:, None] * known[:, None]
    normal = rows.T @ rows
    if not np.linalg.cond(normal) < 1e9:
        raise FusionError(f"{int(known.sum())} of {len(known)} axes known in a frame: they don't span space")
    covariance: Floats = np.asarray(np.linalg.inv(normal), float)
    return np.asarray(covariance @ rows.T / law.noise_si), covariance


def _condition(covariance: Floats, mean: Floats, here: slice, law: ErrorLaw, seen: Seen) -> None:
    """Take in what the parity space of some frames tells, in place."""
    whitened = law.directions_box[seen.known] / law.noise_si[seen.known, None]
    basis = np.linalg.svd(whitened)[0][:, 3:]
    if seen.frames == 0 or basis.shape[1] == 0:
        return
    parity = np.zeros((basis.shape[1], len(law.noise_si)))
    parity[:, seen.known] = basis.T / law.noise_si[seen.known]
    cross = covariance[:, here] @ parity.T
    expected = parity @ cross[here] + np.eye(len(parity)) / seen.frames
    gain = np.linalg.solve(expected, cross.T).T
    if seen.mean_si is not None:
        read = np.where(seen.known, seen.mean_si, 0.0)
        mean += gain @ (parity @ (read - mean[here]))
    covariance -= gain @ cross.T


def _of_motion(law: ErrorLaw, several: Sequence[Seen], slow: Floats) -> Floats:
    """(3, 3) covariance of u, a mean over the frames, where that of the slow errors is `slow` (m, m)."""
    total = np.zeros((3, 3))
    for seen in several:
        weights, alone = frame_weights(law, seen.known)
        total += seen.frames * (alone + weights @ slow @ weights.T)
    return np.asarray(total / max(sum(seen.frames for seen in several), 1))


def _rms(covariances: Floats, frames: npt.NDArray[np.int64]) -> Floats:
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    return np.asarray(np.sqrt(frames @ variances / frames.sum()))
