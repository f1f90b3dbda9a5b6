"""Turns of the box from one attitude to the next, compared with the rates that a gyroscope reads in between.

At rest before and after a turn, gravity determines the direction up in the box. In the box's frame this direction
rotates opposite to the box: du/dt = u x w for the rate w. A gyroscope with other axes, signs or scale factors than
those of its header rotates it to another direction. A rotation about the vertical has no effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import permutations, product
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.simulate.motion.posed import carry_up

MOST_STEP_S = 0.3
"""Longest interval, in s, over which a rate is assumed to be constant: a hand turns a box by a right angle in one or
two seconds.
"""

_WRONG_MISS, _RIGHT_SHARE = 0.2, 0.25
"""Least mean miss at which a gyroscope differs from its header, and the largest share of it that remains with other
axes if these explain it. One of six right angles with the wrong sign makes a miss of a third.
"""

_FACTORS = np.arange(-1.5, 2.51, 0.25)
"""Factors of a reading that are tried. They include those of reversed axes, of axes that are not read, and of half a
range.
"""

_TURNED_RAD2 = 0.5
"""Least sum of squared angles about an axis, in rad^2, that determines its factor: one turn of 40 degrees."""

_LEAST_CURVATURE = 0.03
"""Least second derivative of the mean miss with respect to the factor: turns about the vertical have none."""


class Turn(NamedTuple):
    """A turn: unit vectors `up_before` and `up_after` (3,), and the `rate` (s, 3) in rad/s in intervals of `step_s`,
    all in one frame, that of the box or that of a sensor.
    """

    up_before: Floats
    up_after: Floats
    rate: Floats
    step_s: float

    @classmethod
    def of(cls, up_before: Floats, up_after: Floats, rate: Floats, seconds: float) -> Turn | None:
        """Return a turn that takes `seconds`, from the rates (s, 3) in equal parts of it. Parts without rows, which are
        nan, are interpolated between their neighbours. None if most are missing, or if the parts are longer than
        `MOST_STEP_S`.
        """
        known = np.isfinite(rate).all(axis=1)
        if 2 * np.count_nonzero(known) <= len(rate) or seconds > MOST_STEP_S * len(rate):
            return None
        parts = np.arange(len(rate))
        filled = [np.interp(parts, parts[known], column) for column in rate[known].T]
        return cls(up_before, up_after, np.stack(filled, axis=1), seconds / len(rate))


def misses(turns: Sequence[Turn], responses: Floats) -> Floats:
    """Return how much the rates, multiplied by `responses` (m, 3, 3), miss the attitude after a turn: (m,), 1 less the
    cosine of the angle, averaged over the turns.
    """
    return np.asarray(np.mean([1 - _carried(turn, responses) @ turn.up_after for turn in turns], axis=0))


def _carried(turn: Turn, responses: Floats) -> Floats:
    """Return the direction up (m, 3) after a turn."""
    angles = (turn.rate @ responses.swapaxes(1, 2) * turn.step_s).swapaxes(0, 1)
    return np.asarray(carry_up(np.tile(turn.up_before, (len(responses), 1)), angles)[-1])


def likely_exchange(turns: Sequence[Turn]) -> Floats | None:
    """Return the exchange of axes and signs (3, 3) that converts readings to rates which agree with the attitudes after
    the turns. None if the nominal axes agree, if no exchange does, and without turns.
    """
    if not turns:
        return None
    matrices = np.array([np.eye(3), *(matrix.T for matrix in exchanges().values())])
    miss = misses(turns, matrices)
    best = int(miss.argmin())
    return matrices[best] if miss[0] > _WRONG_MISS and miss[best] < _RIGHT_SHARE * miss[0] else None


def factors_of(turns: Sequence[Turn]) -> Floats:
    """Return the factor (3,) of each axis's rates with which the turns lead from each attitude to the next, with the
    other axes unchanged; nan if the box hardly turns about an axis, or if the turns do not determine the factor.
    """
    factors = np.full(3, np.nan)
    angles = np.array([turn.rate.sum(axis=0) * turn.step_s for turn in turns]).reshape(-1, 3)
    for axis in np.flatnonzero((angles**2).sum(axis=0) > _TURNED_RAD2):
        responses = np.tile(np.eye(3), (len(_FACTORS), 1, 1))
        responses[:, axis, axis] = _FACTORS
        factors[axis] = _least(misses(turns, responses))
    return factors


def _least(miss: Floats) -> float:
    """Return the factor of the smallest miss (f,), by a parabola; nan if the miss is flat."""
    at = int(np.clip(miss.argmin(), 1, len(miss) - 2))
    below, least, above = miss[at - 1 : at + 2].tolist()
    step = float(_FACTORS[1] - _FACTORS[0])
    curvature = (below - 2 * least + above) / step**2
    if curvature < _LEAST_CURVATURE:
        return math.nan
    return float(_FACTORS[at] + np.clip((below - above) / (2 * curvature * step), -step, step))


@cache
def exchanges() -> Mapping[str, Floats]:
    """Return the 47 exchanges of axes and signs by name, such as "+Y+X-Z", as matrices (3, 3) from what the axes should
    read to what they read. Right-handed ones are first because no chip is left-handed.
    """
    matrices = {}
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.array(signs)[:, None] * np.eye(3)[list(order)]
        name = "".join("+-"[sign < 0] + "XYZ"[axis] for sign, axis in zip(signs, order, strict=True))
        matrices[name] = matrix
    del matrices["+X+Y+Z"]
    return MappingProxyType(dict(sorted(matrices.items(), key=lambda item: -np.linalg.det(item[1]))))
