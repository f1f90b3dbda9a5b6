"""A bit of the rate register does not reach the divider behind it: it reads back right and acts wrong."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Self, cast

from firmware_emulator.chip import Chip
from firmware_emulator.chips.adxl345 import Adxl345
from firmware_emulator.chips.bma180 import Bma180
from firmware_emulator.chips.l3g4200d import L3g4200d
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site
from imuarray.facts import adxl345, bma180, l3g4200d
from imuarray.facts.registers import Field

FIELDS: dict[str, Field] = {"adxl345": adxl345.RATE, "bma180": bma180.BANDWIDTH, "l3g4200d": l3g4200d.DATA_RATE}


def without_bit(code: int, which: int) -> int:
    """`code` without its set bit number `which`, counted from the lowest; without the highest if there are fewer."""
    bits = [bit for bit in range(code.bit_length()) if code >> bit & 1]
    return code & ~(1 << bits[min(which, len(bits) - 1)]) if bits else code


@contextmanager
def lost(page: bytearray, field: Field, which: int) -> Iterator[None]:
    """The register as the divider sees it."""
    written = page[field.register.address]
    page[field.register.address] = field(without_bit(field.of(written), which)).into(written)
    try:
        yield
    finally:
        page[field.register.address] = written


class Divider:
    """Mixed into a chip: what its rate bits really do."""

    which = 0
    page: bytearray

    def as_wired(self, field: Field) -> AbstractContextManager[None]:
        """Act while a setting is taken over."""
        return lost(self.page, field, self.which)


class DividedAdxl345(Divider, Adxl345):
    """An ADXL345 whose rate follows BW_RATE (ADX-36)."""

    def _configure(self, at_ns: int) -> None:
        with self.as_wired(adxl345.RATE):
            super()._configure(at_ns)


class DividedBma180(Divider, Bma180):
    """A BMA180 whose rate follows the filter code, for its rate can't be set (BMA-81 ... BMA-88)."""

    def _act(self, at_ns: int) -> None:
        with self.as_wired(bma180.BANDWIDTH):
            super()._act(at_ns)


class DividedL3g4200d(Divider, L3g4200d):
    """An L3G4200D whose rate follows DR (L3G-30 ... L3G-33)."""

    def _reconfigure(self, at_ns: int) -> None:
        with self.as_wired(l3g4200d.DATA_RATE):
            super()._reconfigure(at_ns)


DIVIDED: dict[str, type[Chip]] = {"adxl345": DividedAdxl345, "bma180": DividedBma180, "l3g4200d": DividedL3g4200d}


@dataclass(frozen=True)
class RateDivider(SensorMechanism):
    """The set bit number `lost_bit` of the rate code, counted from the lowest, acts as 0; rate, filter and with them
    noise are those of the remaining code. Reference: the lowest set bit; higher ones from severities 2 and 4 on.
    """

    lost_bit: int = 0

    resembles: ClassVar[tuple[str, ...]] = ("odr_error",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A more significant bit."""
        return cls(lost_bit=min(2, max(0, math.floor(math.log2(severity)))))

    def put_on(self, site: Site) -> None:
        """Inside the chip."""
        kind = type(f"Divided{site.chip}", (DIVIDED[site.chip],), {"which": self.lost_bit})
        site.kinds.append(lambda _: cast(Callable[..., Any], kind))
