"""The sphere on which specific forces lie while a box is turned slowly: its radius is 1 g, its centre the biases."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats

MOST_POINTS = 4000
FEWEST_POINTS = 40
SPANS_DIRECTIONS = 0.1
"""Least variance of the directions along any axis (a third if all directions are equally frequent)."""

ON_SPHERE = 0.03
"""Greatest deviation from the sphere (rms), as a share of its radius."""


class Sphere(NamedTuple):
    """Centre (3,) and radius in the unit of the forces."""

    centre: Floats
    radius: float


def fit_sphere(forces: Floats) -> Sphere | None:
    """Return the sphere of forces (n, 3), whatever their offsets; None if they do not span one.

    |f|^2 = 2 f . c + r^2 - |c|^2 is linear in the centre c and in r^2 - |c|^2.
    """
    if len(forces) < FEWEST_POINTS:
        return None
    points = forces[:: max(1, len(forces) // MOST_POINTS)]
    scale = float(np.median(np.linalg.norm(points, axis=1))) or 1.0
    f = points / scale
    solution = np.linalg.lstsq(np.column_stack([2 * f, np.ones(len(f))]), (f**2).sum(axis=1), rcond=None)[0]
    squared = float(solution[3] + solution[:3] @ solution[:3])
    if squared <= 0:
        return None
    radius = squared**0.5
    rays = (f - solution[:3]) / radius
    deviation = float(np.sqrt(np.mean((np.linalg.norm(rays, axis=1) - 1) ** 2)))
    spans = float(np.linalg.eigvalsh(np.cov(rays.T))[0]) > SPANS_DIRECTIONS
    return Sphere(solution[:3] * scale, radius * scale) if spans and deviation < ON_SPHERE else None
