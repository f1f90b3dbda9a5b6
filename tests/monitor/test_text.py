"""The text form and the JSON form, and the command that shows them."""

from __future__ import annotations

import dataclasses
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
from pathlib import Path

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.log import LogWriter
from imuarray.log.format import Event
from imuarray.monitor import LogMonitor, payload
from imuarray.monitor.payload import DRAWN, described, drawn
from imuarray.monitor.snapshot import RepeatedEvent
from imuarray.monitor.text import duration, text_lines
from tests.monitor.conftest import EPOCH, HEADERS, Logger

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished log: 12 s, five frames missing, two events, one of them hostile."""
    path = tmp_path_factory.mktemp("ended") / "run.h5"
    with LogWriter(path, HEADERS, source="emulated", epoch=EPOCH, frame_rate_hz=100.0) as writer:
        writer.keep()
        logger = Logger(writer)
        logger.go_on(4.0)
        logger.now_s += 0.05
        logger.go_on(8.0)
        writer.event(Event(4_000_000_000, "", "late", "5 frames missed: the one before ended too late"))
        writer.event(Event(5_000_000_000, "Acc", "back", "answers \x1b[31magain <script>alert(1)</script>"))
    return path


def words(line: str) -> str:
    return " ".join(line.split())


def test_the_table_shows_sensors_and_events(ended: Path) -> None:
    with LogMonitor(ended) as watch:
        lines = text_lines(watch.refresh(0.0))
    assert lines[0] == "run.h5: finished, 12 s"
    assert lines[1] == "  health amber: 5 frames missed: lower the frame rate, or record fewer sensors"
    assert lines[2] == "  99.5 of 100 Hz, 5 frames missed, 0 delayed"
    assert lines[3].startswith("  disk: ")
    assert lines[4] == "  2 events: late 1, back 1"
    del lines[1]
    assert words(lines[5]) == "sensor Hz mean of the last second unit sd range degC missed"
    assert words(lines[6]) == "Acc 99.5 0.250 -0.500 1.000 g 0.0005 25 % 28.0 5"
    assert words(lines[8]) == "Gyro 99.5 10.000 -5.000 2.500 dps 0.0100 4 % -20.0* 5"
    assert words(lines[7]) == "Baro 4.0 1002.500 hPa 0.0000 21.5 0"
    assert lines[10] == "  * only changes are meaningful; the level is unknown"
    assert lines[12] == "  fused (mean, data sheet's values), box frame, last second"
    assert words(lines[13]).startswith("force x ")
    assert words(lines[14]).startswith("rate x 10.000 y -5.000 z 2.500")
    assert lines[-1] == "        4.0 s  late: 5 frames missed: the one before ended too late"
    assert lines[-2] == "        5.0 s  Acc back: answers \\x1b[31magain <script>alert(1)</script>"


def test_the_table_fits_into_80_columns(ended: Path) -> None:
    with LogMonitor(ended) as watch:
        snapshot = watch.refresh(0.0)
    flags = dict.fromkeys(("stale", "overrun", "saturated", "lost_before", "reconfigured", "suspect"), 1000)
    negative = {"mean": np.full(3, -1999.9), "sd": np.full(3, 100.0), "use": np.ones(3), "temperature_degc": -40.0}
    views = [
        dataclasses.replace(view, flags=flags, name=f"{view.name}_of_the_box", relative=True, missed=99999, **negative)
        for view in snapshot.sensors
    ]
    long = Event(360_000_000_000_000, "Acc", "lost", "no reading: " + "why " * 40)
    full = dataclasses.replace(
        snapshot,
        sensors=tuple(views),
        repeated=(RepeatedEvent(long, 3, 0),),
        events={f"kind_{k}": 10_000 for k in range(9)},
        remark="r " * 90,
    )
    lines = text_lines(full)
    assert max(map(len, lines)) <= 80
    assert max(map(len, text_lines(full, 100))) > 80
    assert sum("stale 1000" in line for line in lines) > 0
    assert "…" in lines[-1]


@pytest.mark.parametrize(("seconds", "words"), [(75, "75 s"), (600, "10 min"), (9000, "2.5 h"), (864000, "10 d")])
def test_durations_are_written_with_units(seconds: float, words: str) -> None:
    assert duration(seconds) == words


def test_json_contains_the_same_figures(ended: Path) -> None:
    with LogMonitor(ended) as watch:
        table = described(watch.refresh(0.0))
    json.dumps(table, allow_nan=False)
    assert (table["state"], table["missed"], table["delayed"], table["counted"]) == ("finished", 5, 0, 1.0)
    assert (table["begins_s"], table["ends_s"]) == (0.0, 12.04)
    acc = table["sensors"][0]
    assert (acc["name"], acc["rows"], acc["mean"], acc["temperature_degc"]) == ("Acc", 1200, [0.25, -0.5, 1.0], 28.0)
    assert acc["peak_use_percent"] == pytest.approx([6.262, 12.512, 25.012], abs=1e-3)
    force = table["fused"]["quantities"]["specific_force"]
    assert force["unit"] == "mg"
    assert force["mean"] == pytest.approx([250, -500, 1000], abs=0.5)


def test_curves_keep_the_extremes_of_every_piece(ended: Path) -> None:
    with LogMonitor(ended) as watch:
        snapshot = watch.refresh(0.0)
    view = snapshot.sensors[0]
    spiked = view.values.copy()
    spiked[517, 1] = 3.5
    table = drawn(dataclasses.replace(snapshot, sensors=(dataclasses.replace(view, values=spiked),)))
    trace = table["sensors"][0]["trace"]
    assert len(trace["t"]) == len(trace["x"]) <= 2 * DRAWN
    assert trace["t"] == sorted(trace["t"])
    assert -10.1 < trace["t"][0] < -9.8 and trace["t"][-1] <= 0
    assert max(trace["y"]) == 3.5
    at_s = trace["t"][trace["y"].index(3.5)]
    assert at_s == pytest.approx((view.time[517] - view.time[-1]) * 1e-9, abs=0.1)
    density = table["sensors"][0]["density"]
    assert density["f"][0] > 0 and density["f"][-1] == pytest.approx(50, abs=0.01)
    assert table["sensors"][0]["density_unit"] == "mg"
    # the spectrum was of the log: a count (1000/2048 mg) up and down, in a bin of half a Hann window's width
    assert max(density["x"]) == density["x"][-1]


def test_monitor_prints_text_once(ended: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", str(ended), "--text", "--once"]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert out.startswith("run.h5: finished, 12 s\n")


@pytest.fixture(scope="module")
def died(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished log of 53 s, in which one sensor gave nothing after 4 s."""
    path = tmp_path_factory.mktemp("died") / "up.h5"
    with LogWriter(path, HEADERS, source="emulated", epoch=EPOCH, frame_rate_hz=100.0) as writer:
        logger = Logger(writer)
        logger.go_on(4.0)
        logger.go_on(49.0, without=("Turned",))
    return path


