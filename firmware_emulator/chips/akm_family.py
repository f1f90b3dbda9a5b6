"""Common parts of AKM's magnetometers: identity, modes, and a fuse ROM with the adjustment of the readings.

Facts AKM-13, AKM-16, AKM-24, AKM-27.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import ClassVar

from firmware_emulator.chip import Chip, Element

FAR_NS = 1 << 62
DOWN, SINGLE, SELF_TEST, FUSE_ROM = 0b0000, 0b0001, 0b1000, 0b1111  # AKM-13, AKM-24
ADJUSTMENT = (176, 178, 167)
"""Values in the fuse ROM by default (DEC-231)."""


class AkmFamily(Chip):
    """A magnetometer with the registers of `table`; `adjustment` is the content of its fuse ROM, `identity` that of
    WIA.
    """

    table: ClassVar[ModuleType]

    def __init__(
        self,
        address: int,
        element: Element,
        powered_on_ns: int = 0,
        *,
        adjustment: tuple[int, int, int] = ADJUSTMENT,
        identity: int | None = None,
    ) -> None:
        self._adjustment = adjustment
        self._identity = self.table.WIA.reset if identity is None else identity
        super().__init__(address, self.table, element, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Set the reset values, powered down."""
        super().power_on(at_ns)
        self.page[self.table.WIA.address] = self._identity

    def _data(self, gauss: Sequence[float], gauss_a_count: float, lowest: int, highest: int) -> bytes:
        """Return the six bytes of a field, before adjustment (AKM-16, AKM-27)."""
        codes = (
            round(field / gauss_a_count * 256 / (adjustment + 128))
            for field, adjustment in zip(gauss, self._adjustment, strict=True)
        )
        return b"".join(max(lowest, min(highest, code)).to_bytes(2, "little", signed=True) for code in codes)

    def _byte(self, address: int, control: int) -> int:
        """Return a byte; the fuse ROM can be read in its own mode only (AKM-16, AKM-27, DEC-230)."""
        first, last = self.table.ASAX.address, self.table.ASAZ.address
        if not first <= address <= last:
            return self.page[address]
        return self._adjustment[address - first] if self.table.MODE.of(control) == FUSE_ROM else 0
