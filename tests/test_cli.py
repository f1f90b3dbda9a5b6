"""The acquisition commands as a user calls them: exit codes, one line a mistake, no remaining files, and Ctrl-C."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest
from numpy.lib.format import write_array_header_1_0

from imuarray.acquire import RecordingCounts
from imuarray.cli import COMMANDS, main
from imuarray.commands.log import Interruptible, print_summary
from imuarray.commands.log_display import LogScreen
from imuarray.commands.options import progress
from imuarray.log import open_log
from imuarray.log.format import Event
from tests.selection import some

CONFIG = """
[array]
name = "one"
[[sensor]]
name = "A"
chip = "adxl345"
address = 0x53
range = 4
rate_hz = 800
[[sensor]]
name = "M"
chip = "hmc5883"
address = 0x1E
range = 1.2
rate_hz = 75
"""

NOTE = "imuarray: recording the emulated array, no hardware"

Run = Callable[..., tuple[int, str, list[str]]]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A separate working folder with a configuration."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.toml").write_text(CONFIG)
    return tmp_path


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """``run("log", ...)``: exit code, standard output, lines of standard error but the note about no hardware."""

    def call(*arguments: object) -> tuple[int, str, list[str]]:
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out, [line for line in err.splitlines() if line != NOTE]

    return call


@pytest.mark.parametrize(
    "arguments",
    some([["--help"], ["-h"], ["completion", "-h"], ["log", "--help"], ["detect", "-h"], ["info", "--help"]], 1),
)
def test_help_imports_no_heavy_package(arguments: list[str]) -> None:
    program = (
        "import sys; from imuarray.cli import main; code = main(sys.argv[1:])\n"
        "heavy = {'numpy', 'h5py', 'scipy', 'pydantic', 'matplotlib', 'smbus2'} & set(sys.modules)\n"
        "sys.exit(f'imports {heavy}' if heavy else code)"
    )
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout


def test_version_lists_the_packages_that_results_depend_on(run: Run) -> None:
    code, out, _ = run("--version")
    assert code == 0
    assert {line.split()[0] for line in out.splitlines()} >= {"imuarray", "python", "HDF5", "numpy", "scipy", "h5py"}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_a_script_for_the_shell(run: Run, shell: str) -> None:
    code, out, _ = run("completion", shell)
    assert code == 0
    assert f"_IMUARRAY_COMPLETE={shell}_complete" in out


def test_a_shell_gets_the_completions() -> None:
    asked = {**os.environ, "_IMUARRAY_COMPLETE": "bash_complete", "COMP_WORDS": "imuarray cal", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-m", "imuarray"], capture_output=True, text=True, timeout=30, env=asked)
    assert done.stdout == "plain,calibrate\n"


def test_help_names_every_command(run: Run) -> None:
    code, out, _ = run("--help")
    assert code == 0
    for name in COMMANDS:
        assert f"\n  {name} " in out


def test_log_and_info_print_json(run: Run, here: Path) -> None:
    arguments = ("--bus", "emulated:", "-o", "r.h5", "--seconds", "2", "--phase", "x_down", "--json")
    code, out, err = run("log", "one.toml", *arguments)
    assert (code, err) == (0, [])
    summary = json.loads(out)
    assert (summary["log"], summary["frames"], summary["late"], summary["lost"]) == ("r.h5", 100, 0, {})
    assert summary["seconds"] == pytest.approx(2.0, abs=0.1)
    code, out, err = run("info", "r.h5", "--json")
    assert (code, err) == (0, [])
    report = json.loads(out)
    assert report["source"] == "emulated"
    assert report["truth"] is True
    assert [(phase["name"], phase["up"], phase["start_s"]) for phase in report["phases"]] == [("x_down", "-X", 0.0)]
    sensors = {sensor["name"]: sensor for sensor in report["sensors"]}
    assert sensors["A"]["rows"] == sensors["M"]["rows"] == 100
    assert sensors["A"]["rate_hz"] == pytest.approx(50.0, rel=1e-3)
    assert (sensors["A"]["range"], sensors["A"]["unit"], sensors["M"]["quantity"]) == (4.0, "g", "magnetic_field")
    assert report["events"] == []
    assert sorted(path.name for path in here.iterdir()) == ["one.toml", "r.h5"]


def test_log_and_info_print_text(run: Run) -> None:
    code, out, _ = run(
        "log", "one.toml", "--bus", "emulated:?world=tumble&face_s=1&turn_s=0.2", "-o", "r.h5", "--seconds", "3"
    )
    assert code == 0
    assert out.startswith("r.h5: 150 frames in 3.0 s")
    code, out, _ = run("info", "r.h5")
    assert code == 0
    assert "r.h5: emulated (no hardware)" in out
    assert "phase x_up" in out
    assert "(+X up)" in out


@pytest.mark.slow
def test_a_note_states_that_there_is_no_hardware(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "one.toml", "--bus", "emulated:", "-o", "r.h5", "--seconds", "0.1"]) == 0
    assert capsys.readouterr().err == NOTE + "\n"


@pytest.mark.slow
def test_some_sensors_are_logged_with_a_transcript(run: Run, here: Path) -> None:
    arguments = ("--bus", "emulated:", "-o", "r.h5", "--seconds", "1", "--only", "A", "--transcript", "t.jsonl")
    assert run("log", "one.toml", *arguments)[0] == 0
    with open_log(here / "r.h5") as log:
        assert list(log.sensors) == ["A"]
        first = log["A"].counts[:]
    lines = [json.loads(line) for line in (here / "t.jsonl").read_text().splitlines()]
    asked = [line.get("to") or line.get("claim") for line in lines]
    assert {address for address in asked if address} == {"53"}
    assert run("log", "one.toml", "--bus", "replay:t.jsonl", "-o", "again.h5", "--seconds", "1", "--only", "A")[0] == 0
    with open_log(here / "again.h5") as log:
        assert (log["A"].counts[:] == first).all()
        assert log.source == "replay"


def test_importing_a_log_is_refused_and_phases_are_suggested(run: Run, here: Path) -> None:
    arguments = ("--bus", "emulated:", "-o", "r.h5", "--seconds", "1", "--sensor", "A", "--phase", "z_up")
    assert run("log", "one.toml", *arguments)[0] == 0
    code, _, err = run("import", "r.h5", "-o", "again.h5")
    assert (code, err) == (2, ["imuarray: r.h5: is a log already; all commands can read it"])
    assert run("import", "r.h5", "--guess")[::2] == (code, err)
    code, _, err = run("characterise", "r.h5", "--phase", "zup", "-o", "noise")
    assert code == 2 and err[0].endswith("it has z_up; did you mean z_up?")


def test_shipped_configurations_are_loaded_by_name(run: Run) -> None:
    code, out, _ = run("detect", "martin2013", "--bus", "emulated:", "--json")
    report = json.loads(out)
    assert code == 0
    assert report["ok"] is True
    assert len(report["found"]) == 13


def test_detect_reports_differences_and_exits_with_2(run: Run, here: Path) -> None:
    (here / "board.toml").write_text(CONFIG.replace("0x53", "0x1D"))
    code, out, err = run("detect", "one.toml", "--bus", "emulated:?board=board.toml&errno=6")
    assert (code, err) == (2, [])
    assert "NO  trunk address 0x53" in out
    assert "no chip acknowledges this address" in out
    assert "?   trunk address 0x1d       not in the configuration     adxl345" in out
    assert out.splitlines()[-1] == "1 of 2 as configured, 1 not"
    code, out, _ = run("detect", "one.toml", "--bus", "emulated:?board=board.toml", "--json")
    assert code == 2
    assert json.loads(out)["ok"] is False


GOOD_LOG = ("log", "one.toml", "--bus", "emulated:", "--seconds", "1")

BAD_INPUT: list[tuple[tuple[str, ...], str]] = [
    (("xyzzy",), "No such command 'xyzzy'"),
    (("calibrat",), "No such command 'calibrat'; did you mean calibrate?"),
    (("--nonsense",), "No such option"),
    (("log",), "Missing argument 'CONFIG'"),
    (("log", "one.toml"), "Missing option '-o'"),
    (("log", "one.toml", "-o", "r.h5", "--seconds", "1"), "one.toml: no bus: give --bus"),
    (("log", "none.toml", "--bus", "emulated:", "-o", "r.h5"), "none.toml: No such file or directory"),
    (("log", ".", "--bus", "emulated:", "-o", "r.h5"), ".: Is a directory"),
    (("log", "broken.toml", "--bus", "emulated:", "-o", "r.h5"), "broken.toml: not TOML"),
    (
        ("log", "wrong.toml", "--bus", "emulated:", "-o", "r.h5"),
        "wrong.toml:8: sensor 1 'A': range 5: allowed are 2, 4, 8, 16",
    ),
    (("log", "one.toml", "--bus", "nonsense", "-o", "r.h5"), "bus 'nonsense': allowed are"),
    (("log", "one.toml", "--bus", "/dev/i2c-1", "-o", "r.h5"), "emulated:; did you mean i2c:/dev/i2c-1?"),
    (("log", "one.toml", "--bus", "/dev/ttyUSB0", "-o", "r.h5"), "emulated:; did you mean serial:/dev/ttyUSB0?"),
    (("log", "one.toml", "--bus", "i2c:/dev/none", "-o", "r.h5"), "i2c:/dev/none: No such file or directory"),
    (("log", "one.toml", "--bus", "replay:none.jsonl", "-o", "r.h5"), "replay:none.jsonl: No such file"),
    (("log", "one.toml", "--bus", "replay:one.toml", "-o", "r.h5"), "one.toml, line 1: not a transaction"),
    (("log", "one.toml", "--bus", "emulated:?x=1", "-o", "r.h5"), "x: no such parameter"),
    (
        ("log", "one.toml", "--bus", "emulated:?board=other.toml", "-o", "r.h5", "--seconds", "1"),
        "A (adxl345) at trunk address 0x53: no chip acknowledges",
    ),
    ((*GOOD_LOG, "-o", "r.h5", "--seconds", "0"), "--seconds"),
    ((*GOOD_LOG, "-o", "r.h5", "--seconds", "x"), "--seconds"),
    ((*GOOD_LOG, "-o", "r.h5", "--rate-hz", "0"), "--rate-hz"),
    ((*GOOD_LOG, "-o", "r.h5", "--rate-hz", "nan"), "'nan' is not a number from 0.01 to 3200"),
    ((*GOOD_LOG, "-o", "r.h5", "--up", "up"), "--up"),
    ((*GOOD_LOG, "-o", "r.h5", "--phase", "z_up", "--up=-Z"), "--up -Z: the phase z_up has +Z up"),
    ((*GOOD_LOG, "-o", "r.h5", "--only", "B"), "no sensor 'B'; it has A, M"),
    ((*GOOD_LOG, "-o", "none/r.h5"), "none/r.h5: the folder none does not exist"),
    ((*GOOD_LOG, "-o", "r.h5", "--transcript", "none/t.jsonl"), "none/t.jsonl"),
    ((*GOOD_LOG, "-o", "r.h5", "--transcript", "one.toml"), "one.toml: exists already"),
    ((*GOOD_LOG, "-o", "one.toml"), "one.toml: exists already; choose another name or use --force"),
    ((*GOOD_LOG, "-o", "folder"), "folder: is a folder"),
    (("detect", "none.toml"), "none.toml: No such file"),
    (("detect", "one.toml", "--bus", "usb:"), "bus 'usb:': allowed are"),
    (("info",), "Missing argument"),
    (("info", "none.h5"), "none.h5: no such file"),
    (("info", "folder"), "folder: is a folder"),
    (("info", ""), "'RUN.h5': the name is empty"),
    ((*GOOD_LOG, "-o", ""), "'-o' / '--output': the name is empty"),
    (("info", "one.toml"), "one.toml: is not an HDF5 file"),
    (("monitor", "folder", "--text"), "folder: is a folder"),
    (("characterise", "x.csv", "-o", "one.toml"), "one.toml: is a file; the output must be a folder"),
    (("info", "/dev/null"), "/dev/null: is a device or a pipe"),
    (("import", "x.npz", "--guess"), "x.npz: does not begin as .npz files do"),
    (("import", "large.npy", "--guess"), "its header states an array of 800000000000 bytes, the file has 144"),
    (("info", "x.csv"), "format 'imuarray-log'; imuarray import makes a log of a .csv"),
    (("info", "foreign.h5"), "foreign.h5: an HDF5 file, but not a log"),
    (("info", "fused.h5"), "fused.h5: is a fused result, not a log"),
    (("fuse", "x.csv", "--calibration", "foreign.h5", "-o", "r.h5"), "foreign.h5: is an HDF5 file, not a text file"),
    (("log", "foreign.h5", "--bus", "emulated:", "-o", "r.h5"), "foreign.h5: is an HDF5 file, not a text file"),
    (("gap",), "choose what to do: "),
    (("calibrate",), "choose what to calibrate: "),
    (("report", "x.csv", "-o", "r.pdf"), "r.pdf: a report is an HTML page; name it r.html"),
    (("report", "x.csv", "-o", "page"), "page: a report is an HTML page; name it page.html"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT)
def test_bad_input_is_one_line_exit_code_2_and_leaves_no_file(
    run: Run, here: Path, arguments: tuple[str, ...], message: str
) -> None:
    (here / "broken.toml").write_text("[array")
    (here / "wrong.toml").write_text(CONFIG.replace("range = 4", "range = 5"))
    (here / "other.toml").write_text(CONFIG.replace("0x53", "0x1D"))
    (here / "folder").mkdir()
    with h5py.File(here / "foreign.h5", "w") as file:
        file["x"] = 1
    with h5py.File(here / "fused.h5", "w") as file:
        file.attrs["format"] = "imuarray-fused"
    (here / "x.csv").write_text("t,x\n0,1\n")
    (here / "x.npz").write_bytes(bytes(range(128, 255)))
    large = io.BytesIO()
    write_array_header_1_0(large, {"descr": "<f8", "fortran_order": False, "shape": (100_000_000_000,)})
    (here / "large.npy").write_bytes(large.getvalue() + bytes(16))
    before = {path: path.stat().st_mtime_ns for path in here.rglob("*")}
    code, out, err = run(*arguments)
    assert code == 2
    assert out == ""
    assert len(err) == 1, err
    assert err[0].startswith("imuarray: ")
    assert message in err[0]
    assert {path: path.stat().st_mtime_ns for path in here.rglob("*")} == before  # hidden .part files included


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "message"),
    some(
        [
            ("zoup", "did you mean z_up?"),
            ("statik", "did you mean static?"),
            ("z_up", ""),
            ("z_up_check", ""),
            ("run 3", ""),
        ],
        1,
    ),
)
def test_a_phase_similar_to_a_known_name_is_mentioned(run: Run, here: Path, phase: str, message: str) -> None:
    """Other names are allowed: they are recorded as they are."""
    code, _, err = run(*GOOD_LOG, "-o", "r.h5", "--seconds", "0.1", "--phase", phase)
    assert code == 0
    mentioned = [line for line in err if "not a name that other commands recognise" in line]
    assert len(mentioned) == bool(message)
    assert all(message in line for line in mentioned)
    with open_log(here / "r.h5") as log:
        assert [entry.name for entry in log.phases] == [phase]


@pytest.mark.parametrize("phase", ["zup", "Z-UP", "z up"])
def test_a_phase_that_differs_only_in_punctuation_is_refused(run: Run, here: Path, phase: str) -> None:
    code, _, err = run(*GOOD_LOG, "-o", "r.h5", "--seconds", "0.1", "--phase", phase)
    assert (code, err) == (
        2,
        [f"imuarray: phase {phase!r}: other commands recognise 'z_up' only; write --phase z_up"],
    )
    assert not (here / "r.h5").exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("fuse cal.toml run.h5 -o f.h5", "unexpected argument run.h5; allowed is imuarray fuse [OPTIONS] RUN.h5"),
        ("log martin2013 --rate-hz 50Hz -o r.h5", "'50Hz' is not a number from 0.01 to 3200"),
        ("demo --workers two", "'two' is not a whole number from 1 to 256"),
        ("fuse run.h5 -o f.csv", "f.csv: a fused result is an HDF5 file; name it f.h5"),
        ("simulate martin2013 -o s.csv", "s.csv: a log is an HDF5 file; name it s.h5"),
        ("import run.csv --map freeimu_thermal -o i.csv", "i.csv: a log is an HDF5 file; name it i.h5"),
        ("log martin2013 --bus emulated: -o r.csv", "r.csv: a log is an HDF5 file; name it r.h5"),
        ("info .", ".: is a folder"),
        ("log martin2013 --bus emulated -o r.h5", "did you mean emulated:?"),
        ("log martin2013 --bus emulated: --phase z_up --up z -o r.h5", "did you mean +Z?"),
        ("log martin2013 --bus emulated: --transcript r.h5 -o r.h5", "r.h5: is the name of the log; choose another"),
        ("fuse run.h5 --only , -o f.h5", "'--only' / '--sensor': names are required, with commas between them"),
        (
            "fuse run.h5 --technique planez --evaluate",
            "are mean, opposed, planes, ranges, optimal; did you mean planes?",
        ),
        ("simulate martin2013 --seconds 1e30 -o s.h5", "'1e30': allowed is at most 3.1536e+09 s"),
        ("calibrate noise run.h5 -o cal.h5", "cal.h5: a calibration is a TOML file; name it cal.toml"),
        ("calibrate compare cal.toml one.toml", "cal.toml: is not a calibration: it has no table [calibration]"),
        ("monitor cal.toml --text", "cal.toml: is not a log; allowed is an HDF5 file (.h5) that is written or will be"),
    ],
)
def test_the_error_of_a_mistake_states_the_allowed_values(run: Run, here: Path, line: str, message: str) -> None:
    for name in ("cal.toml", "run.csv"):
        (here / name).write_text("")
    code, out, err = run(*line.split())
    assert (code, out, len(err)) == (2, "", 1)
    assert err[0].endswith(message)


def test_a_folder_is_never_replaced(run: Run, here: Path) -> None:
    (here / "folder").mkdir()
    code, _, err = run(*GOOD_LOG, "-o", "folder", "--force")
    assert (code, len(err)) == (2, 1)
    assert sorted(path.name for path in here.iterdir()) == ["folder", "one.toml"]


def test_a_missing_kernel_bus_is_an_error_of_one_line(run: Run, here: Path) -> None:
    (here / "kernel.toml").write_text(CONFIG + 'bus = "/dev/i2c-11"\n')
    code, _, err = run("detect", "kernel.toml", "--bus", "emulated:?board=one.toml")
    assert (code, len(err)) == (2, 1)


def test_without_arguments_lines_are_at_most_120_characters(run: Run) -> None:
    code, out, err = run()
    lines = out.splitlines()
    assert "Usage: imuarray" in lines[0]
    assert len(lines) > len(COMMANDS)
    assert (code, err) == (0, [])
    assert max(map(len, lines)) <= 120


def test_an_output_is_overwritten_only_with_force(run: Run, here: Path) -> None:
    assert run(*GOOD_LOG, "-o", "r.h5")[0] == 0
    before = (here / "r.h5").read_bytes()
    code, _, (line,) = run(*GOOD_LOG, "-o", "r.h5")
    assert code == 2
    assert "r.h5: exists already" in line
    assert (here / "r.h5").read_bytes() == before
    assert run(*GOOD_LOG, "-o", "r.h5", "--force", "--phase", "static")[0] == 0
    with open_log(here / "r.h5") as log:
        assert [phase.name for phase in log.phases] == ["static"]
    assert sorted(path.name for path in here.iterdir()) == ["one.toml", "r.h5"]


def test_json_output_is_clean_also_on_a_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """With standard error on a terminal and standard output in a file, progress belongs on standard error."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    code, out, _ = run(*GOOD_LOG, "-o", "r.h5", "--json")
    assert code == 0
    assert json.loads(out)["frames"] == 50


