"""Rows enter a log in the order of their times, from every bus; a row out of order is refused, reported and counted."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.acquire.fault_episode import FaultEpisodes
from imuarray.acquire.recorder import record
from imuarray.acquire.sample_buffer import AHEAD_NS, Intake, in_order, selected
from imuarray.array import parse_array
from imuarray.bus import open_bus
from imuarray.drivers.fifo_clock import FifoClock
from imuarray.log import open_log
from imuarray.log.format import Event
from imuarray.log.writer import Block
from tests.selection import some

S = 1_000_000_000
STALE, OVERRUN, LOST, RECONFIGURED = 1, 2, 8, 16


@pytest.mark.parametrize(
    ("times", "newest", "latest", "kept"),
    [
        ([], None, 40, []),
        ([1, 2, 3], None, 40, [1, 2, 3]),
        ([-5, 0], None, 40, [-5, 0]),
        ([3, 3], None, 40, [3]),
        ([3, 4], 3, 4, [4]),
        ([1, 2, 3], 3, 40, []),
        ([1, 9, 2, 3, 10], None, 40, [1, 9, 10]),  # 2 and 3 are later than 1, but earlier than a stored row
        ([1, 41, 2, 40, 3], None, 40, [1, 2, 40]),  # a row of the future is refused and does not refuse the next
        ([50, 60], None, 40, []),
    ],
)
def test_rows_later_than_all_stored_ones_are_kept(
    times: list[int], newest: int | None, latest: int, kept: list[int]
) -> None:
    given_ns = np.array(times, np.int64)
    assert given_ns[in_order(given_ns, newest, latest)].tolist() == kept


@given(
    times=st.lists(st.integers(-5, 40), max_size=30),
    newest=st.one_of(st.none(), st.integers(-5, 40)),
    latest=st.integers(0, 40),
)
def test_stored_rows_ascend_and_are_stored_again(times: list[int], newest: int | None, latest: int) -> None:
    """Without the refused rows nothing is refused, and no row later than all stored ones is missing at the end."""
    given_ns = np.array(times, np.int64)
    stored = given_ns[in_order(given_ns, newest, latest)]
    assert (np.diff(stored) > 0).all()
    assert in_order(stored, newest, latest).all()
    possible = [time for time in times if time <= latest and (newest is None or time > newest)]
    assert max(stored.tolist(), default=None) == max(possible, default=None)


def test_a_row_takes_over_the_flags_of_refused_rows_before_it() -> None:
    status = np.array([STALE, RECONFIGURED | STALE, 0, OVERRUN, 0], np.uint16)
    block = Block(
        np.arange(5), np.arange(15).reshape(5, 3), status, np.arange(5, dtype=np.int16), {"p": np.arange(5.0)}
    )
    kept = np.array([True, False, True, True, False])
    rows, inherited = selected(block, kept, np.uint16(LOST))
    assert rows.status.tolist() == [STALE | LOST, RECONFIGURED | LOST, OVERRUN]
    assert rows.time.tolist() == [0, 2, 3]
    assert rows.counts[:, 0].tolist() == [0, 6, 9]
    assert rows.temperature_counts is not None
    assert rows.temperature_counts.tolist() == [0, 2, 3]
    assert rows.compensated["p"].tolist() == [0, 2, 3]
    assert inherited == LOST
    assert selected(block, np.ones(5, bool), np.uint16(0)) == (block, 0)


class Waiting:
    """Rows that wait, as `SampleBuffer` gives them."""

    def __init__(self, *blocks: list[int]) -> None:
        self.route: Any = SimpleNamespace(sensor=SimpleNamespace(name="A"))
        self.blocks = [np.array(times, np.int64) for times in blocks]

    def take(self, count: int, epoch_ns: int) -> Block:
        times = self.blocks.pop(0)
        self.doubtful_rows = np.zeros(len(times), bool)
        return Block(times - epoch_ns, np.zeros((len(times), 3), np.int16), np.zeros(len(times), np.uint16))


def test_a_row_ahead_of_the_clock_does_not_block_later_rows() -> None:
    stored: list[tuple[int, int]] = []
    events: list[Event] = []
    log: Any = SimpleNamespace(
        append=lambda name, block: stored.extend(zip(block.time.tolist(), block.status.tolist(), strict=True))
    )
    lost = {"A": 0}
    faults = FaultEpisodes(
        lambda sensor, at_ns, kind, message: events.append(Event(at_ns - 100, sensor, kind, message))
    )
    intake = Intake(log, 100, lambda name, block: None, faults, lost)
    waiting: Any = Waiting([110, 120, 120 + 4277 * S, 130], [125], [140, 150])
    assert AHEAD_NS == S  # the largest error of a fitted clock, and far less than an invented time
    for now_ns in (140, 145, 150):
        intake.write(waiting, 1, now_ns)
    assert stored == [(10, 0), (20, 0), (30, LOST), (40, LOST), (50, 0)]
    assert lost == {"A": 2}
    assert [(event.time_ns, event.sensor, event.kind) for event in events] == [(40, "A", "refused")]
    assert events[0].message == "1 reading refused: not later than the reading before, or ahead of the clock"


@pytest.mark.slow
@pytest.mark.parametrize("rotate_s", some([None, 3.0], 1))
def test_a_queue_that_counts_time_twice_does_not_end_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rotate_s: float | None
) -> None:
    true_times = FifoClock.times
    calls = 0

    def times(self: FifoClock, level: int, at_ns: int, overrun: bool = False, **counted: Any) -> list[int]:
        nonlocal calls
        calls += 1
        drained = true_times(self, level, at_ns, overrun, **counted)
        if calls % 100 == 0:
            self.drained = drained = [time - S for time in drained]
        return drained

    monkeypatch.setattr(FifoClock, "times", times)
    array = parse_array(
        '[array]\nname="a"\n'
        '[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\nrate_hz=100\nfifo=true\n'
        '[[sensor]]\nname="G"\nchip="l3g4200d"\naddress=0x68\nrange=250\n'
    )
    with open_bus("emulated:", array) as bus:
        summary = record(array, bus, tmp_path / "r.h5", rate_hz=50, seconds=8, rotate_s=rotate_s)
    refused = []
    rows = 0
    for path in summary.logs:
        with open_log(path) as log:
            rows += len(log["A"])
            assert (np.diff(log["A"].time[:]) > 0).all()
            refused += [event for event in log.events if event.kind == "refused"]
    assert {event.sensor for event in refused} == {"A"}
    assert 4 <= summary.lost["A"] <= 12  # two samples a frame, four times
    assert rows + summary.lost["A"] == pytest.approx(800, abs=4)
    assert summary.lost["G"] == 0
