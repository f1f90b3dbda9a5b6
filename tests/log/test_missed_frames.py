"""Missed frames, determined from rows, compared with the logger's own grid, frame by frame."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.acquire.recorder import record
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.commands.info import describe
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Event, SensorHeader
from imuarray.log.missed_frames import (
    duration_s,
    frame_period_ns,
    frame_timing,
    frames_in,
    is_read_once_a_frame,
    missed_by_all,
    missed_by_events,
    missing_rows,
)
from imuarray.monitor import LogMonitor
from tests.selection import some

PERIOD_NS = 10_000_000
ROOT = Path(__file__).parents[2]
ACC = SensorHeader("Acc", "bma180", "specific_force", "g", 16.0, 512.0)


def polled(lengths: list[float], forth: float, back: float) -> tuple[list[int], int]:
    """Times of a sensor's rows in frames of these lengths in periods, and the number of frames missed between them."""
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
def test_missing_rows_equal_the_frames_that_the_logger_missed(lengths: list[float], forth: float) -> None:
    times, missed = polled([*lengths, 0.1, 0.1, 0.1, 0.1], forth, 0.8 - forth)  # at the end it has caught up
    assert missing_rows(times[0], np.array(times[-2:]), len(times), PERIOD_NS) == missed


def test_few_rows_have_missing_rows_only_with_a_known_period() -> None:
    assert missing_rows(0, np.array([3 * PERIOD_NS]), 2, PERIOD_NS) == 2
    assert missing_rows(0, np.array([3 * PERIOD_NS]), 2, 0) == 0
    assert missing_rows(3 * PERIOD_NS, np.array([3 * PERIOD_NS]), 1, PERIOD_NS) == 0


@pytest.mark.parametrize("length", [1.1, 1.4, 1.9, 2.5])
def test_missed_frames_of_a_permanently_slow_machine_are_counted(length: float) -> None:
    """Its rows have a constant interval, which is too long."""
    times, missed = polled([length] * 1000, 0.0, 0.0)
    assert missed == pytest.approx((length - 1) * 999, abs=1)
    assert abs(missing_rows(times[0], np.array(times[-2:]), 1000, PERIOD_NS) - missed) <= 1


def test_the_frame_period_is_known_where_the_clock_is_the_loggers() -> None:
    assert [frame_period_ns(source, 50.0) for source in ("i2c", "emulated", "replay")] == [20_000_000] * 3
    assert [frame_period_ns(source, 50.0) for source in ("serial", "simulated", "imported")] == [0, 0, 0]
    assert frame_period_ns("i2c", 0.0) == 0


@pytest.mark.parametrize(
    ("chip_rate_hz", "rate_hz", "once"),
    [(0, 100, True), (800, 100, True), (800, 60, True), (75, 75, False), (800, 790, False)],
)
def test_sensors_of_sufficient_rate_are_read_once_a_frame(chip_rate_hz: float, rate_hz: float, once: bool) -> None:
    assert is_read_once_a_frame(chip_rate_hz, rate_hz, PERIOD_NS) is once


def test_a_reading_lost_by_one_sensor_is_no_missed_frame() -> None:
    assert missed_by_all([(0, 3), (5_000_000, 7)], PERIOD_NS) == 3
    assert missed_by_all([(0, 12), (110_000_000, 1)], PERIOD_NS) == 12  # the first frame took eleven periods
    assert missed_by_all([], PERIOD_NS) is None


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", some([100.0, 700.0], 1))
def test_the_count_from_rows_equals_that_of_the_logger(tmp_path: Path, rate_hz: float) -> None:
    """At 100 Hz the array keeps pace, at 700 Hz the bus is too slow for it."""
    array = load_array(ROOT / "configs" / "martin2013.toml")
    with open_bus("emulated:", array) as bus:
        summary = record(array, bus, tmp_path / "run.h5", rate_hz=rate_hz, seconds=1.0)
    with open_log(tmp_path / "run.h5") as log:
        assert log.frame_rate_hz == rate_hz
        timing = frame_timing(log).missed
    assert (summary.missed > 200) is (rate_hz > 400)
    assert timing == summary.missed


@pytest.mark.parametrize(
    ("seconds", "rate_hz", "frames"),
    [(40, 50, 2000), (40, 9, 360), (200, 0.3, 60), (20, 0.1, 2), (0.001, 50, 1), (1.25, 1, 2), (2, 1 / 3, 1)],
)
def test_the_number_of_frames_follows_from_duration_and_rate(seconds: float, rate_hz: float, frames: int) -> None:
    assert frames_in(seconds, rate_hz) == frames


def late(message: str, sensor: str = "") -> Event:
    return Event(0, sensor, "late", message)


