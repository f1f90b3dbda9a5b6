"""What a box feels that somebody put down by hand: which way is up, from the array's own accelerometers.

In every pose the specific force is one g long and all accelerometers feel the same: from poses in many directions the
bias that they have in common is told from the direction, scale taken as nominal. What is felt in a pose is thus an
estimate, with the array's own noise and errors in it; whoever compares a recording with simulations has to estimate it
in these as well, though there it is known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats

GROSS_G = 0.25
"""An accelerometer that reads so much otherwise than the median of all, in any pose, has no say in the mean: a wrong
range, an axis swapped, a dead chip."""

LEAN_SIGMA, SCALE_PRIOR, _FORM_G = 0.02, 0.02, 1e-3
"""Standard deviations: how far a box leans on a face that is noted, in radians; the scale errors of what the array
reads on average; and what a length in g is known to.
"""

_STEPS = 5
"""Of Gauss and Newton, which double the digits; biases of 0.1 g need three."""

_LEAST_SHARE = 0.1
"""Directions along which the poses tell the common bias so much worse than along the best one are left at none."""


class Ups(NamedTuple):
    """`up_box` (k, 3) of length 1, (0, 0, 0) where nothing is felt; `bias_g` (3,), common to the array, box frame."""

    up_box: Floats
    bias_g: Floats


def ups_of(mean_g: Floats, known_g: Floats, noted_g: Floats | None = None) -> Ups:
    """Directions up from what the array reads on average in k poses, `mean_g` (k, 3) in the box frame; `known_g` (k, 3)
    is what is felt where it is known, `noted_g` (k, 3) where the face is noted and the box may lean a little, nan
    elsewhere.

    Least squares of the lengths' differences from 1 g, of known poses those of all axes, over one bias for all. Noted
    faces add one error of scale for each axis, and how far they lean, both with a normal prior: opposite faces tell the
    bias however they lean, a single one has it lean as little as it can.
    """
    if noted_g is not None and np.isfinite(noted_g).all(axis=1).any():
        return _with_faces(mean_g, known_g, noted_g)
    bias = np.zeros(3)
    unknown = np.isnan(known_g).any(axis=1)
    for _ in range(_STEPS):
        ups, lengths = directions(mean_g - bias)
        apart = (mean_g - bias - known_g)[~unknown]
        design = np.concatenate([ups[unknown], np.tile(np.eye(3), (len(apart), 1))])
        wanted = np.concatenate([lengths[unknown] - 1, apart.ravel()])
        bias = bias + np.linalg.lstsq(design, wanted, rcond=_LEAST_SHARE)[0]
    return Ups(directions(mean_g - bias)[0], bias)


def _with_faces(mean_g: Floats, known_g: Floats, noted_g: Floats) -> Ups:
    known = np.isfinite(known_g).all(axis=1)
    noted = np.isfinite(noted_g).all(axis=1) & ~known
    bias, scale = np.zeros(3), np.zeros(3)
    for _ in range(_STEPS):
        ups, lengths = directions(mean_g - bias)
        free = ~known
        length_rows = np.hstack([ups[free], ups[free] ** 2]) / _FORM_G
        apart = [(lengths[free] - 1 - ups[free] ** 2 @ scale) / _FORM_G]
        rows = [length_rows]
        for at in np.flatnonzero(known):
            rows.append(np.hstack([np.eye(3), np.zeros((3, 3))]) / _FORM_G)
            apart.append((mean_g[at] - bias - known_g[at]) / _FORM_G)
        for at in np.flatnonzero(noted):
            across = np.eye(3) - np.outer(noted_g[at], noted_g[at])
            rows.append(np.hstack([across, np.zeros((3, 3))]) / LEAN_SIGMA)
            apart.append(across @ (mean_g[at] - bias) / LEAN_SIGMA)
        rows.append(np.hstack([np.zeros((3, 3)), np.eye(3)]) / SCALE_PRIOR)
        apart.append(-scale / SCALE_PRIOR)
        step = np.linalg.lstsq(np.vstack(rows), np.concatenate(apart), rcond=None)[0]
        bias, scale = bias + step[:3], scale + step[3:]
    return Ups(directions(mean_g - bias)[0], bias)


def array_mean(readings: Floats) -> Floats:
    """(k, 3) what s accelerometers read together, `readings` (k, s, 3) in g in the box frame, nan of what was not read:
    the median of those that read in every pose and never are `GROSS_G` from it, of two their mean; of all, if there are
    none. By a median the one whose bias changed does not tilt the box for the others.
    """
    whole = np.isfinite(readings).all(axis=(0, 2))
    if not whole.any():
        with np.errstate(invalid="ignore"):
            known = np.isfinite(readings)
            return np.asarray(np.where(known, readings, 0.0).sum(axis=1) / known.sum(axis=1))
    found = readings[:, whole]
    near = (np.abs(found - np.median(found, axis=1)[:, None]) < GROSS_G).all(axis=(0, 2))
    return np.asarray(np.median(found[:, near] if near.any() else found, axis=1))


def directions(vectors: Floats) -> tuple[Floats, Floats]:
    """Of vectors (k, 3): (k, 3) of length 1, and (k,) the lengths; 0 of nothing."""
    lengths = np.linalg.norm(vectors, axis=1)
    units = np.divide(vectors, lengths[:, None], out=np.zeros_like(vectors), where=lengths[:, None] > 0)
    return units, lengths
