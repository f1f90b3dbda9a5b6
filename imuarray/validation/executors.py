"""Executors for cases: processes of this machine, or the workers of a Dask cluster.

Both report in which case a worker died. A `ProcessPoolExecutor` cannot: when one of its processes dies, all submitted
calls fail. Each process here is therefore a pool of its own. A cluster's scheduler reassigns the cases of a lost worker
and gives up after Dask's `allowed-failures`: by default at the fourth death.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from importlib import import_module
from threading import local
from typing import Any, Protocol

from imuarray.errors import ConfigError, ImuArrayError, MissingExtraError
from imuarray.gap.model.workers import Pool, processes

_ADDRESS = re.compile(r"tcp://[^\s/:@]+:\d{1,5}")
_CONNECT_S = 10.0


class Workers(Protocol):
    """An executor that reports how many calls it runs in parallel, and that a worker died."""

    @property
    def places(self) -> int:
        """The number of calls that run in parallel now; 0 if all have to wait."""

    @property
    def deaths(self) -> tuple[type[Exception], ...]:
        """The exceptions that the future of a call raises when its worker died."""

    def submit(self, job: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Submit a call as `concurrent.futures.Executor.submit` does."""


@contextmanager
def executor_of(text: str, workers: int) -> Iterator[Workers]:
    """Return the executor of a name: "processes", with `workers` processes of one BLAS thread each, or a Dask
    scheduler's address, "tcp://host:port", with all its workers.

    A cluster's workers need this version of the package and the same folder under the same path; one thread each (`dask
    worker --nthreads 1`), since a death costs the calls of all threads; and one BLAS thread, which is Dask's default
    without --no-nanny. ConfigError for another text, MissingExtraError without Dask, ImuArrayError if no scheduler
    answers.
    """
    if text == "processes":
        with Processes(workers) as here:
            yield here
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
        """Finish the calls that have started, as every executor does."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait, cancel_futures=cancel_futures)


class Cluster:
    """The workers of a Dask scheduler, through its `distributed.Client`."""

    def __init__(self, client: Any) -> None:
        self.deaths: tuple[type[Exception], ...] = (import_module("distributed").KilledWorker,)
        self._client = client
        self._executor = client.get_executor(pure=False)  # the same call twice is meant, for the sake of its files

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


def _client(address: str) -> Any:
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise MissingExtraError("distributed", "cluster") from None
    try:
        return distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, OverflowError) as error:
        raise ImuArrayError(f"{address}: no Dask scheduler answers there: {error}") from None
