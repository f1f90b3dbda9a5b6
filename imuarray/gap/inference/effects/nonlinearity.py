"""`nonlinearity`: opposite faces whose mean isn't the bias; in motion, readings that bend."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.in_motion import CUBED, OWN, REFERENCE, ROTATION, Moments, moments
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.statistics.cross import SQUARES
from imuarray.simulate.effects.response import Nonlinearity

_IN_MOTION = ("motion_residual", "motion_coupling", "motion_gain", "motion_square", "motion_cube")
_SQUARE, _CUBE = "motion_square", "motion_cube"
_BEYOND = 2.7
_LARGEST = 0.5
"""Of the range, which a curve doesn't bend by more."""

_SMALL = 1e-3
"""Share of the motion: less of a bend isn't looked for."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Quadratic terms by the even part on faces, a gyroscope's by the squares of rates in motion; its cubic ones by the
    cubes of rates, an accelerometer's by what is left in motion, as of a sine.
    """
    yield from with_removal(evidence, Nonlinearity.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    quadratic = np.zeros(3)
    if evidence.header.quantity != "angular_rate":
        quadratic = np.where(np.abs(evidence.score("force_square")) > _BEYOND, evidence.shift("force_square"), 0.0)
    elif evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):  # on a face there is no rate that could be squared
        quadratic = _from_rates(evidence)
    quadratic = np.clip(quadratic, -_LARGEST / evidence.header.range, _LARGEST / evidence.header.range)
    if quadratic.any():
        x, y, z = quadratic.tolist()
        yield Hypothesis((Nonlinearity(quadratic=(x, y, z)),), ("quadratic",))
    if evidence.header.quantity == "angular_rate" and evidence.is_odd(_CUBE, beyond=_BEYOND):
        yield from _of_cubic(_cubic(evidence))
    if evidence.is_odd(*_IN_MOTION, beyond=_BEYOND):
        yield from _from_motion(evidence)


def _from_rates(evidence: Evidence) -> Floats:
    """Return (3,) coefficients of the square of each axis's rate; sensors lie along the box's axes. If the squares
    show, only those of the axes on which they do.
    """
    table = moments(evidence)
    if table is None:
        return np.zeros(3)
    shows = np.abs(evidence.score(_SQUARE)) > _BEYOND
    slope = _slope(table, ROTATION, np.array(SQUARES)[_nearest(evidence)]) * (math.pi / 180) ** 2
    return np.where(shows, slope, 0.0) if shows.any() else slope


def _cubic(evidence: Evidence) -> Floats:
    """Return (3,) coefficients of the cube of the rate of each axis on which it shows."""
    table = moments(evidence)
    if table is None:
        return np.zeros(3)
    nearest = _nearest(evidence)
    sign = np.sign(np.array(evidence.header.orientation)[nearest, range(3)])
    slope = sign * _slope(table, CUBED, nearest) * (math.pi / 180) ** 3
    most = _LARGEST / evidence.header.range**2
    return np.where(np.abs(evidence.score(_CUBE)) > _BEYOND, np.clip(slope, -most, most), 0.0)


def _nearest(evidence: Evidence) -> Indices:
    """Return (3,) the box's axis that is nearest to each axis of the sensor."""
    return np.asarray(np.abs(np.array(evidence.header.orientation)).argmax(axis=0))


def _slope(table: Moments, columns: slice, at: Indices) -> Floats:
    """Return (3,) slopes of the axes' readings over the column of each axis, without what the reference explains of
    both.
    """
    products, shared, _ = table.beyond_reference(columns)
    size = products[at, at]
    return np.divide(shared[at, range(3)], size, out=np.zeros(3), where=size > 0)


def _from_motion(evidence: Evidence) -> Iterator[Hypothesis]:
    """y = x + c x^3 of a sine x of variance s^2 shows a gain of 1 + 3/2 c s^2 and leaves c^2 s^6 / 4."""
    table = moments(evidence)
    if table is None:
        return
    square = np.diag(table.products[REFERENCE, REFERENCE])
    gain = table.products[OWN, REFERENCE].diagonal() / np.where(square > 0, square, np.inf) - 1
    remaining = table.beyond_reference(ROTATION)[2]
    size = 2 * np.sqrt(np.maximum(remaining, 0.0)) / np.where(square > 0, square**1.5, np.inf)
    most = _LARGEST / evidence.header.range**2
    cubic = np.sign(gain) * np.minimum(np.minimum(size, np.abs(gain) / (1.5 * square + 1e-30)), most)
    cubic = np.where(np.abs(cubic) * square > _SMALL, cubic, 0.0)
    yield from _of_cubic(cubic)


def _of_cubic(cubic: Floats) -> Iterator[Hypothesis]:
    """Return the hypothesis of cubic terms (3,), if there are any."""
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
