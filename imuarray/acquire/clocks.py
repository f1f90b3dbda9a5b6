"""The clocks of the machine, recorded together at intervals; samples are timed by one that never steps.

A single-board computer has no clock that runs without power: its wall clock is set some time after the start, and may
be set again. Rows of (monotonic, wall) determine the wall time of every sample afterwards, and the steps of the wall
clock. CLOCK_MONOTONIC is slewed with the network's time, CLOCK_MONOTONIC_RAW is not: the ratio of the two gives the
error of the crystal. CLOCK_BOOTTIME includes the time for which the machine slept.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime

from imuarray.acquire.fault_episode import Report
from imuarray.clock import Clock, MonotonicClock
from imuarray.log.format import ClockRow

PERIOD_NS = 10_000_000_000
STEP_NS = 10_000_000
"""Least change in ns of the wall clock relative to the monotonic clock that is an event; slewing is less in 10 s."""


ClockReader = Callable[[], tuple[int, int, int, int]]
"""CLOCK_MONOTONIC, CLOCK_MONOTONIC_RAW, CLOCK_BOOTTIME and CLOCK_REALTIME in ns."""


def machine_clocks() -> tuple[int, int, int, int]:
    """Read the machine's four clocks."""
    return (
        time.clock_gettime_ns(time.CLOCK_MONOTONIC),
        time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW),
        time.clock_gettime_ns(time.CLOCK_BOOTTIME),
        time.clock_gettime_ns(time.CLOCK_REALTIME),
    )


def clock_reader(clock: Clock, start_ns: int, wall_time: datetime) -> ClockReader:
    """Return the machine's clocks for a bus that follows them; for an emulated bus, four that agree with its clock."""
    if isinstance(clock, MonotonicClock):
        return machine_clocks
    wall_ns = round(wall_time.timestamp() * 1e6) * 1000 - start_ns

    def read() -> tuple[int, int, int, int]:
        now_ns = clock.now_ns()
        return now_ns, now_ns, now_ns, now_ns + wall_ns

    return read


class Clocks:
    """Reads the clocks: passes a row to `add_row` every 10 s, and an event to `report` when the wall clock steps."""

    def __init__(
        self, read_clocks: ClockReader, epoch_ns: int, add_row: Callable[[ClockRow], None], report: Report
    ) -> None:
        self._read_clocks, self._epoch_ns, self._add_row, self._report = read_clocks, epoch_ns, add_row, report
        self._due_ns = -(1 << 62)
        self._wall_ns: int | None = None

    def tick(self, now_ns: int) -> None:
        """Read the clocks if a row is due."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + PERIOD_NS
        clocks = self._read_clocks()
        row = ClockRow(clocks[0] - self._epoch_ns, *clocks)
        self._add_row(row)
        wall_ns = row.realtime_ns - row.monotonic_ns
        if self._wall_ns is not None and abs(wall_ns - self._wall_ns) > STEP_NS:
            self._report(now_ns, "clock", f"the wall clock was set by {(wall_ns - self._wall_ns) * 1e-9:+.3f} s")
        self._wall_ns = wall_ns
