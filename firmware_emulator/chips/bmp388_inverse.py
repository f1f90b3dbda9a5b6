"""Inverse of the BMP388's compensation: temperature and pressure back to raw words (facts BMP-203, BMP-221).

Here the data sheet's formulas in real numbers (its chapter 9), which the manufacturer's integers approximate, are
searched for the words that give a wanted temperature and pressure. The temperature rises with its word, the pressure
falls.
"""

from __future__ import annotations

from typing import NamedTuple

from firmware_emulator.chips.bmp180_inverse import nearest

BITS = 24


class Words(NamedTuple):
    """Calibration words of one part, signed as BMP-203 says; defaults: the example of BMP-220."""

    T1: int = 27427
    T2: int = 18776
    T3: int = -10
    P1: int = -164
    P2: int = -2866
    P3: int = 35
    P4: int = 0
    P5: int = 25578
    P6: int = 31086
    P7: int = -13
    P8: int = -10
    P9: int = 17322
    P10: int = 18
    P11: int = -60


def degc_of(words: Words, raw: float) -> float:
    """The temperature in degC."""
    away = raw - words.T1 * 2.0**8
    return away * words.T2 / 2.0**30 + away * away * words.T3 / 2.0**48


def pascal_of(words: Words, degc: float, raw: float) -> float:
    """The pressure in Pa."""
    offset = words.P5 * 2.0**3 + (words.P6 / 2.0**6 + (words.P7 / 2.0**8 + words.P8 / 2.0**15 * degc) * degc) * degc
    slope = (words.P1 - 2.0**14) / 2.0**20 + (
        (words.P2 - 2.0**14) / 2.0**29 + (words.P3 / 2.0**32 + words.P4 / 2.0**37 * degc) * degc
    ) * degc
    curve = words.P9 / 2.0**48 + words.P10 / 2.0**48 * degc
    return offset + (slope + (curve + words.P11 / 2.0**65 * raw) * raw) * raw


def ut_of(words: Words, degc: float) -> int:
    """UT at a temperature; 24 bits."""
    return nearest(lambda raw: degc_of(words, raw), 0, (1 << BITS) - 1, degc)


def up_of(words: Words, ut: int, pascal: float) -> int:
    """UP at a pressure, for a part that is as warm as `ut` says; 24 bits."""
    degc = degc_of(words, ut)
    return nearest(lambda raw: -pascal_of(words, degc, raw), 0, (1 << BITS) - 1, -pascal)
