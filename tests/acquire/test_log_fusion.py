"""`log --fuse`: the result equals that of fusing the log afterwards, and the log is unchanged by it."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.acquire import RecordingCounts
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import nominal
from imuarray.cli import main
from imuarray.commands.log_display import LogScreen
from imuarray.errors import FusionError
from imuarray.fuse import FusedBlock, FusionStream, read_fused, read_fused_events, read_fused_head
from imuarray.fuse.live_fusion import FusionOutput, LiveFusion, LiveFusionOptions
from imuarray.log import Block, open_log
from imuarray.log.format import SensorHeader
from tests.selection import some

SHAKEN = "emulated:?world=shaking&peak_g=3"
HEADERS = [SensorHeader(f"A{i}", "bma180", "specific_force", "g", 16.0, 512.0) for i in range(2)]
EPOCH = "2024-01-01T00:00:00Z"

Log = Callable[..., tuple[int, str, str]]


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Log:
    """``log(...)``: the emulated array into run.h5; exit code, standard output and error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str, bus: str = SHAKEN, seconds: str = "3") -> tuple[int, str, str]:
        usual = ["log", "martin2013", "--bus", bus, "-o", "run.h5", "--seconds", seconds, "--rate-hz", "100"]
        code = main([*usual, *arguments])
        return code, *capsys.readouterr()

    return call


def columns(path: str) -> dict[str, np.ndarray]:
    """All of a fused file."""
    with h5py.File(path) as file:
        return {name: column[:] for name, column in file["fused"].items()}


def attributes(column: h5py.Dataset) -> dict[str, list[object]]:
    """The attributes of a column without references to other columns of its file, which no other file has."""
    references = ("DIMENSION_LIST", "REFERENCE_LIST")
    return {key: list(value) for key, value in column.attrs.items() if key not in references}


def thermal_calibration(path: Path) -> None:
    """Slopes over the barometer for one accelerometer, behind a lag."""
    path.write_text(
        """
[calibration]
format_version = 1
[[sensor]]
name = "BMA1"
quantity = "specific_force"
unit = "g"
bias_lsb = [3.0, -4.0, 5.0]
bias_sem_lsb = [1.0, 1.0, 1.0]
response_lsb_per_unit = [[512.0, 0.0, 0.0], [0.0, 512.0, 0.0], [0.0, 0.0, 512.0]]
temperature_degc = 20.0
[sensor.thermal]
slope_lsb_per_degc = [20.0, -10.0, 5.0]
slope_sem_lsb_per_degc = [0.1, 0.1, 0.1]
reference_degc = 20.0
meaning = ["bias", "bias", "bias"]
thermometer = "barometer"
lag_s = 3.0
"""
    )


@pytest.mark.slow
@pytest.mark.parametrize(("technique", "warm"), some([("opposed", False), ("mean", True)], 1))
def test_live_fusion_equals_fusing_the_log(log: Log, tmp_path: Path, technique: str, warm: bool) -> None:
    more = ["--calibration", "cal.toml"] if warm else []
    if warm:
        thermal_calibration(tmp_path / "cal.toml")
    code, out, _ = log("--fuse", "--technique", technique, "--json", *more, seconds="12" if warm else "3")
    report = json.loads(out)["fusion"]
    assert (code, report["fused"], report["skipped"], report["failure"]) == (0, "run_fused.h5", 0, "")
    assert main(["fuse", "run.h5", "--causal", "--technique", technique, "-o", "again.h5", *more]) == 0
    live, after = columns("run_fused.h5"), columns("again.h5")
    assert live.keys() == after.keys()
    assert report["frames"] == len(live["time"]) == json.loads(out)["frames"]
    for name, column in live.items():
        if column.dtype.kind in "OS":  # names of axes and entries
            assert column.tolist() == after[name].tolist()
            continue
        largest = np.nanmax(np.abs(after[name])) if np.isfinite(after[name]).any() else 1.0
        np.testing.assert_allclose(column, after[name], rtol=0, atol=1e-9 * largest)
    with h5py.File("run_fused.h5") as first, h5py.File("again.h5") as second:
        assert dict(first.attrs) == dict(second.attrs)
        for name, column in second["fused"].items():
            assert attributes(first["fused"][name]) == attributes(column)
            assert [dim.keys() for dim in first["fused"][name].dims] == [dim.keys() for dim in column.dims]


FROZEN = """
[[fault]]
kind = "frozen"
sensor = "Gyro2"
at_s = 4
for_s = 1.5
"""


