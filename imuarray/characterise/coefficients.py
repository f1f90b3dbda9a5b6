"""Two coefficients read off an Allan curve: the density of the white noise and the floor.

For white noise of two-sided spectral density N^2 the Allan deviation is N / sqrt(tau) (IEEE Std 952, annex C: angle
random walk). Data sheets give the one-sided density, sqrt(2) N, which for white readings is std / sqrt(rate / 2). The
floor of flicker noise with the coefficient B is B sqrt(2 ln 2 / pi) = 0.664 B (the same annex: bias instability).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
import numpy.typing as npt

FLOOR = sqrt(2 * log(2) / pi)
"""Floor of the Allan deviation over the coefficient of bias instability: 0.664."""

_SPAN = 8.0
"""The slope is taken over three octaves, of which the octave grid has whole ones; about a decade."""

_SLOPE_TOLERANCES = (0.02, 0.05, 0.1)
"""Tried in turn: where some part of a curve is as straight as white noise, a part that is less so is not taken."""

_SLOPE_FREEDOM = 20.0
"""Points with less don't tell a slope of -1/2 from another."""

_FLOOR_FREEDOM = 5.0
"""Points with less scatter so far that the lowest would be a matter of chance."""


@dataclass(frozen=True)
class WhiteNoise:
    """`density` N in unit / sqrt(Hz), two-sided, and the taus between which it was read off."""

    density: float
    shortest_s: float
    longest_s: float


@dataclass(frozen=True)
class Floor:
    """`instability` B in the series' unit from the lowest point of the curve, that point's interval (as B) and its tau.

    `is_bound`: the curve still falls at its end (or rises from its start), so that the floor itself was not seen.
    """

    instability: float
    low: float
    high: float
    tau_s: float
    is_bound: bool


def white_noise(
    tau_s: npt.NDArray[np.float64], deviation: npt.NDArray[np.float64], freedom: npt.NDArray[np.float64]
) -> WhiteNoise | None:
    """White noise from the shortest three octaves of one curve (t,) that slope by -1/2; None if no sure ones do."""
    if deviation.min() <= 0:
        return None
    parts = list(_parts(tau_s, freedom))
    for tolerance in _SLOPE_TOLERANCES:
        for part in parts:
            if _excess(tau_s[part], deviation[part], float(freedom[part][-1])) <= tolerance:
                density = float(np.exp(np.mean(np.log(deviation[part] * np.sqrt(tau_s[part])))))
                return WhiteNoise(density, float(tau_s[part][0]), float(tau_s[part][-1]))
    return None


def _parts(tau_s: npt.NDArray[np.float64], freedom: npt.NDArray[np.float64]) -> Iterator[slice]:
    """The parts of a curve that span three octaves and are sure enough, shortest taus first."""
    for first in range(len(tau_s)):
        last = int(np.searchsorted(tau_s, _SPAN * tau_s[first] * (1 - 1e-9)))
        if last < len(tau_s) and freedom[last] >= _SLOPE_FREEDOM:
            yield slice(first, last + 1)


def _excess(tau_s: npt.NDArray[np.float64], deviation: npt.NDArray[np.float64], freedom: float) -> float:
    """Return how much the slope differs from -1/2 beyond two standard errors, which the last and least sure point
    rules.
    """
    span = np.log(tau_s) - np.log(tau_s).mean()
    slope = float(span @ np.log(deviation) / (span @ span))
    error = 1 / sqrt(2 * freedom) / float(span[-1] - span[0])
    return abs(slope + 0.5) - 2 * error


def floor(
    tau_s: npt.NDArray[np.float64],
    deviation: npt.NDArray[np.float64],
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
    freedom: npt.NDArray[np.float64],
) -> Floor | None:
    """The lowest of those points of one curve (t,) that are sure enough; None if none is or the series is constant."""
    sure = np.flatnonzero(freedom >= _FLOOR_FREEDOM)
    if len(sure) == 0 or deviation.min() <= 0:
        return None
    at = int(sure[np.argmin(deviation[sure])])
    value, least, most = (float(ends[at]) / FLOOR for ends in (deviation, low, high))
    return Floor(value, least, most, float(tau_s[at]), at in (sure[0], sure[-1]))
