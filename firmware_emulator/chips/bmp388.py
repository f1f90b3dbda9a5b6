"""BMP388 barometer behind its registers, after the Bosch data sheet BST-BMP388-DS001 rev. 1.0 (BMP-201 ... BMP-223).

It sleeps after power-on. In forced mode it measures once and sleeps again, in normal mode at the set period (BMP-207).
A measurement takes the typical time (BMP-209).

Choices (DEC-220 to -222): writes in the first 2 ms after power-on or reset are acknowledged and lost; noise without
filter is the BMP280's; of measurements that nobody looked at, only the last 64 pass through the filter. The queue,
interrupts and the sensor's clock are left out.
"""

from __future__ import annotations

import random
from collections.abc import Mapping

from firmware_emulator.chip import Chip, Element
from firmware_emulator.chips.bmp388_inverse import BITS, Words, up_of, ut_of
from imuarray.facts import bmp388 as facts

FAR_NS = 1 << 62
START_UP_NS = 2_000_000  # BMP-212
SOFT_RESET = 0xB6  # BMP-204
SLEEP, FORCED, FORCED_TOO, NORMAL = range(4)  # BMP-207
NOISE_PA = (3.3, 2.6, 2.1, 1.6, 1.3, 1.1, 1.1, 1.1)  # by code of the oversampling: DEC-221
WORD_BYTES = (2, 2, 1, 2, 2, 1, 1, 2, 2, 1, 1, 2, 1, 1)  # BMP-203
SKIPPED = 1 << BITS - 1  # BMP-206
FILTERED = 64

_STATUS, _ERROR, _DATA = facts.STATUS.address, facts.ERR_REG.address, facts.DATA_0.address
_POWER, _CONFIG, _COMMAND = facts.PWR_CTRL.address, facts.CONFIG.address, facts.CMD.address


