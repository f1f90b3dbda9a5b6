"""Inverse of the BMP180's compensation: temperature and pressure back to raw words (facts BMP-60 ... BMP-66).

The chip's user turns UT and UP into degC and Pa; here the same formulas, in floor arithmetic, are searched for the
words that give a wanted temperature and pressure. Both rise with their word, so bisection finds them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

STEPS_PER_DEGC = 160  # B5 is the temperature in sixteenths of 0.1 degC: BMP-60


class Words(NamedTuple):
    """Calibration words of one part, signed as BMP-20 ... BMP-30 say; defaults: the data sheet's example."""

    AC1: int = 408
    AC2: int = -72
    AC3: int = -14383
    AC4: int = 32741
    AC5: int = 32757
    AC6: int = 23153
    B1: int = 6190
    B2: int = 4
    MB: int = -32768
    MC: int = -8711
    MD: int = 2868


def b5_of(words: Words, ut: int) -> int:
    """BMP-60; ZeroDivisionError for a word far outside the sensor's range (BMP-66)."""
    x1 = (ut - words.AC6) * words.AC5 >> 15
    return x1 + words.MC * 2048 // (x1 + words.MD)


def pressure_function(words: Words, b5: int, oss: int) -> tuple[int, Callable[[int], int]]:
    """The lowest word that makes sense, and the function from a word to Pa (BMP-61 ... BMP-63)."""
    b6 = b5 - 4000
    square = b6 * b6 >> 12
    x3 = (words.B2 * square >> 11) + (words.AC2 * b6 >> 11)
    b3 = ((words.AC1 * 4 + x3 << oss) + 2) // 4
    x3 = (words.AC3 * b6 >> 13) + (words.B1 * square >> 16) + 2 >> 2
    b4 = words.AC4 * (x3 + 32768) >> 15
    factor = 50000 >> oss

    def pressure(up: int) -> int:
        b7 = (up - b3) * factor
        p = b7 * 2 // b4 if b7 < 0x80000000 else b7 // b4 * 2
        return p + ((p >> 8) * (p >> 8) * 3038 // 65536 + (-7357 * p >> 16) + 3791 >> 4)

    return max(0, b3), pressure


def nearest(function: Callable[[int], float], low: int, high: int, target: float) -> int:
    """The argument in low ... high at which a rising function comes closest to `target`, the lower one of equals."""
    bottom, top = low, high
    while bottom < top:
        middle = bottom + top >> 1
        if function(middle) < target:
            bottom = middle + 1
        else:
            top = middle
    if bottom > low and target - function(bottom - 1) <= function(bottom) - target:
        return bottom - 1
    return bottom


def ut_of(words: Words, degc: float) -> int:
    """UT at a temperature; 16 bits."""
    coldest = words.AC6 - words.MD * 32768 // words.AC5 + 2  # below, X1 + MD is no longer positive
    return nearest(lambda ut: b5_of(words, ut), max(0, coldest), 0xFFFF, degc * STEPS_PER_DEGC)


def up_of(words: Words, ut: int, oss: int, pascal: float) -> int:
    """UP at a pressure, for a part that is as warm as `ut` says; 16 + oss bits."""
    lowest, pressure = pressure_function(words, b5_of(words, ut), oss)
    return nearest(pressure, lowest, (1 << 16 + oss) - 1, pascal)
