"""BMP280 barometer with its registers, according to the Bosch data sheet BST-BMP280-DS001 rev. 1.23 (BMP-101 ...
BMP-126).

It sleeps after power-on. In forced mode it measures once and sleeps again, in normal mode it measures repeatedly with a
pause in between (BMP-107). A measurement takes the typical time (BMP-109).

Choices (DEC-90, DEC-91): writes in the first 2 ms after power-on or reset are acknowledged and lost, and the bit that
indicates the copying of calibration words is set during that time; a write to ctrl_meas aborts a measurement.

Raw words follow from temperature and pressure by inverting the compensation (facts BMP-103, BMP-121): the data sheet's
formulas in real numbers (its section 8.1), which its integer formulas approximate, are solved for the words that give
the required temperature and pressure. The temperature increases with its word, the pressure decreases.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import ClassVar, NamedTuple

from firmware_emulator.chips.bosch_barometer import SOFT_RESET, CyclicBarometer, nearest
from imuarray.facts import bmp280 as facts
from imuarray.facts.registers import Register

BITS = 20


class Bmp280Words(NamedTuple):
    """Calibration words of one part, signed as in BMP-103; the defaults are the data sheet's example."""

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


def fine_of(words: Bmp280Words, adc: float) -> float:
    """Return the temperature in 5120ths of a degC."""
    difference = adc / 16384 - words.T1 / 1024
    return difference * words.T2 + (difference / 8) ** 2 * words.T3


def pascal_of(words: Bmp280Words, fine: float, adc: float) -> float:
    """Return the pressure in Pa; inf for words far outside the sensor's range."""
    warm = fine / 2 - 64000
    offset = (warm * warm * words.P6 / 32768 + warm * words.P5 * 2) / 4 + words.P4 * 65536
    scale = (1 + (words.P3 * warm * warm / 524288 + words.P2 * warm) / 524288 / 32768) * words.P1
    if scale == 0:
        return float("inf")
    p = (1048576 - adc - offset / 4096) * 6250 / scale
    return p + (words.P9 * p * p / 2147483648 + p * words.P8 / 32768 + words.P7) / 16


def ut_of(words: Bmp280Words, degc: float) -> int:
    """Return UT at a temperature; 20 bits."""
    return nearest(lambda adc: fine_of(words, adc), 0, (1 << BITS) - 1, degc * 5120)


def up_of(words: Bmp280Words, ut: int, pascal: float) -> int:
    """Return UP at a pressure, for a part at the temperature of `ut`; 20 bits."""
    fine = fine_of(words, ut)
    return nearest(lambda adc: -pascal_of(words, fine, adc), 0, (1 << BITS) - 1, -pascal)


OVERSAMPLING = (0, 1, 2, 4, 8, 16, 16, 16)  # by code: BMP-106
STANDBY_NS = (500_000, 62_500_000, 125_000_000, 250_000_000, 500_000_000, 10**9, 2 * 10**9, 4 * 10**9)  # BMP-108
COEFFICIENTS = (1, 2, 4, 8, 16, 16, 16, 16)  # of the filter, by code: BMP-110
NOISE_PA = (0.0, 3.3, 2.6, 2.1, 1.6, 1.3, 1.3, 1.3)  # rms, without filter, by code of the oversampling: BMP-125
SKIPPED = 0x80000  # BMP-106

_RESET, _STATUS = facts.SOFT_RESET.address, facts.STATUS.address
_CONTROL, _CONFIG, _DATA = facts.CTRL_MEAS.address, facts.CONFIG.address, facts.PRESS_MSB.address


class Bmp280Chip(CyclicBarometer):
    """The chip."""

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.CHIP_ID
    words = Bmp280Words()
    temperature_word = staticmethod(ut_of)
    word_bytes: ClassVar[Sequence[int]] = (2,) * 12
    control = _CONTROL

    @property
    def duration_ns(self) -> int:
        """Return the time of a measurement: 1 ms, plus 2 ms per sample, plus 0.5 ms if it has pressure (BMP-109)."""
        control = self.page[_CONTROL]
        pressure = OVERSAMPLING[facts.PRESSURE_OVERSAMPLING.of(control)]
        samples = OVERSAMPLING[facts.TEMPERATURE_OVERSAMPLING.of(control)] + pressure
        return 1_000_000 + 2_000_000 * samples + 500_000 * bool(pressure)

    @property
    def period_ns(self) -> int:
        """Return the time of a measurement and the pause after it (BMP-108)."""
        return self.duration_ns + STANDBY_NS[facts.STANDBY.of(self.page[_CONFIG])]

    @property
    def filter_divisor(self) -> int:
        """Return the filter coefficient (BMP-110)."""
        return COEFFICIENTS[facts.FILTER.of(self.page[_CONFIG])]

    def show(self, at_ns: int) -> None:
        """Write pressure and then temperature into the data registers, 20 bits each (BMP-111)."""
        control = self.page[_CONTROL]
        codes = facts.TEMPERATURE_OVERSAMPLING.of(control), facts.PRESSURE_OVERSAMPLING.of(control)
        ut = self.ut(at_ns)
        pascal = self.pressure_pa(at_ns, NOISE_PA[codes[1]])
        values = self.filtered(ut, up_of(self.words, ut, pascal))
        ut_shown, up_shown = (self._round(value, code) for value, code in zip(values, codes, strict=True))
        data = (up_shown << 4).to_bytes(3, "big") + (ut_shown << 4).to_bytes(3, "big")
        self.page[_DATA : _DATA + len(data)] = data

    def _round(self, value: float, code: int) -> int:
        """Return a word rounded to its resolution: 16 bits and one more for each doubling of samples; with the filter
        always 20 bits (BMP-106, BMP-110).
        """
        if not code:
            return SKIPPED
        unused_bits = BITS - 16 - (min(code, 5) - 1) if self.filter_divisor == 1 else 0
        return min(round(value / (1 << unused_bits)), (1 << BITS - unused_bits) - 1) << unused_bits

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte; the status shows whether a measurement is in progress (BMP-105)."""
        self.sync(at_ns)
        if address == _STATUS:
            return facts.COPYING.mask * (at_ns < self._ready_ns) | facts.MEASURING.mask * self._measures(at_ns)
        return self.page[address]

    def _measures(self, at_ns: int) -> bool:
        return self._end_ns - self.duration_ns <= at_ns < self._end_ns

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a mode, a setting or a reset; every other register is read-only."""
        self.sync(at_ns)
        if at_ns < self._ready_ns:
            return
        if address == _RESET:
            if value == SOFT_RESET:
                self.power_on(at_ns)
            return
        super().store(address, value, at_ns)
        if address == _CONFIG:
            self._memory = None  # the next value passes through: BMP-110
        elif address == _CONTROL:
            self.begin(facts.MODE.of(value), at_ns)