@pytest.mark.slow
def test_live_fusion_with_fault_detection_equals_fusing_the_log(log: Log, tmp_path: Path) -> None:
    """To 1e-9 of the largest value, events and estimates of slow errors included; one gyroscope freezes."""
    (tmp_path / "faults.toml").write_text(FROZEN)
    assert log(bus="emulated:", seconds="4")[0] == 0
    assert main(["calibrate", "noise", "run.h5", "-o", "cal.toml"]) == 0
    more = ["--technique", "optimal", "--calibration", "cal.toml", "--json"]
    code, out, err = log("--fuse", "--force", *more, bus="emulated:?faults=faults.toml", seconds="7")
    assert code == 0
    report = json.loads(out[out.index("{") :])["fusion"]
    assert main(["fuse", "run.h5", "--causal", *more, "-o", "again.h5"]) == 0
    live, after = columns("run_fused.h5"), columns("again.h5")
    assert live.keys() == after.keys()
    for name, column in live.items():
        if column.dtype.kind in "OS":  # names of axes and entries
            assert column.tolist() == after[name].tolist()
            continue
        largest = np.nanmax(np.abs(after[name]))
        np.testing.assert_allclose(column, after[name], rtol=0, atol=1e-9 * largest)
    events = read_fused_events("run_fused.h5")
    assert events == read_fused_events("again.h5")
    assert ("Gyro2", "silent") in {(event.sensor, event.state) for event in events}  # the recording flags it
    assert [event.message for event in events] == [fault["sentence"] for fault in report["faults"]]
    assert all(err.count(f"imuarray: {event.message}\n") == 1 for event in events)
    biases = report["learned"]["biases"]
    assert [each["axis"] for each in biases["angular_rate"][:4]] == ["Gyro1 x", "Gyro1 y", "Gyro1 z", "Gyro2 x"]
    assert all(0 < each["sd"] < each["sd_before"] for result in biases.values() for each in result)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "names"),
    some(
        [
            ([], ["run_001_fused.h5", "run_002_fused.h5", "run_003_fused.h5"]),
            (["--fused", "mine.h5"], ["mine_001.h5", "mine_002.h5", "mine_003.h5"]),
        ],
        1,
        0,
    ),
)
def test_each_part_of_a_log_has_a_fused_file(log: Log, more: list[str], names: list[str]) -> None:
    """The frames of a part's file are those of the part."""
    code, out, _ = log("--fuse", "--rotate", "1s", "--json", *more)
    assert code == 0
    assert json.loads(out)["fusion"]["files"] == names
    assert json.loads(out)["fusion"]["frames"] == 300
    for number, name in enumerate(names, start=1):
        part = f"run_{number:03d}.h5"
        assert read_fused_head(name).log == part
        time = np.concatenate([block.time for block in read_fused(name)])
        with open_log(part) as run:
            sensors = [np.asarray(sensor.time[:]) for sensor in run.sensors.values() if sensor.is_triad]
        assert len(time) == 100
        assert any(np.array_equal(time, rows) for rows in sensors)  # the grid is one sensor's times
    assert not Path("run_fused.h5").exists()


@pytest.mark.slow
def test_the_log_is_the_same_with_and_without_fusion(log: Log) -> None:
    with_it = log("--fuse", bus=f"{SHAKEN}&seed=3")
    with open_log("run.h5") as run:
        first = np.asarray(run["BMA1"].counts[:])
    without = log("--force", bus=f"{SHAKEN}&seed=3")
    with open_log("run.h5") as run:
        assert (np.asarray(run["BMA1"].counts[:]) == first).all()
    assert with_it[0] == without[0] == 0
    assert "run_fused.h5: 300 frames fused while recording" in with_it[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--technique", "mean"], "--technique needs --fuse"),
        (["--fused", "f.h5"], "--fused needs --fuse"),
        (["--no-watch"], "--watch needs --fuse"),
        (["--fuse", "--technique", "optimal"], "its noise is not known"),
        (["--fuse", "--rotate", "1s", "--fused", "part.h5"], "part_001.h5: exists already"),
        (["--fuse", "--technique", "best"], "technique 'best': allowed are mean"),
        (["--fuse", "--technique", "planes"], "its noise is not known"),
        (["--fuse", "--fused", "there.h5"], "there.h5: exists already"),
        (["--fuse", "--fused", "run.h5"], "run.h5"),
    ],
)
def test_a_log_that_cannot_be_fused_is_refused_before_it_is_created(log: Log, arguments: list[str], words: str) -> None:
    Path("there.h5").write_text("mine")
    Path("part_001.h5").write_text("mine")
    code, _, err = log(*arguments)
    assert code == 2
    assert words in err
    assert not Path("run.h5").exists()
    assert Path("there.h5").read_text() == "mine"


