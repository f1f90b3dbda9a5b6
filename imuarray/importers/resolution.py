"""Counts per unit of columns in physical units: inferred from the grid of their values, or from their size.

Most such recordings are counts that a driver has multiplied: the values lie on a grid whose step is the scale, and the
original counts are recovered. Other values are rounded to counts as fine as 16 bits allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.importers.cells import INT16
from imuarray.log.format import ASSUMED, DIGITS, RESOLUTION

RANGES = {
    "specific_force": (2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 100.0, 200.0, 400.0),
    "angular_rate": (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0),
    "magnetic_field": (1.3, 4.0, 8.0, 16.0, 50.0),
}
"""Measuring ranges of chips in the unit of a log (g, dps, gauss)."""

SENSITIVITIES = {
    "specific_force": tuple(float(1 << power) for power in range(5, 16)),
    "angular_rate": tuple(131.0 / (1 << power) for power in range(5))
    + tuple(1000 / step for step in (4.375, 8.75, 17.5, 35.0, 70.0)),
    "magnetic_field": (),
}
"""Counts per unit in data sheets: a grid that is within `NEAR` of one is taken for it."""

NEAR = 3e-4
"""Greatest relative difference between a step found from rounded values and that of the data sheet."""

FULL_SPAN = 1.05 * 32768
"""Counts of a 16-bit chip over its range, which may be slightly less than its output. A finer grid is that of the
digits of a text.
"""

SAMPLE_ROWS = 20_000
"""Number of rows from which the grid is found."""

_FEWEST_VALUES = 8
_OFF_GRID = 0.1
"""Share of a step by which values may miss the grid, since digits of a text are rounded."""

_ON_GRID = 0.98
_DIVISORS = (1, 2, 3)
"""Maximum distance of the two closest values in steps."""


def common_step(axes: Sequence[Floats]) -> float | None:
    """Return the step of a grid on which the values of all axes lie: one through zero, or, of readings less a bias, one
    with an offset of its own on each axis; None without one.
    """
    step = grid_step(np.concatenate(axes))
    if step is not None:
        return step
    steps = [grid_step(values - values[0]) for values in axes if len(values)]
    known = [step for step in steps if step is not None]
    if len(known) < len(axes) or max(known) > (1 + NEAR) * min(known):
        return None
    return float(np.median(known))


def grid_step(values: Floats) -> float | None:
    """Return the step of a grid through zero on which the values (n,) lie; None without one."""
    distinct = np.unique(values[np.isfinite(values)])
    if len(distinct) < _FEWEST_VALUES:
        return None
    nearest = float(np.diff(distinct).min())
    for divisor in _DIVISORS:
        step = _refined(distinct, nearest / divisor)
        off = np.abs(distinct / step - np.rint(distinct / step))
        if float(np.mean(off < _OFF_GRID)) > _ON_GRID:
            return step
    return None


def _refined(distinct: Floats, step: float) -> float:
    """Refine a step that fits near zero with values further and further away."""
    base = float(distinct[np.abs(distinct).argmin()])
    away = distinct - base
    reach = 8.0
    while True:
        inside = np.abs(away) <= reach * step
        number = np.rint(away[inside] / step)
        if (number != 0).any():
            step = float(away[inside] @ number / (number @ number))
        if inside.all():
            break
        reach *= 4
    whole = np.rint(distinct / step)
    return float(distinct @ whole / (whole @ whole)) if whole.any() else step


@dataclass(frozen=True)
class Resolution:
    """Counts per unit and range, both in the log's unit; `is_exact`: the values lie on the grid of these counts."""

    sensitivity: float
    range: float
    is_exact: bool

    def attributes(self, log_units: float) -> dict[str, str]:
        """Return the attributes of a log's sensor whose columns were in units of `log_units`: its counts are no codes
        of a chip if they were assumed, or step by decimal digits.
        """
        if not self.is_exact:
            return {RESOLUTION: ASSUMED}
        digits = math.log10(self.sensitivity * log_units)
        return {RESOLUTION: DIGITS} if abs(digits - round(digits)) < _DECIMAL else {}


_DECIMAL = 1e-4
"""Greatest difference of the logarithm of a step to a power of ten."""


def resolution_of(
    quantity: str, axes: Sequence[Floats], largest: float, range_: float | None, sensitivity: float | None
) -> Resolution:
    """Return the resolution of values in the log's unit, of which some are known by axis (`axes`, (n,) each) and
    `largest` is the largest; `range_` and `sensitivity` if they are known.
    """
    if range_ is None:
        range_ = next((value for value in RANGES[quantity] if largest <= value), largest)
    if sensitivity is None:
        step = common_step(axes)
        if step is not None:
            sensitivity = next((value for value in SENSITIVITIES[quantity] if abs(value * step - 1) < NEAR), 1 / step)
            if largest * sensitivity <= INT16[1] and range_ * sensitivity <= FULL_SPAN:
                return Resolution(sensitivity, range_, True)
        return Resolution(INT16[1] / max(range_, largest), range_, False)
    counts = np.concatenate(axes) * sensitivity
    off = counts - np.rint(counts)
    return Resolution(sensitivity, range_, bool(len(off)) and float(np.mean(np.abs(off) < _OFF_GRID)) > _ON_GRID)
