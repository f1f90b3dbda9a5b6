"""A plug that is not quite in: for moments the chip is not there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import WHILE_SET_UP_S, Site


@dataclass(frozen=True)
class LooseContact(SensorMechanism):
    """Closed for `closed_s` on average, then open for `open_s`, both exponential (Gilbert 1960).

    Nothing is acknowledged while open. Begins `WHILE_SET_UP_S` after power-on. Reference: 50 ms in every 10 s.
    """

    open_s: float = 0.05
    closed_s: float = 10.0

    resembles: ClassVar[tuple[str, ...]] = ("dropped_samples",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Open for longer."""
        return cls(open_s=cls.open_s * severity)

    def put_on(self, site: Site) -> None:
        """Act on every message to the chip."""
        random = site.run_random("contact")
        is_open, due_ns = False, (WHILE_SET_UP_S + random.exponential(self.closed_s)) * 1e9

        def closed(at_ns: int) -> bool:
            nonlocal is_open, due_ns
            while at_ns >= due_ns:
                is_open = not is_open
                due_ns += random.exponential((self.open_s if is_open else self.closed_s) * 1e9)
            return not is_open

        site.links.contacts.append(closed)
