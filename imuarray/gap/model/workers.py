"""The same job for many items, side by side: in threads, in processes, or on other machines.

A job's fixed part (what was recorded, what it is compared with) is large beside an item, which is a number. It goes to
a process with every item as bytes, which are read only by a process that doesn't have it yet: whatever a process opened
or worked out for the first item serves for the others.

Matrices are small here: threads of the linear algebra library (BLAS) would wake for nothing, and where several
processes each have as many as there are cores, wait for each other. Processes started here have one thread each.
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

Item = TypeVar("Item")
Result = TypeVar("Result")
Bar = Callable[[int], AbstractContextManager[Callable[[int], None]]]

_ONE_THREAD: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1")
)
"""Read by the usual libraries when numpy is imported, and never again: a process has to be born with them."""

_STARTING = Lock()
_LOOK_S = 2.0

_LATEST: dict[str, Callable[[Any], Any]] = {}
"""The job that came to this process last, by its name."""


def processes(workers: int) -> Pool:
    """So many processes for `runner`, started when they are needed, with one BLAS thread each; a context manager.

    Each imports the program's main module anew (start method "spawn"), which may do nothing then but define things.
    Whatever raises an exception in the manager's block, KeyboardInterrupt too, ends them at once; they take no notice
    of Ctrl-C themselves. ValueError for fewer than one.
    """
    return Pool(workers, _Context(), _watch, (os.getpid(),))


class Pool(ProcessPoolExecutor):
    """Processes that an exception in the manager's block ends at once."""

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            self.shutdown(wait=True)
        else:
            self.terminate()

    def terminate(self) -> None:
        """End all processes, whatever they work on, and wait until they are gone; their futures fail."""
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
    """A process ends when the one that started it is gone: nobody would take its results."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def look() -> None:
        while os.getppid() == parent:
            sleep(_LOOK_S)
        os._exit(1)

    Thread(target=look, daemon=True).start()


class Run(Protocol):
    """Calls a function of something fixed and one item for each item, maybe side by side."""

    def __call__(self, job: Callable[[Any, Any], Any], items: Sequence[Any]) -> list[Any]:
        """The results, in the items' order."""


def no_bar(length: int) -> AbstractContextManager[Callable[[int], None]]:
    """A bar that nobody sees."""
    return nullcontext(lambda done: None)


def runner(fixed: object, executor: Executor | None = None, bar: Bar = no_bar) -> Run:
    """What calls functions of modules with `fixed`, which every process gets once, and one item after the other; the
    results in the items' order. `bar` makes, for a number of items, what is told how many are done.
    """
    sent = _Sent(partial(_applied, fixed))

    def call(job: Callable[[Any, Any], Any], items: Sequence[Any]) -> list[Any]:
        asked = [(job, item) for item in items]
        found = []
        with bar(len(asked)) as tell:
            for result in map(sent, asked) if executor is None else executor.map(sent, asked):
                found.append(result)
                tell(len(found))
        return found

    return call


def _applied(fixed: Any, asked: tuple[Callable[[Any, Any], Any], Any]) -> Any:
    job, item = asked
    return job(fixed, item)


class _Sent(Generic[Item, Result]):
    """A job that a process keeps."""

    def __init__(self, job: Callable[[Item], Result]) -> None:
        self._job, self._name = job, uuid4().hex

    def __call__(self, item: Item) -> Result:
        return self._job(item)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str, bytes]]:
        return _kept, (self._name, self._packed)

    @cached_property
    def _packed(self) -> bytes:
        return bytes(ForkingPickler.dumps(self._job))


def _kept(name: str, packed: bytes) -> Callable[[Any], Any]:
    """The job of this name as it came first; nothing of the ones before it is kept."""
    if name not in _LATEST:
        _LATEST.clear()
        _LATEST[name] = ForkingPickler.loads(packed)
    return _LATEST[name]


class _Process(SpawnProcess):
    """Starts with `_ONE_THREAD` in its environment; Ctrl-C is its parent's business from the first moment on."""

    def start(self) -> None:
        with _STARTING, _environment(_ONE_THREAD), _without_interrupts():
            super().start()


class _Context(SpawnContext):
    """Makes such processes."""

    Process = _Process


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """SIGINT waits until afterwards; a process that is started meanwhile has it blocked. Windows can't."""
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
    """`variables` set in this process's environment, and afterwards as they were."""
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