class Bmp388(Chip):
    """The chip.

    calibration: words by name that differ from the example. generator: where the pressure noise is drawn from; without
    one there is none. identity: what the identity register says.
    """

    def __init__(
        self,
        address: int,
        element: Element,
        powered_on_ns: int = 0,
        *,
        calibration: Mapping[str, int] | None = None,
        generator: random.Random | None = None,
        identity: int | None = None,
    ) -> None:
        self.words = Words()._replace(**(calibration or {}))
        self._generator = generator
        self._identity = facts.CHIP_ID.reset if identity is None else identity
        self._ut_at: tuple[float, int] = (float("nan"), 0)
        super().__init__(address, facts, element, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Reset values, this part's calibration words, asleep, ready for commands."""
        super().power_on(at_ns)
        self.page[facts.CHIP_ID.address] = self._identity
        self.page[_STATUS] = facts.COMMAND_READY.mask
        first = facts.CALIBRATION.address
        for word, count in zip(self.words, WORD_BYTES, strict=True):
            self.page[first : first + count] = (word & (1 << 8 * count) - 1).to_bytes(count, "little")
            first += count
        self._ready_ns = at_ns + START_UP_NS
        self._end_ns = FAR_NS
        self._memory: tuple[float, float] | None = None

    # Measuring --------------------------------------------------------------------------------------------------------

    @property
    def _duration_ns(self) -> int:
        """234 us, and 392 us and 2020 us a sample of pressure, 163 us and 2020 us a sample of temperature (BMP-209)."""
        control, oversampling = self.page[_POWER], self.page[facts.OSR.address]
        pressure = 392_000 + (2_020_000 << facts.PRESSURE_OVERSAMPLING.of(oversampling))
        temperature = 163_000 + (2_020_000 << facts.TEMPERATURE_OVERSAMPLING.of(oversampling))
        return 234_000 + facts.PRESSURE_ON.of(control) * pressure + facts.TEMPERATURE_ON.of(control) * temperature

    @property
    def _period_ns(self) -> int:
        return 5_000_000 << facts.PERIOD.of(self.page[facts.ODR.address])  # BMP-208

    def _sync(self, at_ns: int) -> None:
        """Every measurement that has ended by `at_ns` into the data registers."""
        if at_ns < self._end_ns:
            return
        if facts.MODE.of(self.page[_POWER]) != NORMAL:
            ended_ns, self._end_ns = self._end_ns, FAR_NS
            self.page[_POWER] &= ~facts.MODE.mask & 0xFF
            self._measure(ended_ns)
            return
        count = (at_ns - self._end_ns) // self._period_ns + 1
        filtered = facts.FILTER.of(self.page[_CONFIG]) > 0
        for number in range(max(0, count - (FILTERED if filtered else 1)), count):
            self._measure(self._end_ns + number * self._period_ns)
        self._end_ns += count * self._period_ns

    def _measure(self, at_ns: int) -> None:
        control, oversampling = self.page[_POWER], self.page[facts.OSR.address]
        codes = facts.TEMPERATURE_OVERSAMPLING.of(oversampling), facts.PRESSURE_OVERSAMPLING.of(oversampling)
        on = facts.TEMPERATURE_ON.of(control), facts.PRESSURE_ON.of(control)
        ut = self._ut(at_ns)
        pascal = self.element.pressure(at_ns)
        if self._generator is not None:
            pascal += self._generator.gauss(0.0, NOISE_PA[codes[1]])
        share = 1 << facts.FILTER.of(self.page[_CONFIG])  # coefficients are 0, 1, 3, ... 127: BMP-210
        new = float(ut), float(up_of(self.words, ut, pascal))
        old = self._memory or new
        self._memory = old[0] + (new[0] - old[0]) / share, old[1] + (new[1] - old[1]) / share
        shown = []
        for value, code, is_on in zip(self._memory, codes, on, strict=True):
            left_out = max(0, BITS - 16 - code) if share == 1 else 0
            shown.append(min(round(value / (1 << left_out)) << left_out, (1 << BITS) - 1) if is_on else SKIPPED)
        self.page[_DATA : _DATA + 6] = shown[1].to_bytes(3, "little") + shown[0].to_bytes(3, "little")  # BMP-211
        ready = facts.TEMPERATURE_READY.mask * on[0] | facts.PRESSURE_READY.mask * on[1]
        self.page[_STATUS] |= ready

    def _ut(self, at_ns: int) -> int:
        degc = self.element.temperature(at_ns)
        if degc != self._ut_at[0]:
            self._ut_at = degc, ut_of(self.words, degc)
        return self._ut_at[1]

    # Reading and writing ----------------------------------------------------------------------------------------------

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """A burst shows the registers as they are when it begins (BMP-211)."""
        return super().read(count, at_ns, 0)

    def load(self, address: int, at_ns: int) -> int:
        """A register's byte; reading a result clears its flag, reading the errors clears these (BMP-205)."""
        self._sync(at_ns)
        byte = self.page[address]
        if _DATA <= address < _DATA + 3:
            self.page[_STATUS] &= ~facts.PRESSURE_READY.mask & 0xFF
        elif _DATA + 3 <= address < _DATA + 6:
            self.page[_STATUS] &= ~facts.TEMPERATURE_READY.mask & 0xFF
        elif address == _ERROR:
            self.page[_ERROR] = 0
        return byte

    def store(self, address: int, value: int, at_ns: int) -> None:
        """A mode, a setting, a command, or nothing: every other register is read-only."""
        self._sync(at_ns)
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
        """Begin to measure, or stop; normal mode needs a period that is long enough (BMP-207)."""
        if mode == NORMAL and self._duration_ns > self._period_ns:
            self.page[_ERROR] |= facts.CONFIGURATION_ERROR.mask
            self.page[_POWER] &= ~facts.MODE.mask & 0xFF
            mode = SLEEP
        self._end_ns = FAR_NS if mode == SLEEP else at_ns + self._duration_ns
