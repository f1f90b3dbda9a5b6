"""Run many cases over an executor. A run can be resumed, and if a worker dies, only its case is lost.

A case is submitted with a folder's path and returns its state. The worker writes the files of the case, completely or
not at all; they do not depend on the worker, the number of workers or the order.

A worker may die because of its case (memory, a crash of compiled code) or for another reason. Each start of a case is
first recorded in the folder, so that no case starts a third time, whether this process or a cluster's scheduler
resubmits it.

The cases run in processes of this machine or in the workers of a Dask cluster. Both report in which case a worker died.
A `ProcessPoolExecutor` cannot: when one of its processes dies, all submitted calls fail. Each process here is therefore
a pool of its own. A cluster's scheduler reassigns the cases of a lost worker and gives up after Dask's
`allowed-failures`: by default at the fourth death.
"""

from __future__ import annotations

import json
import re
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from threading import local
from typing import Any, Literal

from imuarray.errors import ConfigError, ImuArrayError, MissingExtraError
from imuarray.gap.model.workers import Pool, processes
from imuarray.validation.case import Case, Outcome, write_json

_ADDRESS = re.compile(r"tcp://[^\s/:@]+:\d{1,5}")
_CONNECT_S = 10.0


@contextmanager
def executor_of(text: str, workers: int) -> Iterator[Workers]:
    """Yield the executor of a name: "processes", with `workers` processes of one BLAS thread each, or a Dask
    scheduler's address, "tcp://host:port", with all its workers.

    A cluster's workers need this version of the package and the same folder under the same path; one thread each (`dask
    worker --nthreads 1`), because the calls of all threads are lost with a worker; and one BLAS thread, which is Dask's
    default without --no-nanny. ConfigError for another text, MissingExtraError without Dask, ImuArrayError if no
    scheduler answers.
    """
    if text == "processes":
        with Processes(workers) as own:
            yield own
    elif _ADDRESS.fullmatch(text):
        with closing(_client(text)) as client:
            yield Cluster(client)
    else:
        raise ConfigError(f"executor {text!r}: neither processes nor the tcp://host:port of a Dask scheduler")


