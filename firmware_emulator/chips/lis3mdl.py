"""LIS3MDL magnetometer with its registers: ST data sheet DocID024204 Rev 6; LIS-01 ... LIS-21, DEC-100 to -104.

It is powered down after power-on. Sub-address bit 7 requests the next register after every byte. Not modelled:
interrupts, FAST_READ.
"""

from __future__ import annotations

from types import ModuleType
from typing import ClassVar, NamedTuple

from firmware_emulator.chip import Chip
from firmware_emulator.six_axis import SampleGrid, clipped
from imuarray.facts import lis3mdl as facts
from imuarray.facts.registers import Register

CONTINUOUS, SINGLE, DOWN, DOWN_TOO = range(4)  # LIS-12
RATES_HZ = (0.625, 1.25, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0)  # LIS-11
FAST_HZ = (1000.0, 560.0, 300.0, 155.0)  # by performance: LIS-11
CODES_PER_GAUSS = (6842.0, 3421.0, 2281.0, 1711.0)  # LIS-10
PUSH_GAUSS = (2.0, 2.0, 0.5)
"""Change of the readings by the self-test in gauss, within the data sheet's limits (LIS-16, DEC-101)."""

_STATUS, _FIRST, _LAST = facts.STATUS_REG.address, facts.OUT_X_L.address, facts.OUT_Z_H.address
_TEMPERATURE = facts.TEMP_OUT_L.address
_OFFSETS = facts.OFFSET_X_L.address
_CONTROL1, _CONTROL2, _CONTROL3 = facts.CTRL_REG1.address, facts.CTRL_REG2.address, facts.CTRL_REG3.address


class _Settings(NamedTuple):
    """The settings that determine the times of samples."""

    operation: int
    rate_hz: float


class Lis3mdlChip(Chip):
    """The chip."""

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.WHO_AM_I

    def power_on(self, at_ns: int) -> None:
        """Set the reset values, powered down."""
        super().power_on(at_ns)
        self._increment = False
        self._grid = SampleGrid()
        self._settings = _Settings(DOWN, 0.0)
        self._held: dict[int, int] = {}

    # Sampling ---------------------------------------------------------------------------------------------------------

    def _sync(self, at_ns: int) -> None:
        """Write the latest sample into the data registers; the status shows whether it replaced an unread sample."""
        previous = self._grid.index
        sampled_ns = self._grid.take(at_ns)
        if sampled_ns is None:
            return
        available = facts.AXIS_AVAILABLE.of(self.page[_STATUS])
        overwritten = 0b111 if self._grid.index - previous > 1 else available
        overrun = facts.AXIS_OVERRUN.of(self.page[_STATUS]) | overwritten
        self.page[_STATUS] = (overrun == 0b111) << 7 | overrun << 4 | 0x0F
        self._convert(sampled_ns)
        if self._settings.operation == SINGLE:  # DEC-102
            self.page[_CONTROL3] |= DOWN_TOO
            self._restart(at_ns)

    def _convert(self, at_ns: int) -> None:
        control = self.page[_CONTROL1]
        full_scale = facts.FULL_SCALE.of(self.page[_CONTROL2])
        performance = facts.XY_PERFORMANCE.of(control)
        field = self.element.sample(at_ns, 4.0 * (full_scale + 1), FAST_HZ[performance] / 2)  # DEC-103
        push = PUSH_GAUSS if facts.SELF_TEST.of(control) else (0.0, 0.0, 0.0)
        order = "big" if facts.BIG_ENDIAN.of(self.page[facts.CTRL_REG4.address]) else "little"
        for axis in range(3):
            offset = int.from_bytes(self.page[_OFFSETS + 2 * axis : _OFFSETS + 2 * axis + 2], "little", signed=True)
            code = clipped(round((field[axis] + push[axis]) * CODES_PER_GAUSS[full_scale]) - offset)
            low = _FIRST + 2 * axis
            self.page[low : low + 2] = code.to_bytes(2, "big" if order == "big" else "little", signed=True)
        if facts.TEMPERATURE_ON.of(control):
            code = clipped(round((self.element.temperature(at_ns) - 25.0) * 8.0))  # LIS-20
            self.page[_TEMPERATURE : _TEMPERATURE + 2] = code.to_bytes(2, "little", signed=True)

    def _restart(self, at_ns: int) -> None:
        """Restart the samples if the rate changed or the chip was woken up (DEC-100)."""
        control = self.page[_CONTROL1]
        rate_hz = RATES_HZ[facts.DATA_RATE.of(control)]
        if facts.FAST_RATE.of(control):
            rate_hz = FAST_HZ[facts.XY_PERFORMANCE.of(control)]
        if facts.LOW_POWER.of(self.page[_CONTROL3]):
            rate_hz = RATES_HZ[0]
        settings = _Settings(facts.OPERATION.of(self.page[_CONTROL3]), rate_hz)
        if settings != self._settings:
            self._grid.set(at_ns, 0)
            self._settings = settings
        is_on = settings.operation in (CONTINUOUS, SINGLE)
        self._grid.set(at_ns, round(1e9 / rate_hz) if is_on else 0)

    # Reading and writing ----------------------------------------------------------------------------------------------

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Write: the first byte is the sub-address, whose bit 7 requests the next register after each byte; the values
        follow (LIS-03).
        """
        if data:
            self._increment = data[0] >= 0x80
            data = bytes((data[0] & 0x7F,)) + data[1:]
        return super().write(data, at_ns, byte_ns)

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the next register if sub-address bit 7 requested it (LIS-03); the data registers wrap from z to x
        (LIS-18, DEC-104).
        """
        if not self._increment:
            return pointer
        return _FIRST if reading and pointer == _LAST else pointer + 1 & 0x7F

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte; with BDU an axis does not change between its first byte and its second (LIS-13)."""
        self._sync(at_ns)
        if not _FIRST <= address <= _LAST:
            return self.page[address]
        axis, half = divmod(address - _FIRST, 2)
        if half and address not in self._held:  # read alone
            self._clear_flags(axis)
            return self.page[address]
        if half:
            self._clear_flags(axis)
            return self._held.pop(address)
        if facts.BLOCK_UPDATE.of(self.page[facts.CTRL_REG5.address]):
            self._held[address + 1] = self.page[address + 1]
        return self.page[address]

    def _clear_flags(self, axis: int) -> None:
        """Clear the flags of an axis when its high byte is read (LIS-12)."""
        status = self.page[_STATUS] & ~(0x11 << axis | facts.ZYX_AVAILABLE.mask | facts.ZYX_OVERRUN.mask)
        self.page[_STATUS] = status & 0xFF

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Write a byte to a register; samples before it are unchanged."""
        self._sync(at_ns)
        if address == _CONTROL2 and value & facts.SOFT_RESET.mask:
            pointer, increment = self.pointer, self._increment
            self.power_on(at_ns)
            self.pointer, self._increment = pointer, increment
            return
        super().store(address, value, at_ns)
        if address == _CONTROL2:
            self.page[address] &= ~facts.REBOOT.mask & 0xFF
        if address in (_CONTROL1, _CONTROL3):
            self._restart(at_ns)
