"""`log --monitor`: a page is served during a recording, its address is reported, it ends with the recording and does
not affect the log."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from imuarray.cli import main
from imuarray.commands import log_display
from imuarray.log import open_log

ROOT = Path(__file__).parents[2]
ENV = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """``log(...)``: a second of the emulated array; exit code, standard output and error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str, str]:
        usual = ["log", "martin2013", "--bus", "emulated:", "--seconds", "1", "--only", "BMA1,BMA2", "-o", "run.h5"]
        code = main([*usual, *arguments])
        return code, *capsys.readouterr()

    return call


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The programs that are begun in the place of a page; each prints a line and waits for its end."""
    begun: list[list[str]] = []
    real = subprocess.Popen

    def begin(program: list[str], **options: Any) -> Any:
        begun.append(program[3:])
        text = "print('http://here/', flush=True); import time; time.sleep(60)"
        return real([sys.executable, "-c", text], **options)

    monkeypatch.setattr(log_display.subprocess, "Popen", begin)
    return begun


@pytest.mark.slow
def test_the_page_shows_the_log_that_is_recorded(log: Call, pages: list[list[str]]) -> None:
    code, _, _ = log("--monitor")
    assert code == 0
    assert pages == [["monitor", "run.h5", "--parent", str(os.getpid())]]
    with open_log("run.h5") as recorded:
        assert recorded.state == "finished"


@pytest.mark.slow
def test_the_page_shows_the_first_part_and_the_fused_file(log: Call, pages: list[list[str]]) -> None:
    options = ["--monitor", "--monitor-port", "0", "--monitor-host", "0.0.0.0", "--rotate", "30s", "--fuse"]  # noqa: S104
    assert log(*options, "--fused", "out.h5")[0] == 0
    parent = ["--parent", str(os.getpid())]
    address = ["--host", "0.0.0.0", "--port", "0"]  # noqa: S104
    assert pages == [["monitor", "run_001.h5", *parent, *address, "--fused", "out.h5"]]


@pytest.mark.slow
def test_no_page_is_served_without_the_option(log: Call, pages: list[list[str]]) -> None:
    assert log()[0] == 0
    assert pages == []


@pytest.mark.parametrize("option", ["--monitor-port=1", "--monitor-host=127.0.0.1"])
def test_options_of_the_page_without_monitor_are_refused(log: Call, option: str) -> None:
    code, _, err = log(option)
    assert code == 2 and f"{option.split('=')[0]} needs --monitor" in err
    assert not Path("run.h5").exists()


def test_without_the_extra_nothing_is_recorded(log: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_display, "find_spec", lambda name: None)
    code, _, err = log("--monitor")
    assert code == 2 and "pip install 'imuarray[monitor]'" in err
    assert not Path("run.h5").exists()


def test_lines_of_the_page_are_reported(tmp_path: Path) -> None:
    lines: list[str] = []
    log_display._report_lines(
        ["http://127.0.0.1:8765/\n", "imuarray: 127.0.0.1:8765: can't serve the page there\n"], lines.append
    )
    assert lines == ["watch it at http://127.0.0.1:8765/", "no page: 127.0.0.1:8765: can't serve the page there"]


def snapshot(address: str) -> dict[str, Any]:
    with urllib.request.urlopen(f"{address}snapshot.json", timeout=60) as answer:  # noqa: S310
        result: dict[str, Any] = json.load(answer)
    return result


def awaited_snapshot(address: str, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first snapshot for which the condition is true."""
    end_s = time.monotonic() + 120
    while time.monotonic() < end_s:
        if wanted(result := snapshot(address)):
            return result
        time.sleep(0.2)
    raise AssertionError(f"never seen; the last one was {result}")


@pytest.mark.slow
def test_a_page_follows_a_recording_in_real_time(tmp_path: Path) -> None:
    """In real time, cut into parts, fused meanwhile; ended by Ctrl-C, and no process is left."""
    program = [sys.executable, "-m", "imuarray", "log", str(ROOT / "configs" / "martin2013.toml")]
    program += ["--bus", "emulated:?clock=real", "--rate-hz", "50", "--rotate", "3s", "--fuse", "-o", "run.h5"]
    program += ["--technique", "opposed", "--monitor", "--monitor-port", "0"]
    process = subprocess.Popen(
        program, cwd=tmp_path, env=ENV, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        assert process.stderr is not None
        text = ""
        while not (result := re.search(r"imuarray: watch it at (http://127\.0\.0\.1:\d+/)\n", text)):
            text += process.stderr.readline()
        address = result[1]
        now = awaited_snapshot(address, lambda now: now["fused"] is not None and now["fused"]["technique"] == "opposed")
        assert now["frame_rate_hz"] == 50.0
        assert len(now["sensors"]) == 12
        later = awaited_snapshot(address, lambda now: now["log"] != "run_001.h5" and now["ends_s"] > 3.5)
        assert later["state"] == "being written" and later["begins_s"] == now["begins_s"]
        process.send_signal(signal.SIGINT)
        awaited_snapshot(address, lambda now: now["state"] == "finished")  # an open page shows the end
        out, _ = process.communicate(timeout=120)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0 and "frames fused while recording" in out
    with pytest.raises(urllib.error.URLError):
        snapshot(address)
    with open_log(tmp_path / "run_001.h5") as first:
        assert first.frame_rate_hz == 50.0


@pytest.mark.slow
def test_a_page_ends_when_its_logger_is_killed(tmp_path: Path) -> None:
    program = (
        "import sys, pathlib\n"
        "from imuarray.commands.log_display import serve_page\n"
        "with serve_page(pathlib.Path('run.h5'), {'--port': 0}):\n"
        "    sys.stdin.readline()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], cwd=tmp_path, env=ENV, text=True,
        stdin=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert process.stderr is not None
        address = process.stderr.readline().split()[-1]
        assert snapshot(address)["state"] == "waiting"
    finally:
        process.kill()
        process.communicate()
    end_s = time.monotonic() + 60
    with pytest.raises(urllib.error.URLError):
        while time.monotonic() < end_s:
            time.sleep(0.2)
            snapshot_or_not = urllib.request.urlopen(address, timeout=5)  # noqa: S310
            snapshot_or_not.close()
            time.sleep(4)  # no request for longer than the page waits
