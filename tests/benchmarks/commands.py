"""Commands as whole processes, compared with scripts of the same result (`short_scripts.py`) and with a user's time.

A log of nine triads at 100 Hz, six minutes of it, with `full` an hour. The figures are processor time, that of the
kernel included, of a process from its start to its end, both sides in one run. Neither side uses more than one thread
of linear algebra, and our modules are compiled to bytecode as those of an installed package are. Peak memory is that of
the process, beside that of the script, which holds the log; of a log ten times as long it is to be the same.

`python tests/benchmarks/commands.py --beside FOLDER` measures the commands beside those of another version instead,
whose source is in a folder (`git archive COMMIT | tar -x -C FOLDER`), in turn and on one log.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

import h5py
from compare import Row, row

HERE = Path(__file__).parent

SHORT_S, LONG_S, FACTOR = 360, 3600, 10
TRIADS = "ADXL1,ADXL2,BMA1,BMA2,BMA3,BMA4,Gyro1,Gyro2,Gyro3"


class Command(NamedTuple):
    """A command: words after `imuarray`, in which LOG and OUT stand for files; the scripts that come to the same; the
    suffix of what it writes; the ratio of processor times that is required of the short log, and of the long one.
    """

    words: str
    scripts: tuple[str, ...]
    suffix: str
    short: float
    long: float


COMMANDS = (
    Command("info LOG", ("info",), "", 2.0, 2.0),
    Command("verify LOG", ("verify",), "", 3.0, 3.0),
    Command("export LOG -o OUT", ("export",), ".mcap", 0.5, 0.16),
    Command("fuse LOG --technique mean -o OUT", ("mean",), ".h5", 2.0, 0.5),
    Command("fuse LOG --technique planes -o OUT", ("planes",), ".h5", 4.0, 1.0),
    Command("fuse LOG --technique optimal -o OUT", ("optimal",), ".h5", 1.0, 0.5),
    Command("characterise LOG -o OUT", ("characterise",), "", 2.0, 1.5),
    Command("report LOG -o OUT", ("characterise", "mean", "planes", "optimal"), ".html", 1.5, 0.6),
    Command(
        f"simulate martin2013 --only {TRIADS} --rate-hz 100 --seconds SECONDS -o OUT", ("simulate",), ".h5", 4.0, 1.2
    ),
)
"""Each with its peers; where start-up is most of a short run the ratio that is required is above one."""

MEMORY = 2.0
"""Of the script's peak memory: more than half of ours is what is imported, of a log however short."""

BOUNDS = (("log martin2013 --bus emulated: --seconds 60 -o OUT", ".h5", 60 / 50), ("demo -o OUT", "", 30.0))
"""Commands without a peer, and the seconds of processor time that they may take: a minute of the emulated array, with
start-up, 50 times as fast as a real one.
"""


GAINS = {
    "report": 21.7, "characterise": 3.7, "fuse mean": 10.3, "fuse planes": 7.85, "fuse optimal": 9.2, "simulate": 4.4,
    "demo": 2.5, "log": 2.1, "info": 2.15, "export": 16.7, "verify": 1.0,
}  # fmt: skip
"""How many times as fast each is wanted as it was at commit faee4471, on an hour."""

TURNS, LONG_TURN_S = 3, 10.0
"""Measurements of each version, in turn, of which the median counts; one where it takes longer than so many seconds."""


class Spent(NamedTuple):
    """Processor time of a process, and its peak memory."""

    seconds: float
    megabytes: float


_LAUNCHER = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, used = os.wait4(process.pid, 0)
print(os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss)
"""
"""A small process that starts a command: Linux counts the memory of the process that starts it as the command's own."""


