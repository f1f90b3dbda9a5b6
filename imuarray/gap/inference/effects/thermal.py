"""Levels against temperature: fits over all phases at rest, each log and face about its own level."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.gap.inference.effects.levels import Levels, centre
from imuarray.gap.model.rest import REFERENCE_DEGC

TRACES = (
    *("thermal_slope", "thermal_square", "thermal_change", "thermal_residual"),
    *("mean_halves", "wander", "mean_return", "mean", "allan_longest", "slow_own_axes", "slow_between_axes"),
)
"""Probes that move where a level doesn't follow the temperature in a straight line."""

BEYOND = 2.7
LEAST_DEGC = 1.0
"""A smaller span of temperatures says nothing of a slope."""


class Fit(NamedTuple):
    """(c, 3) coefficients and their standard errors, of columns for one axis each; 0 and infinite where one can't be
    told from the others.
    """

    coefficient: Floats
    error: Floats


def warmth(table: Levels) -> Floats:
    """Return (n,) degC above the temperature at which biases hold."""
    return np.asarray(table.degc - REFERENCE_DEGC)


def is_warmed(table: Levels) -> bool:
    """Return whether the temperature changed within a log and face."""
    return any(np.ptp(table.degc[at]) >= LEAST_DEGC for at in table.groups())


def fitted(columns: Floats, values: Floats, group: Integers | None) -> Fit:
    """Return the least-squares fit of values (n, 3) by columns (n, c), both less the means of their groups (None: as
    they are).
    """
    if group is not None:
        columns, values = centre(columns, group), centre(values, group)
    size = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / np.where(size > 0, size, 1.0)
    nothing = np.zeros((columns.shape[1], values.shape[1]))
    if len(columns) <= columns.shape[1] + 1 or np.linalg.matrix_rank(scaled, tol=1e-2) < columns.shape[1]:
        return Fit(nothing, np.full_like(nothing, np.inf))
    solution = np.linalg.lstsq(scaled, values, rcond=None)[0]
    residuals = values - scaled @ solution
    variance = (residuals**2).sum(axis=0) / (len(columns) - columns.shape[1])
    inverse = np.diag(np.linalg.inv(scaled.T @ scaled))
    return Fit(solution / size[:, None], np.sqrt(inverse[:, None] * variance) / size[:, None])
