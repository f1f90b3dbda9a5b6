"""AKM's magnetometers with their registers: the AK8963 of the MPU-9250 and the AK8975 of the MPU-9150.

AK8963: AKM data sheet MS1356-E-02 (2013); AKM-01 ... AKM-16, DEC-230 to -233. AK8975: AKM-21 ... AKM-28, DEC-231 to
-235; it measures once on command and powers down afterwards. Not modelled: the external trigger, the I2C disable
register. The bypass of the chip around a magnetometer determines whether it can be reached (`firmware_emulator.array`).
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, ClassVar

from firmware_emulator.chip import NEVER_NS, Chip, Triple
from firmware_emulator.six_axis import SampleGrid
from imuarray.facts import ak8963, ak8975
from imuarray.facts.registers import Register

DOWN, SINGLE, SELF_TEST, FUSE_ROM = 0b0000, 0b0001, 0b1000, 0b1111  # AKM-13, AKM-24
ADJUSTMENT = (176, 178, 167)
"""Values in the fuse ROM by default (DEC-231)."""
AK8963_NS, AK8975_NS = 7_200_000, 7_300_000  # time of a measurement, typical: AKM-14, AKM-25

AK8963_RATES_HZ = {0b0010: 8.0, 0b0110: 100.0}  # AKM-13
AK8963_GAUSS_A_COUNT = (0.006, 0.0015)  # 14 and 16 bits: AKM-11
AK8963_HIGHEST = (8190, 32760)
AK8963_OVERFLOWS_GAUSS = 49.12  # sum of the sizes: AKM-12
AK8963_OWN_FIELD = (0.0, 0.0, -2000 * 0.0015)
"""Field of the self-test in gauss: -2000 adjusted counts of 16 bits, inside the limits (AKM-15, DEC-232)."""

AK8975_GAUSS_A_COUNT = 0.003  # AKM-22
AK8975_LOWEST, AK8975_HIGHEST = -4096, 4095
AK8975_OVERFLOWS_GAUSS = 24.0  # sum of the sizes: AKM-23
AK8975_FULL_SCALE_GAUSS = 12.29
AK8975_OWN_FIELD = (0.0, 0.0, -1.8)
"""Field of the self-test in gauss: -600 counts, adjusted (AKM-26, DEC-234)."""


class AkmChip(Chip):
    """A magnetometer with its mode in `control`; `adjustment` is the content of the fuse ROM."""

    control: ClassVar[int]
    own_field: ClassVar[Triple]
    """Field of the self-test in gauss; it replaces the external field."""

    def __init__(self, *arguments: Any, adjustment: tuple[int, int, int] = ADJUSTMENT, **switches: Any) -> None:
        self._adjustment = adjustment
        super().__init__(*arguments, **switches)

    def power_on(self, at_ns: int) -> None:
        """Set the reset values, powered down."""
        super().power_on(at_ns)
        self._once_ns = NEVER_NS  # end of the single measurement in progress

    def _sync(self, at_ns: int) -> None:
        """Write every measurement that has ended by `at_ns` into the data registers."""
        raise NotImplementedError

    @property
    def _mode(self) -> int:
        return int(self.table.MODE.of(self.page[self.control]))

    def _input(self, at_ns: int, full_scale: float) -> Triple:
        gauss = self.element.sample(at_ns, full_scale, 50.0)
        is_own = self._mode == SELF_TEST and self.table.SELF_TEST.of(self.page[self.table.ASTC.address])
        return self.own_field if is_own else gauss

    def _set_data(self, gauss: Triple, gauss_a_count: float, lowest: int, highest: int) -> None:
        """Write a field to the data registers, before adjustment (AKM-16, AKM-27)."""
        first = self.table.HXL.address
        for axis, (field, adjustment) in enumerate(zip(gauss, self._adjustment, strict=True)):
            code = max(lowest, min(highest, round(field / gauss_a_count * 256 / (adjustment + 128))))
            self.page[first + 2 * axis : first + 2 * axis + 2] = code.to_bytes(2, "little", signed=True)

    def load(self, address: int, at_ns: int) -> int:
        """Return a byte; reading data or ST2 clears ST1 (AKM-12, AKM-23), and the fuse ROM can be read in its own mode
        only (AKM-16, AKM-27, DEC-230).
        """
        self._sync(at_ns)
        byte, rom = self.page[address], address - self.table.ASAX.address
        if self.table.HXL.address <= address <= self.table.ST2.address:
            self.page[self.table.ST1.address] = 0
        if 0 <= rom < len(self._adjustment):
            return self._adjustment[rom] if self._mode == FUSE_ROM else 0
        return byte


class Ak8963Chip(AkmChip):
    """The chip; it measures once, or continuously."""

    table: ClassVar[ModuleType] = ak8963
    who_am_i: ClassVar[Register | None] = ak8963.WIA
    control: ClassVar[int] = ak8963.CNTL1.address
    own_field: ClassVar[Triple] = AK8963_OWN_FIELD

    def power_on(self, at_ns: int) -> None:
        """Set the reset values, powered down."""
        super().power_on(at_ns)
        self.page[ak8963.INFO.address] = 0x9A
        self._grid = SampleGrid()
        self._reading = False

    def _sync(self, at_ns: int) -> None:
        """Write each measurement that ended by `at_ns` to the data registers, unless a read is in progress (AKM-12)."""
        if self._reading:
            return
        if at_ns >= self._once_ns:
            self._measure(self._once_ns)
            self._once_ns = NEVER_NS
            self.page[self.control] &= ~ak8963.MODE.mask & 0xFF
        previous = self._grid.index
        sampled_ns = self._grid.take(at_ns)
        if sampled_ns is not None:
            overrun = self.page[ak8963.ST1.address] & ak8963.DATA_READY.mask or self._grid.index - previous > 1
            self._measure(sampled_ns)
            self.page[ak8963.ST1.address] |= ak8963.DATA_OVERRUN.mask if overrun else 0

    def _measure(self, at_ns: int) -> None:
        fine = ak8963.SIXTEEN_BITS.of(self.page[self.control])
        gauss = self._input(at_ns, AK8963_OVERFLOWS_GAUSS)
        self._set_data(gauss, AK8963_GAUSS_A_COUNT[fine], -AK8963_HIGHEST[fine], AK8963_HIGHEST[fine])
        overflow = sum(map(abs, gauss)) >= AK8963_OVERFLOWS_GAUSS
        self.page[ak8963.ST2.address] = ak8963.SIXTEEN_BITS_SHOWN.mask * fine | ak8963.OVERFLOW.mask * overflow
        self.page[ak8963.ST1.address] |= ak8963.DATA_READY.mask

    def load(self, address: int, at_ns: int) -> int:
        """Return a byte; reading data locks the registers until ST2 is read (AKM-12)."""
        byte = super().load(address, at_ns)
        if ak8963.HXL.address <= address <= ak8963.ST2.address:
            self._reading = address != ak8963.ST2.address and self._grid.start_ns < NEVER_NS
        return byte

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a mode, a setting or a reset; ignore other writes."""
        self._sync(at_ns)
        if address == ak8963.CNTL2.address:
            if ak8963.SOFT_RESET.of(value):
                self.reset(at_ns)
            return
        super().store(address, value, at_ns)
        if address == self.control:
            mode = ak8963.MODE.of(value)
            self._reading = False
            self._grid.set(at_ns, 0)
            self._grid.set(at_ns, round(1e9 / AK8963_RATES_HZ[mode]) if mode in AK8963_RATES_HZ else 0)
            self._once_ns = at_ns + AK8963_NS if mode in (SINGLE, SELF_TEST) else NEVER_NS


