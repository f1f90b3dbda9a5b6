"""Counts per unit of columns in physical units: inferred from the grid of their values, or from their size.

Most recordings in physical units are counts that a driver has multiplied: the values lie on a grid with the scale as
its step, and the original counts are recovered. Other values are rounded to counts as fine as 16 bits allow, or to
finer counts if their noise is less than one of these. A log keeps counts of up to 32 bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats
from imuarray.importers.cells import INT16
from imuarray.log.format import ASSUMED, COUNT_BITS, DIGITS, RESOLUTION

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
"""Counts per unit in data sheets: a measured grid within `NEAR` of one of these is assumed to be equal to it."""

RATE_SENSITIVITIES = (
    *SENSITIVITIES["angular_rate"],
    *(scale / (1 << power) for scale in (262.4, 262.144) for power in range(5)),
    *(128.0 / (1 << power) for power in range(4)),
    14.375,
)
"""Counts per dps of gyroscopes, also of those that only a measured grid distinguishes from the most common ones."""

WIDE_SENSITIVITIES = {
    "specific_force": (12_800.0, 25_600.0, 51_200.0, 64_000.0, 128_000.0, 256_000.0, 52_428_800.0, 262_144_000.0),
    "angular_rate": (655_360.0, 2_621_440.0, 10_485_760.0),
    "magnetic_field": (16_384.0,),
}
"""The same for chips with codes of more than 16 bits: Analog Devices' ADXL355 and ADXL357 (20 bits), the ADIS16470 and
ADIS16495 (32 bits); the MMC5983MA (18 bits).
"""

NEAR = 3e-4
"""Largest relative difference between a step measured from rounded values and that of the data sheet."""

FULL_SPAN = 1.05 * 32768
"""Largest number of counts in the range of a 16-bit chip; the range may be slightly larger than that of the output. A
finer grid is that of the digits of a text.
"""

BEYOND_RANGE = 1.002
"""Ratio of the largest reading to the range of its chip: 32767 / 131 is 250.13 dps in a range of 250 dps."""

SAMPLE_ROWS = 20_000
"""Number of rows from which the grid is estimated."""

MOST_BITS = 32
"""Bits of the widest counts of a log."""

FINE = 1.0
"""Noise (rms) in counts of 16 bits from which on rounding adds less than a tenth to its variance."""

_WIDE_NOISE = 16.0
"""Least noise in counts after conversion of values with a noise of less than a count of 16 bits: rounding then adds a
3000th to the variance.
"""

_FEWEST_VALUES = 8
_OFF_GRID = 0.1
"""Largest distance of values from the grid, as a share of a step: the digits of a text are rounded."""

_ON_GRID = 0.98
_DIVISORS = (1, 2, 3)
"""Possible distances of the two closest values in steps."""


def common_step(axes: Sequence[Floats]) -> float | None:
    """Return the step of a grid on which the values of all axes lie: a grid through zero, or, for readings less a bias,
    a grid with a separate offset on each axis, if it is coarser; None without one.
    """
    step = grid_step(np.concatenate(axes))
    steps = [grid_step(values - values[0]) for values in axes if len(values)]
    known = [each for each in steps if each is not None]
    if len(known) < len(axes) or max(known) > (1 + NEAR) * min(known):
        return step
    of_axes = float(np.median(known))
    return of_axes if step is None or of_axes > _COARSER * step else step


_COARSER = 1.5
"""Least ratio of the steps of single axes to that of all axes together at which the axes have offsets of their own."""


def named_step(axes: Sequence[Floats], sensitivities: Sequence[float]) -> float | None:
    """Return the step of the least of the `sensitivities` of data sheets on whose grid the values of all axes lie, each
    step with a value of its own; None without one. Digits that are only a few times finer than the grid hide its step
    from `grid_step`.
    """
    distinct = np.unique(np.concatenate(axes))
    distinct = distinct[np.isfinite(distinct)]
    if len(distinct) < _FEWEST_NAMED:
        return None
    for sensitivity in sorted(sensitivities):
        counts = distinct * sensitivity
        number = np.rint(counts)
        is_on_grid = float(np.mean(np.abs(counts - number) < _OFF_GRID)) > _ON_GRID
        if is_on_grid and len(np.unique(number)) > _ON_GRID * len(distinct):
            return _refine(distinct, 1 / sensitivity)
    return None


_FEWEST_NAMED = 16
"""Fewest different values for a step from a data sheet: by chance they are on one of twenty grids once in 1e10."""


def grid_step(values: Floats) -> float | None:
    """Return the step of a grid through zero on which the values (n,) lie; None without one."""
    distinct = np.unique(values[np.isfinite(values)])
    if len(distinct) < _FEWEST_VALUES:
        return None
    nearest = float(np.diff(distinct).min())
    for divisor in _DIVISORS:
        step = _refine(distinct, nearest / divisor)
        deviation = np.abs(distinct / step - np.rint(distinct / step))
        if float(np.mean(deviation < _OFF_GRID)) > _ON_GRID:
            return step
    return None


def _refine(distinct: Floats, step: float) -> float:
    """Refine a step that fits values near zero by values that are increasingly far from it."""
    base = float(distinct[np.abs(distinct).argmin()])
    distance = distinct - base
    reach = 8.0
    while True:
        inside = np.abs(distance) <= reach * step
        number = np.rint(distance[inside] / step)
        if (number != 0).any():
            step = float(distance[inside] @ number / (number @ number))
        if inside.all():
            break
        reach *= 4
    whole = np.rint(distinct / step)
    return float(distinct @ whole / (whole @ whole)) if whole.any() else step


@dataclass(frozen=True)
class Resolution:
    """Counts per unit and range, both in the log's unit. `is_exact` is true if the values lie on the grid of these
    counts, which have `bits` bits.
    """

    sensitivity: float
    range: float
    is_exact: bool
    bits: int = 16

    def attributes(self, log_units: float) -> dict[str, int | float | str]:
        """Return the attributes of a log's sensor whose columns were in units of `log_units`: its counts are not codes
        of a chip if they were assumed, or if their step is a power of ten.
        """
        wide: dict[str, int | float | str] = {COUNT_BITS: self.bits} if self.bits > 16 else {}
        if not self.is_exact:
            return {RESOLUTION: ASSUMED, **wide}
        digits = math.log10(self.sensitivity * log_units)
        return {RESOLUTION: DIGITS, **wide} if abs(digits - round(digits)) < _DECIMAL else wide


_DECIMAL = 1e-4
"""Greatest difference of the logarithm of a step to a power of ten."""


def resolution_of(
    quantity: str, axes: Sequence[Floats], largest: float, range_: float | None, sensitivity: float | None
) -> Resolution:
    """Return the resolution of values in the log's unit, from some values of each axis (`axes`, (n,) each) and the
    `largest` of all values; `range_` and `sensitivity` are None if unknown.
    """
    if range_ is None:
        range_ = next((value for value in RANGES[quantity] if largest <= value * BEYOND_RANGE), largest)
    if sensitivity is None:
        return _infer(quantity, axes, largest, range_)
    counts = np.concatenate(axes) * sensitivity
    deviation = counts - np.rint(counts)
    is_exact = bool(len(deviation)) and float(np.mean(np.abs(deviation) < _OFF_GRID)) > _ON_GRID
    return Resolution(sensitivity, range_, is_exact, bits_of(largest * sensitivity, range_ * sensitivity))


def bits_of(largest: float, end: float) -> int:
    """Return the number of bits of counts with this `largest` value and the `end` of their range: 16, or as many as
    required, but at most `MOST_BITS`.
    """
    if largest <= INT16[1]:
        return 16
    return min(MOST_BITS, 1 + math.ceil(math.log2(max(largest, end * (1 - _DECIMAL)))))


def usual_bits(largest: float) -> int:
    """Return the least usual number of bits for codes of more than 16 bits with this `largest` value."""
    return next((bits for bits in _USUAL_BITS if largest <= 1 << bits - 1), MOST_BITS)


_USUAL_BITS = (18, 19, 20, 24)
"""Numbers of bits of chips' codes, in addition to 16 and 32."""


