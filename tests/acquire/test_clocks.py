"""The machine's clocks are read together; a step of the wall clock is reported and changes no other clock."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Any

from imuarray.acquire.clocks import ClockRow, Clocks, clock_reader, machine_clocks
from imuarray.clock import MonotonicClock

SECOND = 1_000_000_000


def test_the_machines_clocks_are_read_in_order() -> None:
    before = time.monotonic_ns(), time.time_ns()
    monotonic, raw, boot, real = machine_clocks()
    assert before[0] <= monotonic <= time.monotonic_ns()
    assert before[1] <= real <= time.time_ns()
    assert boot >= monotonic
    assert raw > 0


class Wall:
    """Four clocks, of which the wall clock is set by -3.25 s after 25 s."""

    def __init__(self) -> None:
        self.now_ns = 100 * SECOND

    def __call__(self) -> tuple[int, int, int, int]:
        real_ns = self.now_ns + 10**18 - (3_250_000_000 if self.now_ns > 125 * SECOND else 0)
        return self.now_ns, self.now_ns + 1, self.now_ns + 2, real_ns


def test_a_row_every_ten_seconds_and_an_event_for_a_step() -> None:
    wall, rows, events = Wall(), list[ClockRow](), list[Any]()
    clocks = Clocks(wall, 100 * SECOND, rows.append, lambda *event: events.append(event))
    for tick in range(600):
        wall.now_ns = 100 * SECOND + tick * SECOND // 10
        clocks.tick(wall.now_ns)
    assert [row.time_ns for row in rows] == [index * 10 * SECOND for index in range(6)]
    assert [row.monotonic_ns for row in rows] == [(100 + index * 10) * SECOND for index in range(6)]
    assert rows[1].monotonic_raw_ns == 110 * SECOND + 1
    assert rows[1].boottime_ns == 110 * SECOND + 2
    assert rows[3].realtime_ns - rows[2].realtime_ns == 10 * SECOND - 3_250_000_000
    assert events == [(130 * SECOND, "clock", "the wall clock was set by -3.250 s")]


def test_an_emulated_bus_has_clocks_that_agree() -> None:
    class Emulated:
        def now_ns(self) -> int:
            return 7 * SECOND

        def sleep_until(self, at_ns: int) -> None:
            pass

    read = clock_reader(Emulated(), 2 * SECOND, datetime(2026, 3, 1, tzinfo=UTC))
    assert read() == (7 * SECOND, 7 * SECOND, 7 * SECOND, 1_772_323_205 * SECOND)  # date -d 2026-03-01T00:00:05Z +%s
    assert clock_reader(MonotonicClock(), 0, datetime.now(UTC)) is machine_clocks
