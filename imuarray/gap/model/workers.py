"""Parallel execution of one job for many items: in threads, in processes, or on other machines.

The fixed part of a job (the recording and its model) is large compared with an item, which is a number. It is sent as
bytes with every item, and a process decodes the bytes only if it does not have the job yet, so that files opened and
results computed for the first item are reused for the others.

Matrices are small here: several threads of the linear algebra library (BLAS) would not make them faster, and several
processes with one thread per core would wait for each other. Processes started here therefore use one thread each.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cached_property, partial
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.reduction import ForkingPickler
from threading import Lock, Thread
from time import sleep
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar
from uuid import uuid4

from imuarray.heap import keep_freed_memory

Item = TypeVar("Item")
Result = TypeVar("Result")
Bar = Callable[[int], AbstractContextManager[Callable[[int], None]]]

_ONE_THREAD: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1")
)
"""Environment variables for one thread. The usual libraries read them once, when numpy is imported, so a process has to
start with them.
"""

_STARTING = Lock()
_LOOK_S = 2.0
"""Interval, in s, at which a process checks that its parent is running."""

_LATEST: dict[str, Callable[[Any], Any]] = {}
"""The latest job that this process received, by its name."""


def processes(workers: int) -> Pool:
    """Return a pool of processes for `runner`, started on demand, with one BLAS thread each; a context manager.

    Each process imports the program's main module again (start method "spawn"), so that module must have no side
    effects when imported. An exception in the manager's block, including KeyboardInterrupt, ends the processes at once;
    they ignore Ctrl-C themselves. ValueError for fewer than one worker.
    """
    return Pool(workers, _Context(), _watch, (os.getpid(),))


class Pool(ProcessPoolExecutor):
    """Pool whose processes are ended at once by an exception in the manager's block."""

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            self.shutdown(wait=True)
        else:
            self.terminate()

    def terminate(self) -> None:
        """End all processes even if they are working, and wait for them; their futures fail."""
        started = list((self._processes or {}).values())
        manager: Any = self._executor_manager_thread
        self.shutdown(wait=False, cancel_futures=True)
        for process in started:
            process.terminate()
        if manager is not None:
            manager.join()
        for process in started:
            process.join()


def _watch(parent: int) -> None:
    """Initialise a process: set up its heap, ignore Ctrl-C, and end it when its parent has ended, since its results
    would not be received.
    """
    keep_freed_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def look() -> None:
        while os.getppid() == parent:
            sleep(_LOOK_S)
        os._exit(1)

    Thread(target=look, daemon=True).start()


class Run(Protocol):
    """Callable that calls a job with a fixed argument and each item, possibly in parallel."""

    def __call__(self, job: Callable[[Any, Any], Any], items: Sequence[Any]) -> list[Any]:
        """Return the results in the order of the items."""


def no_bar(length: int) -> AbstractContextManager[Callable[[int], None]]:
    """Return a progress bar that shows nothing."""
    return nullcontext(lambda count: None)


def runner(fixed: object, executor: Executor | None = None, bar: Bar = no_bar) -> Run:
    """Return a callable that calls a module function with `fixed`, which every process decodes once, and each item.

    Results are in the order of the items. `bar` returns, for a number of items, a context manager whose function is
    called with the number of items done.
    """
    sent = _Job(partial(_apply, fixed))

    def call(job: Callable[[Any, Any], Any], items: Sequence[Any]) -> list[Any]:
        requests = [(job, item) for item in items]
        results = []
        with bar(len(requests)) as show_done:
            for result in map(sent, requests) if executor is None else executor.map(sent, requests):
                results.append(result)
                show_done(len(results))
        return results

    return call


def _apply(fixed: Any, request: tuple[Callable[[Any, Any], Any], Any]) -> Any:
    job, item = request
    return job(fixed, item)


class _Job(Generic[Item, Result]):
    """A job that a process caches by its name."""

    def __init__(self, job: Callable[[Item], Result]) -> None:
        self._job, self._name = job, uuid4().hex

    def __call__(self, item: Item) -> Result:
        return self._job(item)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str, bytes]]:
        return _unpack, (self._name, self._packed)

    @cached_property
    def _packed(self) -> bytes:
        return bytes(ForkingPickler.dumps(self._job))


def _unpack(name: str, packed: bytes) -> Callable[[Any], Any]:
    """Return the job of this name as first received; earlier jobs are dropped."""
    if name not in _LATEST:
        _LATEST.clear()
        _LATEST[name] = ForkingPickler.loads(packed)
    return _LATEST[name]


class _Process(SpawnProcess):
    """Process that starts with `_ONE_THREAD` in its environment and with Ctrl-C blocked; its parent handles Ctrl-C."""

    def start(self) -> None:
        with _STARTING, _environment(_ONE_THREAD), _without_interrupts():
            super().start()


class _Context(SpawnContext):
    """A spawn context whose processes are `_Process`."""

    Process = _Process


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block SIGINT during the context, also for processes that are started in it; no effect on Windows."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set `variables` in the environment of this process during the context, and restore them afterwards."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
