"""Readings that a program took apart: bytes of a code from different readings, and codes that overflowed.

A code of 16 bits is read as two bytes. If the chip updates it in between, or a program joins the bytes wrongly, single
readings are off by 256 codes, always by the same amount. A sum or a conversion that exceeds 16 bits continues at the
other end of the range.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.log import SensorLog
from imuarray.printable import counted
from imuarray.robust import MEDIAN_ABSOLUTE

MOST_ROWS = 1 << 16
"""Number of rows from the beginning of a recording that are examined."""

_BLOCK_ROWS = 64
"""Rows whose noise is determined together, so that motion raises the limit where it occurs."""

FEWEST_JUMPS = 8
MOST_JUMPS = 0.1
"""Fewest single readings off by the same amount, and largest share of the readings: more are a signal."""

_STANDS_OUT = 6.0
"""Least distance of such a reading from its neighbours, in standard deviations of the noise."""

_LEAST_CHANGES = 0.05
"""Share of the smallest changes of an axis, which are those by one code of its chip."""

_SAME_AMOUNT = 0.15
"""Largest scatter (interquartile range) of the distances, as a share of their median."""

_LEAST_BIT = 64.0
_NEAR_BIT = 0.08
"""Least size in counts of a lost bit that can be distinguished from noise, and largest relative difference of the
median distance from it.
"""

_FULL = 0.05
"""Largest relative difference of the range in counts from half of all codes of 16 bits."""

_OVERFLOW = 0.75
"""Least change from row to row that is an overflow, as a share of all codes."""

_GOES_ON = 0.125
_MOSTLY = 0.75
"""Largest difference from the line through the two readings before, as a share of all codes, and least share of the
jumps for which this holds. Shaking with the whole range has jumps of all sizes, a quarter of which fit by chance.
"""

FEWEST_OVERFLOWS = 4
"""Fewest overflows that are reported."""

_CODES_16 = 1 << 16


def find_jumps(sensor: SensorLog) -> Iterator[str]:
    """Yield sentences on single readings of a triad that are all off by the same amount, and on overflows."""
    counts = np.asarray(sensor.counts[:MOST_ROWS], float)
    if len(counts) < 2 * _BLOCK_ROWS:
        return
    is_full = abs(sensor.range * sensor.sensitivity / (_CODES_16 / 2) - 1) < _FULL
    for axis, column in zip("xyz", counts.T, strict=True):
        if is_full and (overflows := _overflows(column)) >= FEWEST_OVERFLOWS:
            yield (
                f"{axis} jumps {counted(overflows, 'time')} from one end of its codes to the other: the values exceed"
                " 16 bits and continue at the other end (overflow)"
            )
            continue
        amounts = _single_jumps(column)
        if FEWEST_JUMPS <= len(amounts) <= MOST_JUMPS * len(column):
            low, middle, high = np.quantile(amounts, (0.25, 0.5, 0.75))
            power = 2.0 ** round(np.log2(middle))
            if high - low <= _SAME_AMOUNT * middle and power >= _LEAST_BIT and abs(middle / power - 1) < _NEAR_BIT:
                size = f" ({middle / sensor.sensitivity:.4g} {sensor.unit})" if sensor.sensitivity else ""
                yield (
                    f"{counted(len(amounts), 'single reading')} of {axis} jump by about {middle:.0f} counts{size} and"
                    " back: bytes of two readings in one code, or a lost bit?"
                )


def _single_jumps(column: Floats) -> Floats:
    """Return the distances (k,) of the readings (n,) that stand out from both neighbours, which agree."""
    middle = (column[2:] + column[:-2]) / 2
    apart = np.abs(column[1:-1] - middle)
    blocks = len(apart) // _BLOCK_ROWS
    apart = apart[: blocks * _BLOCK_ROWS].reshape(blocks, _BLOCK_ROWS)
    neighbours = np.abs(column[2:] - column[:-2])[: apart.size].reshape(apart.shape)
    changes = np.abs(np.diff(column))
    step = float(np.quantile(changes[changes > 0], _LEAST_CHANGES)) if changes.any() else 1.0
    noise = np.maximum(np.median(apart, axis=1) / MEDIAN_ABSOLUTE, step)[:, None]
    inside = ~_at_end(column[1:-1])[: apart.size].reshape(apart.shape)
    return np.asarray(apart[inside & (apart > _STANDS_OUT * noise) & (neighbours < _STANDS_OUT * noise / 2)])


def _overflows(column: Floats) -> int:
    """Return the number of overflows in the codes of 16 bits (n,) of an axis: jumps to the other end after which the
    codes go on as before, if 65536 is added or subtracted. Codes at the ends are clipped.
    """
    before, last, code = column[:-2], column[1:-1], column[2:]
    jump = code - last
    is_jump = (np.abs(jump) > _OVERFLOW * _CODES_16) & ~_at_end(code) & ~_at_end(last)
    goes_on = np.abs(code - np.sign(jump) * _CODES_16 - (2 * last - before)) < _GOES_ON * _CODES_16
    count = int(np.count_nonzero(is_jump & goes_on))
    return count if count > _MOSTLY * np.count_nonzero(is_jump) else 0


def _at_end(column: Floats) -> Booleans:
    """Return which codes (n,) are at an end of those of 16 bits, where a chip clips."""
    return np.asarray((column >= _CODES_16 / 2 - 1) | (column <= -_CODES_16 / 2 + 1))
