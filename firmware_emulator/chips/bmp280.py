"""BMP280 barometer behind its registers, after the Bosch data sheet BST-BMP280-DS001 rev. 1.23 (BMP-101 ... BMP-126).

It sleeps after power-on. In forced mode it measures once and sleeps again, in normal mode over and over with a pause in
between (BMP-107). A measurement takes the typical time (BMP-109).

Choices (DEC-90, DEC-91): writes in the first 2 ms after power-on or reset are acknowledged and lost, and the bit that
says that calibration words are being copied is set meanwhile; a write to ctrl_meas breaks a measurement off; of
measurements that nobody looked at, only the last 64 pass through the filter.
"""

from __future__ import annotations

import random
from collections.abc import Mapping

from firmware_emulator.chip import Chip, Element
from firmware_emulator.chips.bmp280_inverse import BITS, Words, up_of, ut_of
from imuarray.facts import bmp280 as facts

FAR_NS = 1 << 62
START_UP_NS = 2_000_000  # BMP-113
SOFT_RESET = 0xB6  # BMP-104
SLEEP, FORCED, FORCED_TOO, NORMAL = range(4)  # BMP-107
OVERSAMPLING = (0, 1, 2, 4, 8, 16, 16, 16)  # by code: BMP-106
STANDBY_NS = (500_000, 62_500_000, 125_000_000, 250_000_000, 500_000_000, 10**9, 2 * 10**9, 4 * 10**9)  # BMP-108
COEFFICIENTS = (1, 2, 4, 8, 16, 16, 16, 16)  # of the filter, by code: BMP-110
NOISE_PA = (0.0, 3.3, 2.6, 2.1, 1.6, 1.3, 1.3, 1.3)  # rms, without filter, by code of the oversampling: BMP-125
SKIPPED = 0x80000  # BMP-106
FILTERED = 64

_RESET, _STATUS = facts.SOFT_RESET.address, facts.STATUS.address
_CONTROL, _CONFIG, _DATA = facts.CTRL_MEAS.address, facts.CONFIG.address, facts.PRESS_MSB.address


class Bmp280(Chip):
    """The chip.

    calibration: words by name that differ from the data sheet's worked example.
    generator: where the pressure noise is drawn from; without one there is none. Temperature noise is left out.
    identity: what the identity register says.
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
        """Reset values, this part's calibration words, asleep."""
        super().power_on(at_ns)
        self.page[facts.CHIP_ID.address] = self._identity
        for index, word in enumerate(self.words):
            first = facts.CALIBRATION.address + 2 * index
            self.page[first : first + 2] = (word & 0xFFFF).to_bytes(2, "little")
        self._ready_ns = at_ns + START_UP_NS
        self._end_ns = FAR_NS
        self._memory: tuple[float, float] | None = None

    # Measuring --------------------------------------------------------------------------------------------------------

    @property
    def _duration_ns(self) -> int:
        """1 ms, 2 ms for each sample, and 0.5 ms where the pressure is measured (BMP-109)."""
        control = self.page[_CONTROL]
        pressure = OVERSAMPLING[facts.PRESSURE_OVERSAMPLING.of(control)]
        samples = OVERSAMPLING[facts.TEMPERATURE_OVERSAMPLING.of(control)] + pressure
        return 1_000_000 + 2_000_000 * samples + 500_000 * bool(pressure)

    def _sync(self, at_ns: int) -> None:
        """Every measurement that has ended by `at_ns` into the data registers."""
        if at_ns < self._end_ns:
            return
        if facts.MODE.of(self.page[_CONTROL]) != NORMAL:
            ended_ns, self._end_ns = self._end_ns, FAR_NS
            self.page[_CONTROL] &= ~facts.MODE.mask
            self._measure(ended_ns)
            return
        period_ns = self._duration_ns + STANDBY_NS[facts.STANDBY.of(self.page[_CONFIG])]
        count = (at_ns - self._end_ns) // period_ns + 1
        filtered = COEFFICIENTS[facts.FILTER.of(self.page[_CONFIG])] > 1
        for number in range(max(0, count - (FILTERED if filtered else 1)), count):
            self._measure(self._end_ns + number * period_ns)
        self._end_ns += count * period_ns

    def _measure(self, at_ns: int) -> None:
        control = self.page[_CONTROL]
        codes = facts.TEMPERATURE_OVERSAMPLING.of(control), facts.PRESSURE_OVERSAMPLING.of(control)
        ut = self._ut(at_ns)
        pascal = self.element.pressure(at_ns)
        if self._generator is not None:
            pascal += self._generator.gauss(0.0, NOISE_PA[codes[1]])
        coefficient = COEFFICIENTS[facts.FILTER.of(self.page[_CONFIG])]
        new = float(ut), float(up_of(self.words, ut, pascal))
        old = self._memory or new
        self._memory = (
            old[0] + (new[0] - old[0]) / coefficient,
            old[1] + (new[1] - old[1]) / coefficient,
        )
        ut_shown, up_shown = (
            self._shown(value, code, coefficient) for value, code in zip(self._memory, codes, strict=True)
        )
        data = (up_shown << 4).to_bytes(3, "big") + (ut_shown << 4).to_bytes(3, "big")  # BMP-111
        self.page[_DATA : _DATA + len(data)] = data

    def _shown(self, value: float, code: int, coefficient: int) -> int:
        """16 bits and one more for each doubling of samples; with the filter always 20 (BMP-106, BMP-110)."""
        if not code:
            return SKIPPED
        left_out = BITS - 16 - (min(code, 5) - 1) if coefficient == 1 else 0
        return min(round(value / (1 << left_out)), (1 << BITS - left_out) - 1) << left_out

    def _ut(self, at_ns: int) -> int:
        degc = self.element.temperature(at_ns)
        if degc != self._ut_at[0]:
            self._ut_at = degc, ut_of(self.words, degc)
        return self._ut_at[1]

    # Reading and writing ----------------------------------------------------------------------------------------------

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """A burst shows the registers as they are when it begins (BMP-112)."""
        return super().read(count, at_ns, 0)

    def load(self, address: int, at_ns: int) -> int:
        """A register's byte; the status says whether a measurement is in progress (BMP-105)."""
        self._sync(at_ns)
        if address == _STATUS:
            return facts.COPYING.mask * (at_ns < self._ready_ns) | facts.MEASURING.mask * self._measures(at_ns)
        return self.page[address]

    def _measures(self, at_ns: int) -> bool:
        return self._end_ns - self._duration_ns <= at_ns < self._end_ns

    def store(self, address: int, value: int, at_ns: int) -> None:
        """A mode, a setting, a reset, or nothing: every other register is read-only."""
        self._sync(at_ns)
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
            mode = facts.MODE.of(value)
            self._end_ns = FAR_NS if mode == SLEEP else at_ns + self._duration_ns
