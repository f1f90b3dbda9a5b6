"""Lasting faults of sensors are reported and handled in the place of the sensor in the frame; the others lose no
reading.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.acquire import record
from imuarray.acquire.fault_episode import FaultEpisode
from imuarray.array import parse_array
from imuarray.bus import open_bus
from imuarray.cli import main
from imuarray.errors import SensorError
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, RECONFIGURED, SUSPECT
from imuarray.log.health import StartVerdict
from tests.selection import some

SECOND = 1_000_000_000
MS = 1_000_000


@pytest.fixture
def faulty_recording(an_array: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    """``faulty_recording(toml, seconds, A=0, B=1)``: the counts of `record`, and the log."""

    def make(toml: str, seconds: float, *, rate_hz: float = 50.0, judge: Any = None, **channels: int | None) -> Any:
        array = an_array(**channels)
        (tmp_path / "night.toml").write_text(toml)
        path = tmp_path / "r.h5"
        with open_bus(f"emulated:?faults={tmp_path / 'night.toml'}", array) as bus:
            done = record(array, bus, path, rate_hz=rate_hz, seconds=seconds, judge=judge, force=True)
        return done, open_log(path)

    return make


def events_of(log: Any) -> list[tuple[str, str]]:
    return [(event.sensor, event.kind) for event in log.events]


@pytest.mark.slow
def test_an_unplugged_sensor_is_polled_at_increasing_intervals(board: Callable[..., Any]) -> None:
    made = board("", lambda call: call.address == 0x40 and call.at_ns > 5 * SECOND, A=0, B=0)
    done = made.record(50, seconds=60)
    times = np.array([call.at_ns for call in made.bus.failed])
    gaps = np.diff(times) / SECOND
    gaps = gaps[gaps > 0.05]  # at first it is read in every frame, and once more
    np.testing.assert_allclose(gaps[:6], [0.1, 0.2, 0.4, 0.8, 1.6, 3.2], atol=0.05)
    np.testing.assert_allclose(gaps[6:], 3.2, atol=0.05)
    with made.log() as log:
        assert len(log["A"]) == done.frames
        assert events_of(log) == [("B", "lost"), ("B", "lost")]
        assert log.events[1].message.startswith(f"in all {done.lost['B']} readings lost in ")


@pytest.mark.slow
def test_a_sensor_that_was_only_silent_is_not_set_up_again(faulty_recording: Callable[..., Any]) -> None:
    table = '[[fault]]\nkind="no_acknowledge"\nsensor="B"\nat_s=3.0\nfor_s=0.8\n'
    done, log = faulty_recording(table, 6, A=0, B=0)
    with log:
        status = np.asarray(log["B"].status)
        assert events_of(log) == [("B", "lost"), ("B", "lost"), ("B", "back")]
        assert not (status & (RECONFIGURED | SUSPECT)).any()
        assert np.count_nonzero(status & LOST_BEFORE) == 1
        assert len(status) + done.lost["B"] == done.frames


@pytest.mark.slow
@pytest.mark.parametrize("for_s", some([0.08, 0.2, 0.7, 3.0, 20.0], 1))
def test_lost_readings_of_a_barometer_are_counted_at_its_own_rate(
    faulty_recording: Callable[..., Any], for_s: float
) -> None:
    """Eight readings a second, asked for fifty times: rows and lost readings together are what its rate would give."""
    table = f'[[fault]]\nkind="no_acknowledge"\nsensor="P"\nat_s=3.0\nfor_s={for_s}\n'
    done, log = faulty_recording(table, 30, P=0, A=1)
    with log:
        time, status = np.asarray(log["P"].time), np.asarray(log["P"].status)
        gaps = np.rint(np.diff(time) * 8 / SECOND).astype(int)
        assert done.lost["P"] == (gaps - 1).sum()
        assert abs(done.lost["P"] - 8 * for_s) <= 26  # it is looked for every 3.2 s at the latest
        np.testing.assert_array_equal(np.flatnonzero(status & LOST_BEFORE), np.flatnonzero(gaps > 1) + 1)
        messages = [event.message for event in log.events if event.kind == "lost"]
        assert messages[0].startswith("no reading")
        if for_s > 2:
            (count,) = [int(message.split()[2]) for message in messages[1:]]
            assert count == pytest.approx(done.lost["P"], abs=2)  # its way back takes one or two more


@pytest.mark.slow
def test_a_queue_restarts_after_a_reset(faulty_recording: Callable[..., Any], tmp_path: Path) -> None:
    array = parse_array(
        '[array]\nname="a"\n[[sensor]]\nname="Q"\nchip="l3g4200d"\naddress=0x68\nrange=250\nrate_hz=800\n'
        "bandwidth_hz=110\nfifo=true\n"
    )
    (tmp_path / "n.toml").write_text('[[fault]]\nkind="reset"\nsensor="Q"\nat_s=3.0\n')
    with open_bus(f"emulated:?faults={tmp_path / 'n.toml'}", array) as bus:
        record(array, bus, tmp_path / "q.h5", rate_hz=40, seconds=8)
    with open_log(tmp_path / "q.h5") as log:
        time, status = np.asarray(log["Q"].time), np.asarray(log["Q"].status)
        (again,) = np.flatnonzero(status & RECONFIGURED)
        assert time[again] < 5 * SECOND
        assert not (status[again:] & SUSPECT).any()
        assert np.median(np.diff(time[again:])) == pytest.approx(1.25 * MS, rel=0.02)


@pytest.mark.slow
def test_a_permanently_frozen_sensor_is_set_up_at_increasing_intervals(faulty_recording: Callable[..., Any]) -> None:
    table = '[[fault]]\nkind="frozen"\nsensor="B"\nat_s=3.0\nfor_s=1000\n'
    _, log = faulty_recording(table, 63, A=0, B=0)
    with log:
        time, status = np.asarray(log["B"].time), np.asarray(log["B"].status)
        first = np.searchsorted(time, 3 * SECOND)
        assert (status[first + 1 :] & SUSPECT).all()
        again = np.flatnonzero(status & RECONFIGURED)
        assert 3 <= len(again) <= 6
        assert (np.diff(time[again][1:]) > 1.5 * np.diff(time[again][:-1])).all()
        assert not np.asarray(log["A"].status).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames", "messages"),
    some(
        [
            (198, ["the same reading until the end"]),
            (201, ["the same reading for 1.10 s", "still present when the log ended, after 0.0 s"]),
        ],
        1,
    ),
)
def test_a_reading_that_is_frozen_at_the_end_is_reported_once(
    faulty_recording: Callable[..., Any], frames: int, messages: list[str]
) -> None:
    """A constant reading for a second, 50 rows, is frozen; this is checked every ten frames. Of the first log
    54 rows stand still, of which the last check saw 46; of the second the last check saw 56, and the sensor is set up.
    """
    done, log = faulty_recording('[[fault]]\nkind="frozen"\nsensor="B"\nat_s=3.0\nfor_s=1000\n', frames / 50, A=0, B=0)
    with log:
        assert done.frames == frames
        assert [(event.sensor, event.message) for event in log.events] == [("B", message) for message in messages]
        status = np.asarray(log["B"].status)
        np.testing.assert_array_equal(np.flatnonzero(status & SUSPECT), np.arange(144, min(frames, 200)))
        assert not np.asarray(log["A"].status).any()


@pytest.mark.slow
def test_rows_without_a_later_check_are_suspect_at_the_end(board: Callable[..., Any]) -> None:
    """From 4 s on no configuration register can be read back, though readings arrive."""
    made = board("", lambda call: call.read == 1 and call.at_ns > 4 * SECOND, B=0)
    made.record(50, seconds=30)
    with made.log() as log:
        time, status = np.asarray(log["B"].time), np.asarray(log["B"].status)
        assert len(time) == 1500
        assert (status[time > 4 * SECOND] & SUSPECT).all()
        assert not (status[time < 2 * SECOND] & SUSPECT).any()


@pytest.mark.slow
def test_sensors_on_a_separate_bus_are_read_while_another_bus_hangs(tmp_path: Path) -> None:
    array = parse_array(
        '[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=4\nrate_hz=800\n'
        '[[sensor]]\nname="B"\nchip="bma180"\naddress=0x40\nrange=2\nbus="/dev/i2c-11"\n'
    )

    class Hanging:
        def __init__(self, bus: Any) -> None:
            self.bus, self.clock, self.source = bus, bus.clock, bus.source

        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            if 3 * SECOND < self.clock.now_ns() < 6 * SECOND:
                self.clock.sleep_until(self.clock.now_ns() + 30 * MS)
                raise TimeoutError(110, "Connection timed out")
            answer: bytes = self.bus.transfer(address, write, read)
            return answer

        def __getattr__(self, name: str) -> Any:
            return getattr(self.bus, name)

    with open_bus("emulated:", array) as bus:
        done = record(array, Hanging(bus), tmp_path / "r.h5", rate_hz=20, seconds=8)  # type: ignore[arg-type]
    with open_log(tmp_path / "r.h5") as log:
        assert done.lost["B"] == done.missed == 0
        assert len(log["B"]) == done.frames == 160
        assert 60 <= done.lost["A"] <= 70
        assert not np.asarray(log["B"].status).any()


def test_an_address_of_a_kernel_driver_is_refused_at_the_start(faulty_recording: Callable[..., Any]) -> None:
    with pytest.raises(SensorError, match=r"^B \(bma180\): channel 1 address 0x40 belongs to a driver of the kernel"):
        faulty_recording('[[fault]]\nkind="kernel_driver"\nsensor="B"\nfor_s=1\n', 1, A=0, B=1)


@pytest.mark.slow
def test_missed_frames_are_lost_readings_of_polled_sensors(faulty_recording: Callable[..., Any]) -> None:
    done, log = faulty_recording('[[fault]]\nkind="stall"\nat_s=3.0\nfor_s=0.1\n', 4, A=0, B=1)
    with log:
        assert (done.late, done.missed, done.frames) == (1, 4, 196) or (done.missed, done.frames) == (5, 195)
        assert events_of(log) == [("", "late")]
        for name in "AB":
            time, status = np.asarray(log[name].time), np.asarray(log[name].status)
            (after,) = np.flatnonzero(status & LOST_BEFORE)
            assert time[after] - time[after - 2] > 100 * MS  # the reading in the midst of it has an uncertain time


@pytest.mark.slow
def test_a_sensor_that_repeatedly_starts_in_another_state_stays_suspect(faulty_recording: Callable[..., Any]) -> None:
    def judge(readings: Any) -> dict[str, StartVerdict]:
        return {"G": StartVerdict(bool(readings["G"].mean() > 1000), "too much")} if "G" in readings else {}

    table = '[[fault]]\nkind="start_up"\nsensor="G"\nbias=[90.0, 90.0, 90.0]\n'
    _, log = faulty_recording(table, 45, rate_hz=20, judge=judge, A=0, G=0)
    with log:
        assert (np.asarray(log["G"].status) & SUSPECT).all()
        assert [kind for sensor, kind in events_of(log)] == ["start_up", "reconfigured"] * 2 + ["start_up"]
        assert not np.asarray(log["A"].status).any()


def test_episodes_are_reported_at_their_begin_and_after_they_lasted() -> None:
    events = list[Any]()
    episode = FaultEpisode("lost", "readings lost", lambda *event: events.append(event))
    for at_ms in range(0, 500, 20):
        episode.happened(at_ms * MS, "gone")
    episode.settle(1000 * MS)
    assert events == [(0, "lost", "gone")]
    episode.happened(1400 * MS, "gone")  # less than a second later: the same episode
    episode.settle(2401 * MS)
    episode.settle(9000 * MS)
    assert events[1:] == [(1400 * MS, "lost", "in all 26 readings lost in 1.4 s")]
    episode.happened(9500 * MS, "gone")
    episode.close(9600 * MS)
    assert events[2:] == [(9500 * MS, "lost", "gone")]


def test_the_command_logs_an_array_with_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.toml").write_text(
        '[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=4\nrate_hz=800\n'
    )
    (tmp_path / "night.toml").write_text('[[fault]]\nkind="reset"\nsensor="A"\nat_s=2.0\n')
    run = str(tmp_path / "r.h5")
    url = f"emulated:?faults={tmp_path / 'night.toml'}"
    assert main(["log", str(tmp_path / "a.toml"), "--bus", url, "--seconds", "5", "-o", run, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["missed"] == report["uncertain"] == 0
    assert 1 <= report["lost"]["A"] <= 20
    assert main(["info", run, "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert [(event["sensor"], event["kind"]) for event in info["events"]] == [
        ("A", "configuration"),
        ("A", "reconfigured"),
    ]
    assert info["sensors"][0]["flags"]["reconfigured"] == 1
    assert (
        main(["log", str(tmp_path / "a.toml"), "--bus", "emulated:?faults=none.toml", "-o", str(tmp_path / "s.h5")])
        == 2
    )
    assert "faults=none.toml: No such file or directory" in capsys.readouterr().err