class Ak8975Chip(AkmChip):
    """The chip."""

    table: ClassVar[ModuleType] = ak8975
    who_am_i: ClassVar[Register | None] = ak8975.WIA
    control: ClassVar[int] = ak8975.CNTL.address
    own_field: ClassVar[Triple] = AK8975_OWN_FIELD

    def _sync(self, at_ns: int) -> None:
        """Write a completed measurement into the data registers, then power down (AKM-24)."""
        if at_ns < self._once_ns:
            return
        gauss = self._input(self._once_ns, AK8975_FULL_SCALE_GAUSS)
        self._set_data(gauss, AK8975_GAUSS_A_COUNT, AK8975_LOWEST, AK8975_HIGHEST)
        self.page[ak8975.ST2.address] = ak8975.OVERFLOW.mask * (sum(map(abs, gauss)) >= AK8975_OVERFLOWS_GAUSS)
        self.page[ak8975.ST1.address] = ak8975.DATA_READY.mask
        self.page[self.control] = DOWN
        self._once_ns = NEVER_NS

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Carry out a mode or a setting; a mode ends a measurement in progress (DEC-235)."""
        self._sync(at_ns)
        super().store(address, value, at_ns)
        if address == self.control:
            self._once_ns = at_ns + AK8975_NS if ak8975.MODE.of(value) in (SINGLE, SELF_TEST) else NEVER_NS
