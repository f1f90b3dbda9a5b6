"""BMP388 barometer with its registers, according to the Bosch data sheet BST-BMP388-DS001 rev. 1.0 (BMP-201 ...
BMP-223).

It sleeps after power-on. In forced mode it measures once and sleeps again, in normal mode at the set period (BMP-207).
A measurement takes the typical time (BMP-209).

Choices (DEC-220 to -222): writes in the first 2 ms after power-on or reset are acknowledged and lost; the noise without
filter is that of the BMP280. The queue, interrupts and the sensor's clock are not modelled.

Raw words follow from temperature and pressure by inverting the compensation (facts BMP-203, BMP-221): the data sheet's
formulas in real numbers (its chapter 9), which its integer formulas approximate, are solved for the words that give the
required temperature and pressure. The temperature increases with its word, the pressure decreases.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import ClassVar, NamedTuple

from firmware_emulator.chips.bosch_barometer import NORMAL, SLEEP, SOFT_RESET, CyclicBarometer, nearest
from imuarray.facts import bmp388 as facts
from imuarray.facts.registers import Register

BITS = 24


class Bmp388Words(NamedTuple):
    """Calibration words of one part, signed as in BMP-203; the defaults are the example of BMP-220."""

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


def degc_of(words: Bmp388Words, raw: float) -> float:
    """Return the temperature in degC."""
    difference = raw - words.T1 * 2.0**8
    return difference * words.T2 / 2.0**30 + difference * difference * words.T3 / 2.0**48


def pascal_of(words: Bmp388Words, degc: float, raw: float) -> float:
    """Return the pressure in Pa."""
    offset = words.P5 * 2.0**3 + (words.P6 / 2.0**6 + (words.P7 / 2.0**8 + words.P8 / 2.0**15 * degc) * degc) * degc
    slope = (words.P1 - 2.0**14) / 2.0**20 + (
        (words.P2 - 2.0**14) / 2.0**29 + (words.P3 / 2.0**32 + words.P4 / 2.0**37 * degc) * degc
    ) * degc
    curve = words.P9 / 2.0**48 + words.P10 / 2.0**48 * degc
    return offset + (slope + (curve + words.P11 / 2.0**65 * raw) * raw) * raw


def ut_of(words: Bmp388Words, degc: float) -> int:
    """Return UT at a temperature; 24 bits."""
    return nearest(lambda raw: degc_of(words, raw), 0, (1 << BITS) - 1, degc)


def up_of(words: Bmp388Words, ut: int, pascal: float) -> int:
    """Return UP at a pressure, for a part at the temperature of `ut`; 24 bits."""
    degc = degc_of(words, ut)
    return nearest(lambda raw: -pascal_of(words, degc, raw), 0, (1 << BITS) - 1, -pascal)


NOISE_PA = (3.3, 2.6, 2.1, 1.6, 1.3, 1.1, 1.1, 1.1)  # by code of the oversampling: DEC-221
WORD_BYTES = (2, 2, 1, 2, 2, 1, 1, 2, 2, 1, 1, 2, 1, 1)  # BMP-203
SKIPPED = 1 << BITS - 1  # BMP-206

_STATUS, _ERROR, _DATA = facts.STATUS.address, facts.ERR_REG.address, facts.DATA_0.address
_POWER, _CONFIG, _COMMAND = facts.PWR_CTRL.address, facts.CONFIG.address, facts.CMD.address


class Bmp388Chip(CyclicBarometer):
    """The chip."""

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.CHIP_ID
    words = Bmp388Words()
    temperature_word = staticmethod(ut_of)
    word_bytes: ClassVar[Sequence[int]] = WORD_BYTES
    control = _POWER

    def power_on(self, at_ns: int) -> None:
        """Start up and accept commands."""
        super().power_on(at_ns)
        self.page[_STATUS] = facts.COMMAND_READY.mask

    @property
    def duration_ns(self) -> int:
        """Return the time of a measurement: 234 us, plus 392 us and 2020 us per sample for the pressure, plus 163 us
        and 2020 us per sample for the temperature (BMP-209).
        """
        control, oversampling = self.page[_POWER], self.page[facts.OSR.address]
        pressure = 392_000 + (2_020_000 << facts.PRESSURE_OVERSAMPLING.of(oversampling))
        temperature = 163_000 + (2_020_000 << facts.TEMPERATURE_OVERSAMPLING.of(oversampling))
        return 234_000 + facts.PRESSURE_ON.of(control) * pressure + facts.TEMPERATURE_ON.of(control) * temperature

    @property
    def period_ns(self) -> int:
        """Return the set period (BMP-208)."""
        return 5_000_000 << facts.PERIOD.of(self.page[facts.ODR.address])

    @property
    def filter_divisor(self) -> int:
        """Return the filter coefficient, 0, 1, 3, ... 127, plus one (BMP-210)."""
        return 1 << facts.FILTER.of(self.page[_CONFIG])

    def show(self, at_ns: int) -> None:
        """Write pressure and then temperature into the data registers, 24 bits each, and set a flag for each (BMP-205,
        BMP-211).
        """
        control, oversampling = self.page[_POWER], self.page[facts.OSR.address]
        codes = facts.TEMPERATURE_OVERSAMPLING.of(oversampling), facts.PRESSURE_OVERSAMPLING.of(oversampling)
        enabled = facts.TEMPERATURE_ON.of(control), facts.PRESSURE_ON.of(control)
        ut = self.ut(at_ns)
        pascal = self.pressure_pa(at_ns, NOISE_PA[codes[1]])
        results = []
        for value, code, is_on in zip(self.filtered(ut, up_of(self.words, ut, pascal)), codes, enabled, strict=True):
            unused_bits = max(0, BITS - 16 - code) if self.filter_divisor == 1 else 0
            rounded = min(round(value / (1 << unused_bits)) << unused_bits, (1 << BITS) - 1)
            results.append(rounded if is_on else SKIPPED)
        self.page[_DATA : _DATA + 6] = results[1].to_bytes(3, "little") + results[0].to_bytes(3, "little")
        self.page[_STATUS] |= facts.TEMPERATURE_READY.mask * enabled[0] | facts.PRESSURE_READY.mask * enabled[1]

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte; reading a result clears its flag, reading the error register sets 0 (BMP-205)."""
        self.sync(at_ns)
        byte = self.page[address]
        if _DATA <= address < _DATA + 3:
            self.page[_STATUS] &= ~facts.PRESSURE_READY.mask & 0xFF
        elif _DATA + 3 <= address < _DATA + 6:
            self.page[_STATUS] &= ~facts.TEMPERATURE_READY.mask & 0xFF
        elif address == _ERROR:
            self.page[_ERROR] = 0
        return byte

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a mode, a setting or a command; every other register is read-only."""
        self.sync(at_ns)
        if at_ns < self._ready_ns:
            return
        if address == _COMMAND:
            if value == SOFT_RESET:
                self.power_on(at_ns)
            return
        super().store(address, value, at_ns)
        if address == _POWER:
            self._switch(facts.MODE.of(value), at_ns)

    def _switch(self, mode: int, at_ns: int) -> None:
        """Begin to measure, or stop; normal mode needs a sufficiently long period (BMP-207)."""
        if mode == NORMAL and self.duration_ns > self.period_ns:
            self.page[_ERROR] |= facts.CONFIGURATION_ERROR.mask
            self.page[_POWER] &= ~facts.MODE.mask & 0xFF
            mode = SLEEP
        self.begin(mode, at_ns)