def _infer(quantity: str, axes: Sequence[Floats], largest: float, range_: float) -> Resolution:
    """Return the resolution of values whose counts per unit are not stated."""
    widest = max(range_, largest)
    coarse = INT16[1] / widest
    noise = _noise(axes)
    usual = RATE_SENSITIVITIES if quantity == "angular_rate" else SENSITIVITIES[quantity]
    step = common_step(axes) or named_step(axes, usual)
    if step is not None:
        sensitivities = (*usual, *WIDE_SENSITIVITIES[quantity])
        named = next((value for value in sensitivities if abs(value * step - 1) < NEAR), None)
        sensitivity = 1 / step if named is None else named
        if largest * sensitivity <= INT16[1] and range_ * sensitivity <= FULL_SPAN:
            return Resolution(sensitivity, range_, True)
        is_needed = named is not None or noise * coarse < FINE
        if is_needed and widest * sensitivity < 1 << MOST_BITS - 1:
            bits = usual_bits(largest * sensitivity)
            return Resolution(sensitivity, min(range_, (1 << bits - 1) / sensitivity), True, bits)
    if not 0 < noise * coarse < FINE:
        return Resolution(coarse, range_, False)
    bits = min(MOST_BITS, 16 + math.ceil(math.log2(_WIDE_NOISE / (noise * coarse))))
    return Resolution(((1 << bits - 1) - 1) / widest, range_, False, bits)


def _noise(axes: Sequence[Floats]) -> float:
    """Return the noise (rms) of the quietest axis that changes, from its median change between rows; 0 without one."""
    changes = [np.abs(np.diff(values)) for values in axes]
    usual = [float(np.median(change[change > 0])) for change in changes if (change > 0).any()]
    return min(usual, default=0.0) / _MEDIAN_CHANGE


_MEDIAN_CHANGE = 0.6745 * math.sqrt(2)
"""Median of the absolute difference of two normal deviates with unit variance."""
