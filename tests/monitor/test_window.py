"""Delayed and missed rows, counted from times alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.monitor.log_source import Backlog
from imuarray.monitor.window import MOST_ROWS, Gaps, LatestRows, gaps_of, period_of

PERIOD_NS = 10_000_000
Times = npt.NDArray[np.int64]


def frames(numbers: Times, forth_and_back: float = 0.0) -> Times:
    """Times of the frames of these numbers, read there and back: every other one later by a share of the period."""
    turn = np.where(np.arange(len(numbers)) % 2, forth_and_back, 0.0)
    return np.asarray((numbers + turn) * PERIOD_NS, np.int64)


def window_of(time: Times, *, at_once: int, span_ns: int = 1_000_000_000) -> LatestRows:
    window = LatestRows(span_ns)
    for start in range(0, len(time), at_once):
        part = time[start : start + at_once]
        window.add({"time": part, "counts": np.zeros((len(part), 3), np.int16)})
    return window


@pytest.mark.parametrize("forth_and_back", [0.0, 0.4, 0.9])
def test_a_steady_sensor_misses_nothing_at_any_place_in_a_frame(forth_and_back: float) -> None:
    time = frames(np.arange(500), forth_and_back)
    assert period_of(time) == PERIOD_NS
    assert gaps_of(time, PERIOD_NS) == Gaps(0, 0)


@pytest.mark.parametrize("forth_and_back", [0.0, 0.4, 0.9])
def test_every_missing_frame_is_counted_once(forth_and_back: float) -> None:
    numbers = np.delete(np.arange(500), [100, 200, 201, 202, 350])
    assert gaps_of(frames(numbers, forth_and_back), PERIOD_NS).missed == 5


def test_a_delayed_frame_is_counted_once_and_is_not_missing() -> None:
    time = frames(np.arange(500))
    time[[70, 300]] += PERIOD_NS * 4 // 10
    time[150] += PERIOD_NS // 10  # that much is usual
    gaps = gaps_of(time, PERIOD_NS)
    assert (gaps.delayed, gaps.missed) == (2, 0)


@given(
    lost=st.sets(st.integers(2, 395), max_size=30),
    at_once=st.integers(1, 400),
    forth_and_back=st.sampled_from([0.0, 0.3, 0.8]),
)
def test_rows_are_counted_in_blocks_of_any_length(lost: set[int], at_once: int, forth_and_back: float) -> None:
    numbers = np.delete(np.arange(400), sorted(lost))
    span_ns = 400 * PERIOD_NS  # a median needs most of its values to be whole periods
    window = window_of(frames(numbers, forth_and_back), at_once=at_once, span_ns=span_ns)
    assert window.total == 400 - len(lost)
    if at_once > 60:
        assert window.gaps.missed == len(lost)


def test_only_the_last_seconds_are_kept() -> None:
    window = window_of(frames(np.arange(1000)), at_once=37)
    assert (window.total, window.first_ns) == (1000, 0)
    assert window.time.tolist() == frames(np.arange(899, 1000)).tolist()
    assert all(column.base is None for column in window.rows.values())  # no view that keeps more alive


def test_the_number_of_rows_in_memory_is_limited() -> None:
    window = window_of(np.arange(3 * MOST_ROWS), at_once=MOST_ROWS // 2)
    assert len(window.time) == MOST_ROWS


def test_rows_added_twice_are_counted_once() -> None:
    window = window_of(frames(np.arange(100)), at_once=100)
    again = frames(np.arange(90, 110))
    assert window.add({"time": again, "counts": np.full((20, 3), -7, np.int16)}) == 10
    assert window.total == 110
    assert window.peak_lsb is not None and window.peak_lsb.tolist() == [7, 7, 7]


def test_missing_rows_are_counted_across_discarded_rows() -> None:
    window = window_of(frames(np.arange(100)), at_once=100)
    window.forget(1 << 60)
    assert len(window.time) == 0 and window.newest.tolist() == frames(np.arange(98, 100)).tolist()
    for number in range(130, 160):
        window.add({"time": frames(np.array([number])), "counts": np.zeros((1, 3), np.int16)})
    assert (window.total, window.gaps.missed, window.usual_ns) == (130, 30, PERIOD_NS)


def test_the_period_of_a_silent_sensor_is_determined_from_earlier_rows() -> None:
    window = LatestRows(1_000_000_000)
    window.begins_behind(90, frames(np.arange(100)))
    assert (window.total, window.first_ns, window.period_ns, window.usual_ns) == (90, 0, 0, PERIOD_NS)
    assert window.newest.tolist() == frames(np.arange(88, 90)).tolist()


def test_rows_without_a_period_are_skipped() -> None:
    backlog = Backlog({"A": (frames(np.arange(5)), 5)})
    backlog.step({"A": 0.0})
    assert (backlog.counted, backlog.gaps("A")) == (1.0, Gaps())


def test_earlier_rows_are_counted_a_piece_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imuarray.monitor.log_source.AT_ONCE", 100)
    time = frames(np.delete(np.arange(1000), [99, 100, 101, 500]))
    closed: list[bool] = []
    backlog = Backlog({"A": (time, 600), "B": (time, 300)}, lambda: closed.append(True))
    looks = 0
    while backlog.counted < 1:
        assert not closed
        backlog.step({"A": PERIOD_NS, "B": PERIOD_NS})
        looks += 1
    assert (looks, closed) == (9, [True])
    assert (backlog.gaps("A").missed, backlog.gaps("B").missed) == (4, 3)
    backlog.close()
    assert closed == [True]


def test_without_earlier_rows_the_count_is_complete() -> None:
    backlog = Backlog({})
    assert backlog.counted == 1.0
    assert backlog.gaps("A") == Gaps()
