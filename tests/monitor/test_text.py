"""The text form and the JSON form, and the command that shows them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from imuarray.cli import main
from imuarray.log import LogWriter
from imuarray.log.format import Event
from imuarray.monitor import Watch
from imuarray.monitor.payload import DRAWN, described, drawn
from imuarray.monitor.text import duration, lines_of
from tests.monitor.conftest import EPOCH, HEADERS, Logger


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished log: 12 s, five frames missing, two events, one of them made to do harm."""
    path = tmp_path_factory.mktemp("ended") / "run.h5"
    with LogWriter(path, HEADERS, source="emulated", epoch=EPOCH) as writer:
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


def test_the_table(ended: Path) -> None:
    with Watch(ended) as watch:
        lines = lines_of(watch.refresh(0.0))
    assert lines[0] == "run.h5: finished, 12 s"
    assert lines[1].startswith("  99.5 Hz, 0 frames late, 5 missed; disk: ")
    assert lines[2] == "  2 events: late 1, back 1"
    assert words(lines[4]) == "sensor Hz mean of the last second unit sd range degC missed flags"
    assert words(lines[5]) == "Acc 99.5 0.250 -0.500 1.000 g 0.0005 25% 28.0 5"
    assert words(lines[7]) == "Gyro 99.5 10.000 -5.000 2.500 dps 0.0100 4% -20.0* 5"
    assert words(lines[6]) == "Baro 4.0 1002.500 hPa 0.0000 21.5 0"
    assert lines[10] == "  fused (mean, data sheet's values), box frame, last second"
    assert words(lines[11]).startswith("specific force x ")
    assert words(lines[12]).startswith("angular rate x 10.000 y -5.000 z 2.500")
    assert lines[-1] == "          4.0 s  late: 5 frames missed: the one before ended too late"
    assert lines[-2] == "          5.0 s  Acc back: answers \\x1b[31magain <script>alert(1)</script>"


@pytest.mark.parametrize(("seconds", "words"), [(75, "75 s"), (600, "10 min"), (9000, "2.5 h"), (864000, "10 d")])
def test_durations(seconds: float, words: str) -> None:
    assert duration(seconds) == words


def test_json_says_the_same_in_numbers(ended: Path) -> None:
    with Watch(ended) as watch:
        found = described(watch.refresh(0.0))
    json.dumps(found, allow_nan=False)
    assert (found["state"], found["missed"], found["late"], found["counted"]) == ("finished", 5, 0, 1.0)
    assert (found["begins_s"], found["ends_s"]) == (0.0, 12.04)
    acc = found["sensors"][0]
    assert (acc["name"], acc["rows"], acc["mean"], acc["temperature_degc"]) == ("Acc", 1200, [0.25, -0.5, 1.0], 28.0)
    assert acc["peak_use_percent"] == pytest.approx([6.262, 12.512, 25.012], abs=1e-3)
    force = found["fused"]["quantities"]["specific_force"]
    assert force["unit"] == "mg"
    assert force["mean"] == pytest.approx([250, -500, 1000], abs=0.5)


def test_curves_keep_both_ends_of_every_piece(ended: Path) -> None:
    with Watch(ended) as watch:
        snapshot = watch.refresh(0.0)
    view = snapshot.sensors[0]
    spiked = view.values.copy()
    spiked[517, 1] = 3.5
    found = drawn(dataclasses.replace(snapshot, sensors=(dataclasses.replace(view, values=spiked),)))
    trace = found["sensors"][0]["trace"]
    assert len(trace["t"]) == len(trace["x"]) <= 2 * DRAWN
    assert trace["t"] == sorted(trace["t"])
    assert -10.1 < trace["t"][0] < -9.8 and trace["t"][-1] <= 0
    assert max(trace["y"]) == 3.5
    at_s = trace["t"][trace["y"].index(3.5)]
    assert at_s == pytest.approx((view.time[517] - view.time[-1]) * 1e-9, abs=0.1)
    density = found["sensors"][0]["density"]
    assert density["f"][0] > 0 and density["f"][-1] == pytest.approx(50, abs=0.01)
    assert found["sensors"][0]["density_unit"] == "mg"
    # the spectrum was of the log: a count (1000/2048 mg) up and down, in a bin of half a Hann window's width
    assert max(density["x"]) == density["x"][-1]


def test_monitor_text_once(ended: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", str(ended), "--text", "--once"]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert out.startswith("run.h5: finished, 12 s\n")


def test_monitor_ends_with_the_log(ended: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", str(ended), "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["state"] == "finished"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere.h5", "--text", "--once"], "nowhere.h5: no such file"),
        (["run.h5", "--once"], "say --text or --json with it"),
        (["run.h5", "--text", "--calibration", "none.toml"], "none.toml: No such file"),
        (["run.h5", "--host", "192.0.2.1", "--port", "1"], "192.0.2.1:1: can't serve there"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", *arguments]) == 2
    assert says in capsys.readouterr().err


def test_without_the_extra_the_text_form_works_and_the_page_says_what_to_install(
    ended: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import sys

    for name in [name for name in sys.modules if name.split(".")[0] in ("bokeh", "tornado")]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("bokeh", "tornado"):
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["monitor", str(ended), "--text", "--once"]) == 0
    assert main(["monitor", str(ended)]) == 2
    assert "pip install 'imuarray[monitor]'" in capsys.readouterr().err
