"""Emulated and real time, in integer nanoseconds.

On the virtual clock, a transfer takes exactly the computed time of the bus and a sleep takes no real time, so that torn
reads, overruns and update ticks are the same in every run (DEC-50). On the real clock, time passes by itself.
"""

from __future__ import annotations

import time
from typing import Protocol


class WireClock(Protocol):
    """The clock that the wire reads and by which a caller sleeps."""

    def now_ns(self) -> int:
        """Return the present time."""

    def advance(self, ns: int) -> None:
        """Note that the wire was busy for `ns`."""

    def sleep_until(self, ns: int) -> None:
        """Wait until `now_ns()` is at least `ns`."""


class VirtualClock:
    """A clock that advances only by transfers and sleeps."""

    is_virtual = True

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Return the present time."""
        return self._now_ns

    def advance(self, ns: int) -> None:
        """Advance by `ns`; ValueError if it is negative."""
        if ns < 0:
            raise ValueError(f"time can't go back: {ns} ns")
        self._now_ns += ns

    def sleep_until(self, ns: int) -> None:
        """Advance to `ns` at once; a time in the past changes nothing."""
        if ns > self._now_ns:
            self._now_ns = ns


class RealClock:
    """CLOCK_MONOTONIC."""

    def now_ns(self) -> int:
        """Return the present time."""
        return time.monotonic_ns()

    def advance(self, ns: int) -> None:
        """Sleep for `ns`, as a program waits for its adapter; ValueError if it is negative."""
        if ns < 0:
            raise ValueError(f"time can't go back: {ns} ns")
        time.sleep(ns * 1e-9)

    def sleep_until(self, ns: int) -> None:
        """Sleep in real time; return at once if the time has passed."""
        remaining_ns = ns - time.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns * 1e-9)
