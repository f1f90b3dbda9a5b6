"""AK8975 magnetometer behind its registers, as it is in the MPU-9150; AKM-21 ... AKM-28, DEC-231 to -235.

It measures once on command and powers down afterwards. The bypass of the MPU-9150 around it determines whether it can
be reached (`firmware_emulator.array`).
"""

from __future__ import annotations

from types import ModuleType
from typing import ClassVar

from firmware_emulator.chips.akm_family import DOWN, FAR_NS, SELF_TEST, SINGLE, AkmFamily
from imuarray.facts import ak8975 as facts

MEASURED_NS = 7_300_000  # typical: AKM-25
GAUSS_A_COUNT = 0.003  # AKM-22
LOWEST, HIGHEST = -4096, 4095
OVERFLOWS_GAUSS = 24.0  # sum of the sizes: AKM-23
FULL_SCALE_GAUSS = 12.29
OWN_FIELD = (0.0, 0.0, -1.8)
"""Field of the self-test in gauss, in place of the external field: -600 counts, adjusted (AKM-26, DEC-234)."""

_ST1, _ST2, _DATA = facts.ST1.address, facts.ST2.address, facts.HXL.address
_CONTROL = facts.CNTL.address


class Ak8975Chip(AkmFamily):
    """The chip."""

    table: ClassVar[ModuleType] = facts

    def power_on(self, at_ns: int) -> None:
        """Set the reset values, powered down."""
        super().power_on(at_ns)
        self._over_ns = FAR_NS

    def _sync(self, at_ns: int) -> None:
        """Write a completed measurement into the data registers, then power down (AKM-24)."""
        if at_ns < self._over_ns:
            return
        gauss = self.element.sample(self._over_ns, FULL_SCALE_GAUSS, 50.0)
        is_own = facts.MODE.of(self.page[_CONTROL]) == SELF_TEST and facts.SELF_TEST.of(self.page[facts.ASTC.address])
        if is_own:
            gauss = OWN_FIELD
        self.page[_DATA : _DATA + 6] = self._data(gauss, GAUSS_A_COUNT, LOWEST, HIGHEST)
        self.page[_ST2] = facts.OVERFLOW.mask * (sum(map(abs, gauss)) >= OVERFLOWS_GAUSS)
        self.page[_ST1] = facts.DATA_READY.mask
        self.page[_CONTROL] = DOWN
        self._over_ns = FAR_NS

    def load(self, address: int, at_ns: int) -> int:
        """Return a byte; reading data or ST2 clears ST1 (AKM-23)."""
        self._sync(at_ns)
        byte = self._byte(address, self.page[_CONTROL])
        if _DATA <= address <= _ST2:
            self.page[_ST1] = 0
        return byte

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a mode or a setting; a mode ends a measurement in progress (DEC-235)."""
        self._sync(at_ns)
        super().store(address, value, at_ns)
        if address == _CONTROL:
            self._over_ns = at_ns + MEASURED_NS if facts.MODE.of(value) in (SINGLE, SELF_TEST) else FAR_NS