def interrupted(here: Path, number: int, *more: str) -> subprocess.CompletedProcess[str]:
    """A recording in real time without an end that receives a signal once it runs, and ends within a minute; what it
    said.
    """
    command = [
        sys.executable,
        "-m",
        "imuarray",
        "log",
        "one.toml",
        "--bus",
        "emulated:?clock=real",
        "-o",
        "r.h5",
        *more,
    ]
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
    try:
        process = subprocess.Popen(command, cwd=here, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    finally:
        signal.signal(signal.SIGHUP, before)
    deadline = time.monotonic() + 60
    while not (here / "r.h5").exists() and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.01)
    time.sleep(0.3)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    return subprocess.CompletedProcess(command, process.returncode, out, err)


@pytest.mark.parametrize("number", some([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], 1))
def test_an_interrupt_ends_a_log_cleanly(here: Path, number: int) -> None:
    done = interrupted(here, number, "--rate-hz", "50", "--json")
    first, *events = done.stderr.splitlines()
    assert (done.returncode, first) == (0, NOTE)
    assert [line for line in events if " late: " not in line] == []  # that is of a machine that was busy
    report = json.loads(done.stdout)
    with open_log(here / "r.h5") as log:
        assert len(log["A"]) == len(log["M"]) == report["frames"] > 3
        assert log.source == "emulated"
    assert sorted(path.name for path in here.iterdir()) == ["one.toml", "r.h5"]


