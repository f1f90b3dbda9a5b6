"""The supply dips, and the chip forgets what it was told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import WHILE_SET_UP_S, Site


@dataclass(frozen=True)
class BrownOut(SensorMechanism):
    """One dip a power-up, after an exponential time of mean `mean_s` from `WHILE_SET_UP_S` on: every register at its
    reset value, the range the one of the EEPROM, as after power-on (BMA-52, BMA-57).

    The driver's checks may notice. Reference: a mean of 300 s, shorter as severity grows.
    """

    mean_s: float = 300.0

    touches: ClassVar[tuple[str, ...]] = ("bma180",)  # the others wake up silent
    resembles: ClassVar[tuple[str, ...]] = ("range_reset",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Sooner."""
        return cls(mean_s=cls.mean_s / severity)

    def put_on(self, site: Site) -> None:
        """Act before the chip is next addressed."""
        due_ns = (WHILE_SET_UP_S + site.run_random("dip").exponential(self.mean_s)) * 1e9
        done, touched = False, site.touched.setdefault(self, set())

        def reset(at_ns: int) -> int | None:
            nonlocal done
            if done or at_ns < due_ns:
                return None
            done = True
            touched.add(site.name)
            site.note(f"browned out at {due_ns * 1e-9:.3f} s")
            return round(due_ns)

        site.links.resets.append(reset)
