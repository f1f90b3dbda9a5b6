"""Cases over an executor: finished cases stay finished, an error loses its case only, and results do not depend on
workers.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from imuarray.errors import ConfigError, ImuArrayError, MissingExtraError
from imuarray.validation.case import Case
from imuarray.validation.running import Processes, RunSummary, executor_of, run_cases
from tests.validation.jobs import case_of, worked, written

ROOT = Path(__file__).parents[2]


def error_of(folder: Path, case: Case) -> str:
    return str(json.loads((folder / "outcomes" / f"{case.name}.json").read_text())["error"])


def counted(calls: list[int], case: Case, folder: Path) -> None:
    calls.append(case.number)
    worked(case, folder)


def test_a_case_with_an_outcome_is_not_repeated(tmp_path: Path) -> None:
    cases = [case_of(number) for number in range(4)]
    calls: list[int] = []
    heard: list[int] = []
    assert run_cases(cases[1:3], tmp_path, partial(counted, calls)) == RunSummary(2, 0, (), ())
    assert run_cases(cases, tmp_path, partial(counted, calls), progress=heard.append) == RunSummary(4, 2, (), ())
    assert calls == [1, 2, 0, 3]
    assert heard == [2, 3, 4]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["outcomes", "sealed"]


def test_a_case_with_a_truncated_outcome_is_repeated(tmp_path: Path) -> None:
    case = case_of(0)
    run_cases([case], tmp_path, worked)
    whole = written(tmp_path)
    outcome = tmp_path / "outcomes" / f"{case.name}.json"
    outcome.write_bytes(outcome.read_bytes()[:-20])
    assert run_cases([case], tmp_path, worked).before == 0
    assert written(tmp_path) == whole


def test_an_error_is_the_outcome_of_its_case_alone(tmp_path: Path) -> None:
    plans = ("raise", "work", "leave", "nothing", "work")
    cases = [case_of(number, plan) for number, plan in enumerate(plans)]
    ran = run_cases(cases, tmp_path, worked)
    assert ran == RunSummary(5, 0, tuple(cases[number].name for number in (0, 2, 3)), ())
    assert [error_of(tmp_path, case) for case in cases] == [
        "ValueError: no such thing",
        "",
        "SystemExit: 3",
        "it wrote no outcome",
        "",
    ]


def test_cases_with_errors_are_repeated_on_request(tmp_path: Path) -> None:
    cases = [case_of(0, "raise"), case_of(1)]
    run_cases(cases, tmp_path, worked)
    calls: list[int] = []
    mended = [case_of(0), cases[1]]
    assert run_cases(mended, tmp_path, partial(counted, calls)).before == 2
    assert calls == []
    assert run_cases(mended, tmp_path, partial(counted, calls), again=True) == RunSummary(2, 1, (), ())
    assert calls == [0]
    assert error_of(tmp_path, cases[0]) == ""


def test_two_cases_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="one name"):
        run_cases([case_of(0), case_of(0, "slow")], tmp_path, worked)


class Places(ThreadPoolExecutor):
    """Threads, and the number of simultaneous calls."""

    deaths: tuple[type[Exception], ...] = ()

    def __init__(self, places: list[int]) -> None:
        super().__init__(16)
        self._places, self._lock, self._out, self.most = places, threading.Lock(), 0, [0]

    @property
    def places(self) -> int:
        """The next number of places; the last number is repeated."""
        if len(self._places) > 1:
            self.most.append(0)
            return self._places.pop(0)
        return self._places[0]

    def submit(self, job: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        with self._lock:
            self._out += 1
            self.most[-1] = max(self.most[-1], self._out)
        future = super().submit(job, *args, **named)
        future.add_done_callback(self._back)
        return future

    def _back(self, future: Future[Any]) -> None:
        with self._lock:
            self._out -= 1


@pytest.mark.parametrize(("places", "most"), [(3, 3), (0, 1)])
def test_simultaneous_cases_are_limited_to_the_places(tmp_path: Path, places: int, most: int) -> None:
    """A case waits for a free place."""
    cases = [case_of(number, "slow") for number in range(3 * most)]
    with Places([places]) as executor:
        assert run_cases(cases, tmp_path, worked, executor) == RunSummary(3 * most, 0, (), ())
    assert executor.most == [most]


def test_later_places_are_used(tmp_path: Path) -> None:
    cases = [case_of(number, "slow") for number in range(12)]
    with Places([1, 1, 4]) as executor:
        run_cases(cases, tmp_path, worked, executor)
    assert max(executor.most[:-1]) == 1
    assert executor.most[-1] == 4


@pytest.mark.slow
def test_results_do_not_depend_on_workers_or_their_deaths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that dies once loses no case, a case that kills two workers is lost, and all others have the same
    outcome.
    """
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])  # processes inherit the path from here, to import the job
    plans = ["work", "die once", "raise", "work", "die", "work", "die once", "work"]
    cases = [case_of(number, plan) for number, plan in enumerate(plans)]
    here, one, two = (tmp_path / name for name in ("here", "one", "two"))
    harmless = [case for case in cases if case.plan in ("work", "raise")]
    run_cases(harmless, here, worked)
    for folder, workers, order in ((one, 1, cases), (two, 2, cases[::-1])):
        with executor_of("processes", workers) as executor:
            ran = run_cases(order, folder, worked, executor)
        assert ran == RunSummary(8, 0, (cases[2].name,), (cases[4].name,))
        assert error_of(folder, cases[4]) == "its worker died twice"
        assert (folder / "die-4").read_bytes() == b".."
        assert not (folder / "begun").exists()
    assert written(one) == written(two)
    assert written(here).items() <= written(one).items()
    assert len(written(one)) == 8 + 6  # errors have no sealed file