def test_missed_frames_are_counted_from_events() -> None:
    first, more = late("3 frames missed: the one before ended too late"), late("1 frame missed: the one before ended")
    assert missed_by_events([]) == 0
    assert missed_by_events([first, more]) == 4
    assert missed_by_events([first, late("in all 12 frames missed in 2.5 s"), more]) == 13
    assert missed_by_events([late("9 frames missed", "A"), Event(0, "", "lost", "9 frames missed")]) == 0
    assert missed_by_events([late("in all 12 frames missed in 2.5 s"), more]) is None  # begun in the log before


BLOCKS = {
    "none": ({}, 0),
    "one": ({100: 1.225}, 60),
    "short ones close together": ({100: 0.045, 105: 0.065, 110: 0.105}, 1 + 2 + 4),
    "many": ({100 * count: 0.145 for count in range(1, 15)}, 14 * 6),
    "in the last frame but one": ({1998: 1.225}, 1),
    "until long after the end": ({1500: 60.0}, 499),
    "in the first frame": ({0: 2.025}, 100),
}
"""Blocks in s by the grid place of the frame, and how many frames of 20 ms are missed: a block of n + 1 periods and a
quarter costs n frames while a frame takes less than three quarters."""


@pytest.mark.slow
@pytest.mark.parametrize("name", some(BLOCKS, 1, 2))
@pytest.mark.parametrize("sensors", some(["Gyro1", "BMA1,BMA2,ADXL1,Gyro1,Gyro2,BMP180", "ADXL1,HMC1"], 1))
def test_missed_frames_of_a_blocked_recorder_are_counted(tmp_path: Path, name: str, sensors: str) -> None:
    """For any cause of blocking: the summary and the log have the same missed frames and duration."""
    array = load_array(ROOT / "configs" / "martin2013.toml").only(tuple(sensors.split(",")))
    blocks, missed = BLOCKS[name]
    delays = dict(blocks)
    begins: list[int] = []
    with open_bus("emulated:", array) as bus:

        def stopped() -> bool:
            if not begins:
                begins.append(bus.clock.now_ns())
            place = (bus.clock.now_ns() - begins[0]) // 20_000_000
            bus.clock.advance(round(delays.pop(place, 0.0) * 1e9))
            return False

        summary = record(array, bus, tmp_path / "run.h5", rate_hz=50, seconds=40, stopped=stopped)
    assert not delays
    assert (summary.frames, summary.missed, summary.seconds) == (2000 - missed, missed, 40.0)
    with open_log(tmp_path / "run.h5") as log:
        assert frame_timing(log) == (missed, 40.0)
        assert describe(log)["seconds"] == 40.0
        assert describe(log)["missed"] == missed


@pytest.mark.slow
def test_creating_files_takes_no_time_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    array = load_array(ROOT / "configs" / "martin2013.toml").only(("Gyro1",))
    with open_bus("emulated:", array) as bus:
        keep = LogWriter.keep

        def slow(writer: LogWriter) -> None:
            bus.clock.advance(18_000_000_000)
            keep(writer)

        monkeypatch.setattr(LogWriter, "keep", slow)
        summary = record(array, bus, tmp_path / "run.h5", rate_hz=50, seconds=4)
    assert (summary.frames, summary.missed, summary.seconds) == (200, 0, 4.0)
    with open_log(tmp_path / "run.h5") as log:
        assert frame_timing(log) == (0, 4.0)


@pytest.mark.slow
def test_each_part_has_its_own_missed_frames(tmp_path: Path) -> None:
    array = load_array(ROOT / "configs" / "martin2013.toml").only(("Gyro1", "BMA1"))
    delays = {225: 0.145, 234: 0.145, 252: 0.145, 261: 0.145, 700: 0.205}  # the second part begins with frame 250
    begins: list[int] = []
    with open_bus("emulated:", array) as bus:

        def stopped() -> bool:
            if not begins:
                begins.append(bus.clock.now_ns())
            place = (bus.clock.now_ns() - begins[0]) // 20_000_000
            bus.clock.advance(round(delays.pop(place, 0.0) * 1e9))
            return False

        summary = record(
            array, bus, tmp_path / "run.h5", rate_hz=50, seconds=20, rotate_s=5.0, stopped=stopped, batch_s=1.0
        )
    assert (summary.missed, summary.seconds) == (4 * 6 + 9, 20.0)
    paces = []
    for path in summary.logs:
        with open_log(path) as log:
            paces.append(frame_timing(log))
    assert paces == [(12, 5.0), (12, 5.0), (9, 5.0), (0, 5.0)]


