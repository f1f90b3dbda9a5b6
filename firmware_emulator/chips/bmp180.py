"""BMP180 barometer with its registers, according to the Bosch data sheet v2.8 (facts BMP-01 ... BMP-67).

Each command starts one conversion. Temperature and pressure share the result registers, which keep the previous result
until the new one is complete (BMP-48). Conversions take the typical time (BMP-40 ... BMP-44).

Choices: commands in the 10 ms after power-on or reset (BMP-50) are acknowledged and lost; a command during a conversion
replaces it; an unknown measurement starts no conversion, and sco reads 0 immediately.

Raw words follow from temperature and pressure by inverting the compensation (facts BMP-60 ... BMP-66): the formulas, in
floor arithmetic, are solved by bisection for the words that give the required values; both increase with their word.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, ClassVar, Literal, NamedTuple

from firmware_emulator.chip import NEVER_NS
from firmware_emulator.chips.bosch_barometer import SOFT_RESET, BoschBarometer, nearest
from imuarray.facts import bmp180 as facts
from imuarray.facts.registers import Register

START_UP_NS = 10_000_000  # BMP-50
TEMPERATURE, PRESSURE = 0x0E, 0x14  # the measurement field: BMP-45
TEMPERATURE_NS = 3_000_000  # typical: BMP-40
PRESSURE_NS = (3_000_000, 5_000_000, 9_000_000, 17_000_000)  # typical, by oss: BMP-41 ... BMP-44
NOISE_PA = (6.0, 5.0, 4.0, 3.0)  # rms, typical, by oss

_CONTROL, _OUT, _RESET = facts.CTRL_MEAS.address, facts.OUT_MSB.address, facts.SOFT_RESET.address

STEPS_PER_DEGC = 160  # B5 is the temperature in sixteenths of 0.1 degC: BMP-60


class Bmp180Words(NamedTuple):
    """Calibration words of one part, signed as in BMP-20 ... BMP-30; the defaults are the data sheet's example."""

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


def b5_of(words: Bmp180Words, ut: int) -> int:
    """Return B5 (BMP-60); ZeroDivisionError for a word far outside the sensor's range (BMP-66)."""
    x1 = (ut - words.AC6) * words.AC5 >> 15
    return x1 + words.MC * 2048 // (x1 + words.MD)


def pressure_function(words: Bmp180Words, b5: int, oss: int) -> tuple[int, Callable[[int], int]]:
    """Return the lowest valid word, and the function from a word to Pa (BMP-61 ... BMP-63)."""
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


def ut_of(words: Bmp180Words, degc: float) -> int:
    """Return UT at a temperature; 16 bits."""
    coldest = words.AC6 - words.MD * 32768 // words.AC5 + 2  # below, X1 + MD is no longer positive
    return nearest(lambda ut: b5_of(words, ut), max(0, coldest), 0xFFFF, degc * STEPS_PER_DEGC)


def up_of(words: Bmp180Words, ut: int, oss: int, pascal: float) -> int:
    """Return UP at a pressure, for a part at the temperature of `ut`; 16 + oss bits."""
    lowest, pressure = pressure_function(words, b5_of(words, ut), oss)
    return nearest(pressure, lowest, (1 << 16 + oss) - 1, pascal)


class Bmp180Chip(BoschBarometer):
    """The chip."""

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.CHIP_ID
    words = Bmp180Words()
    temperature_word = staticmethod(ut_of)
    word_bytes: ClassVar[Sequence[int]] = (2,) * 11
    byte_order: ClassVar[Literal["little", "big"]] = "big"

    def __init__(self, *arguments: Any, start_up_ns: int = START_UP_NS, **switches: Any) -> None:
        """Take the arguments of `BoschBarometer`, and the time after power-on or reset in which commands are lost."""
        self.start_up_ns = start_up_ns
        super().__init__(*arguments, **switches)

    def power_on(self, at_ns: int) -> None:
        """Start up without a conversion."""
        super().power_on(at_ns)
        self._up_at: tuple[tuple[int, int, float], int] = ((0, -1, 0.0), 0)

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte, after storing the result of a conversion that has ended by `at_ns`."""
        if at_ns >= self._end_ns:
            self._finish()
        return self.page[address]

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a command or a reset; every other register is read-only."""
        if at_ns >= self._end_ns:
            self._finish()
        if at_ns < self._ready_ns:
            return
        if address == _RESET and value == SOFT_RESET:
            self.power_on(at_ns)
        elif address == _CONTROL:
            self.page[_CONTROL] = value
            self._command(value, at_ns)

    def _command(self, value: int, at_ns: int) -> None:
        measurement = facts.MEASUREMENT.of(value)
        is_known = measurement in (TEMPERATURE, PRESSURE) and facts.CONVERTING.of(value)
        if not is_known:
            self.page[_CONTROL] &= ~facts.CONVERTING.mask
            self._end_ns = NEVER_NS
        elif measurement == TEMPERATURE:
            self._end_ns = at_ns + TEMPERATURE_NS
        else:
            self._end_ns = at_ns + PRESSURE_NS[facts.OVERSAMPLING.of(value)]

    def _finish(self) -> None:
        """Write the result into the shared registers and clear sco (BMP-46)."""
        at_ns, self._end_ns = self._end_ns, NEVER_NS
        self.page[_CONTROL] &= ~facts.CONVERTING.mask
        ut = self.ut(at_ns)
        result = ut << 8
        if facts.MEASUREMENT.of(self.page[_CONTROL]) == PRESSURE:
            oss = facts.OVERSAMPLING.of(self.page[_CONTROL])
            result = self._up(ut, oss, at_ns) << 8 - oss  # BMP-47
        self.page[_OUT : _OUT + 3] = result.to_bytes(3, "big")

    def _up(self, ut: int, oss: int, at_ns: int) -> int:
        pascal = self.pressure_pa(at_ns, NOISE_PA[oss])
        if (ut, oss, pascal) != self._up_at[0]:
            self._up_at = (ut, oss, pascal), up_of(self.words, ut, oss, pascal)
        return self._up_at[1]