def rows(full: bool = False) -> list[Row]:
    """Every command beside its peers; with `full` on the long log, and its memory on one ten times as long."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seconds = LONG_S if full else SHORT_S
        log = _simulated(folder / "log.h5", seconds)
        found = _beside_peers(log, folder, seconds, full)
        for words, suffix, bound_s in BOUNDS if full else BOUNDS[:1]:
            spent = _run(_ours(words, log, folder / f"bound{suffix}", seconds))
            found.append(row(f"imuarray {words.split()[0]}", spent.seconds, bound_s, "s of processor", 1.0, "lower"))
        if full:
            found += _memory_rows(log, _simulated(folder / "longer.h5", FACTOR * seconds), folder)
    return found


def rows_beside(folder: Path, full: bool = False) -> Iterator[Row]:
    """Every command of this version beside that of the version in a folder, on an hour (`full`) or six minutes."""
    with tempfile.TemporaryDirectory() as name:
        seconds = LONG_S if full else SHORT_S
        log = _simulated(Path(name) / "log.h5", seconds)
        commands = [(_said(command), command.words, command.suffix) for command in COMMANDS]
        commands += [(words.split()[0], words, suffix) for words, suffix, _ in BOUNDS]
        for said, words, suffix in commands:
            line = _ours(words, log, Path(name) / f"made{suffix}", seconds)
            ours, theirs = [], list[float]()
            while len(theirs) < TURNS and max(theirs, default=0.0) < LONG_TURN_S:
                ours.append(_run(line).seconds)
                theirs.append(_run(line, folder).seconds)
            title = f"imuarray {said}, {seconds // 60} min of nine triads, against {folder.name}"
            yield row(title, median(ours), median(theirs), "s of processor", 1 / GAINS[said], "lower")


def _memory_rows(log: Path, longer: Path, folder: Path) -> list[Row]:
    """Peak memory of every command on the long log and on one ten times as long; of the report also on logs that don't
    know the truth, as those of real arrays.
    """
    unknown, unknown_longer = (_without_truth(path) for path in (log, longer))
    report = next(command for command in COMMANDS if _said(command) == "report")
    cases = [(_said(command), command, log, longer) for command in COMMANDS]
    cases.append(("report, without a truth", report, unknown, unknown_longer))
    found = []
    for name, command, short, long in cases:
        of_long = _memory(command, long, folder, FACTOR * LONG_S)
        of_short = _memory(command, short, folder, LONG_S)
        found.append(row(f"peak memory, ten hours: imuarray {name}", of_long, of_short, "MB", 1.1, "lower"))
    return found


def _without_truth(log: Path) -> Path:
    """Copy a log without its truth."""
    copy = log.with_name(f"unknown_{log.name}")
    shutil.copyfile(log, copy)
    with h5py.File(copy, "r+") as file:
        del file["truth"]
    return copy


def _beside_peers(log: Path, folder: Path, seconds: int, full: bool) -> list[Row]:
    """Processor times of all commands and scripts; a script that several need runs once."""
    theirs: dict[str, Spent] = {}
    result = []
    for command in COMMANDS:
        ours = _run(_ours(command.words, log, folder / f"ours{command.suffix}", seconds))
        for script in set(command.scripts) - set(theirs):
            words = [sys.executable, str(HERE / "short_scripts.py"), script, str(log), str(folder / f"bare_{script}")]
            theirs[script] = _run(words)
        peers = [theirs[script] for script in command.scripts]
        name = f"imuarray {_said(command)}, {seconds // 60} min of nine triads, against a bare script"
        target = command.long if full else command.short
        result.append(row(name, ours.seconds, sum(peer.seconds for peer in peers), "s of processor", target, "lower"))
        most = max(peer.megabytes for peer in peers)
        result.append(row(f"{name}: peak memory", ours.megabytes, most, "MB", MEMORY, "lower"))
    return result


def _said(command: Command) -> str:
    words = command.words.split()
    return f"{words[0]} {words[3]}" if words[0] == "fuse" else words[0]


def _memory(command: Command, log: Path, folder: Path, seconds: int) -> float:
    return _run(_ours(command.words, log, folder / f"ours{command.suffix}", seconds)).megabytes


def _simulated(path: Path, seconds: int) -> Path:
    words = f"simulate martin2013 --only {TRIADS} --rate-hz 100 --seconds SECONDS -o OUT"
    _run(_ours(words, path, path, seconds))
    return path


def _ours(words: str, log: Path, output: Path, seconds: int) -> list[str]:
    """The command line of one of our commands."""
    stands_for = {"LOG": str(log), "OUT": str(output), "SECONDS": str(seconds)}
    force = ["--force"] if "OUT" in words else []
    return [sys.executable, "-m", "imuarray", *(stands_for.get(word, word) for word in words.split()), *force]


def _run(words: Sequence[str], source: Path = HERE.parent.parent) -> Spent:
    """Run a process to its end, with the version of a source folder; RuntimeError if it fails."""
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | one_thread
    environment["PYTHONPATH"] = str(source)
    launched = [sys.executable, "-I", "-S", "-c", _LAUNCHER, *words]
    answer = subprocess.run(launched, env=environment, cwd=source, stdout=subprocess.PIPE, text=True, check=True)
    exit_code, seconds, kilobytes = answer.stdout.split()
    if int(exit_code) != 0:
        raise RuntimeError(f"{' '.join(words)}: exit code {exit_code}")
    return Spent(float(seconds), int(kilobytes) / 1024)


if __name__ == "__main__":
    other = Path(sys.argv[sys.argv.index("--beside") + 1]).resolve() if "--beside" in sys.argv else None
    for made in rows("--full" in sys.argv) if other is None else rows_beside(other, "--full" in sys.argv):
        print(made, flush=True)
