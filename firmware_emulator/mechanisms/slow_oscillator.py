"""The chip's own oscillator limps: it converts less often than it is asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self, cast

from firmware_emulator.chip import Chip
from firmware_emulator.chips.adxl345 import Adxl345
from firmware_emulator.chips.bma180_converter import UPDATE_HZ
from firmware_emulator.chips.l3g4200d import L3g4200d
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


class LimpingAdxl345(Adxl345):
    """An ADXL345 that converts every `period_ns`, whatever its rate register says."""

    period_ns = 0

    def _schedule(self, period_ns: int, at_ns: int) -> None:
        super()._schedule(self.period_ns or period_ns, at_ns)


class LimpingL3g4200d(L3g4200d):
    """An L3G4200D that converts every `period_ns`, whatever its rate bits say."""

    period_ns = 0

    def _set_clock(self, ctrl1: int, at_ns: int, latest: int) -> None:
        super()._set_clock(ctrl1, at_ns, latest)
        self._period_ns = self.period_ns or self._period_ns


LIMPING: dict[str, type[Chip]] = {"adxl345": LimpingAdxl345, "l3g4200d": LimpingL3g4200d}


@dataclass(frozen=True)
class SlowOscillator(SensorMechanism):
    """`rate_hz` conversions a second on the chip's own grid; a reading asked for in between is the one before.

    The chip's ready flags tell the truth about it. Reference: 40 Hz, slower as severity grows.
    """

    rate_hz: float = 40.0

    resembles: ClassVar[tuple[str, ...]] = ("stale_samples", "odr_error")

    @classmethod
    def at(cls, severity: float) -> Self:
        """A slower oscillator."""
        return cls(rate_hz=cls.rate_hz / severity)

    def put_on(self, site: Site) -> None:
        """A BMA180 has its rate error as a switch; the others have another clock."""
        if site.chip == "bma180":
            site.switches["rate_error"] = self.rate_hz / UPDATE_HZ - 1
            return
        kind = type(f"Slow{site.chip}", (LIMPING[site.chip],), {"period_ns": round(1e9 / self.rate_hz)})
        site.kinds.append(lambda _: cast(Callable[..., Any], kind))
