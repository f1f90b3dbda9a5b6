"""`nonlinearity`: opposite faces whose mean isn't the bias; in motion, readings that bend."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.in_motion import OWN, REFERENCE, ROTATION, moments
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.nonlinearity import Nonlinearity

_SQUARES = (0, 3, 5)
"""Where xx, yy and zz stand among the products of rates."""

_IN_MOTION = ("motion_residual", "motion_coupling", "motion_gain")
_BEYOND = 2.7
_LARGEST = 0.5
"""Of the range, which a curve doesn't bend by more."""

_SMALL = 1e-3
"""Share of the motion: less of a bend isn't looked for."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Quadratic terms by the even part on faces, a gyroscope's by the squares of rates in motion; a cubic one by what
    is left in motion, as of a sine.
    """
    yield from with_removal(evidence, Nonlinearity.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Hypothesis]:
    quadratic = np.zeros(3)
    if evidence.header.quantity != "angular_rate":
        quadratic = np.where(np.abs(evidence.score("force_square")) > _BEYOND, evidence.shift("force_square"), 0.0)
    elif evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):  # on a face there is no rate that could be squared
        quadratic = _from_rates(evidence)
    quadratic = np.clip(quadratic, -_LARGEST / evidence.header.range, _LARGEST / evidence.header.range)
    if quadratic.any():
        x, y, z = quadratic.tolist()
        yield Hypothesis((Nonlinearity(quadratic=(x, y, z)),), ("quadratic",))
    if evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):
        yield from _from_motion(evidence)


def _from_rates(evidence: Evidence) -> Floats:
    """(3,) coefficients of the square of each axis's rate; sensors lie along the box's axes."""
    table = moments(evidence)
    if table is None:
        return np.zeros(3)
    rotation, shared, _ = table.beside(ROTATION)
    at = np.array(_SQUARES)[np.abs(np.array(evidence.header.orientation)).argmax(axis=0)]
    size = rotation[at, at]
    slope = np.divide(shared[at, range(3)], size, out=np.zeros(3), where=size > 0)
    return np.asarray(slope * (math.pi / 180) ** 2)


def _from_motion(evidence: Evidence) -> Iterator[Hypothesis]:
    """y = x + c x^3 of a sine x of variance s^2 shows a gain of 1 + 3/2 c s^2 and leaves c^2 s^6 / 4."""
    table = moments(evidence)
    if table is None:
        return
    square = np.diag(table.products[REFERENCE, REFERENCE])
    gain = table.products[OWN, REFERENCE].diagonal() / np.where(square > 0, square, np.inf) - 1
    remaining = table.beside(ROTATION)[2]
    size = 2 * np.sqrt(np.maximum(remaining, 0.0)) / np.where(square > 0, square**1.5, np.inf)
    most = _LARGEST / evidence.header.range**2
    cubic = np.sign(gain) * np.minimum(np.minimum(size, np.abs(gain) / (1.5 * square + 1e-30)), most)
    cubic = np.where(np.abs(cubic) * square > _SMALL, cubic, 0.0)
    if cubic.any():
        x, y, z = cubic.tolist()
        yield Hypothesis((Nonlinearity(cubic=(x, y, z)),), ("cubic",))


NONLINEARITY = Candidate(
    Nonlinearity.name,
    guesses,
    {
        "tumble": "all six faces, 1 minute each",
        "motion": "turns and strokes up to the range along every axis, 1 minute",
    },
)
