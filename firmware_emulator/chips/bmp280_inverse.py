"""Inverse of the BMP280's compensation: temperature and pressure back to raw words (facts BMP-103, BMP-121).

Here the data sheet's formulas in real numbers (its section 8.1), which its integer formulas approximate, are searched
for the words that give a wanted temperature and pressure. The temperature rises with its word, the pressure falls.
"""

from __future__ import annotations

from typing import NamedTuple

from firmware_emulator.chips.bmp180_inverse import nearest

BITS = 20


class Words(NamedTuple):
    """Calibration words of one part, signed as BMP-103 says; defaults: the data sheet's example."""

    T1: int = 27504
    T2: int = 26435
    T3: int = -1000
    P1: int = 36477
    P2: int = -10685
    P3: int = 3024
    P4: int = 2855
    P5: int = 140
    P6: int = -7
    P7: int = 15500
    P8: int = -14600
    P9: int = 6000


def fine_of(words: Words, adc: float) -> float:
    """The temperature in 5120ths of a degC."""
    away = adc / 16384 - words.T1 / 1024
    return away * words.T2 + (away / 8) ** 2 * words.T3


def pascal_of(words: Words, fine: float, adc: float) -> float:
    """The pressure in Pa; inf for words far outside the sensor's range."""
    warm = fine / 2 - 64000
    offset = (warm * warm * words.P6 / 32768 + warm * words.P5 * 2) / 4 + words.P4 * 65536
    scale = (1 + (words.P3 * warm * warm / 524288 + words.P2 * warm) / 524288 / 32768) * words.P1
    if scale == 0:
        return float("inf")
    p = (1048576 - adc - offset / 4096) * 6250 / scale
    return p + (words.P9 * p * p / 2147483648 + p * words.P8 / 32768 + words.P7) / 16


def ut_of(words: Words, degc: float) -> int:
    """UT at a temperature; 20 bits."""
    return nearest(lambda adc: fine_of(words, adc), 0, (1 << BITS) - 1, degc * 5120)


def up_of(words: Words, ut: int, pascal: float) -> int:
    """UP at a pressure, for a part that is as warm as `ut` says; 20 bits."""
    fine = fine_of(words, ut)
    return nearest(lambda adc: -pascal_of(words, fine, adc), 0, (1 << BITS) - 1, -pascal)
