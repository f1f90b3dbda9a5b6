"""Rows that all sensors lack are gaps of the recorder, and not a difference from a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.gap.inference.comparison import prepare
from imuarray.gap.recording.recordings import Recording, recording_of, sources_of
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import LOST_BEFORE, OVERRUN, Event, Phase, SensorHeader
from tests.selection import some

RATE_HZ = 50
SECOND = 10**9
ROWS = 20 * RATE_HZ
SENSORS = (
    SensorHeader("Acc", "mpu9150", "specific_force", "g", 16.0, 2048.0),
    SensorHeader("Gyro", "mpu9150", "angular_rate", "dps", 2000.0, 16.4),
)


def logged(
    path: Path,
    lost: Mapping[str, slice],
    message: str = "",
    late_s: float = 0.0,
    sensors: Sequence[SensorHeader] = SENSORS,
    is_delayed: bool = False,
    frame_rate_hz: float = 0.0,
    flag: int = LOST_BEFORE,
    kind: str = "late",
    reported: str = "",
    rows: int = ROWS,
) -> Recording:
    """At rest for as long as the `rows` take; each sensor lacks the rows `lost`; the logger reports `message` on the
    sensor `reported` ("": that it was late). If it `is_delayed` within a frame, the row after the lost rows is 1 ms
    before the next row, which has the flag instead.
    """
    rng = np.random.default_rng(1)
    with LogWriter(path, sensors, source="imported", epoch="2024-01-01T00:00:00Z", frame_rate_hz=frame_rate_hz) as log:
        for number, sensor in enumerate(sensors):
            level = (0, 0, 2048) if number == 0 else (0, 0, 0)
            time = np.arange(rows, dtype=np.int64) * SECOND // RATE_HZ + number * 300_000
            counts = np.rint(rng.normal(level, 5, (rows, 3))).astype(np.int16)
            status = np.zeros(rows, np.uint16)
            held = np.ones(rows, bool)
            if sensor.name in lost:
                held[lost[sensor.name]] = False
                stop = lost[sensor.name].stop
                status[stop + is_delayed] = flag
                if is_delayed:
                    time[stop] = time[stop + 1] - 1_000_000
            log.append(sensor.name, Block(time[held], counts[held], status[held]))
        log.phase(Phase(0, rows * SECOND // RATE_HZ - 1, "static", "+Z"))
        if message:
            log.event(Event(round(late_s * SECOND), reported, kind, message))
    return recording_of(open_log(path))


def due(recording: Recording) -> dict[str, int]:
    return {name: line.rows for name, (_, line) in recording.experiment.plan.sensors.items()}


@pytest.mark.parametrize("rows", [slice(300, 301), slice(300, 340)])
def test_rows_that_all_sensors_lack_are_not_counted_as_lost(tmp_path: Path, rows: slice) -> None:
    recording = logged(tmp_path / "log.h5", {"Acc": rows, "Gyro": rows})
    left = ROWS - (rows.stop - rows.start)
    assert due(recording) == {"Acc": left, "Gyro": left}
    assert any(note.startswith("the recorder read no sensor for") for note in recording.notes)


@pytest.mark.parametrize("rows", [slice(300, 301), slice(300, 340)])
def test_rows_that_one_sensor_lacks_are_counted_as_lost(tmp_path: Path, rows: slice) -> None:
    recording = logged(tmp_path / "log.h5", {"Acc": rows})
    assert due(recording) == {"Acc": ROWS, "Gyro": ROWS}
    assert not any("recorder" in note for note in recording.notes)


@pytest.mark.parametrize(("lost", "counted"), [(1, 0), (2, 2)])
def test_one_unreported_row_in_ten_thousand_is_the_hosts(tmp_path: Path, lost: int, counted: int) -> None:
    """Of 12,000 rows, in which one is the largest usual number."""
    rows = 12_000
    recording = logged(tmp_path / "log.h5", {"Acc": slice(300, 300 + lost)}, flag=0, rows=rows)
    assert due(recording) == {"Acc": rows - lost + counted, "Gyro": rows}


@pytest.mark.parametrize(("chip_hz", "lost"), some([(25.0, 0), (40.0, 1), (50.0, 1), (0.0, 1)], 1))
def test_a_skipped_poll_of_a_slow_chip_loses_no_reading(tmp_path: Path, chip_hz: float, lost: int) -> None:
    """Polled 50 times a second: rows that are 40 ms apart skip none of 25 readings per second, but one of 40 or 50."""
    slow = tuple(replace(sensor, rate_hz=chip_hz) for sensor in SENSORS)
    recording = logged(tmp_path / "log.h5", {"Acc": slice(300, 301)}, sensors=slow)
    assert due(recording) == {"Acc": ROWS - 1 + lost, "Gyro": ROWS}
    assert not any("recorder" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("frame_rate_hz", "flag", "lost"), some([(20.0, 0, 0), (20.0, OVERRUN, 1), (20.0, LOST_BEFORE, 1), (50.0, 0, 1)], 1)
)
def test_a_queue_without_overflow_loses_no_reading(tmp_path: Path, frame_rate_hz: float, flag: int, lost: int) -> None:
    """50 rows per second in 20 frames are from a queue; a sensor that is polled once a frame lacks a row."""
    recording = logged(tmp_path / "log.h5", {"Acc": slice(300, 301)}, frame_rate_hz=frame_rate_hz, flag=flag)
    assert due(recording) == {"Acc": ROWS - 1 + lost, "Gyro": ROWS}


@pytest.mark.parametrize(
    ("message", "late_s", "is_of_recorder"),
    some(
        [
            ("40 frames missed: the one before ended too late", 6.8, True),
            ("60 frames missed: the one before ended too late", 7.4, True),
            ("in all 80 frames missed in 4.5 s", 10.0, True),
            ("40 frames missed: the one before ended too late", 9.0, False),
            ("in all 80 frames missed in 2.5 s", 10.0, False),
        ],
        2,
    ),
)
def test_delays_reported_by_the_logger_are_used(
    tmp_path: Path, message: str, late_s: float, is_of_recorder: bool
) -> None:
    """From 6.0 to 6.8 s; for a single sensor there is no other information on the lost rows. A queue that overflows
    lacks the first rows of a delay of 60 frames of 20 ms, which the logger reports when it ends.
    """
    recording = logged(tmp_path / "log.h5", {"Acc": slice(300, 340)}, message, late_s)
    assert due(recording)["Acc"] == (ROWS - 40 if is_of_recorder else ROWS)


@pytest.mark.parametrize(
    ("kind", "message", "is_of_recorder"),
    [
        ("missed", "frames missed: the computer was busy", True),
        ("info", "stalled by the SD card", True),
        ("note", "the fan was switched on", False),
    ],
)
def test_delays_reported_by_other_loggers_are_used(
    tmp_path: Path, kind: str, message: str, is_of_recorder: bool
) -> None:
    """A single sensor lacks rows, and there is an event without a sensor at the next row."""
    recording = logged(tmp_path / "log.h5", {"Acc": slice(400, 403)}, message, 403 / RATE_HZ, SENSORS[:1], kind=kind)
    assert due(recording)["Acc"] == ROWS - 3 * is_of_recorder


@pytest.mark.parametrize(("sensor", "is_of_recorder"), [("Acc", True), ("Gyro", False)])
def test_a_delay_may_be_reported_for_each_sensor(tmp_path: Path, sensor: str, is_of_recorder: bool) -> None:
    """Three readings are too many to be usual losses; an event of another sensor does not explain them."""
    recording = logged(tmp_path / "log.h5", {"Acc": slice(400, 403)}, "skipped", 403 / RATE_HZ, reported=sensor)
    assert due(recording)["Acc"] == ROWS - 3 * is_of_recorder


@pytest.mark.parametrize(("late_s", "is_lost"), [(8.0, False), (9.0, True)])
def test_a_flag_at_a_reported_delay_is_the_recorders(tmp_path: Path, late_s: float, is_lost: bool) -> None:
    """No row is missing, since the reading before the skipped one was late: only a flag reports the loss."""
    flagged = logged(tmp_path / "log.h5", {"Acc": slice(400, 400)}, "skipped", late_s, reported="Acc", flag=LOST_BEFORE)
    source = sources_of(flagged)["Acc"]
    lost = sum(int((block.status & LOST_BEFORE != 0).sum()) for block in source.blocks(0, 20 * SECOND))
    assert lost == is_lost


@pytest.mark.parametrize(
    ("rows", "late_s", "reported", "is_of_recorder"),
    some(
        [
            (slice(300, 301), 6.02, "Acc", True),
            (slice(300, 301), 6.02, "Gyro", False),
            (slice(300, 301), 9.0, "Acc", False),
            (slice(300, 302), 6.04, "Acc", False),
        ],
        2,
    ),
)
def test_a_single_reading_that_the_logger_reports_as_lost_is_usual(
    tmp_path: Path, rows: slice, late_s: float, reported: str, is_of_recorder: bool
) -> None:
    """Two of 1000 readings, a loss that is reported on another sensor or at another time: these are not usual."""
    recording = logged(tmp_path / "log.h5", {"Acc": rows}, "bus error", late_s, kind="lost", reported=reported)
    assert due(recording) == {"Acc": ROWS - is_of_recorder, "Gyro": ROWS}
    assert any("lost readings, as on any bus: Acc (1)" in note for note in recording.notes) is is_of_recorder


@pytest.mark.parametrize(("flag", "is_of_recorder"), [(0, True), (LOST_BEFORE, False), (OVERRUN, False)])
def test_a_gap_of_a_single_sensor_is_the_recorders_unless_it_is_flagged(
    tmp_path: Path, flag: int, is_of_recorder: bool
) -> None:
    recording = logged(tmp_path / "log.h5", {"Acc": slice(300, 305)}, sensors=SENSORS[:1], flag=flag)
    assert due(recording) == {"Acc": ROWS - 5 * is_of_recorder}


@pytest.mark.slow
@pytest.mark.parametrize("is_delayed", some([True, False], 1))
def test_a_gap_of_the_recorder_does_not_change_the_statistics(tmp_path: Path, is_delayed: bool) -> None:
    rows = slice(300, 340)
    recording = logged(tmp_path / "log.h5", {"Acc": rows, "Gyro": rows}, is_delayed=is_delayed)
    bench, campaign = prepare([recording], None, 0)
    shown = bench.measured(campaign, bench.base.fitted)
    simulated = bench.measured(bench.simulated(bench.models(), 0), bench.base.fitted)
    timing = {
        (key.sensor, key.probe): place for place, key in enumerate(bench.keys) if key.domain in ("timing", "status")
    }
    for sensor in ("Acc", "Gyro"):
        for probe in ("interval", "longest_interval", "gaps", "lost"):
            place = timing[sensor, probe]
            assert shown.values[place] == pytest.approx(simulated.values[place], abs=1e-9)


def test_a_row_within_a_stall_is_not_compared(tmp_path: Path) -> None:
    """A stall of 0.8 s: the reading that was requested before it has the time of its middle; it is unknown whether the
    next row is new.
    """
    path = tmp_path / "log.h5"
    rng = np.random.default_rng(1)
    time = np.delete(np.arange(ROWS, dtype=np.int64) * SECOND // RATE_HZ, slice(301, 340))
    time = np.insert(time, 301, (time[300] + time[301]) // 2)
    status = np.zeros(len(time), np.uint16)
    status[302] = LOST_BEFORE
    with LogWriter(path, SENSORS, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for sensor in SENSORS:
            counts = np.rint(rng.normal((0, 0, 2048), 5, (len(time), 3))).astype(np.int16)
            log.append(sensor.name, Block(time, counts, status))
        log.phase(Phase(0, 20 * SECOND - 1, "static", "+Z"))
        log.event(Event(int(time[302]), "", "late", "39 frames missed: the frame before ended too late"))
    recording = recording_of(open_log(path))
    assert {name: times.tolist() for name, times in recording.experiment.uncertain_ns.items()} == {
        name: time[301:303].tolist() for name in ("Acc", "Gyro")
    }
    for source in sources_of(recording).values():
        compared = np.concatenate([block.time for block in source.blocks(0, 20 * SECOND)])
        np.testing.assert_array_equal(compared, np.delete(time, [301, 302]))


def test_a_late_row_with_a_wrong_flag_is_not_compared(tmp_path: Path) -> None:
    """Rows are up to 12 ms late; row 501 is 1 ms before row 502, which is flagged as if rows were lost. A timeline with
    such times has no gap.
    """
    rng, path = np.random.default_rng(1), tmp_path / "log.h5"
    time = np.arange(ROWS) * SECOND // RATE_HZ + rng.integers(0, 12_000_000, ROWS)
    time[501] = time[502] - 1_000_000
    status = np.zeros(ROWS, np.uint16)
    status[502] = LOST_BEFORE
    with LogWriter(path, SENSORS, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for sensor, level in zip(SENSORS, (2048, 0), strict=True):
            counts = np.rint(rng.normal((0, 0, level), 5, (ROWS, 3))).astype(np.int16)
            log.append(sensor.name, Block(time, counts, status))
        log.phase(Phase(0, 20 * SECOND - 1, "static", "+Z"))
    recording = recording_of(open_log(path))
    blocks = list(sources_of(recording)["Acc"].blocks(0, 20 * SECOND))
    assert sum(len(block.time) for block in blocks) == ROWS
    assert not any((block.status & LOST_BEFORE).any() for block in blocks)


def in_bursts(path: Path, lost: Sequence[int], second_ns: int = 0) -> Recording:
    """At rest for 40 s; a busy host stamps both sensors when it reads them, 1 to 20 rows at once. The gyroscope lacks
    rows, and has its stamp `second_ns` later.
    """
    rng = np.random.default_rng(3)
    rows = 40 * RATE_HZ
    sizes = rng.integers(1, 21, rows)
    ends = np.cumsum(sizes)
    burst = np.searchsorted(ends, np.arange(rows), side="right")
    in_burst = np.arange(rows) - (ends - sizes)[burst]
    stamps = np.minimum(ends[burst], rows) * SECOND // RATE_HZ + in_burst * 20_000
    with LogWriter(path, SENSORS, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for number, sensor in enumerate(SENSORS):
            held = np.ones(rows, bool)
            if number:
                held[list(lost)] = False
            counts = np.rint(rng.normal((0, 0, 2048 * (1 - number)), 5, (rows, 3))).astype(np.int16)
            time = stamps + number * second_ns
            log.append(sensor.name, Block(time[held], counts[held], np.zeros(rows, np.uint16)[held]))
    return recording_of(open_log(path))


@pytest.mark.slow
def test_common_stamps_determine_the_lost_rows_of_a_sensor(tmp_path: Path) -> None:
    """Also for irregular stamps; without common stamps they are unknown."""
    lost = (30, 500, 501, 1700)
    recording = in_bursts(tmp_path / "common.h5", lost)
    rows = len(recording.log["Acc"])
    assert due(recording) == {"Acc": rows, "Gyro": rows}
    _, line = recording.experiment.plan.sensors["Gyro"]
    assert [missing for *_, missing in line.holes()] == [1, 2, 1]
    whole, own = recording.experiment.plan.sensors["Acc"][1].stamps(0, rows), line.stamps(0, rows)
    np.testing.assert_allclose(own, whole, atol=1)
    times = np.concatenate([read.time for read in sources_of(recording)["Gyro"].blocks(0, 41 * SECOND)])
    np.testing.assert_allclose(times, np.delete(whole, lost), atol=1)
    apart = in_bursts(tmp_path / "apart.h5", lost, second_ns=7)
    assert due(apart) == {"Acc": rows, "Gyro": rows - len(lost)}


def test_settling_rows_of_a_filter_are_excluded(tmp_path: Path) -> None:
    """Five time constants of 10 Hz are 80 ms: four rows at 50 Hz. A chip without a filter has none."""
    sensors = (replace(SENSORS[0], bandwidth_hz=10.0), SENSORS[1])
    recording = logged(tmp_path / "log.h5", {}, sensors=sensors)
    source = sources_of(recording)["Acc"]
    first_ns = next(iter(source.blocks(0, SECOND))).time[0]
    assert first_ns == 80_000_000
    assert list(recording.experiment.uncertain_ns) == ["Acc"]