class Dying(Places):
    """An executor whose workers die before they begin."""

    deaths = (BrokenProcessPool,)

    def submit(self, job: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(BrokenProcessPool("gone"))
        return future


def test_workers_that_do_not_start_stop_the_run(tmp_path: Path) -> None:
    """Cases that were not tried are not lost."""
    with Dying([2]) as executor, pytest.raises(ImuArrayError, match="die before they begin: BrokenProcessPool: gone"):
        run_cases([case_of(0), case_of(1)], tmp_path, worked, executor)
    assert written(tmp_path) == {}


def test_a_folder_that_workers_cannot_read_stops_the_run(tmp_path: Path) -> None:
    def taken_away(done: int) -> None:
        (tmp_path / "begun").rmdir()

    with pytest.raises(ImuArrayError, match="can't begin: FileNotFoundError"), Places([1]) as executor:
        run_cases([case_of(0)], tmp_path, worked, executor, progress=taken_away)


def test_an_interrupt_prints_how_to_resume_and_the_run_can_be_resumed(tmp_path: Path) -> None:
    cases = [case_of(number) for number in range(5)]

    def stop(done: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match=r"^2 of 5 cases are done; run the same command again to continue$"):
        run_cases(cases, tmp_path, worked, progress=stop)
    assert run_cases(cases, tmp_path, worked) == RunSummary(5, 2, (), ())


PROGRAM = """
import signal
import sys
from pathlib import Path
from imuarray.validation.running import executor_of, run_cases
from tests.validation.jobs import case_of, worked

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background
    cases = [case_of(0), *(case_of(number, "wait to be killed") for number in range(1, 9))]
    with executor_of("processes", 2) as executor:
        run_cases(cases, Path(sys.argv[1]), worked, executor)
"""


@pytest.mark.slow
def test_ctrl_c_ends_all_processes(tmp_path: Path) -> None:
    """The terminal sends it to the whole group."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    folder = tmp_path / "run"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(program), str(folder)]
    with subprocess.Popen(
        command, env=environment, start_new_session=True, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            pids = [read_when_there(folder / f"wait to be killed-{number}") for number in (1, 2)]
            os.killpg(process.pid, signal.SIGINT)
            errors = process.communicate(timeout=60)[1]
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    assert errors.rstrip().endswith("KeyboardInterrupt: 1 of 9 cases are done; run the same command again to continue")
    assert [path.name for path in (folder / "outcomes").iterdir()] == [f"{case_of(0).name}.json"]
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def read_when_there(path: Path) -> int:
    for _ in range(600):
        if path.exists():
            return int(path.read_text())
        time.sleep(0.1)
    raise TimeoutError(path)


@pytest.mark.parametrize(
    "text", ["", "threads", "tcp://", "tcp://here", "http://here:1", "tcp://here:1/x", "processes "]
)
def test_an_unknown_executor_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="neither processes nor the tcp://host:port"), executor_of(text, 1):
        pass


def test_a_cluster_without_its_extra_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(MissingExtraError, match=r"distributed.*imuarray\[cluster\]"),
        executor_of("tcp://127.0.0.1:1", 1),
    ):
        pass


def test_zero_processes_are_refused() -> None:
    with pytest.raises(ValueError, match="max_workers"):
        Processes(0)
