"""The poll loop over the emulated bus: transactions on the wire and rows in the log, also when readings are lost."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest

from imuarray.acquire import connect, record
from imuarray.acquire.bus_segment import alternating_orders, routes_of
from imuarray.acquire.recorder import Poll
from imuarray.acquire.recording import VIRTUAL_BATCH_S, RecordingOptions, Service
from imuarray.array import load_array, parse_array
from imuarray.bus import open_bus
from imuarray.bus.transcript import RecordingBus
from imuarray.clock import MonotonicClock
from imuarray.errors import OutputExistsError, SensorError
from imuarray.log import open_log
from imuarray.log.format import Phase
from imuarray.log.writer import LogWriter
from tests.selection import some

MS = 1_000_000
SHIPPED = Path(__file__).parents[2] / "configs" / "martin2013.toml"
STALE, LOST = 1, 8
MakeBoard = Callable[..., Any]


def test_orders_alternate(an_array: Callable[..., Any], tapped: Callable[..., Any]) -> None:
    array = an_array(A=0, B=1, G=0, M=1, P=None)
    there, back = alternating_orders(routes_of(array, tapped(array)))
    names = [[[route.sensor.name for route in segment] for segment in order] for order in (there, back)]
    assert names == [[["A", "G"], ["B", "M"], ["P"]], [["P"], ["B", "M"], ["A", "G"]]]


@pytest.mark.slow
@pytest.mark.parametrize(("channels", "switches"), some([((0, 1), 1), ((0, 1, 2), 2), ((3, 1, 2, 0), 3), ((2,), 0)], 1))
def test_a_frame_has_one_switch_less_than_channels(board: MakeBoard, channels: tuple[int, ...], switches: int) -> None:
    made = board(**{f"A{channel}": channel for channel in channels})
    made.record(seconds=1)
    polled = [call for call in made.bus.calls if call.at_ns >= made.begun_ns]
    selects = [call for call in polled if call.address == 0x70]
    assert abs(len(selects) - 100 * switches) <= 2 * len(
        channels
    )  # the first frame selects its channel, the last reads it back
    assert all(call.write[0] in (4, 5, 6, 7) and len(call.write) == 1 and call.read == 0 for call in selects)
    assert len([call for call in polled if call.read > 1]) == 100 * len(channels)
    # One register a frame is checked, and one in each visit of a channel on which twins could be taken for each other.
    visits = 100 * len(channels) if len(channels) > 1 else 0
    assert len([call for call in polled if call.read == 1]) <= visits + 110 + 10 * len(channels)


@pytest.mark.slow
def test_a_frame_of_the_papers_array_takes_the_scl_clocks_of_its_transactions(tmp_path: Path) -> None:
    """A burst a sensor, one switch, a register of each channel and up to two more read back: 9 (n + 3) clocks, 18 for
    a switch (BUS-02, BUS-04).
    """
    array = load_array(SHIPPED)
    array = array.only(tuple(sensor.name for sensor in array.sensors if sensor.chip not in ("bmp180", "hmc5883")))
    with open_bus("emulated:", array) as bus:
        marks: list[int] = []
        record(
            array,
            bus,
            tmp_path / "r.h5",
            rate_hz=50,
            seconds=1,
            stopped=lambda: bool(marks.append(bus.wire.scl_clocks)),
        )
    bursts = 4 * 90 + 5 * 99 + 18  # 4 BMA180 of 7 bytes, 2 ADXL345 and 3 L3G4200D of 8
    assert set(np.diff(marks[1:])) <= {bursts + 2 * 36, bursts + 3 * 36, bursts + 4 * 36}


def test_frames_have_a_steady_rate_and_every_reading(board: MakeBoard) -> None:
    made = board("world=shaking&still_s=0.2&motion_s=5", A=0, G=0)
    done = made.record(200, seconds=12)
    assert (done.frames, done.late, done.lost) == (2400, 0, {"A": 0, "G": 0})  # more than two batches of 1024
    assert done.seconds == pytest.approx(12, abs=0.01)
    for name in "AG":
        time, counts, status = made.rows(name)
        assert len(time) == len(counts) == 2400
        np.testing.assert_allclose(np.diff(time), 5 * MS, atol=1)
        assert not (status & STALE).any()
        assert not (status & LOST).any()


@pytest.mark.parametrize("channel", some([0, 1], 1))
def test_the_time_of_a_row_is_the_start_of_its_burst(board: MakeBoard, channel: int) -> None:
    made = board(A=0, G=channel)
    made.record(seconds=1)
    polled = [call for call in made.bus.calls if call.at_ns >= made.begun_ns and call.read == 8]
    for name, address in (("A", 0x53), ("G", 0x68)):
        bursts = [call.at_ns for call in polled if call.address == address]
        np.testing.assert_array_equal(made.rows(name)[0], np.array(bursts) - made.begun_ns)


def silence(address: int, start_ms: float, end_ms: float) -> Callable[[Any], bool]:
    """No chip acknowledges `address` between these times after the chips have been set up, 2 s after power-on."""
    return lambda call: call.address == address and 2000 + start_ms <= call.at_ns / MS < 2000 + end_ms


@pytest.fixture(scope="module")
def losses(board_at: MakeBoard, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What the recorder says, and its bus and log: a BMA180 is silent from 100 ms to 200 ms."""
    path, url = tmp_path_factory.mktemp("lost") / "r.h5", "world=shaking&still_s=0.1&motion_s=60&peak_g=0.6"
    made = board_at(path, url, silence(0x40, 100, 200), A=0, B=1)
    made.bus.clock.sleep_until(1500 * MS)
    connect(made.array, made.bus)
    made.bus.clock.sleep_until(2000 * MS - 300 * MS)
    return made.record(seconds=1), made


