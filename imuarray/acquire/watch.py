"""Are the chips still configured as they were? One register a frame is read back, in turn, and two wrong reads count.

A chip that was reset by a glitch on its supply goes on measuring with other settings and says nothing (the paper's
BMA1, run 10). Each watched register is read at least once in `SWEEP_S`, so that such a chip is noticed within a second;
the rows since its last good check are flagged, and an event says what was found. Checks ride on the segment of the bus
that is selected anyway: they cost one read, never a switch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from imuarray.acquire.pending import Pending
from imuarray.facts.registers import Setting

SWEEP_S = 0.85
"""Longest time between two reads of the same register; a wrong one is read again in the next frame."""


@dataclass
class _Check:
    """One register of one chip."""

    pending: Pending
    setting: Setting
    good_rows: int = 0
    """Rows that were waiting when this register was last right."""
    wrong: int = 0
    """Wrong reads in a row."""


class Watch:
    """The checks of all stations, and whose turn it is."""

    def __init__(self, pending: Sequence[Pending], rate_hz: float, report: Callable[[Pending, str], None]) -> None:
        """`pending` in visiting order; `report` is told when a chip has lost its configuration and when it is back."""
        self._checks = [_Check(item, setting) for item in pending for setting in item.driver.watched]
        self._of = {id(item): [check for check in self._checks if check.pending is item] for item in pending}
        self._report = report
        self._next = 0
        frames = max(1.0, SWEEP_S * rate_hz)
        self.per_frame = math.ceil(len(self._checks) / frames)

    def due(self) -> list[_Check]:
        """This frame's checks: those that were wrong last time first, then the next in turn."""
        if not self._checks:
            return []
        again = [check for check in self._checks if check.wrong == 1]
        turn = [self._checks[(self._next + index) % len(self._checks)] for index in range(self.per_frame)]
        self._next = (self._next + self.per_frame) % len(self._checks)
        return again + [check for check in turn if check.wrong != 1]

    def run(self, check: _Check) -> None:
        """Read one register back; a bus that fails says nothing about it."""
        registers = check.pending.driver.registers
        try:
            found = registers.peek(check.setting.register)[0]
        except OSError:
            return
        if found & check.setting.mask == check.setting.value:
            self._right(check)
        else:
            self._wrong(check, found)

    def _right(self, check: _Check) -> None:
        was_wrong, check.wrong = check.wrong, 0
        check.good_rows = len(check.pending.times_ns)
        if was_wrong > 1 and not any(other.wrong > 1 for other in self._of[id(check.pending)]):
            check.pending.trust()
            self._report(check.pending, "its configuration is right again")

    def _wrong(self, check: _Check, found: int) -> None:
        check.wrong += 1
        if check.wrong == 2:
            known = any(other.wrong > 1 for other in self._of[id(check.pending)] if other is not check)
            check.pending.distrust(check.good_rows)
            if not known:  # one reset spoils several registers; it is one event
                address, wanted = check.setting.register.address, check.setting.into(found)
                self._report(check.pending, f"register {address:#04x} reads {found:#04x}, configured {wanted:#04x}")
        if check.wrong > 1:
            check.good_rows = len(check.pending.times_ns)  # flagged already; nothing to hold back for

    def finish(self) -> None:
        """Check everything once more (twice where it is wrong), so that no row is left in doubt."""
        for check in self._checks:
            self.run(check)
            if check.wrong == 1:
                self.run(check)

    def trusted_rows(self, pending: Pending) -> int:
        """How many of the waiting rows have been vouched for by a later check of every register."""
        checks = self._of[id(pending)]
        return min((check.good_rows for check in checks), default=len(pending.times_ns))

    def taken(self, pending: Pending, count: int) -> None:
        """The oldest `count` rows were written and are gone."""
        for check in self._of[id(pending)]:
            check.good_rows = max(check.good_rows - count, 0)
