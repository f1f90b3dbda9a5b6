"""MMC5983MA magnetometer with its registers: MEMSIC data sheet Rev A (2019); MMC-01 ... MMC-20, DEC-210 to -213.

SET and RESET reverse the magnetisation of the elements: their response changes its sign, the offset of the bridges does
not. Not modelled: interrupts, the three-wire SPI, magnetisation by strong fields.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, ClassVar

from firmware_emulator.chip import NEVER_NS, Chip, Triple
from firmware_emulator.six_axis import SampleGrid
from imuarray.facts import mmc5983 as facts
from imuarray.facts.registers import Register

ZERO, HIGHEST, CODES_PER_GAUSS = 1 << 17, (1 << 18) - 1, 16384.0  # MMC-11
RESET_NS = 10_000_000  # MMC-15
BANDWIDTHS_HZ = (100.0, 200.0, 400.0, 800.0)
MEASURED_NS = (8_000_000, 4_000_000, 2_000_000, 500_000)  # MMC-13
RATES_HZ = (0.0, 1.0, 10.0, 20.0, 50.0, 100.0, 200.0, 1000.0)  # MMC-16
BRIDGE_GAUSS = (0.11, -0.07, 0.19)
"""Outputs of the bridges in zero field, in gauss (DEC-212), within the limits of MMC-20."""
EXTRA_GAUSS = 1.0
"""Change of the readings by the extra current, in gauss (DEC-213)."""

_STATUS, _CONTROL0, _CONTROL1 = facts.STATUS.address, facts.CONTROL_0.address, facts.CONTROL_1.address
_CONTROL2, _CONTROL3 = facts.CONTROL_2.address, facts.CONTROL_3.address


class Mmc5983Chip(Chip):
    """The chip; `bridge` is the offset of its bridges in gauss."""

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.PRODUCT_ID

    def __init__(self, *arguments: Any, bridge: Triple = BRIDGE_GAUSS, **switches: Any) -> None:
        self._bridge = bridge
        super().__init__(*arguments, **switches)

    def power_on(self, at_ns: int) -> None:
        """Set the reset values: idle, magnetised as by a SET (DEC-211)."""
        super().power_on(at_ns)
        self.page[_STATUS] = facts.OTP_READ_DONE.mask
        self._control = bytearray(4)
        self._sign = 1.0
        self._grid = SampleGrid()
        self._field_ns = self._temperature_ns = NEVER_NS
        self._ready_ns = at_ns + RESET_NS

    # Measuring --------------------------------------------------------------------------------------------------------

    def _sync(self, at_ns: int) -> None:
        """Write every measurement that has ended by `at_ns` into the data registers."""
        if at_ns >= self._field_ns:
            self._measure(self._field_ns)
            self._field_ns = NEVER_NS
        if at_ns >= self._temperature_ns:
            degc = self.element.temperature(self._temperature_ns)
            self.page[facts.T_OUT.address] = max(0, min(255, round((degc + 75.0) * 255 / 200)))  # MMC-18
            self.page[_STATUS] |= facts.TEMPERATURE_DONE.mask
            self._temperature_ns = NEVER_NS
        sampled_ns = self._grid.take(at_ns)
        if sampled_ns is not None:
            if facts.AUTO_SET_RESET.of(self._control[0]) and facts.PERIODIC_SET_ON.of(self._control[2]):
                self._sign = 1.0  # MMC-16
            self._measure(sampled_ns)

    def _measure(self, at_ns: int) -> None:
        control = self._control[1]
        field = self.element.sample(at_ns, 8.0, BANDWIDTHS_HZ[facts.BANDWIDTH.of(control)])
        current = self._control[3]
        extra = EXTRA_GAUSS * (facts.CURRENT_PLUS.of(current) - facts.CURRENT_MINUS.of(current))
        disabled = (facts.X_OFF.of(control), facts.YZ_OFF.of(control) == 0b11, facts.YZ_OFF.of(control) == 0b11)
        low = self.page[facts.XYZ_OUT_2.address]
        for axis, bits in enumerate((facts.X_LOW, facts.Y_LOW, facts.Z_LOW)):
            if disabled[axis]:
                continue
            gauss = self._sign * (field[axis] + extra) + self._bridge[axis]
            code = max(0, min(HIGHEST, ZERO + round(gauss * CODES_PER_GAUSS)))
            first = facts.X_OUT_0.address + 2 * axis
            self.page[first : first + 2] = (code >> 2).to_bytes(2, "big")
            low = bits(code & 0b11).into(low)
        self.page[facts.XYZ_OUT_2.address] = low
        self.page[_STATUS] |= facts.FIELD_DONE.mask

    # Reading and writing ----------------------------------------------------------------------------------------------

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte; control registers read 0 (DEC-210)."""
        self._sync(at_ns)
        return 0 if self.registers.get(address, facts.STATUS).access == "w" else self.page[address]

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a command or a setting, or clear a bit of the status (MMC-17)."""
        self._sync(at_ns)
        register = self.registers.get(address)
        if register is None or register.access == "r" or at_ns < self._ready_ns:
            return
        value &= ~register.reserved & 0xFF
        if address == _STATUS:
            self.page[_STATUS] &= ~(value & (facts.FIELD_DONE.mask | facts.TEMPERATURE_DONE.mask)) & 0xFF
            return
        self._control[address - _CONTROL0] = value
        if address == _CONTROL0:
            self._command(value, at_ns)
        elif address == _CONTROL1 and facts.SOFT_RESET.of(value):
            self.reset(at_ns)
        elif address == _CONTROL2:
            is_continuous = facts.CONTINUOUS.of(value) and facts.FREQUENCY.of(value)
            self._grid.set(at_ns, 0)
            self._grid.set(at_ns, round(1e9 / RATES_HZ[facts.FREQUENCY.of(value)]) if is_continuous else 0)

    def _command(self, value: int, at_ns: int) -> None:
        if facts.SET_COIL.of(value):
            self._sign = 1.0
        if facts.RESET_COIL.of(value):
            self._sign = -1.0
        duration_ns = MEASURED_NS[facts.BANDWIDTH.of(self._control[1])]
        if facts.TAKE_FIELD.of(value):
            self._field_ns = at_ns + duration_ns
            self.page[_STATUS] &= ~facts.FIELD_DONE.mask & 0xFF
        elif facts.TAKE_TEMPERATURE.of(value):  # not both at once: MMC-18
            self._temperature_ns = at_ns + duration_ns
            self.page[_STATUS] &= ~facts.TEMPERATURE_DONE.mask & 0xFF
