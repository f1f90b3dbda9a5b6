"""A gyroscope that changes its full-scale range by itself, and gives nothing new meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site

THRESHOLD_DPS = 100.0


@dataclass(frozen=True)
class AdaptiveRange(SensorMechanism):
    """An adaptive range that stays on: at the sample at which the size of an axis has passed 100 dps, either way, the
    converter keeps its reading, and for `held_s` from then on.

    An ICM-42688-P does so unless INTF_CONFIG1 says otherwise (TDK-18), which the driver sets and verifies; this is a
    part that obeys the register by its reading back alone. Reference: 1.5 ms (DEC-63).
    """

    held_s: float = 1.5e-3

    touches: ClassVar[tuple[str, ...]] = ("icm42688_gyro",)
    resembles: ClassVar[tuple[str, ...]] = ("adaptive_range",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Longer holds."""
        return cls(held_s=cls.held_s * severity)

    def put_on(self, site: Site) -> None:
        """All axes share the range."""
        was_inside: tuple[bool, ...] | None = None
        until_ns, shown = -1.0, (0.0, 0.0, 0.0)

        def hold(at_ns: int, value: Triple, full_scale: float) -> Triple:
            nonlocal was_inside, until_ns, shown
            inside = tuple(abs(part) < THRESHOLD_DPS for part in value)
            if was_inside is not None and inside != was_inside:
                until_ns = at_ns + self.held_s * 1e9
            was_inside = inside
            if at_ns >= until_ns:
                shown = value
            return shown

        site.chain.amplified.append(hold)
