"""A recording killed at any moment: the log can be opened, and contains every acknowledged frame."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from imuarray.cli import main
from imuarray.log import open_log
from tests.reliability import storage_rows as rows

FRAMES, BATCH, CHUNK = 1000, 10, 256


def recorded(folder: Path, batches: int = 0, seconds: float | None = None) -> int:
    """Record in a child of this process, killed some time after so many batches were acknowledged; wait status."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            rows.record(folder / "run.h5", FRAMES, BATCH, CHUNK, rows.counter(folder / "acknowledged"))
            status = 0
        finally:
            os._exit(status)
    if seconds is not None:
        while batches and rows.counts(folder / "acknowledged") < batches:
            time.sleep(0.0002)
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    return os.waitpid(child, 0)[1]


def nursery(folder: Path, times: int, seed: int) -> None:
    """Many killed recordings, in a separate process without open files.

    Three of four are killed after a random number of batches, and a random part of a batch more: how fast the
    machine is at that moment does not matter.  The others die at a random time, also while the log is opened or
    finished.
    """
    draw = random.Random(seed)
    wholes = []
    for number in range(3 if times > 10 else 1):
        (folder / f"whole{number}").mkdir()
        start = time.perf_counter()
        if recorded(folder / f"whole{number}") != 0:
            sys.exit("the recording failed")
        wholes.append(time.perf_counter() - start)
    whole_s = min(wholes)
    for number in range(times):
        place = folder / f"{number:03d}"
        place.mkdir()
        if number % 4 < 3:
            recorded(place, draw.randrange(1, FRAMES // BATCH), draw.uniform(0, 0.01 * whole_s))
        else:
            recorded(place, 0, draw.uniform(0, whole_s))


def look(folder: Path) -> tuple[str, int, int]:
    """State of the log, frames that it holds, frames that were acknowledged; its rows are correct."""
    acknowledged = rows.counted(folder / "acknowledged")
    if acknowledged == 0 and not (folder / "run.h5").exists():
        return "not begun", 0, 0
    with open_log(folder / "run.h5") as log:
        state = log.state
    frames, problems = rows.wrong(folder / "run.h5")
    assert problems == []
    return state, frames, acknowledged


def killed(folder: Path, times: int, seed: int) -> list[Path]:
    program = [sys.executable, "-m", "tests.reliability.test_storage_kills", str(folder), str(times), str(seed)]
    root = Path(__file__).parents[2]
    subprocess.run(program, cwd=root, check=True, timeout=300, env=os.environ | {"PYTHONPATH": str(root)})
    return sorted(path for path in folder.iterdir() if not path.name.startswith("whole"))


def check(places: list[Path]) -> dict[str, int]:
    """All of them; how many were in which state."""
    states: dict[str, int] = {}
    for place in places:
        before = {path.name: path.read_bytes() for path in place.iterdir()}
        state, frames, acknowledged = look(place)
        assert frames >= acknowledged, f"{place}: {acknowledged} acknowledged, {frames} there"
        assert {path.name: path.read_bytes() for path in place.iterdir()} == before  # a reader changes nothing
        states[state] = states.get(state, 0) + 1
        shutil.rmtree(place)
    return states


@pytest.mark.campaign
def test_a_log_killed_a_hundred_times_contains_all_acknowledged_frames(tmp_path: Path) -> None:
    states = check(killed(tmp_path, 100, 2))
    print(f"killed at 100 random moments: {states}; no acknowledged frame lost, none wrong")
    assert sum(states.values()) == 100
    assert states["interrupted"] >= 50


@pytest.mark.slow
def test_a_killed_log_is_recovered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for place in killed(tmp_path, 3, 3):
        if not (place / "run.h5").exists():
            continue
        frames, _ = rows.wrong(place / "run.h5")
        assert main(["verify", str(place / "run.h5")]) == 0
        assert main(["recover", str(place / "run.h5")]) == 0
        assert {path.name for path in place.iterdir()} <= {"run.h5", "acknowledged"}
        assert rows.wrong(place / "run.h5") == (frames, [])
        assert main(["verify", str(place / "run.h5")]) == 0
        with open_log(place / "run.h5") as log:
            assert log.state == "finished"
    assert "recovered" in capsys.readouterr().out


if __name__ == "__main__":
    nursery(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
