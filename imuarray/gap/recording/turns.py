"""Turns of the box from one attitude to the next, by the rates that a gyroscope reads in between.

At rest before and after a turn, gravity tells which direction of the box is up. In the box's frame that direction turns
against the box: du/dt = u x w for the rate w. A gyroscope whose axes, signs or scale factors are not those of its
header carries it elsewhere. A rotation about the vertical does not show.
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
"""Longest interval over which a rate is taken as constant: a hand turns a box by a right angle in a second or two."""

_WRONG_MISS, _RIGHT_SHARE = 0.2, 0.25
"""Mean miss from which on a gyroscope is not the one of its header, and the share of it that other axes leave at most:
one of six right angles with the wrong sign makes a miss of a third.
"""

_FACTORS = np.arange(-1.5, 2.51, 0.25)
"""Factors of a reading that are tried: those of reversed axes, of axes that are not read, and of half a range."""

_TURNED_RAD2 = 0.5
"""Least sum of squared angles about an axis that tells its factor: one turn of 40 degrees."""

_LEAST_CURVATURE = 0.03
"""Least second derivative of the mean miss with the factor: turns about the vertical have none."""


class Turn(NamedTuple):
    """A turn: unit vectors `up_before` and `up_after` (3,), and the `rate` (s, 3) in rad/s in intervals of `step_s`, in
    one frame, that of the box or of a sensor.
    """

    up_before: Floats
    up_after: Floats
    rate: Floats
    step_s: float

    @classmethod
    def of(cls, up_before: Floats, up_after: Floats, rate: Floats, seconds: float) -> Turn | None:
        """Return a turn that takes so many seconds, by rates (s, 3) in equal parts of it; those without rows, which are
        nan, get what lies between their neighbours. None if most are missing, or the parts are too long.
        """
        known = np.isfinite(rate).all(axis=1)
        if 2 * np.count_nonzero(known) <= len(rate) or seconds > MOST_STEP_S * len(rate):
            return None
        parts = np.arange(len(rate))
        filled = [np.interp(parts, parts[known], column) for column in rate[known].T]
        return cls(up_before, up_after, np.stack(filled, axis=1), seconds / len(rate))


def misses(turns: Sequence[Turn], responses: Floats) -> Floats:
    """Return (m,) by how much the rates, multiplied by `responses` (m, 3, 3), miss the attitude after a turn: 1 less
    the cosine of the angle, in the mean of the turns.
    """
    return np.asarray(np.mean([1 - _carried(turn, responses) @ turn.up_after for turn in turns], axis=0))


def _carried(turn: Turn, responses: Floats) -> Floats:
    """Return (m, 3) the direction up after a turn."""
    angles = (turn.rate @ responses.swapaxes(1, 2) * turn.step_s).swapaxes(0, 1)
    return np.asarray(carry_up(np.tile(turn.up_before, (len(responses), 1)), angles)[-1])


def likely_exchange(turns: Sequence[Turn]) -> Floats | None:
    """Return the exchange of axes and signs (3, 3) by which readings become rates that carry up to where it is after
    the turns; None where the nominal axes do, where no exchange does, and without turns.
    """
    if not turns:
        return None
    matrices = np.array([np.eye(3), *(matrix.T for matrix in exchanges().values())])
    miss = misses(turns, matrices)
    best = int(miss.argmin())
    return matrices[best] if miss[0] > _WRONG_MISS and miss[best] < _RIGHT_SHARE * miss[0] else None


def factors_of(turns: Sequence[Turn]) -> Floats:
    """Return the factor (3,) of each axis's rates by which the turns lead from each attitude to the next, the other
    axes as they are; nan where the box hardly turns about an axis.
    """
    factors = np.full(3, np.nan)
    angles = np.array([turn.rate.sum(axis=0) * turn.step_s for turn in turns]).reshape(-1, 3)
    for axis in np.flatnonzero((angles**2).sum(axis=0) > _TURNED_RAD2):
        responses = np.tile(np.eye(3), (len(_FACTORS), 1, 1))
        responses[:, axis, axis] = _FACTORS
        factors[axis] = _least(misses(turns, responses))
    return factors


def _least(miss: Floats) -> float:
    """Return the factor of the least miss (f,), by a parabola; nan where it is flat."""
    at = int(np.clip(miss.argmin(), 1, len(miss) - 2))
    below, least, above = miss[at - 1 : at + 2].tolist()
    step = float(_FACTORS[1] - _FACTORS[0])
    curvature = (below - 2 * least + above) / step**2
    if curvature < _LEAST_CURVATURE:
        return math.nan
    return float(_FACTORS[at] + np.clip((below - above) / (2 * curvature * step), -step, step))


@cache
def exchanges() -> Mapping[str, Floats]:
    """Return the 47 exchanges of axes and signs by name, "+Y+X-Z", as matrices (3, 3) from what the axes should read to
    what they read; right-handed ones first, since no chip is left-handed.
    """
    matrices = {}
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.array(signs)[:, None] * np.eye(3)[list(order)]
        name = "".join("+-"[sign < 0] + "XYZ"[axis] for sign, axis in zip(signs, order, strict=True))
        matrices[name] = matrix
    del matrices["+X+Y+Z"]
    return MappingProxyType(dict(sorted(matrices.items(), key=lambda item: -np.linalg.det(item[1]))))
