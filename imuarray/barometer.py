"""The arithmetic of the barometers: from raw words to degrees and pascals, and back. Bosch data sheets; facts BMP-*. It
uses the integers of the data sheets, with floor division throughout, and reproduces every printed intermediate value of
the BMP180 (BMP-64) and the BMP280's fine temperature (BMP-121). `words` are the calibration words of one part, by name.
`BAROMETERS` has the arithmetic of each chip by its name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

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

EXAMPLE_WORDS_BMP280: Words = MappingProxyType(
    {
        "T1": 27504,
        "T2": 26435,
        "T3": -1000,
        "P1": 36477,
        "P2": -10685,
        "P3": 3024,
        "P4": 2855,
        "P5": 140,
        "P6": -7,
        "P7": 15500,
        "P8": -14600,
        "P9": 6000,
    }
)
"""The part of the data sheet's example (BMP-120)."""

EXAMPLE_WORDS_BMP388: Words = MappingProxyType(
    {
        "T1": 27427,
        "T2": 18776,
        "T3": -10,
        "P1": -164,
        "P2": -2866,
        "P3": 35,
        "P4": 0,
        "P5": 25578,
        "P6": 31086,
        "P7": -13,
        "P8": -10,
        "P9": 17322,
        "P10": 18,
        "P11": -60,
    }
)
"""The calibration words of a real part, because the data sheet has no example (BMP-220)."""

_SIXTEENTHS = 160
"""B5 is the temperature in sixteenths of 0.1 degC (BMP-60)."""


class Barometer(NamedTuple):
    """The arithmetic of one chip with the settings of its driver.

    `words`: the part of the data sheet's example; `noise_pa`: typical rms noise of the pressure; `compensate` and
    `uncompensated`: from raw words UT and UP (n,) to degC and Pa (n,) by the part's words, and back; `settings`: the
    settings that the driver stores in a log with the words.
    """

    words: Words
    noise_pa: float
    compensate: Callable[[Integers, Integers, Words], tuple[Floats, Floats]]
    uncompensated: Callable[[Floats, Floats, Words], tuple[Integers, Integers]]
    settings: Mapping[str, int] = MappingProxyType({})


# BMP180 ---------------------------------------------------------------------------------------------------------------


def compensate(ut: Integers, up: Integers, words: Words, oversampling: int) -> tuple[Floats, Floats]:
    """Return temperature (n,) in degC and pressure (n,) in Pa from the uncompensated readings (BMP-60 ... BMP-63)."""
    b5 = _b5(ut, words)
    return (b5 + 8 >> 4) / 10.0, _pressure(up, b5, words, oversampling).astype(np.float64)