class TestLostReadings:
    """A BMA180 that is silent from 100 ms to 200 ms, in a box that is shaken all the time."""

    def test_a_silent_sensor_has_no_rows(self, losses: Any) -> None:
        done, made = losses
        assert len(made.bus.failed) > 0
        time, _, _ = made.rows("B")
        assert done.frames == 100
        assert done.lost["B"] == 100 - len(time) == 10
        gaps = np.diff(time)
        assert np.count_nonzero(gaps > 15 * MS) == 1
        assert gaps.max() == pytest.approx(110 * MS, abs=2 * MS)

    def test_the_next_row_is_flagged_lost(self, losses: Any) -> None:
        _, made = losses
        time, _, status = made.rows("B")
        (flagged,) = np.flatnonzero(status & LOST)
        assert flagged == np.argmax(np.diff(time)) + 1

    def test_one_event_states_the_cause(self, losses: Any) -> None:
        _, made = losses
        with made.log() as log:
            event, end = log.events
            time = log["B"].time[:]
        assert (event.sensor, event.kind) == (end.sensor, end.kind) == ("B", "lost")
        assert end.message.startswith("in all 10 readings lost in 0.1 s")
        assert "errno 121" in event.message
        before = time[np.argmax(np.diff(time))]
        assert before < event.time_ns <= before + 12 * MS

    def test_no_reading_is_repeated(self, losses: Any) -> None:
        _, made = losses
        time, counts, _ = made.rows("B")
        assert (np.diff(time) > 0).all()
        assert (np.diff(counts.astype(int), axis=0) != 0).any(axis=1).mean() > 0.95

    def test_other_sensors_lose_nothing(self, losses: Any) -> None:
        done, made = losses
        time, _, status = made.rows("A")
        assert len(time) == 100
        assert done.lost["A"] == 0
        assert not (status & LOST).any()


def test_a_reading_that_fails_once_is_repeated_and_not_lost(board: MakeBoard) -> None:
    count = [0]

    def every_seventh(call: Any) -> bool:
        count[0] += call.address == 0x53 and call.read == 8
        return bool(call.address == 0x53 and call.read == 8 and count[0] % 7 == 0)

    made = board("", every_seventh, A=0)
    done = made.record(seconds=1)
    assert made.bus.failed
    assert done.lost == {"A": 0}
    time, _, status = made.rows("A")
    assert len(time) == 100
    assert not (status & LOST).any()


@pytest.mark.slow
def test_a_silent_mux_loses_the_readings_of_its_channels_until_it_answers(board: MakeBoard) -> None:
    made = board(A=0, B=1, G=None)
    made.bus.clock.sleep_until(1500 * MS)
    made.bus.fails = lambda call: (
        bool(made.begun_ns) and call.address != 0x68 and 200 * MS <= call.at_ns - made.begun_ns < 300 * MS
    )
    done = made.record(seconds=1)
    assert done.lost["G"] == 0
    assert 9 <= done.lost["A"] <= 10
    assert 9 <= done.lost["B"] <= 10
    with made.log() as log:
        assert sorted(event.sensor for event in log.events) == ["A", "A", "B", "B"]