def test_an_ignored_hang_up_stays_ignored(here: Path) -> None:
    """As nohup starts a program."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interruptible() as stop:
            states = []
            for number in (signal.SIGHUP, signal.SIGTERM):
                os.kill(os.getpid(), number)
                states.append((stop.asked, stop.hung_up))
        assert states == [(False, False), (True, False)]
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_closed_terminal_does_not_end_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    class ClosedTerminal(io.StringIO):
        def isatty(self) -> bool:
            return True

        def write(self, text: str, /) -> int:
            refused.extend([text] if text else [])
            raise OSError(5, "Input/output error")

    refused: list[str] = []
    monkeypatch.setattr(sys, "stderr", ClosedTerminal())
    screen = LogScreen("r.h5", 50, None)
    screen.event(Event(0, "A", "lost", "no reading"))
    screen.counted(RecordingCounts(frames=50))
    screen.close()
    assert [re.sub(r"\r?\x1b\[K", "", text) for text in refused] == [
        "      0.0 s  A lost: no reading\n",
        "r.h5: 50 frames, 1 s, 0 readings lost",
        "",
    ]


@pytest.mark.parametrize(
    ("silent", "end"), [(["A", "B"], ", 0 late, incomplete: no sensor answered at its end"), (["A"], ", 0 late")]
)
def test_the_summary_of_a_recording_whose_link_was_lost_says_that_it_is_incomplete(
    silent: list[str], end: str, capsys: pytest.CaptureFixture[str]
) -> None:
    counts = RecordingCounts(frames=600, seconds=6.0, lost={"A": 0, "B": 0}, silent=silent, logs=[Path("r.h5")])
    print_summary(counts, Path("r.h5"), [], None, as_json=False)
    assert capsys.readouterr().out == f"r.h5: 600 frames in 6.0 s (100.0 Hz){end}\n"


@pytest.mark.slow
def test_an_interrupt_ends_a_slow_log_soon(here: Path) -> None:
    done = interrupted(here, signal.SIGINT, "--rate-hz", "0.01")  # a frame in 100 s
    assert done.returncode == 0


@pytest.mark.slow
def test_events_are_shown_by_info(run: Run, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from firmware_emulator.wire import Wire

    real, silent = Wire.transfer, [0]

    def flaky(self: Any, address: int, write: bytes = b"", read: int = 0) -> bytes:
        if address == 0x53 and read > 1:
            silent[0] += 1
            if 50 < silent[0] < 61:
                raise OSError(121, "Remote I/O error")
        return real(self, address, write, read)

    monkeypatch.setattr(Wire, "transfer", flaky)
    code, out, err = run(*GOOD_LOG, "-o", "r.h5", "--seconds", "2")
    assert code == 0
    report, end = err
    assert re.fullmatch(r" +\d\.\d s  A lost: no reading: Remote I/O error \(errno 121\)", report)
    assert re.fullmatch(r" +\d\.\d s  A lost: in all 5 readings lost in 0\.1 s", end)
    assert "  A: 5 readings lost (see events: imuarray info r.h5)" in out
    _, out, _ = run("info", "r.h5", "--json")
    report = json.loads(out)
    assert [(event["sensor"], event["kind"]) for event in report["events"]] == [("A", "lost")] * 2
    assert report["sensors"][0]["rows"] == 95
    assert report["sensors"][0]["flags"] == {"lost_before": 1}
    assert "A lost: no reading: Remote I/O error (errno 121)" in run("info", "r.h5")[1]


@pytest.mark.slow
def test_a_log_is_written_in_parts(run: Run, here: Path) -> None:
    arguments = ("log", "one.toml", "--bus", "emulated:", "-o", "n.h5", "--seconds", "3")
    code, out, _ = run(*arguments, "--rotate", "1s", "--json")
    assert code == 0
    assert json.loads(out)["logs"] == ["n_001.h5", "n_002.h5", "n_003.h5"]
    code, _, err = run(*arguments, "--rotate", "1s")
    assert (code, err) == (2, ["imuarray: n_001.h5: exists already; choose another name or use --force"])
    code, _, err = run(*arguments, "--rotate", "1 week")
    assert code == 2
    assert "write 30s, 10min, 1h or 1d" in err[-1]


@pytest.mark.slow
def test_the_part_with_the_events_is_named(run: Run, here: Path) -> None:
    (here / "night.toml").write_text('[[fault]]\nkind="no_acknowledge"\nsensor="A"\nat_s=1.5\nfor_s=0.1\n')
    url = "emulated:?faults=night.toml"
    code, out, _ = run("log", "one.toml", "--bus", url, "-o", "n.h5", "--seconds", "4", "--rotate", "1s")
    assert code == 0
    assert re.search(r"  A: \d readings lost \(see events: imuarray info n_002\.h5\)$", out, re.MULTILINE)


def test_progress_is_shown_on_a_terminal(run: Run, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("imuarray.commands.log_display._PAUSE_S", 0)
    _, out, err = run(*GOOD_LOG, "-o", "r.h5", "--seconds", "7")
    shown = "\n".join(err).split("\x1b[K")
    assert "r.h5: 250 frames, 5 of 7 s, 0 readings lost" in [line.strip() for line in shown]
    assert shown[-1] == ""
    assert out.startswith("r.h5: 350 frames in 7.0 s")


def test_the_progress_line_fits_a_narrow_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each update of a longer line would begin a new one."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("imuarray.commands.log_display._PAUSE_S", 0)
    monkeypatch.setenv("COLUMNS", "40")
    _, _, err = run(*GOOD_LOG, "-o", "r.h5", "--seconds", "3")
    shown = [line.strip() for line in "\n".join(err).split("\x1b[K")]
    assert "r.h5: 150 frames, 3 of 3 s, 0 readings" in shown
    assert max(map(len, shown[1:])) <= 39


def test_a_progress_bar_fits_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress(100, "a_folder/a_night_001.h5") as move:
        for done in range(0, 101, 5):
            move(done)
    shown = re.split(r"\r|\n", re.sub(r"\x1b\[[?0-9]*[a-zA-Z]", "", sys.stderr.getvalue()))
    assert "..01.h5  [####----]   50%" in [line.rstrip() for line in shown]
    assert max(map(len, shown)) <= 39


@pytest.mark.parametrize("folder", [".", "..", "/"])
@pytest.mark.parametrize(
    "command",
    [
        ("log", "one.toml", "--bus", "emulated:"),
        ("fuse", "r.h5"),
        ("report", "r.h5"),
        ("export", "r.h5"),
        ("simulate", "one.toml", "--experiment", "static"),
        ("import", "r.h5", "--map", "one.toml"),
        ("calibrate", "noise", "r.h5"),
    ],
)
def test_a_folder_is_no_output(run: Run, here: Path, command: tuple[str, ...], folder: str) -> None:
    """`Path.with_suffix` raises ValueError for "." and "/", which have no name."""
    (here / "r.h5").touch()
    code, _, (line,) = run(*command, "-o", folder)
    assert (code, line) == (2, f"imuarray: {folder}: is a folder; the output must be a file")


def test_the_name_of_a_log_needs_its_suffix(run: Run, here: Path) -> None:
    code, _, (line,) = run(*GOOD_LOG, "-o", "night")
    assert (code, line) == (2, "imuarray: night: a log is an HDF5 file; name it night.h5")
    assert [path.name for path in here.iterdir()] == ["one.toml"]


def test_a_closed_standard_output_is_an_error(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python sets `sys.stdout` to None if descriptor 1 is closed (Python Library Reference, sys.__stdout__)."""
    monkeypatch.setattr(sys, "stdout", None)
    assert main(["info", "--help"]) == 2
    assert capsys.readouterr().err == "imuarray: standard output is closed; nothing can be printed\n"


