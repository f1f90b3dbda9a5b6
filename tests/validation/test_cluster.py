"""Cases over a real Dask scheduler: a lost worker loses no outcome, and the outcomes are those of one process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import TypeVar

import pytest

from imuarray.errors import ImuArrayError
from imuarray.validation import running
from imuarray.validation.running import RunSummary, Workers, executor_of, run_cases
from tests.selection import some
from tests.validation.jobs import case_of, worked, written

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("distributed") is None, reason="needs distributed, installed by the test extra"),
]

ROOT = Path(__file__).parents[2]
WAIT_S = 90
Found = TypeVar("Found")


@pytest.fixture(autouse=True)
def _importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes inherit the path from here, to import the jobs of the tests."""
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])


def soon(look: Callable[[], Found | None]) -> Found:
    """Wait until `look` returns a value, and return it."""
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        result = look()
        if result:
            return result
        time.sleep(0.05)
    raise TimeoutError(look)


@contextmanager
def dask(*arguments: str, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """A program of Dask's that can import the tests' jobs."""
    command = [sys.executable, "-m", "dask", *arguments, "--host", "127.0.0.1", "--no-dashboard"]
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    with subprocess.Popen(command, env=surroundings, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.terminate()


@contextmanager
def cluster(folder: Path, nanny: str, allowed_failures: int = 3) -> Iterator[tuple[Workers, subprocess.Popen[bytes]]]:
    """Two workers of one thread each, and their scheduler. A nanny restarts its worker after its death."""
    schedule = folder / "scheduler.json"
    allowed = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(allowed_failures)}
    with ExitStack() as stack:
        scheduler = stack.enter_context(dask("scheduler", "--port", "0", "--scheduler-file", str(schedule), **allowed))
        soon(lambda: schedule.exists() and schedule.read_text().rstrip().endswith("}"))
        address = json.loads(schedule.read_text())["address"]
        for _ in range(2):
            stack.enter_context(dask("worker", address, "--nworkers", "1", "--nthreads", "1", nanny))
        executor = stack.enter_context(executor_of(address, 0))
        soon(lambda: executor.places == 2)
        yield executor, scheduler


def test_a_killed_worker_loses_no_case(tmp_path: Path) -> None:
    """It is in the middle of a case; the remaining worker runs that case and all others."""
    cases = [case_of(number, "wait to be killed" if number == 5 else "slow") for number in range(24)]
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    killed = "wait to be killed-5"
    (here / killed).write_text("killed before")
    run_cases(cases, here, worked)

    def kill() -> None:
        pid = soon(lambda: (there / killed).exists() and int((there / killed).read_text()))
        assert (there / "begun" / cases[5].name).read_bytes() == b"."
        os.kill(pid, signal.SIGKILL)

    heard: list[int] = []
    killer = Thread(target=kill)
    with cluster(tmp_path, "--no-nanny") as (executor, _):
        killer.start()
        assert run_cases(cases, there, worked, executor, progress=heard.append) == RunSummary(24, 0, (), ())
        assert executor.places == 1
    killer.join()
    assert heard == list(range(25))
    assert written(there) == written(here)


@pytest.mark.parametrize("allowed_failures", some([0, 3], 1, 0))
def test_a_case_that_kills_two_workers_is_lost(tmp_path: Path, allowed_failures: int) -> None:
    """Both if the scheduler sends the case of a lost worker to another worker and if it returns it."""
    plans = {4: "die", 9: "die once", 11: "raise"}
    cases = [case_of(number, plans.get(number, "work")) for number in range(20)]
    here, there = tmp_path / "here", tmp_path / "there"
    with executor_of("processes", 1) as processes:
        run_cases(cases, here, worked, processes)
    with cluster(tmp_path, "--nanny", allowed_failures) as (executor, _):
        ran = run_cases(cases, there, worked, executor)
    assert ran == RunSummary(20, 0, (cases[11].name,), (cases[4].name,))
    assert (there / "die-4").read_bytes() == b".."
    assert written(there) == written(here)


def test_another_executor_continues_after_the_scheduler_is_lost(tmp_path: Path) -> None:
    cases = [case_of(number, "slow") for number in range(24)]
    here, there = tmp_path / "here", tmp_path / "there"
    run_cases(cases, here, worked)
    with cluster(tmp_path, "--no-nanny") as (executor, scheduler):

        def kill(done: int) -> None:
            if done == 6:
                scheduler.kill()

        with pytest.raises(ImuArrayError, match="run the same command again to continue"):
            run_cases(cases, there, worked, executor, progress=kill)
    with executor_of("processes", 1) as processes:
        ran = run_cases(cases, there, worked, processes)
    assert ran.before >= 6
    assert written(there) == written(here)


def test_a_missing_scheduler_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "_CONNECT_S", 0.5)
    with (
        pytest.raises(ImuArrayError, match=r"tcp://127.0.0.1:9: no Dask scheduler"),
        executor_of("tcp://127.0.0.1:9", 0),
    ):
        pass
