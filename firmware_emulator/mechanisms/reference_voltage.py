"""The converter's reference voltage is off: everything it converts, bias and noise included, comes out too small."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class ReferenceVoltage(SensorMechanism):
    """code = input / (1 + `error`): the reference is `error` too high. Reference size: 3 %."""

    error: float = 0.03

    resembles: ClassVar[tuple[str, ...]] = ("scale",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A worse reference."""
        return cls(error=cls.error * severity)

    def put_on(self, site: Site) -> None:
        """All axes share the reference."""
        share = 1 / (1 + self.error)

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            return value[0] * share, value[1] * share, value[2] * share

        site.chain.amplified.append(amplified)
