"""Who works on cases: processes of this machine, or the workers of a Dask cluster.

Both tell in which case a worker died. A `ProcessPoolExecutor` can't: where one of its processes dies, all that was
handed to it fails. So each process here is a pool of its own. A cluster's scheduler hands the cases of a lost worker to
the next one by itself, and gives them up as Dask's `allowed-failures` says: by default when four died.
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
    """An executor that knows how many calls it works on side by side, and tells that a worker died."""

    @property
    def places(self) -> int:
        """So many calls are worked on at once, now; 0 if all have to wait."""

    @property
    def deaths(self) -> tuple[type[Exception], ...]:
        """What a future raises whose worker died."""

    def submit(self, job: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """As `concurrent.futures.Executor.submit`."""


@contextmanager
def executor_of(text: str, workers: int) -> Iterator[Workers]:
    """The executor of a name: "processes", so many `workers` with one BLAS thread each, or a Dask scheduler's address,
    "tcp://host:port", with all workers that it has.

    A cluster's workers need this very version of the package and the same folder under the same path; one thread each
    (`dask worker --nthreads 1`), since a death costs what all threads are at; and one BLAS thread, which is what Dask
    gives them unless told --no-nanny. ConfigError for another text, MissingExtraError without Dask, ImuArrayError if no
    scheduler answers.
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
    """Processes with one BLAS thread each, started when they are needed; the place of one that died is filled again.
    An exception in the manager's block, KeyboardInterrupt too, ends them at once.
    """

    deaths = (BrokenExecutor,)

    def __init__(self, workers: int) -> None:
        self.places = workers
        self._threads = ThreadPoolExecutor(workers)
        self._own = local()
        self._pools: list[Pool] = []

    def submit(self, job: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        """To the next process that has nothing to do."""
        return self._threads.submit(self._call, partial(job, *args, **named))

    def _call(self, job: Callable[[], Any]) -> Any:
        """In the process of this thread."""
        if getattr(self._own, "pool", None) is None:
            self._own.pool = processes(1)
            self._pools.append(self._own.pool)
        try:
            return self._own.pool.submit(job).result()
        except BrokenExecutor:
            self._own.pool = None
            raise

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Waits for what was submitted, unless the block failed."""
        if kind is not None:
            self._threads.shutdown(wait=False, cancel_futures=True)
            for pool in self._pools:
                pool.terminate()
        self.shutdown()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As an executor does: what was begun is finished."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait, cancel_futures=cancel_futures)


class Cluster:
    """The workers of a Dask scheduler, by its `distributed.Client`."""

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
            raise ImuArrayError(f"the scheduler is gone: {error}; the same again goes on") from None

    def submit(self, job: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """To the worker that the scheduler chooses, or to the first that comes."""
        future: Future[Any] = self._executor.submit(job, *args)
        return future


class Here:
    """This process, at once."""

    places = 1
    deaths = ()

    def submit(self, job: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Done when it returns; what the call raises is raised here."""
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
