"""BMP180 barometer behind its registers, after the Bosch data sheet v2.8 (facts BMP-01 ... BMP-67).

One command, one conversion; temperature and pressure share the result registers, which keep the previous result
until the new one is finished (BMP-48). Conversions take the typical time (BMP-40 ... BMP-44).

Choices: commands in the 10 ms after power-on or reset (BMP-50) are acknowledged and lost; a command during a
conversion takes its place; an unknown measurement starts nothing, and sco reads 0 at once.
"""

from __future__ import annotations

import random
from collections.abc import Mapping

from firmware_emulator.chip import Chip, Element
from firmware_emulator.chips.bmp180_inverse import Words, up_of, ut_of
from imuarray.facts import bmp180 as facts

FAR_NS = 1 << 62
START_UP_NS = 10_000_000  # BMP-50
SOFT_RESET = 0xB6  # BMP-12
TEMPERATURE, PRESSURE = 0x0E, 0x14  # the measurement field: BMP-45
TEMPERATURE_NS = 3_000_000  # typical: BMP-40
PRESSURE_NS = (3_000_000, 5_000_000, 9_000_000, 17_000_000)  # typical, by oss: BMP-41 ... BMP-44
NOISE_PA = (6.0, 5.0, 4.0, 3.0)  # rms, typical, by oss

_CONTROL, _OUT, _RESET = facts.CTRL_MEAS.address, facts.OUT_MSB.address, facts.SOFT_RESET.address


class Bmp180(Chip):
    """The chip.

    calibration: words by name that differ from the data sheet's worked example.
    generator: where the pressure noise is drawn from; without one there is none. Temperature noise is unknown (BMP-77).
    start_up_ns: how long after power-on or reset commands are lost.
    """

    def __init__(
        self,
        address: int,
        element: Element,
        powered_on_ns: int = 0,
        *,
        calibration: Mapping[str, int] | None = None,
        generator: random.Random | None = None,
        start_up_ns: int = START_UP_NS,
    ) -> None:
        self.words = Words()._replace(**(calibration or {}))
        self._generator = generator
        self._start_up_ns = start_up_ns
        self._ut_at: tuple[float, int] = (float("nan"), 0)
        self._up_at: tuple[tuple[int, int, float], int] = ((0, -1, 0.0), 0)
        super().__init__(address, facts, element, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Reset values, this part's calibration words, no conversion."""
        super().power_on(at_ns)
        for index, word in enumerate(self.words):
            first = facts.CALIBRATION.address + 2 * index
            self.page[first : first + 2] = (word & 0xFFFF).to_bytes(2, "big")
        self._ready_ns = at_ns + self._start_up_ns
        self._end_ns = FAR_NS

    def load(self, address: int, at_ns: int) -> int:
        """A register's byte, after a conversion that has ended by `at_ns` has left its result."""
        if at_ns >= self._end_ns:
            self._finish()
        return self.page[address]

    def store(self, address: int, value: int, at_ns: int) -> None:
        """A command, a reset, or nothing: every other register is read-only."""
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
        known = measurement in (TEMPERATURE, PRESSURE) and facts.CONVERTING.of(value)
        if not known:
            self.page[_CONTROL] &= ~facts.CONVERTING.mask
            self._end_ns = FAR_NS
        elif measurement == TEMPERATURE:
            self._end_ns = at_ns + TEMPERATURE_NS
        else:
            self._end_ns = at_ns + PRESSURE_NS[facts.OVERSAMPLING.of(value)]

    def _finish(self) -> None:
        """The result into the shared registers, sco to 0 (BMP-46)."""
        at_ns, self._end_ns = self._end_ns, FAR_NS
        self.page[_CONTROL] &= ~facts.CONVERTING.mask
        ut = self._ut(at_ns)
        result = ut << 8
        if facts.MEASUREMENT.of(self.page[_CONTROL]) == PRESSURE:
            oss = facts.OVERSAMPLING.of(self.page[_CONTROL])
            result = self._up(ut, oss, at_ns) << 8 - oss  # BMP-47
        self.page[_OUT : _OUT + 3] = result.to_bytes(3, "big")

    def _ut(self, at_ns: int) -> int:
        degc = self.element.temperature(at_ns)
        if degc != self._ut_at[0]:
            self._ut_at = degc, ut_of(self.words, degc)
        return self._ut_at[1]

    def _up(self, ut: int, oss: int, at_ns: int) -> int:
        pascal = self.element.pressure(at_ns)
        if self._generator is not None:
            pascal += self._generator.gauss(0.0, NOISE_PA[oss])
        if (ut, oss, pascal) != self._up_at[0]:
            self._up_at = (ut, oss, pascal), up_of(self.words, ut, oss, pascal)
        return self._up_at[1]
