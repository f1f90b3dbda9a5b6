"""Tolerances of the units of one kind of chip, as each data sheet states them, in g, dps or gauss.

"Typ" tolerances of Bosch, ST and InvenSense are interpreted as two sigma and as the limit; those of Analog Devices as
one sigma, with the printed minimum and maximum as limits (DEC-51), or three sigma without printed limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from firmware_emulator.chip import Triple


@dataclass(frozen=True)
class TruncatedNormal:
    """A normal distribution around `mean`, truncated at the distance `limit` from it."""

    sigma: float
    limit: float
    mean: float = 0.0

    def draw(self, random: np.random.Generator) -> float:
        """Draw one value."""
        while True:
            deviation = float(random.normal(0.0, self.sigma)) if self.sigma else 0.0
            if abs(deviation) <= self.limit:
                return self.mean + deviation


def typical(limit: float) -> TruncatedNormal:
    """Return a spread from a "typ" tolerance of Bosch or ST."""
    return TruncatedNormal(limit / 2, limit)


def one_sigma(sigma: float, limit: float | None = None) -> TruncatedNormal:
    """Return a spread from a "typ" tolerance of Analog Devices."""
    return TruncatedNormal(sigma, 3 * sigma if limit is None else limit)


NONE = TruncatedNormal(0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """The tolerances of one chip's units, in g, dps or gauss; triples are x, y, z. Scale and cross-axis tolerances are
    relative. A tolerance that the data sheet does not state is zero.
    """

    bias: tuple[TruncatedNormal, TruncatedNormal, TruncatedNormal] = (NONE, NONE, NONE)
    slope_per_degc: tuple[TruncatedNormal, TruncatedNormal, TruncatedNormal] = (NONE, NONE, NONE)
    scale: TruncatedNormal = NONE
    cross_axis: TruncatedNormal = NONE
    alignment_deg: TruncatedNormal = NONE
    noise: Triple
    noise_full_scale: float
    noise_bandwidth_hz: float
    noise_exponent: float = 0.0
    scale_slope_per_degc: TruncatedNormal = NONE
    shift: TruncatedNormal = NONE
    shift_from: float = math.inf
    g_sensitivity: TruncatedNormal = NONE
    thermometer_degc: TruncatedNormal = NONE
    pressure_pa: TruncatedNormal = NONE


Sheet = Tolerances | Callable[[float], Tolerances]
"""The tolerances of a data sheet; a function of the measuring range if they depend on it."""
