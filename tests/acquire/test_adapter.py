"""The start time of a burst, and the detection of a bus that hangs."""

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.acquire.bus_segment import AdapterState
from imuarray.report.verdicts import recording_verdict

MS = 1_000_000


def test_a_burst_without_interruption_starts_at_the_time_of_the_request() -> None:
    """90 clocks at 400 kHz are 225 us; the machine adds 50 to 300 us."""
    adapter = AdapterState()
    for index, extra_us in enumerate((300, 50, 120)):
        begun_ns = index * 20 * MS
        assert adapter.start_of(begun_ns, begun_ns + (225 + extra_us) * 1000, 90) == (begun_ns, True)


@pytest.mark.slow
@given(st.integers(0, 20 * MS), st.integers(0, 20 * MS))
def test_the_start_of_an_interrupted_burst_is_off_by_at_most_half_the_interruption(
    before_ns: int, after_ns: int
) -> None:
    """Whether the program was interrupted before the burst or after it can't be known."""
    adapter = AdapterState()
    adapter.start_of(0, 225_000, 90)
    true_ns = 50 * MS + before_ns
    start_ns, certain = adapter.start_of(50 * MS, true_ns + 225_000 + after_ns, 90)
    slack_ns = before_ns + after_ns
    assert certain == (slack_ns <= 1 * MS)
    assert abs(start_ns - true_ns) <= (slack_ns if certain else slack_ns / 2 + 1)


def test_the_time_of_a_clock_measured_on_a_quick_chip_applies_to_a_slow_chip() -> None:
    adapter = AdapterState()
    adapter.start_of(0, 250_000, 100)  # 2.5 us a clock
    assert adapter.start_of(10 * MS, 12 * MS + 250_000, 100) == (11 * MS, False)


def test_two_time_outs_in_a_row_pause_the_bus() -> None:
    adapter = AdapterState()
    assert not adapter.note_time_out(0)
    assert adapter.note_time_out(30 * MS)
    assert adapter.hangs
    assert adapter.silent_until_ns == 80 * MS
    assert not adapter.note_time_out(110 * MS)  # it is known
    assert adapter.silent_until_ns == 210 * MS  # and asked half as often
    for at_ms in range(1000, 2000, 100):
        adapter.note_time_out(at_ms * MS)
    assert adapter.silent_until_ns == 1900 * MS + 400 * MS
    assert adapter.note_answer()
    assert not adapter.note_answer()
    assert not adapter.note_time_out(5000 * MS)


class InterruptedBus:
    """An open bus whose program is interrupted for 8 ms after some readings of one chip, before it can look at the
    clock.
    """

    def __init__(self, bus: Any, address: int) -> None:
        self.bus, self.clock, self.source, self.address = bus, bus.clock, bus.source, address
        self.starts: list[int] = []

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        start_ns = self.clock.now_ns()
        answer: bytes = self.bus.transfer(address, write, read)
        if address == self.address and read > 1:
            self.starts.append(start_ns)
            if len(self.starts) % 10 == 0:
                self.clock.sleep_until(self.clock.now_ns() + 8 * MS)
        return answer

    def __getattr__(self, name: str) -> Any:
        return getattr(self.bus, name)


@pytest.mark.slow
def test_interrupted_readings_are_counted_and_their_times_are_within_half(board: Callable[..., Any]) -> None:
    made = board(A=0, G=0)
    made.bus = InterruptedBus(made.bus.bus, 0x68)
    done = made.record(50, seconds=4)
    assert done.uncertain == 20
    assert (done.late, done.missed) == (0, 0)
    with made.log() as log:
        error_ns = np.asarray(log["G"].time) - (np.array(made.bus.starts) - made.bus.starts[0] + log["G"].time[0])
        assert np.count_nonzero(error_ns) == 20
        assert np.abs(error_ns).max() == pytest.approx(4 * MS, rel=0.05)
        assert (np.diff(np.asarray(log["A"].time)) == 20 * MS).all()


class HungBus(InterruptedBus):
    """An open bus whose clock wire is held low from 1 s to 1.13 s: each transaction then times out after 30 ms.
    At 2 s the program is not run for 55 ms.
    """

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        now_ns = self.clock.now_ns()
        self.starts.append(now_ns)
        if now_ns - self.starts[0] > 2000 * MS and self.address:
            self.address = 0
            self.clock.sleep_until(now_ns + 55 * MS)
        if 1000 * MS <= now_ns - self.starts[0] < 1130 * MS:
            self.clock.sleep_until(now_ns + 30 * MS)
            raise OSError(errno.ETIMEDOUT, "Connection timed out")
        answer: bytes = self.bus.transfer(address, write, read)
        return answer


def test_frames_missed_by_a_hung_bus_are_counted_apart_from_those_of_a_busy_machine(board: Callable[..., Any]) -> None:
    """Two time-outs of 30 ms in a frame of 10 ms, then one more: 5 and 2 frames. 55 ms of a busy machine: 4 frames."""
    made = board(A=0, G=0)
    made.bus = HungBus(made.bus.bus, 1)
    done = made.record(seconds=3)
    assert (done.missed_by_bus, done.missed - done.missed_by_bus) == (7, 4)
    with made.log() as log:
        late = [event.message for event in log.events if event.kind == "late"]
        assert "missed: the bus did not answer in time" in late[0]
        assert "check the wires and pull-up resistors of the bus" in recording_verdict(log).sentence