@pytest.mark.slow
def test_a_lost_reading_of_the_barometer_is_flagged_and_counted(board: MakeBoard) -> None:
    made = board(P=0)
    made.bus.fails = lambda call: (
        bool(made.begun_ns) and call.address == 0x77 and 1000 * MS <= call.at_ns - made.begun_ns < 2000 * MS
    )
    done = made.record(seconds=3)
    time, _, status = made.rows("P")
    assert np.diff(time).max() > 900 * MS
    assert done.lost["P"] > 0
    assert (status & LOST).any()


@pytest.mark.slow
def test_a_triad_equal_to_its_predecessor_is_flagged_stale(board: MakeBoard) -> None:
    made = board(M=0)
    made.array = parse_array(made.array.text.replace("range=1.2", "range=7.9"))  # no ready bit in its burst
    made.record(70, seconds=60)
    _, counts, status = made.rows("M")
    same = (np.diff(counts.astype(int), axis=0) == 0).all(axis=1)
    assert len(counts) > 3000
    assert 0 < same.sum() < 300
    np.testing.assert_array_equal((status[1:] & STALE).astype(bool), same)  # across the batches of 1024, too


def test_saturation_at_1600_hz_is_flagged_at_both_ends_of_the_range(board: MakeBoard) -> None:
    made = board("world=shaking&still_s=0.1&peak_g=8", A=None)
    made.array = parse_array(made.array.text.replace("range=4\nrate_hz=800", "range=2\nrate_hz=1600"))
    made.record(seconds=10)
    _, counts, status = made.rows("A")
    at_end = ((counts == -512) | (counts == 510)).any(axis=1)  # 2 g, even codes only: ADX-46, ADX-47
    assert (counts == 510).any()
    assert (counts == -512).any()
    np.testing.assert_array_equal((status & 4).astype(bool), at_end)


@pytest.mark.slow
def test_phases_and_truth_of_the_world_are_logged(board: MakeBoard) -> None:
    made = board("world=tumble&face_s=2&turn_s=0.5", B=0)
    made.record(50, seconds=6, phases=made.bus.phases)
    with made.log() as log:
        assert log.source == "emulated"
        assert [(phase.name, phase.up) for phase in log.phases] == [("z_up", "+Z"), ("x_up", "+X"), ("y_up", "+Y")]
        set_up_ns = log.phases[1].start_ns - 2500 * MS  # the clock ran while the chip was set up
        assert -1000 * MS < set_up_ns < 0
        assert log.phases[0].start_ns == 0
        assert log.phases[0].end_ns == 2000 * MS + set_up_ns
        assert log.phases[2].end_ns == pytest.approx(6000 * MS, abs=20 * MS)
        truth = log.truth
        assert truth is not None
        assert truth.specific_force is not None
        assert len(truth.time) == 300
        resting = (truth.time[:] > log.phases[1].start_ns) & (truth.time[:] < log.phases[1].end_ns)
        np.testing.assert_allclose(truth.specific_force[:][resting], [[9.80665, 0, 0]] * resting.sum(), atol=1e-12)
        # and the sensor measured it: x up, axes as the box's, 4096 counts per g within 5 % and 60 mg
        rows = log["B"].between(log.phases[1].start_ns + 100 * MS, log.phases[1].end_ns)
        np.testing.assert_allclose(log["B"].counts[rows].mean(axis=0), [4096, 0, 0], atol=500)


@pytest.mark.slow
def test_a_named_phase_covers_the_log(board: MakeBoard) -> None:
    made = board(A=None)
    made.record(50, seconds=1, phase="x_down", up="-X")
    with made.log() as log:
        (phase,) = log.phases
        assert phase == Phase(0, phase.end_ns, "x_down", "-X")
        assert phase.end_ns == pytest.approx(1000 * MS, abs=20 * MS)
        assert log["A"].time[-1] < phase.end_ns