def uncompensated(
    temperature_degc: Floats, pressure_pa: Floats, words: Words, oversampling: int
) -> tuple[Integers, Integers]:
    """Return the lowest raw words UT (n,) and UP (n,) whose compensation reaches these temperatures and pressures, by
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
    x2 = (words["MC"] << 11) // np.where(divisor == 0, 1, divisor)  # an invalid UT must not end the log: BMP-66
    return np.asarray(x1 + x2)


def _offset(b5: Integers, words: Words, oversampling: int) -> tuple[Integers, Integers]:
    """Return B3, and the square term that is also part of B4."""
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
    """Return for each of `wanted` (n,) the lowest word in low ... high at which `rising` reaches it (high if none)."""
    bottom, top = np.full(len(wanted), low, np.int64), np.full(len(wanted), high, np.int64)
    while (bottom < top).any():
        middle = bottom + top >> 1
        short = rising(middle) < wanted
        bottom, top = np.where(short, middle + 1, bottom), np.where(short, top, middle)
    return bottom


# BMP280 ---------------------------------------------------------------------------------------------------------------

_WORD_BITS = 20


def compensate_bmp280(ut: Integers, up: Integers, words: Words) -> tuple[Floats, Floats]:
    """Return the temperature (n,) in degC, steps of 0.01, and pressure (n,) in Pa, steps of 1/256, by the 64-bit
    formula (BMP-121, BMP-122).
    """
    fine = fine_temperature_bmp280(ut, words)
    return (fine * 5 + 128 >> 8) / 100.0, pressure_bmp280(up, fine, words) / 256.0


def uncompensated_bmp280(temperature_degc: Floats, pressure_pa: Floats, words: Words) -> tuple[Integers, Integers]:
    """Return the lowest raw words UT (n,) and UP (n,) whose compensation reaches these temperatures and pressures, by
    bisection: the temperature rises with its word, the pressure falls.
    """
    highest = (1 << _WORD_BITS) - 1
    ut = _first_reaching(lambda word: fine_temperature_bmp280(word, words), temperature_degc * 5120, 0, highest)
    fine = fine_temperature_bmp280(ut, words)
    up = _first_reaching(lambda word: -pressure_bmp280(word, fine, words), -pressure_pa * 256, 0, highest)
    return ut, up


def fine_temperature_bmp280(ut: Integers, words: Words) -> Integers:
    """Return the temperature (n,) in 5120ths of a degC, which is also used for the pressure (BMP-121)."""
    linear = ((ut >> 3) - (words["T1"] << 1)) * words["T2"] >> 11
    difference = (ut >> 4) - words["T1"]
    return np.asarray(linear + ((difference * difference >> 12) * words["T3"] >> 14))


def pressure_bmp280(up: Integers, fine: Integers, words: Words) -> Integers:
    """Return the pressure (n,) in 256ths of a Pa by the formula for 64 bits, 0 if the divisor is 0 (BMP-122)."""
    a = np.asarray(fine, np.int64) - 128000
    b = a * a * words["P6"] + (a * words["P5"] << 17) + (words["P4"] << 35)
    a = (a * a * words["P3"] >> 8) + (a * words["P2"] << 12)
    a = ((1 << 47) + a) * words["P1"] >> 33
    p = (((1048576 - up) << 31) - b) * 3125 // np.where(a == 0, 1, a)
    c = words["P9"] * (p >> 13) * (p >> 13) >> 25
    d = words["P8"] * p >> 19
    return np.where(a == 0, 0, (p + c + d >> 8) + (words["P7"] << 4))


# BMP388 ---------------------------------------------------------------------------------------------------------------

_RAW_BITS_BMP388 = 24


def compensate_bmp388(ut: Integers, up: Integers, words: Words) -> tuple[Floats, Floats]:
    """Return the temperature (n,) in degC and pressure (n,) in Pa, both in steps of 0.01, by the integers of the
    manufacturer's driver (BMP-221).
    """
    fine = fine_temperature_bmp388(ut, words)
    return _quotient(fine * 25, 16384) / 100.0, pressure_bmp388(up, fine, words) / 100.0


def uncompensated_bmp388(temperature_degc: Floats, pressure_pa: Floats, words: Words) -> tuple[Integers, Integers]:
    """Return the lowest raw words UT (n,) and UP (n,) whose compensation reaches these temperatures and pressures, by
    bisection: the temperature rises with its word, the pressure falls.
    """
    highest = (1 << _RAW_BITS_BMP388) - 1
    ut = _first_reaching(lambda word: fine_temperature_bmp388(word, words), temperature_degc * 65536, 0, highest)
    fine = fine_temperature_bmp388(ut, words)
    up = _first_reaching(lambda word: -pressure_bmp388(word, fine, words), -pressure_pa * 100, 0, highest)
    return ut, up


def fine_temperature_bmp388(ut: Integers, words: Words) -> Integers:
    """Return the temperature (n,) in 65536ths of a degC, which is also used for the pressure (BMP-221)."""
    difference = np.asarray(ut, np.int64) - 256 * words["T1"]
    return _quotient(words["T2"] * difference * 262144 + difference * difference * words["T3"], 1 << 32)


def pressure_bmp388(up: Integers, fine: Integers, words: Words) -> Integers:
    """Return the pressure (n,) in hundredths of a Pa, 0 if the result is negative (BMP-221)."""
    up = np.asarray(up, np.int64)
    square = fine * fine
    cube = _quotient(_quotient(square, 64) * fine, 256)
    offset = words["P5"] * (1 << 47) + _quotient(words["P8"] * cube, 32)
    offset += words["P7"] * square * 16 + words["P6"] * fine * (1 << 22)
    slope = (words["P1"] - 16384) * (1 << 46) + _quotient(words["P4"] * cube, 32)
    slope += words["P3"] * square * 4 + (words["P2"] - 16384) * fine * (1 << 21)
    bend = _quotient((words["P10"] * fine + 65536 * words["P9"]) * up, 8192)
    curve = _quotient(up * _quotient(bend, 10), 512) * 10
    twist = _quotient(_quotient(words["P11"] * (up * up), 65536) * up, 128)
    whole = _quotient(offset, 4) + _quotient(slope, 1 << 24) * up + curve + twist
    hundredths = np.maximum(whole, 0).astype(np.uint64) * np.uint64(25) >> np.uint64(40)
    return np.asarray(hundredths, np.int64)


def _quotient(numerator: Integers, divisor: int) -> Integers:
    """Return the quotient rounded towards zero, as in C."""
    return np.where(numerator < 0, -(-numerator // divisor), numerator // divisor)


# Each chip ------------------------------------------------------------------------------------------------------------

_OVERSAMPLING_BMP180 = 3  # eight samples, the quietest: BMP-44

BAROMETERS: Mapping[str, Barometer] = MappingProxyType(
    {
        "bmp180": Barometer(
            EXAMPLE_WORDS,
            3.0,  # BMP-44
            lambda ut, up, words: compensate(ut, up, words, _OVERSAMPLING_BMP180),
            lambda degc, pa, words: uncompensated(degc, pa, words, _OVERSAMPLING_BMP180),
            MappingProxyType({"oversampling": _OVERSAMPLING_BMP180}),
        ),
        "bmp280": Barometer(EXAMPLE_WORDS_BMP280, 1.3, compensate_bmp280, uncompensated_bmp280),  # noise: BMP-125
        "bmp388": Barometer(EXAMPLE_WORDS_BMP388, 1.3, compensate_bmp388, uncompensated_bmp388),  # noise: BMP-223
    }
)
