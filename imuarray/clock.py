"""Clocks, which are arguments of other functions: integer nanoseconds that never step back. `MonotonicClock` is the
clock of the machine; an emulated bus has its own clock, which advances by bus traffic and by sleeping.
"""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """A clock for the polling loop and the drivers."""

    def now_ns(self) -> int:
        """Return the nanoseconds since an arbitrary start; they never decrease."""

    def sleep_until(self, at_ns: int) -> None:
        """Return when `now_ns()` has reached `at_ns`; immediately if it already has."""


class MonotonicClock:
    """CLOCK_MONOTONIC of this machine."""

    def now_ns(self) -> int:
        """Return the nanoseconds since about the boot of the machine."""
        return time.monotonic_ns()

    def sleep_until(self, at_ns: int) -> None:
        """Sleep until `at_ns`."""
        left_ns = at_ns - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns * 1e-9)


def is_virtual(clock: Clock) -> bool:
    """Return whether a clock advances without real time passing, such as that of the emulated array."""
    return bool(getattr(clock, "is_virtual", False))


def sleep_for(clock: Clock, seconds: float) -> None:
    """Sleep for `seconds` on `clock`: chips need time after a reset or a power-up."""
    clock.sleep_until(clock.now_ns() + round(seconds * 1e9))