@pytest.mark.slow
def test_a_failure_of_fusion_is_reported_once_and_recording_continues(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    pushes = 0
    push = FusionStream.push

    def breaking(self: FusionStream, sensor: str, block: Block) -> Iterator[FusedBlock]:
        nonlocal pushes
        pushes += 1
        if pushes > 20:
            raise ArithmeticError("one too many")
        return push(self, sensor, block)

    monkeypatch.setattr(FusionStream, "push", breaking)
    code, out, err = log("--fuse", "--json", seconds="5")
    assert code == 0
    assert json.loads(out)["frames"] == 500
    assert json.loads(out)["fusion"]["failure"] == "ArithmeticError: one too many"
    assert err.count("fusion stops, recording continues: ArithmeticError: one too many") == 1
    with open_log("run.h5") as run:
        assert len(run["BMA1"]) == 500


def rows(start: int, count: int = 100) -> Block:
    time_ns = (np.arange(start, start + count) * 10_000_000).astype(np.int64)
    return Block(time_ns, np.tile(np.array([0, 0, 512], np.int16), (count, 1)), np.zeros(count, np.uint16))


def test_rows_that_overfill_the_queue_are_skipped_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread stops at the first of twenty blocks, the queue has room for seven: six seconds are lost."""
    messages: list[str] = []
    standing, going = threading.Event(), threading.Event()
    push = FusionStream.push

    def waiting(self: FusionStream, sensor: str, block: Block) -> Iterator[FusedBlock]:
        standing.set()
        going.wait(60)
        return push(self, sensor, block)

    monkeypatch.setattr(FusionStream, "push", waiting)
    output = FusionOutput(tmp_path / "f.h5", tmp_path / "r.h5")
    fusion = LiveFusion(output, Calibration(), LiveFusionOptions(100, queue_blocks=7), messages.append)
    fusion.begin(EPOCH, HEADERS)
    batches = [(header.name, rows(100 * second)) for second in range(10) for header in HEADERS]
    fusion.observe(*batches[0])
    assert standing.wait(60)
    for sensor, block in batches[1:]:
        fusion.observe(sensor, block)
    going.set()
    deadline = time.monotonic() + 60
    while fusion._queue.qsize() and time.monotonic() < deadline:
        time.sleep(0.01)
    for header in HEADERS:
        fusion.observe(header.name, rows(1000))
    fusion.close()
    assert fusion.skipped == 600
    assert messages[0] == "fusion can't keep up: its file lacks frames; the log contains them"
    assert messages[-1] == f"{tmp_path / 'f.h5'}: {fusion.skipped} frames skipped: fusion could not keep up"
    time_ns = np.concatenate([block.time for block in read_fused(tmp_path / "f.h5")])
    assert len(time_ns) == fusion.frames == 1100 - fusion.skipped
    assert time_ns[-1] == 10_990_000_000


def noisy(start: int, rng: np.random.Generator, count: int = 100, *, stuck: bool = False, mean: int = 512) -> Block:
    counts = np.array([0, 0, mean]) + (0 if stuck else 1) * np.rint(rng.normal(0, 5, (count, 3)))
    return rows(start, count)._replace(counts=counts.astype(np.int16))


def test_a_failed_sensor_is_reported_once_and_is_an_event_of_the_file(tmp_path: Path) -> None:
    """One of four is stuck from 3 s on: left out in the window in which it is found, for as long as it lasts."""
    messages: list[str] = []
    headers = [SensorHeader(f"A{i}", "bma180", "specific_force", "g", 16.0, 512.0) for i in range(4)]
    paths = tmp_path / "f.h5", tmp_path / "r.h5"
    fusion = LiveFusion(FusionOutput(*paths), Calibration(), LiveFusionOptions(100, watch=True), messages.append)
    fusion.begin(EPOCH, headers)
    rng = np.random.default_rng(1)
    for second in range(6):
        for header in headers:
            fusion.observe(header.name, noisy(100 * second, rng, stuck=header.name == "A2" and second >= 3))
    fusion.close()
    (sentence,) = messages
    assert sentence.endswith("A2 is stuck (10 sigma): excluded")
    assert [fault["sentence"] for fault in fusion.report()["faults"]] == messages  # type: ignore[attr-defined]
    (event,) = read_fused_events(paths[0])
    assert (event.sensor, event.kind, event.state, event.message) == ("A2", "stuck", "isolated", sentence)
    assert 3.0 <= event.time_ns * 1e-9 <= 3.2
    used = np.concatenate([block.used["specific_force"] for block in read_fused(paths[0])])
    assert (used[:, [0, 1, 3]] == 7).all()
    assert not used[320:, 2].any()


def test_biases_are_of_the_states_determined_before_the_first_rows(tmp_path: Path) -> None:
    """Rows of a barometer arrive before that is known."""
    asked: list[bool] = []
    pressure = SensorHeader("P", "bmp180", "pressure", "Pa", 0.0, 0.0)

    def start_up_states() -> Calibration:
        asked.append(True)
        known = {header.name: replace(nominal(header), bias_lsb=np.array([0.0, 0.0, 256.0])) for header in HEADERS}
        return Calibration(known)

    paths = tmp_path / "f.h5", tmp_path / "r.h5"
    fusion = LiveFusion(FusionOutput(*paths), Calibration(), LiveFusionOptions(100, start_calibration=start_up_states))
    fusion.begin(EPOCH, [*HEADERS, pressure])
    fusion.observe("P", rows(0))
    time.sleep(0.3)
    assert not asked
    for header in HEADERS:
        fusion.observe(header.name, rows(0))
    fusion.close()
    triads = np.concatenate([block.triads["specific_force"] for block in read_fused(paths[0])])
    np.testing.assert_allclose(triads, np.tile([0, 0, 256 / 512 * 9.80665], (100, 1)), rtol=1e-12)
    assert asked == [True]


@pytest.mark.slow
def test_the_fused_file_can_be_read_while_it_is_written(tmp_path: Path) -> None:
    fusion = LiveFusion(FusionOutput(tmp_path / "f.h5", tmp_path / "r.h5"), Calibration(), LiveFusionOptions(100))
    fusion.begin(EPOCH, HEADERS)
    for second in range(5):
        for header in HEADERS:
            fusion.observe(header.name, rows(100 * second))
    deadline = time.monotonic() + 60
    while not fusion.frames and time.monotonic() < deadline:
        time.sleep(0.01)
    program = f"import h5py; print(len(h5py.File({str(tmp_path / 'f.h5')!r}, 'r', swmr=True)['fused/time']))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert fusion.status() == "0.0 0.0 1000.0 mg"
    fusion.close()
    assert int(done.stdout) >= 100
    assert fusion.frames == 500
    assert sys.getswitchinterval() == pytest.approx(0.005)


def test_a_terminal_shows_the_fused_value(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    screen = LogScreen("r.h5", 50, None, lambda: "0.0 0.0 1000.0 mg")
    screen.counted(RecordingCounts(frames=50))
    screen.remark("G2: silent, fused without it")
    line = "r.h5: 50 frames, 1 s, 0 readings lost; 0.0 0.0 1000.0 mg"
    assert terminal.getvalue().split("\r\x1b[K")[1:] == [line, f"imuarray: G2: silent, fused without it\n{line}"]


def test_a_log_without_rows_leaves_no_fused_file(tmp_path: Path) -> None:
    fusion = LiveFusion(FusionOutput(tmp_path / "f.h5", tmp_path / "r.h5"), Calibration(), LiveFusionOptions(100))
    fusion.begin(EPOCH, HEADERS)
    fusion.close()
    assert list(tmp_path.iterdir()) == []


def test_an_array_without_an_inertial_sensor_is_refused(tmp_path: Path) -> None:
    fusion = LiveFusion(FusionOutput(tmp_path / "f.h5", tmp_path / "r.h5"), Calibration(), LiveFusionOptions(100))
    magnetometer = SensorHeader("M", "hmc5883", "magnetic_field", "gauss", 1.3, 1090.0)
    with pytest.raises(FusionError, match="the array: no inertial sensor"):
        fusion.begin(EPOCH, [magnetometer])
    fusion.close()


@pytest.mark.slow
def test_an_interrupt_ends_the_log_and_its_fusion_cleanly(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "imuarray", "log", "martin2013", "--bus", "emulated:?clock=real", "-o", "run.h5"]
    with subprocess.Popen(
        [*command, "--fuse", "--json", "--rate-hz", "50"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        deadline = time.monotonic() + 120
        while not (tmp_path / "run.h5").exists() and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.02)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    report = json.loads(out)
    assert report["fusion"]["failure"] == ""
    time_ns = np.concatenate([block.time for block in read_fused(tmp_path / "run_fused.h5")])
    with open_log(tmp_path / "run.h5") as run:
        assert run.state == "finished"
        newest_ns = min(int(sensor.time[-1]) for sensor in run.of("specific_force"))
    assert newest_ns - time_ns[-1] < 3 * 20_000_000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.h5", "run_fused.h5"]