class Processes(Executor):
    """Processes with one BLAS thread each, started on demand; a process that dies is replaced. An exception in the
    manager's block, including KeyboardInterrupt, ends them at once.
    """

    deaths = (BrokenExecutor,)

    def __init__(self, workers: int) -> None:
        self.places = workers
        self._threads = ThreadPoolExecutor(workers)
        self._own = local()
        self._pools: list[Pool] = []

    def submit(self, job: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        """Submit a call to the next idle process."""
        return self._threads.submit(self._call, partial(job, *args, **named))

    def _call(self, job: Callable[[], Any]) -> Any:
        """Run the call in the process of this thread."""
        if getattr(self._own, "pool", None) is None:
            self._own.pool = processes(1)
            self._pools.append(self._own.pool)
        try:
            return self._own.pool.submit(job).result()
        except BrokenExecutor:
            self._own.pool = None
            raise

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Wait for the submitted calls, unless the block failed."""
        if kind is not None:
            self._threads.shutdown(wait=False, cancel_futures=True)
            for pool in self._pools:
                pool.terminate()
        self.shutdown()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the calls that have started, as every executor does."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait, cancel_futures=cancel_futures)


class Cluster:
    """The workers of a Dask scheduler, through its `distributed.Client`."""

    def __init__(self, client: Any) -> None:
        self.deaths: tuple[type[Exception], ...] = (import_module("distributed").KilledWorker,)
        self._client = client
        self._executor = client.get_executor(pure=False)  # equal calls must all run, because they write files

    @property
    def places(self) -> int:
        """The threads of all workers. ImuArrayError if the scheduler is gone."""
        try:
            return sum(self._client.nthreads().values())
        except OSError as error:
            raise ImuArrayError(f"the scheduler has ended: {error}; run the same command again to continue") from None

    def submit(self, job: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Submit a call to the worker that the scheduler chooses."""
        future: Future[Any] = self._executor.submit(job, *args)
        return future


class InlineExecutor:
    """An executor that runs each call at once in this process."""

    places = 1
    deaths = ()

    def submit(self, job: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Run the call and return its completed future; an exception of the call is raised here."""
        future: Future[Any] = Future()
        future.set_result(job(*args))
        return future


Workers = Processes | Cluster | InlineExecutor
"""An executor that states how many calls it runs in parallel now (`places`; 0 if all have to wait), and which
exceptions the future of a call raises when its worker died (`deaths`).
"""


def _client(address: str) -> Any:
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise MissingExtraError("distributed", "cluster") from None
    try:
        return distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, OverflowError) as error:
        raise ImuArrayError(f"{address}: no Dask scheduler answers there: {error}") from None


__all__ = ["LOST", "Job", "RunSummary", "State", "executor_of", "run_cases"]

Job = Callable[[Case, Path], None]
"""A module-level function that runs a case and writes sealed/NAME.json and, last, outcomes/NAME.json into the folder.
The files depend on the case alone.
"""
State = Literal["done", "failed", "lost"]

LOST = "its worker died twice"
"""The `error` in the outcome of a lost case."""

_MOST_STARTS = 2
_LOOK_S = 5.0
"""Interval at which the size of a cluster is queried while nothing finishes."""


@dataclass(frozen=True)
class RunSummary:
    """The summary of a run: the number of `cases`, the number that already had an outcome `before`, the names of those
    that `failed` with an error now, and of those `lost` with their workers.
    """

    cases: int
    before: int
    failed: tuple[str, ...]
    lost: tuple[str, ...]


def run_cases(
    cases: Sequence[Case],
    folder: Path,
    job: Job,
    executor: Workers | None = None,
    *,
    again: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> RunSummary:
    """Run every case that has no outcome in `folder` (`again`: or an error) on `executor` (None: in this process with
    its own number of BLAS threads). `progress` receives the number of finished cases.

    An exception in a case becomes the `error` of its outcome (its `seconds` are 0) and stops no other case. A case
    whose worker died is tried once more; with processes after all others, alone. If its worker dies again, it is lost.
    ImuArrayError if workers cannot start or are lost for good, ValueError for two cases of one name. Finished cases
    remain then and after a KeyboardInterrupt, whose text says how to continue.
    """
    folder = folder.resolve()
    if len({case.name for case in cases}) < len(cases):
        raise ValueError("two cases have one name")
    _make_folders(folder)
    todo = _find_unfinished(cases, folder, again)
    before = len(cases) - len(todo)
    states: dict[str, State] = {}
    try:
        with closing(_run_until_finished(todo, executor or InlineExecutor(), job, folder)) as worked:
            progress(before)
            for case, state in worked:
                states[case.name] = state
                progress(before + len(states))
    except KeyboardInterrupt:
        done = f"{before + len(states)} of {len(cases)} cases are done"
        raise KeyboardInterrupt(f"{done}; run the same command again to continue") from None
    with suppress(OSError):
        _mark(folder).rmdir()
    failed, lost = (tuple(sorted(name for name in states if states[name] == state)) for state in ("failed", "lost"))
    return RunSummary(len(cases), before, failed, lost)


def _make_folders(folder: Path) -> None:
    """Create the folders and delete the marks of an earlier run."""
    for part in (folder / "outcomes", folder / "sealed", _mark(folder)):
        part.mkdir(parents=True, exist_ok=True)
    for mark in _mark(folder).iterdir():
        mark.unlink()


def _find_unfinished(cases: Sequence[Case], folder: Path, again: bool) -> list[Case]:
    """Return the cases without an outcome. With `again` an outcome with an error is deleted first."""
    todo = []
    for case in cases:
        state = _state(case, folder)
        if state is not None and state != "done" and again:
            _outcome(case, folder).unlink()
            state = None
        if state is None:
            todo.append(case)
    return todo


def _run_until_finished(
    cases: Sequence[Case], workers: Workers, job: Job, folder: Path
) -> Generator[tuple[Case, State], None, None]:
    """Yield each case when it finishes. No more are submitted than run in parallel, so that few are lost on exit."""
    waiting, again, deaths = deque(cases), deque[Case](), Counter[str]()
    running: dict[Future[State], Case] = {}
    try:
        while waiting or again or running:
            if not waiting and not running:
                waiting.append(again.popleft())
            for _ in range(min(len(waiting), max(workers.places, 1) - len(running))):
                case = waiting.popleft()
                running[workers.submit(_attempt, job, case, folder)] = case
            for future in wait(running, _LOOK_S, FIRST_COMPLETED).done:
                case = running.pop(future)
                state = _state_of_future(future, case, folder, workers, deaths)
                if state is None:
                    again.append(case)
                else:
                    yield case, state
    finally:
        for future in running:
            future.cancel()


def _state_of_future(
    future: Future[State], case: Case, folder: Path, workers: Workers, deaths: Counter[str]
) -> State | None:
    """Return a submitted case's state; None if it must be submitted again. `deaths` counts dead workers by case."""
    try:
        return future.result()
    except CancelledError:
        raise ImuArrayError(
            f"{case.name}: cancelled: has the scheduler ended? Run the same command again to continue"
        ) from None
    except workers.deaths as error:
        deaths[case.name] += 1
        starts = _starts(case, folder)
        if starts >= _MOST_STARTS:
            return _finish(case, folder, LOST)
        if deaths[case.name] - starts >= _MOST_STARTS:
            raise ImuArrayError(f"{case.name}: workers die before they begin: {_line(error)}") from error
        return None
    except Exception as error:
        raise ImuArrayError(f"{case.name}: a worker can't begin: {_line(error)}") from error


def _attempt(job: Job, case: Case, folder: Path) -> State:
    """Run a case in the worker. A case may already be finished if its worker died before it reported the result."""
    state = _state(case, folder)
    if state is not None:
        return state
    if _starts(case, folder) >= _MOST_STARTS:
        return _finish(case, folder, LOST)
    with _mark(folder, case).open("ab") as beginnings:
        beginnings.write(b".")
    try:
        job(case, folder)
    except (Exception, SystemExit) as error:
        return _finish(case, folder, _line(error))
    return _finish(case, folder, "" if _outcome(case, folder).exists() else "it wrote no outcome")


def _finish(case: Case, folder: Path, error: str) -> State:
    """Write an error as outcome and delete the mark."""
    if error:
        write_json(_outcome(case, folder), asdict(Outcome(case.name, {}, {}, 0.0, error)))
    _mark(folder, case).unlink(missing_ok=True)
    return _error_state(error)


def _state(case: Case, folder: Path) -> State | None:
    """Return the state from the outcome file; None if there is no readable file."""
    try:
        return _error_state(json.loads(_outcome(case, folder).read_text())["error"])
    except (FileNotFoundError, ValueError):
        return None


def _error_state(error: str) -> State:
    return "lost" if error == LOST else "failed" if error else "done"


def _outcome(case: Case, folder: Path) -> Path:
    return folder / "outcomes" / f"{case.name}.json"


def _mark(folder: Path, case: Case | None = None) -> Path:
    """Return the file that has one byte for each start of the case, or the folder of these files."""
    return folder / "begun" / (case.name if case else "")


def _starts(case: Case, folder: Path) -> int:
    try:
        return _mark(folder, case).stat().st_size
    except FileNotFoundError:
        return 0


def _line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