@pytest.mark.slow
def test_late_frames_are_counted_and_not_skipped(board: MakeBoard) -> None:
    made = board("bit_rate=10000", A=0, B=0, G=0)  # 99 + 90 + 99 clocks at 10 kHz: 29 ms and more a frame
    done = made.record(seconds=1)
    assert 25 <= done.frames <= 35
    assert done.frames - 1 <= done.late <= done.frames
    assert done.frames + done.missed == pytest.approx(100, abs=2)
    for name in "ABG":
        assert len(made.rows(name)[0]) == done.frames


@pytest.mark.parametrize(("longer_ns", "late"), [(0, 0), (1, 10)])
def test_a_frame_that_ends_when_the_next_one_is_due_is_not_late(
    board: MakeBoard, monkeypatch: pytest.MonkeyPatch, longer_ns: int, late: int
) -> None:
    """Ten frames that take exactly their 10 ms, and ten that take a nanosecond more."""

    def frame(poll: Poll) -> None:
        poll.clock.sleep_until(poll.clock.now_ns() + 10 * MS + longer_ns)
        poll.summary.frames += 1

    monkeypatch.setattr(Poll, "frame", frame)
    made = board(A=0)
    done = made.record(seconds=0.1)
    assert (done.frames, done.late, done.missed) == (10, late, 0)


def test_a_stop_ends_the_recording_after_the_current_frame(board: MakeBoard) -> None:
    made = board(A=0)
    asked = [0]

    def stop() -> bool:
        asked[0] += 1
        return asked[0] > 7

    done = made.record(stopped=stop)
    assert done.frames == 7
    assert len(made.rows("A")[0]) == 7


def test_a_stop_before_the_first_frame_gives_an_empty_log(board: MakeBoard) -> None:
    made = board(A=0)
    made.record(stopped=lambda: True)
    assert len(made.rows("A")[0]) == 0


@pytest.mark.slow
def test_progress_is_reported_every_second(board: MakeBoard) -> None:
    made, frames = board(A=0), list[int]()
    made.record(800, seconds=3, batch_s=1.0, progress=frames.append)
    assert frames == [800, 1600, 2400, 2400]


def test_progress_is_reported_after_each_batch(board: MakeBoard) -> None:
    """Rows are written every five seconds of a virtual clock."""
    made, frames = board(A=0), list[int]()
    made.record(10, seconds=11, progress=frames.append)
    assert frames == [50, 100, 110]


def test_followed_rows_are_written_every_second(board: MakeBoard) -> None:
    made, frames = board(A=0), list[int]()
    made.record(10, seconds=3, on_block=lambda sensor, block: None, progress=frames.append)
    assert frames[:3] == [10, 20, 30]


def test_the_clock_decides_how_often_rows_are_written(tmp_path: Path, board: MakeBoard) -> None:
    """The clock of a bus that writes a transcript is that of a replay, which takes real time."""
    options, bus = RecordingOptions(50.0), board(A=0).bus
    clock, recorder = bus.clock, RecordingBus(bus, tmp_path / "run.jsonl")
    assert (options.write_interval_s(clock), options.write_interval_s(MonotonicClock())) == (5.0, 1.0)
    assert RecordingOptions(50.0, batch_s=0.25).write_interval_s(clock) == 0.25
    with recorder:
        assert options.write_interval_s(recorder.clock) == 1.0


@pytest.mark.slow
def test_rows_do_not_depend_on_the_batches(board: MakeBoard) -> None:
    sensors = {"A0": 0, "A1": 1, "B": 1, "G": 0, "M": 2, "P": None}
    contents = []
    for batch_s in (1.0, VIRTUAL_BATCH_S):
        made = board("world=shaking&still_s=2&motion_s=8", **sensors)
        made.record(50, seconds=13, batch_s=batch_s, force=True)
        contents.append({name: [column.tobytes() for column in made.rows(name)] for name in sensors})
    assert contents[0] == contents[1]


@pytest.mark.slow
def test_the_epoch_is_the_wall_time_of_the_start(board: MakeBoard) -> None:
    made = board(A=0)
    start = datetime(2026, 3, 1, 12, 0, 0, 5, tzinfo=timezone(timedelta(hours=2)))
    made.record(seconds=0.1, wall_time=start)
    with made.log() as log:
        assert log.epoch == "2026-03-01T10:00:00.000005Z"
        assert log["A"].time[0] == 0
    begun = datetime.now(UTC)
    made = board(A=0)
    made.path = made.path.with_name("s.h5")
    made.record(seconds=0.1)
    with made.log() as log:
        assert begun <= datetime.fromisoformat(log.epoch) <= datetime.now(UTC)


