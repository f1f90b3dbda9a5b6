"""One job for many items: who works doesn't matter, and what a process has is not made again."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from random import Random

import pytest

from imuarray.gap import workers
from imuarray.gap.workers import processes, run


class Heavy:
    """Counts how often it is used."""

    def __init__(self) -> None:
        self.used = 0


def power(base: int, exponent: int) -> int:
    return int(base**exponent)


def use(heavy: Heavy, item: int) -> int:
    heavy.used += 1
    return heavy.used


def test_results_come_in_order_whoever_works() -> None:
    job, wanted = partial(power, 3), [1, 3, 9, 27, 81]
    assert list(run(None, job, range(5))) == wanted
    with ThreadPoolExecutor(3) as threads:
        assert list(run(threads, job, range(5))) == wanted


def test_without_an_executor_nothing_is_done_before_it_is_asked_for() -> None:
    heavy = Heavy()
    results: Iterator[int] = run(None, partial(use, heavy), range(3))
    assert heavy.used == 0
    assert next(results) == 1


@pytest.mark.slow
def test_a_process_keeps_the_job() -> None:
    """A generator that is there already goes on; unpickled anew for every item it would repeat its first number."""
    generator = Random(1)
    wanted = [generator.uniform(0.0, 1.0) for _ in range(4)]
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        assert list(run(pool, partial(Random(1).uniform, 0.0), [1.0] * 4)) == wanted
        assert list(run(pool, partial(Random(1).uniform, 0.0), [1.0] * 2)) == wanted[:2]


@pytest.mark.slow
def test_processes_have_one_thread_each_and_nothing_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """As their environment says from the start, whatever that of the parent is."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    names = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "HOME"]
    with processes(2) as pool:
        assert list(run(pool, os.getenv, names * 4)) == ["1", "1", os.environ["HOME"]] * 4
        assert [os.getenv(name) for name in names[:2]] == ["7", None]


def test_no_process_is_no_pool() -> None:
    with pytest.raises(ValueError, match="max_workers"):
        processes(0)


def test_the_last_job_alone_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_LATEST", {})
    first, second = (pickle.dumps(workers._Sent(partial(use, Heavy()))) for _ in range(2))
    job = pickle.loads(first)  # noqa: S301
    assert pickle.loads(first) is job  # noqa: S301
    assert [job(0), job(0)] == [1, 2]
    assert pickle.loads(second) is not job  # noqa: S301
    assert list(workers._LATEST.values()) != [job]
    assert len(workers._LATEST) == 1
    assert pickle.loads(first)(0) == 1  # noqa: S301
