"""What a clipped axis still says: that its reading would have been beyond the end of the range.

The unknowns and the reading that was not to be had are jointly normal before; given that the reading lies beyond a
bound it is a truncated normal, and the unknowns follow it by linear regression. Mean and covariance of that are exact
for one clipped axis; several are taken one after the other, each time with a normal of the same mean and covariance
(assumed density filtering; Maybeck, "Stochastic models, estimation and control", volume 2, 1982, section 12.7).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import erfcx

Floats = npt.NDArray[np.float64]

_FAR = 50.0
"""Standard deviations beyond which the tail's variance is taken from its asymptotic series."""


class Clipped(NamedTuple):
    """c clipped axes of n frames: `rows` (c, k) of the unknowns; `known` (n, k, c), how the slow errors of the axes in
    use, as the gain turns them into unknowns, go with those of the clipped ones; `own` (n, c, c) covariance of their
    slow errors and noise; `bounds` (n, c) less expected slow errors, and `signs` (n, c) of the end they stand at.
    """

    rows: Floats
    known: Floats
    own: Floats
    bounds: Floats
    signs: Floats


def truncated(distance: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of a standard normal that is known to be above `distance`, any sign.

    Johnson, Kotz, Balakrishnan, "Continuous univariate distributions", volume 1, 1994, section 13.10.1.
    """
    with np.errstate(over="ignore"):
        mean = np.sqrt(2 / np.pi) / erfcx(distance / np.sqrt(2))
    far = np.maximum(distance, _FAR)
    variance = np.where(distance > _FAR, 1 / far**2 - 6 / far**4, 1 - mean * (mean - distance))
    return mean, np.clip(variance, 0.0, 1.0)


def censored(unknowns: Floats, covariance: Floats, clipped: Clipped) -> tuple[Floats, Floats]:
    """`unknowns` (n, k) and their covariance (n, k, k) with what clipped axes say."""
    count = unknowns.shape[1]
    mean = np.concatenate([unknowns, unknowns @ clipped.rows.T], axis=1)
    joint = _joint(covariance, clipped)
    for index in range(len(clipped.rows)):
        place = count + index
        sign, spread = clipped.signs[:, index], np.sqrt(np.maximum(joint[:, place, place], 1e-300))
        distance = sign * (clipped.bounds[:, index] - mean[:, place]) / spread
        moved, left = truncated(distance)
        gain = joint[:, :, place] / spread[:, None]
        mean = mean + gain * (sign * moved)[:, None]
        joint = joint - gain[:, :, None] * gain[:, None, :] * (1 - left)[:, None, None]
    return mean[:, :count], joint[:, :count, :count]


def _joint(covariance: Floats, clipped: Clipped) -> Floats:
    """(n, k + c, k + c) covariance of the unknowns and of the readings that the clipped axes would have given."""
    rows = clipped.rows
    across = covariance @ rows.T - clipped.known
    shared = rows @ clipped.known
    own = rows @ covariance @ rows.T - shared - np.swapaxes(shared, 1, 2) + clipped.own
    top = np.concatenate([covariance, across], axis=2)
    return np.concatenate([top, np.concatenate([np.swapaxes(across, 1, 2), own], axis=2)], axis=1)