def test_a_dead_sensor_is_silent_in_the_table(died: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", str(died), "--text", "--once"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (line,) = (line for line in lines if line.startswith("  Turned"))
    assert words(line) == "Turned 0.0 silent 49 s g 4900"
    assert lines[1] == "  health red: Turned silent for 49 s: check cable, power and address"
    assert lines[2] == "  100.0 of 100 Hz, 0 frames missed, 0 delayed"


def test_a_dead_sensor_is_silent_in_json(died: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", str(died), "--json", "--once"]) == 0
    output = {view["name"]: view for view in json.loads(capsys.readouterr().out)["sensors"]}
    acc, turned = output["Acc"], output["Turned"]
    assert (acc["silent_s"], acc["missed"]) == (None, 0)
    assert (turned["silent_s"], turned["rate_hz"], turned["missed"], turned["flags"]) == (49.0, 0.0, 4900, {})
    assert (turned["mean"], turned["sd"], turned["use_percent"]) == ([None] * 3, [None] * 3, None)


def test_frames_without_a_value_are_gaps_of_a_curve_and_not_zeros(ended: Path) -> None:
    """The fused rate ends before the fused force if a gyroscope's rows are held back longer."""
    with LogMonitor(ended) as watch:
        snapshot = watch.refresh(0.0)
    rows = 500
    values = np.full((rows, 3), 3.5)
    values[-20:] = np.nan
    values[100::4, 0] = np.nan  # gaps inside of pieces keep the extremes of the others
    view = dataclasses.replace(snapshot.sensors[0], time=np.arange(rows) * 10_000_000, values=values)
    trace = drawn(dataclasses.replace(snapshot, sensors=(view,)))["sensors"][0]["trace"]
    for name in view.columns:
        assert trace[name][-8:] == [None] * 8
        assert set(trace[name][:-10]) == {3.5}


def test_curves_of_a_dead_sensor_are_empty(died: Path) -> None:
    with LogMonitor(died) as watch:
        (turned,) = (view for view in drawn(watch.refresh(0.0))["sensors"] if view["name"] == "Turned")
    assert turned["trace"] == {"t": [], "x": [], "y": [], "z": []}
    assert turned["density"] is None


def test_monitor_ends_with_the_log(ended: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", str(ended), "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["state"] == "finished"


def test_json_has_the_documented_keys(ended: Path) -> None:
    """Those of the module's docstring, and no other."""
    with LogMonitor(ended) as watch:
        table = described(watch.refresh(0.0))
    promised = set(re.findall(r"`(\w+)`", payload.__doc__ or ""))
    keys = set(table) | set(table["disk"]) | set(table["sensors"][0]) | set(table["recent"][0]) | set(table["fused"])
    keys |= set(table["repeated"][0]) | set(table["health"])
    keys |= set(table["fused"]["quantities"]["angular_rate"])
    assert keys == promised


def test_repeated_events_are_one_line_with_a_count(log_path: Path) -> None:
    """Alike but for numbers; the end of a fault is a separate line, and no fault."""
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
        Logger(writer).go_on(10.0)
        for second in range(1, 6):
            writer.event(Event(second * 10**9, "Acc", "lost", f"no reading at {second}.5 s"))
            writer.event(Event(second * 10**9 + 1, "", "bus", f"works again, after {second}.0 s"))
    with LogMonitor(log_path) as watch:
        snapshot = watch.refresh(0.0)
    assert text_lines(snapshot)[-2:] == [
        "        5.0 s  5 times since 1.0 s, bus: works again, after 5.0 s",
        "        5.0 s  5 times since 1.0 s, Acc lost: no reading at 5.5 s",
    ]
    assert snapshot.problems == 5
    table = described(snapshot)
    assert [(entry["kind"], entry["count"], entry["first_s"], entry["trouble"]) for entry in table["repeated"]] == [
        ("bus", 5, 1.0, False),
        ("lost", 5, 1.0, True),
    ]
    assert table["health"] == {
        "level": "amber",
        "reason": "5 faults of Acc reported (readings lost)",
        "advice": "read the events, which say why",
    }


@pytest.mark.slow
def test_a_barometer_that_is_read_four_times_a_second_is_not_silent(log_path: Path) -> None:
    """For any age of its newest row within its period, from the first second on."""
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        logger = Logger(writer)
        with LogMonitor(log_path) as watch:
            for _ in range(12):
                logger.go_on(0.25)
                health = watch.refresh(0.0).health
                assert health is not None
                assert (health.level, health.reason.split(",")[0]) == ("green", "all 4 sensors deliver")


def heed_interrupts() -> None:
    """Ctrl-C is ignored by programs that start where the tests run in the background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_a_terminal_is_redrawn_in_place(log_path: Path, logger: Logger) -> None:
    """Nothing is cleared before it is overwritten, a new size applies at once, Ctrl-C is the usual end."""
    logger.go_on(3.0)
    screen, end = pty.openpty()
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 80, 0, 0))
    program = [sys.executable, "-m", "imuarray", "monitor", str(log_path), "--text", "--every", "60"]
    size = {"COLUMNS", "LINES"}  # would take precedence over the terminal
    environment = {name: value for name, value in os.environ.items() if name not in size}
    process = subprocess.Popen(
        program, cwd=ROOT, stdin=end, stdout=end, stderr=end, env=environment, preexec_fn=heed_interrupts
    )

    def look() -> str:
        """One drawing of the screen."""
        drawn = b""
        while not drawn.endswith(b"\x1b[J"):
            drawn += os.read(screen, 1 << 16)
        return drawn.decode()

    try:
        first = look()
        fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("HHHH", 10, 40, 0, 0))
        process.send_signal(signal.SIGWINCH)
        second = look()  # the next refresh would be in a minute
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert select.select([screen], [], [], 0)[0] == []  # and nothing is printed
    finally:
        process.kill()
        process.wait(60)
        os.close(screen)
        os.close(end)
    for shown, rows, columns in ((first, 40, 80), (second, 10, 40)):
        assert shown.startswith("\x1b[H") and "\x1b[2J" not in shown
        lines = shown.removeprefix("\x1b[H").removesuffix("\x1b[J").replace("\x1b[K", "").split("\r\n")
        assert len(lines) <= rows and 30 < max(map(len, lines)) < columns
        assert "\x1b" not in "".join(lines)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere.h5", "--text", "--once"], "nowhere.h5: no such file"),
        (["run.h5", "--once"], "--once needs --text or --json"),
        (["run.h5", "--text", "--calibration", "none.toml"], "none.toml: No such file"),
        (["run.h5", "--host", "192.0.2.1", "--port", "1"], "192.0.2.1:1: can't serve the page there"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_without_the_extra_text_works_and_the_page_names_the_package(
    ended: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import sys

    extra = [name for name in sys.modules if name.split(".")[0] in ("bokeh", "tornado")]
    for name in [*extra, *({"imuarray.monitor.server"} & set(sys.modules))]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("bokeh", "tornado"):
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["monitor", str(ended), "--text", "--once"]) == 0
    assert main(["monitor", str(ended)]) == 2
    assert "pip install 'imuarray[monitor]'" in capsys.readouterr().err
