"""AK8963 magnetometer behind its registers: AKM data sheet MS1356-E-02 (2013); AKM-01 ... AKM-16, DEC-230 to -233.

Not modelled: the external trigger, the I2C disable register. The bypass of the MPU-9250 around it determines whether it
can be reached (`firmware_emulator.array`).
"""

from __future__ import annotations

from types import ModuleType
from typing import ClassVar

from firmware_emulator.chips.akm_family import FAR_NS, SELF_TEST, SINGLE, AkmFamily
from firmware_emulator.six_axis import SampleGrid
from imuarray.facts import ak8963 as facts

SLOW, FAST = 0b0010, 0b0110  # AKM-13
RATES_HZ = {SLOW: 8.0, FAST: 100.0}
MEASURED_NS = 7_200_000  # typical: AKM-14
GAUSS_A_COUNT = (0.006, 0.0015)  # 14 and 16 bits: AKM-11
HIGHEST = (8190, 32760)
OVERFLOWS_GAUSS = 49.12  # sum of the sizes: AKM-12
OWN_FIELD = (0, 0, -2000)
"""The response of the self-test in adjusted counts of 16 bits: inside the data sheet's limits (AKM-15, DEC-232)."""

_ST1, _ST2, _DATA = facts.ST1.address, facts.ST2.address, facts.HXL.address
_CONTROL, _RESET = facts.CNTL1.address, facts.CNTL2.address


class Ak8963Chip(AkmFamily):
    """The chip."""

    table: ClassVar[ModuleType] = facts

    def power_on(self, at_ns: int) -> None:
        """Set the reset values, powered down."""
        super().power_on(at_ns)
        self.page[facts.INFO.address] = 0x9A
        self._grid = SampleGrid()
        self._once_ns = FAR_NS
        self._reading = False

    # Measuring --------------------------------------------------------------------------------------------------------

    def _sync(self, at_ns: int) -> None:
        """Write every measurement that has ended by `at_ns` into the data registers, unless a read is in progress
        (AKM-12).
        """
        if self._reading:
            return
        if at_ns >= self._once_ns:
            ended_ns, self._once_ns = self._once_ns, FAR_NS
            self._measure(ended_ns, facts.MODE.of(self.page[_CONTROL]) == SELF_TEST)
            self.page[_CONTROL] &= ~facts.MODE.mask & 0xFF
        previous = self._grid.index
        sampled_ns = self._grid.take(at_ns)
        if sampled_ns is not None:
            overrun = self.page[_ST1] & facts.DATA_READY.mask or self._grid.index - previous > 1
            self._measure(sampled_ns, False)
            self.page[_ST1] |= facts.DATA_OVERRUN.mask if overrun else 0

    def _measure(self, at_ns: int, self_test: bool) -> None:
        control = self.page[_CONTROL]
        fine = facts.SIXTEEN_BITS.of(control)
        gauss = self.element.sample(at_ns, OVERFLOWS_GAUSS, 50.0)
        if self_test and facts.SELF_TEST.of(self.page[facts.ASTC.address]):
            x, y, z = (count * GAUSS_A_COUNT[1] for count in OWN_FIELD)
            gauss = x, y, z
        self.page[_DATA : _DATA + 6] = self._data(gauss, GAUSS_A_COUNT[fine], -HIGHEST[fine], HIGHEST[fine])
        overflow = sum(abs(field) for field in gauss) >= OVERFLOWS_GAUSS
        self.page[_ST2] = facts.SIXTEEN_BITS_SHOWN.mask * fine | facts.OVERFLOW.mask * overflow
        self.page[_ST1] |= facts.DATA_READY.mask

    # Reading and writing ----------------------------------------------------------------------------------------------

    def load(self, address: int, at_ns: int) -> int:
        """Return a byte; reading data or ST2 clears ST1, and reading data locks the registers until ST2 is read
        (AKM-12).
        """
        self._sync(at_ns)
        byte = self._byte(address, self.page[_CONTROL])
        if _DATA <= address <= _ST2:
            self.page[_ST1] = 0
            self._reading = address != _ST2 and bool(self._grid.start_ns < FAR_NS)
        return byte

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a mode, a setting or a reset; ignore other writes."""
        self._sync(at_ns)
        if address == _RESET:
            if facts.SOFT_RESET.of(value):
                pointer = self.pointer
                self.power_on(at_ns)
                self.pointer = pointer
            return
        super().store(address, value, at_ns)
        if address == _CONTROL:
            mode = facts.MODE.of(value)
            self._reading = False
            self._grid.set(at_ns, 0)
            self._grid.set(at_ns, round(1e9 / RATES_HZ[mode]) if mode in RATES_HZ else 0)
            self._once_ns = at_ns + MEASURED_NS if mode in (SINGLE, SELF_TEST) else FAR_NS