@pytest.mark.parametrize(("recovered", "missed"), [(False, 2), (True, 3)])
def test_events_count_missed_frames_only_in_a_complete_log(tmp_path: Path, recovered: bool, missed: int) -> None:
    """Rows at 0, 1, 2, 6, 7 and 8 periods: three are missing, of which the logger counted two. Events of a log that was
    interrupted may be incomplete; then the rows are counted.
    """
    path = tmp_path / "run.h5"
    with LogWriter(path, [ACC], source="i2c", epoch="2026-01-01T00:00:00Z", frame_rate_hz=100.0) as writer:
        times = np.array([0, 1, 2, 6, 7, 8]) * PERIOD_NS
        writer.append("Acc", Block(times, np.zeros((6, 3), np.int16), np.zeros(6, np.uint16)))
        writer.event(Event(6 * PERIOD_NS, "", "late", "2 frames missed: the one before ended too late"))
        if recovered:
            writer.event(Event(6 * PERIOD_NS, "", "recovered", "the log was cut short"))
    with open_log(path) as log:
        assert frame_timing(log).missed == missed


@pytest.mark.parametrize(
    ("acc", "gyro", "faults", "missed"),
    [
        ([5, 6, 7], [20, 21], [("Acc", "lost"), ("Gyro", "lost")], 0),
        ([5, 6, 7], [5, 6, 7], [("", "adapter")], 0),
        ([5, 6, 7], [5, 6, 7], [("", "bus")], 0),
        ([5, 6, 7, 20, 21], [5, 6, 7], [("Acc", "lost")], 3),
        ([5, 6, 7], [5, 6, 7], [("Acc", "bus")], 3),
        ([5, 6, 7], [5, 6, 7], [("Acc", "back"), ("Gyro", "reconfigured")], 3),
        ([5, 6, 7], [5, 6, 7], [], 3),
    ],
)
def test_readings_that_all_sensors_lost_are_no_missed_frames(
    tmp_path: Path, acc: list[int], gyro: list[int], faults: list[tuple[str, str]], missed: int
) -> None:
    """Each sensor lacks some of 40 rows at 100 Hz, which last 0.4 s; the events say whose readings were lost."""
    path = tmp_path / "run.h5"
    turns = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 114.0)
    with LogWriter(path, [ACC, turns], source="i2c", epoch="2026-01-01T00:00:00Z", frame_rate_hz=100.0) as writer:
        for name, lost in (("Acc", acc), ("Gyro", gyro)):
            times = np.delete(np.arange(40), lost) * PERIOD_NS
            writer.append(name, Block(times, np.zeros((len(times), 3), np.int16), np.zeros(len(times), np.uint16)))
        for name, kind in faults:
            writer.event(Event(8 * PERIOD_NS, name, kind, "no reading: Remote I/O error"))
    with open_log(path) as log:
        assert frame_timing(log) == (missed, pytest.approx(0.4))
    with LogMonitor(path) as watch:
        assert watch.refresh(0.0).missed == missed


def test_a_late_last_row_is_no_further_frame(tmp_path: Path) -> None:
    """40 frames at 100 Hz; the last two rows of the gyroscope are 1.2 periods late."""
    path = tmp_path / "run.h5"
    turns = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 114.0)
    with LogWriter(path, [ACC, turns], source="i2c", epoch="2026-01-01T00:00:00Z", frame_rate_hz=100.0) as writer:
        times = np.arange(40) * PERIOD_NS
        late = times + np.where(np.arange(40) < 38, 0, 12_000_000)
        for name, of_sensor in (("Acc", times), ("Gyro", late)):
            writer.append(name, Block(of_sensor, np.zeros((40, 3), np.int16), np.zeros(40, np.uint16)))
    with open_log(path) as log:
        assert frame_timing(log) == (0, pytest.approx(0.4))


def test_a_log_of_another_clock_lasts_from_its_first_row_to_its_last(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with LogWriter(path, [ACC], source="serial", epoch="2026-01-01T00:00:00Z", frame_rate_hz=10.0) as writer:
        times = np.array([0, 100_000_000, 900_000_000])
        writer.append("Acc", Block(times, np.zeros((3, 3), np.int16), np.zeros(3, np.uint16)))
    with open_log(path) as log:
        assert frame_timing(log) == (None, 1.0)
    assert duration_s(113, 1887, 50.0) == 40.0


@pytest.mark.parametrize("kept", some([False, True], 1))
def test_the_frame_rate_is_an_attribute_of_the_log(tmp_path: Path, kept: bool) -> None:
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
        assert (log.frame_rate_hz, frame_timing(log).missed) == (12.5, 0)


@pytest.mark.parametrize("message", some([None, "fast", -3.0, float("nan"), float("inf"), [50.0, 50.0], True], 2))
def test_invalid_frame_rates_are_ignored(tmp_path: Path, message: object) -> None:
    path = tmp_path / "run.h5"
    with LogWriter(path, [ACC], source="i2c", epoch="2026-01-01T00:00:00Z") as writer:
        writer.append("Acc", Block(np.arange(3), np.zeros((3, 3), np.int16), np.zeros(3, np.uint16)))
    if message is not None:
        with h5py.File(path, "a") as file:
            file.attrs["frame_rate_hz"] = message
    with open_log(path) as log:
        assert (log.frame_rate_hz, frame_timing(log).missed) == (0.0, None)
