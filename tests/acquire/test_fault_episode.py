"""A lasting fault is reported at its begin and its end; an intermittent fault makes few events."""

from __future__ import annotations

import re
from collections import defaultdict
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_emulator.faults import BUS_FAULTS, FAULTS
from imuarray.acquire.fault_episode import FaultEpisode
from tests.reliability.night import array_of, night
from tests.selection import some

SECOND = 1_000_000_000
HOUR = 3600 * SECOND
MOST = 28
"""Two events an episode; episodes that end after quiet times of 1, 2, 4, ... 512, 900, 900, 900 s begin at 0, 1, 3, 7,
..., 1023, 1923, 2823 s and later than an hour: 10 + 1 + 2 + 1 of them."""


def is_end(message: str) -> bool:
    counted = r"(^|, )in all \d+ .* in [0-9.]+ s$"
    return re.search(rf"{counted}|(again|ended|well), after [0-9.]+ s$|until", message) is not None


class EventRecorder:
    """An episode and the events that it reported."""

    def __init__(self) -> None:
        self.events: list[tuple[int, str]] = []
        self.episode = FaultEpisode("bus", "times", lambda at_ns, kind, message: self.events.append((at_ns, message)))


def test_a_lasting_fault_is_reported_at_its_begin_and_its_end() -> None:
    recorder = EventRecorder()
    recorder.episode.begin(0, "hangs")
    for at_s in range(1, 300):
        recorder.episode.settle(at_s * SECOND)
    assert recorder.events == [(0, "hangs")]
    recorder.episode.end(300 * SECOND, "works again")
    assert recorder.events[1:] == [(300 * SECOND, "works again, after 300.0 s")]


def test_a_fault_that_lasts_until_the_log_ends_is_closed_once() -> None:
    recorder = EventRecorder()
    recorder.episode.begin(5 * SECOND, "hangs")
    recorder.episode.close(65 * SECOND)
    assert recorder.events[1:] == [(65 * SECOND, "still present when the log ended, after 60.0 s")]
    recorder.episode.close(66 * SECOND)
    assert len(recorder.events) == 2