@pytest.mark.slow
def test_the_log_describes_its_sensors(board: MakeBoard) -> None:
    made = board(A=0, B=0, G=1, M=1, P=0)
    made.record(50, seconds=1)
    with made.log() as log:
        assert log.config == made.array.text
        headers = {
            name: (sensor.chip, sensor.quantity, sensor.unit, sensor.range, sensor.rate_hz, sensor.bandwidth_hz)
            for name, sensor in log.sensors.items()
        }
        assert headers == {
            "A": ("adxl345", "specific_force", "g", 4, 800, 0),
            "B": ("bma180", "specific_force", "g", 2, 2400, 150),
            "G": ("l3g4200d", "angular_rate", "dps", 250, 800, 110),
            "M": ("hmc5883", "magnetic_field", "gauss", 1.2, 75, 0),
            "P": ("bmp180", "pressure", "Pa", 0, 8, 0),
        }
        assert {name: sensor.temperature_counts is not None for name, sensor in log.sensors.items()} == {
            "A": False, "B": True, "G": True, "M": False, "P": False,
        }  # fmt: skip
        assert log["P"].attributes["AC1"] == 408
        assert log["P"].compensated("pressure")[:].mean() == pytest.approx(101325, abs=500)
        assert log["P"].compensated("temperature")[:].mean() == pytest.approx(25, abs=2.5)


class TestNothingIsWritten:
    @pytest.mark.parametrize("number", [6, 121])
    def test_a_missing_chip_is_refused(self, an_array: Callable[..., Any], tmp_path: Path, number: int) -> None:
        array, board = an_array(A=0, B=1), an_array(A=0)
        (tmp_path / "board.toml").write_text(board.text)
        with (
            open_bus(f"emulated:?errno={number}&board={tmp_path / 'board.toml'}", array) as bus,
            pytest.raises(
                SensorError, match=r"^B \(bma180\) at channel 1 address 0x40: no chip acknowledges this address$"
            ),
        ):
            record(array, bus, tmp_path / "r.h5", rate_hz=50, seconds=1)
        assert [path.name for path in tmp_path.iterdir()] == ["board.toml"]

    def test_a_wrong_chip_is_refused(self, board: MakeBoard) -> None:
        made = board(A=0, B=1)
        made.bus.chips["B"].page[0] = 0x42
        with pytest.raises(SensorError, match=r"^B \(bma180\) at channel 1 address 0x40: identity 42, expected 03$"):
            made.record(50, seconds=1)
        assert list(made.path.parent.iterdir()) == []
        assert not [call for call in made.bus.calls if len(call.write) > 1]  # no chip was configured

    def test_a_chip_that_fails_while_it_is_set_up_is_refused(self, board: MakeBoard) -> None:
        made = board("", lambda call: call.address == 0x40 and call.write[:1] == b"\x35", A=0, B=1)
        with pytest.raises(
            SensorError, match=r"^B at channel 1 address 0x40: the bus fails while it is configured: Remote I/O error$"
        ):
            made.record(50, seconds=1)
        assert list(made.path.parent.iterdir()) == []

    def test_an_existing_output_is_refused(self, board: MakeBoard) -> None:
        made = board(A=0)
        made.path.write_text("precious")
        with pytest.raises(OutputExistsError):
            made.record(50, seconds=1)
        assert made.path.read_text() == "precious"


@pytest.mark.slow
def test_an_error_during_recording_keeps_the_rows_read_before(board: MakeBoard) -> None:
    made = board(A=0)
    asked = [0]

    def stop() -> bool:
        asked[0] += 1
        if asked[0] > 1500:
            raise RuntimeError("mine")
        return False

    with pytest.raises(RuntimeError, match="mine"):
        made.record(800, stopped=stop)
    assert len(made.rows("A")[0]) > 1000
    assert len(list(made.path.parent.iterdir())) == 1