@pytest.mark.slow
def test_long_lines_of_info_are_broken_at_the_width_of_the_terminal(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    run("log", "one.toml", "--bus", "emulated:", "-o", "r.h5", "--seconds", "0.1")
    unbroken = run("info", "r.h5")[1]
    monkeypatch.setenv("COLUMNS", "40")
    lines = run("info", "r.h5")[1].splitlines()
    assert max(map(len, lines)) <= 40
    assert "\n".join(lines).split() == unbroken.split()


def test_a_full_disk_has_exit_code_3(run: Run, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imuarray.log.writer.free_bytes", lambda path: 0)
    code, _, err = run("log", "one.toml", "--bus", "emulated:", "-o", "n.h5", "--seconds", "1")
    assert code == 3
    assert err[-1].startswith("imuarray: n.h5: less than ")


@pytest.mark.parametrize("arguments", [["demo", "-o", "demo"], ["report", "log.h5", "-o", "report.html"]])
def test_a_missing_package_of_pages_is_named_before_the_work(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.h5").touch()
    monkeypatch.setitem(sys.modules, "jinja2", None)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error == "imuarray: this needs jinja2, which is not installed: pip install 'imuarray[report]'\n"
    assert [path.name for path in tmp_path.iterdir()] == ["log.h5"]
