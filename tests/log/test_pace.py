"""Missed frames, told from rows: the logger's own grid is walked through here, frame by frame, and compared."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.acquire.record import record
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from imuarray.log.pace import frame_period_ns, is_read_once_a_frame, missed_by_all, missed_frames, missing_rows

PERIOD_NS = 10_000_000
ROOT = Path(__file__).parents[2]
ACC = SensorHeader("Acc", "bma180", "specific_force", "g", 16.0, 512.0)


def polled(lengths: list[float], forth: float, back: float) -> tuple[list[int], int]:
    """Times of a sensor's rows in frames that take so many periods, and how many frames were missed between them."""
    times, passed, missed, due = [], [], 0, 0.0
    now = 0.0
    for number, length in enumerate(lengths):
        now = max(now, due)
        times.append(round((now + (back if number % 2 else forth)) * PERIOD_NS))
        passed.append(missed)
        now += length
        due += 1
        if now > due:
            missed += int(now - due)
            due += int(now - due)
    return times, passed[-1]


@given(
    lengths=st.lists(st.sampled_from([0.25, 0.5, 0.9, 1.4, 2.3, 7.1]), min_size=2, max_size=120),
    forth=st.sampled_from([0.0, 0.2, 0.8]),
)
def test_what_is_missing_is_what_the_logger_missed(lengths: list[float], forth: float) -> None:
    times, missed = polled([*lengths, 0.1, 0.1, 0.1, 0.1], forth, 0.8 - forth)  # at last it has caught up
    assert missing_rows(times[0], np.array(times[-2:]), len(times), PERIOD_NS) == missed


@pytest.mark.parametrize("length", [1.1, 1.4, 1.9, 2.5])
def test_a_machine_that_is_too_slow_all_the_time(length: float) -> None:
    """Its rows come evenly, and too seldom."""
    times, missed = polled([length] * 1000, 0.0, 0.0)
    assert missed == pytest.approx((length - 1) * 999, abs=1)
    assert abs(missing_rows(times[0], np.array(times[-2:]), 1000, PERIOD_NS) - missed) <= 1


def test_the_grid_is_known_where_the_clock_is_the_loggers() -> None:
    assert [frame_period_ns(source, 50.0) for source in ("i2c", "emulated", "replay")] == [20_000_000] * 3
    assert [frame_period_ns(source, 50.0) for source in ("serial", "simulated", "imported")] == [0, 0, 0]
    assert frame_period_ns("i2c", 0.0) == 0


@pytest.mark.parametrize(
    ("chip_rate_hz", "rate_hz", "once"),
    [(0, 100, True), (800, 100, True), (800, 60, True), (75, 75, False), (800, 790, False)],
)
def test_which_sensors_are_read_once_a_frame(chip_rate_hz: float, rate_hz: float, once: bool) -> None:
    assert is_read_once_a_frame(chip_rate_hz, rate_hz, PERIOD_NS) is once


def test_a_reading_lost_from_one_sensor_is_no_frame_missed() -> None:
    assert missed_by_all([(0, 3), (5_000_000, 7)], PERIOD_NS) == 3
    assert missed_by_all([(0, 12), (110_000_000, 1)], PERIOD_NS) == 12  # the first frame took eleven periods
    assert missed_by_all([], PERIOD_NS) is None


@pytest.mark.parametrize("rate_hz", [100.0, 700.0])
def test_the_logger_says_the_same(tmp_path: Path, rate_hz: float) -> None:
    """At 100 Hz the array keeps pace, at 700 Hz the bus is too slow for it."""
    array = load_array(ROOT / "configs" / "martin2013.toml")
    with open_bus("emulated:", array) as bus:
        summary = record(array, bus, tmp_path / "run.h5", rate_hz=rate_hz, seconds=1.0)
    with open_log(tmp_path / "run.h5") as log:
        assert log.frame_rate_hz == rate_hz
        found = missed_frames(log)
    assert (summary.missed > 200) is (rate_hz > 400)
    assert found is not None and abs(found - summary.missed) <= 1


@pytest.mark.parametrize("kept", [False, True])
def test_the_rate_stands_in_the_log(tmp_path: Path, kept: bool) -> None:
    path = tmp_path / "run.h5"
    with LogWriter(path, [ACC], source="i2c", epoch="2026-01-01T00:00:00Z", frame_rate_hz=12.5) as writer:
        if kept:
            writer.keep()
            writer.flush()
            with open_log(path) as log:
                assert log.frame_rate_hz == 12.5
        writer.append("Acc", Block(np.arange(3) * 80_000_000, np.zeros((3, 3), np.int16), np.zeros(3, np.uint16)))
    with h5py.File(path) as file:
        assert file.attrs["frame_rate_hz"] == 12.5
    with open_log(path) as log:
        assert (log.frame_rate_hz, missed_frames(log)) == (12.5, 0)


@pytest.mark.parametrize("said", [None, "fast", -3.0, float("nan"), float("inf"), [50.0, 50.0], True])
def test_a_log_may_say_anything(tmp_path: Path, said: object) -> None:
    path = tmp_path / "run.h5"
    with LogWriter(path, [ACC], source="i2c", epoch="2026-01-01T00:00:00Z") as writer:
        writer.append("Acc", Block(np.arange(3), np.zeros((3, 3), np.int16), np.zeros(3, np.uint16)))
    if said is not None:
        with h5py.File(path, "a") as file:
            file.attrs["frame_rate_hz"] = said
    with open_log(path) as log:
        assert (log.frame_rate_hz, missed_frames(log)) == (0.0, None)