@pytest.mark.slow
def test_clocks_are_in_the_log(board: MakeBoard) -> None:
    made = board(A=0)
    start = datetime(2026, 3, 1, tzinfo=UTC)
    made.record(10, seconds=25, wall_time=start)
    with made.log() as log:
        assert log.clocks is not None
        np.testing.assert_allclose(log.clocks.time[:] * 1e-9, [0.2, 10.2, 20.2], atol=0.11)
        wall = log.clocks.realtime[:] - log.clocks.time[:]
        np.testing.assert_array_equal(wall, 1_772_323_200 * 10**9)  # date -d 2026-03-01T00:00:00Z +%s
        np.testing.assert_array_equal(np.diff(log.clocks.monotonic[:]), np.diff(log.clocks.time[:]))


@pytest.mark.slow
def test_the_parts_of_a_log_equal_the_whole_log(board: MakeBoard) -> None:
    made, divided = board(A=0, G=1), board(A=0, G=1)
    divided.path = divided.path.with_name("p.h5")
    whole = made.record(50, seconds=5, phase="static", up="+Z")
    parts = divided.record(50, seconds=5, phase="static", up="+Z", rotate_s=2)
    assert [path.name for path in whole.logs] == ["r.h5"]
    assert [path.name for path in parts.logs] == ["p_001.h5", "p_002.h5", "p_003.h5"]
    assert sorted(made.path.parent.iterdir()) == [*parts.logs, *whole.logs]
    for name in "AG":
        together = [
            np.concatenate(columns) for columns in zip(*(made.rows(name, path) for path in parts.logs), strict=True)
        ]
        for column, expected in zip(together, made.rows(name), strict=True):
            np.testing.assert_array_equal(column, expected)
    for number, path in enumerate(parts.logs):
        with open_log(path) as log:
            ((start_ns, end_ns, phase, up),) = log.phases
            assert (start_ns, phase, up) == (number * 2_000_000_000, "static", "+Z")
            assert end_ns == (number + 1) * 2_000_000_000 if number < 2 else end_ns > 4_970_000_000


@pytest.mark.slow
@pytest.mark.parametrize("rotate_s", some([None, 1.0], 1))
def test_slow_creation_of_files_costs_no_frame(
    board: MakeBoard, monkeypatch: pytest.MonkeyPatch, rotate_s: float | None
) -> None:
    """Creating a file in the sampling thread takes 0.2 s: it happens once, before the first frame."""
    made, real = board(A=0), LogWriter.keep

    def slow(self: LogWriter) -> None:
        if threading.current_thread() is threading.main_thread():
            made.bus.clock.sleep_until(made.bus.clock.now_ns() + 200 * MS)
        real(self)

    monkeypatch.setattr(LogWriter, "keep", slow)
    done = made.record(50, seconds=3, rotate_s=rotate_s)
    assert (done.late, done.missed, done.frames) == (0, 0, 150)
    assert len(done.logs) == (3 if rotate_s else 1)
    assert sorted(made.path.parent.iterdir()) == done.logs
    assert [len(made.rows("A", path)[0]) for path in done.logs] == ([50, 50, 50] if rotate_s else [150])


def test_a_log_that_is_cut_short_contains_its_phase(board: MakeBoard) -> None:
    made, seen = board(A=0), list[Any]()

    def look(frames: int) -> None:
        with made.log() as log:
            truth_ns = int(log.truth.time[-1]) if log.truth else 0
            seen.append((log.state, log.phases, truth_ns))

    made.record(seconds=3, batch_s=1.0, phase="room", up="-Y", progress=look)
    state, phases, last_ns = seen[-2]
    assert state == "being written"
    assert phases == (() if last_ns == 0 else (Phase(0, last_ns + 1, "room", "-Y"),))
    assert last_ns > 1_000_000_000


def test_the_service_manager_is_notified_of_stored_rows(board: MakeBoard) -> None:
    class Manager(Service):
        def __init__(self) -> None:
            super().__init__({})
            self.heard: list[Any] = []

        def stored(self, rows: int) -> None:
            self.heard.append(rows)

        def stopping(self, status: str = "") -> None:
            self.heard.append("stopping")

    made, manager = board(A=0), Manager()  # rows are stored by a thread, which is given the time for it
    made.record(seconds=5, service=manager, progress=lambda _: sleep(0.03))
    *rows, last = manager.heard
    assert last == "stopping"
    assert rows == sorted(rows)
    assert 0 < rows[-1] <= 500
