"""What goes wrong and on, told twice: when it begins, and when it is over if it lasted. A night of it fills no log."""

from __future__ import annotations

from collections.abc import Callable

QUIET_NS = 1_000_000_000
"""What comes back within this is the same trouble."""

Tell = Callable[[int, str, str], None]
"""(at_ns, kind, message)."""


class Trouble:
    """One kind of trouble of one sensor; `tell` hears of it. Where it is `exact` the events tell of every count: the
    total is told of a short one too, if more happened than what it began with.
    """

    def __init__(self, kind: str, unit: str, tell: Tell, *, exact: bool = False) -> None:
        self.kind = kind
        self.on = False
        self.count = 0
        self._unit = unit
        self._exact = exact
        self._first = 0
        self._tell = tell
        self._since_ns = self.last_ns = 0

    def happened(self, at_ns: int, message: str, count: int = 1) -> None:
        """It happened, for the first time or again."""
        if not self.on:
            self.on, self._since_ns, self._first = True, at_ns, count
            self._tell(at_ns, self.kind, message)
        self.count += count
        self.last_ns = at_ns

    def settle(self, now_ns: int) -> None:
        """Tell that it is over if it has not happened for a while, and lasted longer than that."""
        if self.on and now_ns - self.last_ns > QUIET_NS:
            self.close()

    def close(self) -> None:
        """It is over, or the log is."""
        lasted_ns = self.last_ns - self._since_ns
        if self.on and (lasted_ns > QUIET_NS or (self._exact and self.count > self._first)):
            self._tell(self.last_ns, self.kind, f"in all {self.count} {self._unit} in {lasted_ns * 1e-9:.1f} s")
        self.on, self.count = False, 0