def test_an_intermittent_fault_is_one_episode_of_increasing_length() -> None:
    """Every 5 s for an hour: its end is reported after 1, 2 and 4 s without it, and then not before 8 s without it."""
    recorder = EventRecorder()
    for at_s in range(0, 3600, 5):
        recorder.episode.settle(at_s * SECOND)
        recorder.episode.begin(at_s * SECOND, "hangs")
        recorder.episode.end(at_s * SECOND + SECOND // 2, "works again")
    recorder.episode.settle(3700 * SECOND)
    assert [at_ns / SECOND for at_ns, _ in recorder.events] == [0, 0.5, 5, 5.5, 10, 10.5, 15, 3595.5]
    assert recorder.events[-1][1] == "works again, in all 717 times in 3580.5 s"


def test_a_fault_after_an_hour_without_it_is_a_new_episode() -> None:
    recorder = EventRecorder()
    for start_s in (0, 4000):
        for at_s in (start_s, start_s + 3):
            recorder.episode.settle(at_s * SECOND)
            recorder.episode.begin(at_s * SECOND, "hangs")
            recorder.episode.end(at_s * SECOND + 1, "works again")
            count = len(recorder.events)
            recorder.episode.settle(at_s * SECOND + 2)
        assert count in (3, 7)  # the second time it waits for two seconds
        recorder.episode.settle((start_s + 6) * SECOND)


@given(
    st.lists(st.tuples(st.floats(0.001, 2000.0), st.integers(1, 5), st.booleans()), min_size=1, max_size=200),
    st.floats(0.0, 5000.0),
)
def test_events_of_any_sequence_are_few_and_their_counts_add_up(
    happenings: list[tuple[float, int, bool]], rest_s: float
) -> None:
    recorder, now_ns, total = EventRecorder(), 0, 0
    for pause_s, count, lasts in happenings:
        now_ns += round(pause_s * SECOND)
        recorder.episode.settle(now_ns)
        if lasts:
            recorder.episode.begin(now_ns, "bad 1")
            now_ns += SECOND // 10
            recorder.episode.end(now_ns, "well")
            total += 1
        else:
            recorder.episode.happened(now_ns, f"bad {count}", count)
            total += count
    recorder.episode.close(now_ns + round(rest_s * SECOND))
    times = [at_ns for at_ns, _ in recorder.events]
    assert all(sum(start <= at_ns < start + HOUR for at_ns in times) <= MOST + 1 for start in times)
    ends = [is_end(message) for _, message in recorder.events]
    assert not any(before and after for before, after in pairwise(ends))
    # An episode's count is in its end, or, where it happened once, in its only event.
    counted = 0
    for index, (_, message) in enumerate(recorder.events):
        if "in all" in message:
            counted += int(message.partition("in all ")[2].split()[0])
        elif not is_end(message) and (index + 1 == len(ends) or "in all" not in recorder.events[index + 1][1]):
            counted += int(message.split()[1])
    assert counted == total


TABLES: dict[str, dict[str, Any]] = {
    kind: {"kind": kind} if kind in BUS_FAULTS else {"kind": kind, "sensor": "C"} for kind in FAULTS
}
TABLES["start_up"] |= {"bias": [4.0, 0.0, 0.0]}
SHOWN_BY: dict[str, tuple[str, str]] = {
    "no_acknowledge": ("C", "lost"),
    "unplugged": ("C", "lost"),
    "reset": ("C", "configuration"),
    "torn": ("C", "configuration"),
    "frozen": ("C", "frozen"),
    "stale": ("C", "frozen"),
    "kernel_driver": ("C", "taken"),
    "clock_held": ("C", "lost"),
    "stuck_bus": ("", "bus"),
    "wrong_channel": ("", "channel"),
    "stall": ("", "late"),
    "adapter_unplugged": ("", "adapter"),
}
"""By what a fault that lasts is told. A multiplexer that forgets costs next to nothing, and a wrong start is told by a
judge, which there is not here."""
MOMENTARY = ("reset", "torn", "mux_reset")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("every_s", "seconds"),
    [
        (None, 600),
        pytest.param(5.3, 600, marks=pytest.mark.campaign),
        pytest.param(1.7, 600, marks=pytest.mark.campaign),
        pytest.param(37.0, 600, marks=pytest.mark.campaign),
        pytest.param(None, 3600, marks=pytest.mark.campaign),
        pytest.param(5.3, 3600, marks=pytest.mark.campaign),
    ],
)
@pytest.mark.parametrize("kind", some(FAULTS, 1))
def test_no_fault_fills_a_log_with_events(kind: str, every_s: float | None, seconds: int) -> None:
    """A fault of every kind for the whole recording, or again and again: few events, and the last of them is an end."""
    table = {"at_s": 20.0, **TABLES[kind]}
    if kind in MOMENTARY:
        table |= {"every_s": every_s or 0.9}
    elif kind == "stall":
        table |= {"every_s": every_s or 0.9, "for_s": 0.7}
    elif every_s is None:
        table |= {"for_s": 1e6}
    else:
        table |= {"every_s": every_s, "for_s": min(0.4 * every_s, 3.0)}
    log = night(array_of(A=0, B=0, C=1), [table], seconds, rate_hz=5.0).log
    groups: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for event in sorted(log.events):
        groups[event.sensor, event.kind].append(event)
    for events in groups.values():
        times = [event.time_ns for event in events]
        assert max(sum(start <= at_ns < start + HOUR for at_ns in times) for start in times) <= MOST, events
        ends = [is_end(event.message) for event in events]
        assert not any(before and after for before, after in pairwise(ends)), events
    assert len(log.events) <= 100
    if kind in SHOWN_BY and every_s is None:
        first, *_, last = groups[SHOWN_BY[kind]]
        assert first.time_ns < 30 * SECOND
        assert not is_end(first.message)
        assert last.time_ns > (seconds - 10) * SECOND
        assert is_end(last.message)


@pytest.mark.slow
@pytest.mark.parametrize(("reset_s", "rate_hz"), [(20.0, 10.0), (19.4, 5.0), (19.6, 5.0)])
def test_a_reset_and_a_kernel_driver_of_one_chip_are_both_reported(reset_s: float, rate_hz: float) -> None:
    """Both are reported, whichever is detected first, and both end when the chip is given back and set up again."""
    reset = {"kind": "reset", "sensor": "C", "at_s": reset_s}
    driver = {"kind": "kernel_driver", "sensor": "C", "at_s": 20.0, "for_s": 4.0}
    log = night(array_of(A=0, C=0), [reset, driver], 60, rate_hz=rate_hz).log
    kinds = {event.kind: event.message for event in log.events if event.sensor == "C"}
    assert {"configuration", "taken", "reconfigured"} <= set(kinds)
    assert "driver of the kernel" in kinds["taken"]
    assert [message for message in kinds.values() if "when the log ended" in message] == []
