"""The BMP180's arithmetic: from its raw words to degrees and pascals, and back. Bosch data sheet v2.8; facts BMP-*.

Floor division throughout, which reproduces every printed intermediate value (BMP-64). `words` are the eleven
calibration words of one part, by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats, Integers

Words = Mapping[str, int]

EXAMPLE_WORDS: Words = MappingProxyType(
    {
        "AC1": 408,
        "AC2": -72,
        "AC3": -14383,
        "AC4": 32741,
        "AC5": 32757,
        "AC6": 23153,
        "B1": 6190,
        "B2": 4,
        "MB": -32768,
        "MC": -8711,
        "MD": 2868,
    }
)
"""The part of the data sheet's example (BMP-20 ... BMP-30)."""

_SIXTEENTHS = 160
"""B5 is the temperature in sixteenths of 0.1 degC (BMP-60)."""


def compensate(ut: Integers, up: Integers, words: Words, oversampling: int) -> tuple[Floats, Floats]:
    """Temperature (n,) in degC and pressure (n,) in Pa from the uncompensated readings (BMP-60 ... BMP-63)."""
    b5 = _b5(ut, words)
    return (b5 + 8 >> 4) / 10.0, _pressure(up, b5, words, oversampling).astype(np.float64)


def uncompensated(
    temperature_degc: Floats, pressure_pa: Floats, words: Words, oversampling: int
) -> tuple[Integers, Integers]:
    """The raw words UT (n,) and UP (n,) whose compensation comes first to these temperatures and pressures, by
    bisection: both rise with their word.
    """
    coldest = words["AC6"] - words["MD"] * 32768 // words["AC5"] + 2  # below it the divisor of BMP-60 is not positive
    ut = _first_reaching(lambda word: _b5(word, words), temperature_degc * _SIXTEENTHS, max(coldest, 0), 0xFFFF)
    b5 = _b5(ut, words)
    lowest = int(_offset(b5, words, oversampling)[0].max(initial=0))
    up = _first_reaching(
        lambda word: _pressure(word, b5, words, oversampling), pressure_pa, lowest, (1 << 16 + oversampling) - 1
    )
    return ut, up


def _b5(ut: Integers, words: Words) -> Integers:
    x1 = (ut - words["AC6"]) * words["AC5"] >> 15
    divisor = x1 + words["MD"]
    x2 = (words["MC"] << 11) // np.where(divisor == 0, 1, divisor)  # a nonsense UT must not end the log: BMP-66
    return np.asarray(x1 + x2)


def _offset(b5: Integers, words: Words, oversampling: int) -> tuple[Integers, Integers]:
    """B3 and the square term that B4 needs too."""
    b6 = b5 - 4000
    square = b6 * b6 >> 12
    b3 = (((words["AC1"] * 4 + (words["B2"] * square >> 11) + (words["AC2"] * b6 >> 11)) << oversampling) + 2) >> 2
    return b3, square


def _pressure(up: Integers, b5: Integers, words: Words, oversampling: int) -> Integers:
    b3, square = _offset(b5, words, oversampling)
    x3 = ((words["AC3"] * (b5 - 4000) >> 13) + (words["B1"] * square >> 16) + 2) >> 2
    b4 = words["AC4"] * (x3 + 32768) >> 15
    b7 = (up - b3) * (50000 >> oversampling)
    b4 = np.where(b4 == 0, 1, b4)
    p = np.where(b7 < 0x80000000, 2 * b7 // b4, b7 // b4 * 2)
    x1 = ((p >> 8) * (p >> 8)) * 3038 >> 16
    return np.asarray(p + ((x1 + (-7357 * p >> 16) + 3791) >> 4))


def _first_reaching(rising: Callable[[Integers], Integers], wanted: Floats, low: int, high: int) -> Integers:
    """For each of `wanted` (n,) the lowest word in low ... high at which `rising` has reached it (high if none)."""
    bottom, top = np.full(len(wanted), low, np.int64), np.full(len(wanted), high, np.int64)
    while (bottom < top).any():
        middle = bottom + top >> 1
        short = rising(middle) < wanted
        bottom, top = np.where(short, middle + 1, bottom), np.where(short, top, middle)
    return bottom
