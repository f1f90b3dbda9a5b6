"""One job for many items: who works doesn't matter, and what a process has is not made again."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from random import Random
from time import sleep

import pytest

from imuarray.gap.model import workers
from imuarray.gap.model.workers import processes, runner


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
    wanted = [1, 3, 9, 27, 81]
    assert runner(3)(power, range(5)) == wanted
    with ThreadPoolExecutor(3) as threads:
        assert runner(3, threads)(power, range(5)) == wanted


def test_a_bar_hears_how_many_are_done() -> None:
    heard: list[int] = []

    @contextmanager
    def bar(length: int) -> Iterator[Callable[[int], None]]:
        heard.append(length)
        yield heard.append

    assert runner(2, bar=bar)(power, [5, 6, 7]) == [32, 64, 128]
    assert heard == [3, 1, 2, 3]


@pytest.mark.slow
def test_a_process_keeps_what_is_fixed() -> None:
    """A generator that is there already goes on; unpickled anew for every item it would repeat its first number.
    Another runner brings its own.
    """
    generator = Random(1)
    wanted = [generator.getrandbits(32) for _ in range(4)]
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        run = runner(Random(1), pool)
        assert run(Random.getrandbits, [32] * 3) == wanted[:3]
        assert run(Random.getrandbits, [32]) == wanted[3:]
        assert runner(Random(1), pool)(Random.getrandbits, [32] * 2) == wanted[:2]


@pytest.mark.slow
def test_processes_have_one_thread_each_and_nothing_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """As their environment says from the start, whatever that of the parent is."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with processes(2) as pool:
        for name, value in (("OMP_NUM_THREADS", "1"), ("OPENBLAS_NUM_THREADS", "1"), ("HOME", os.environ["HOME"])):
            assert runner(name, pool)(os.getenv, ["nothing"] * 4) == [value] * 4
        assert [os.getenv(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")] == ["7", None]


def test_no_process_is_no_pool() -> None:
    with pytest.raises(ValueError, match="max_workers"):
        processes(0)


def test_the_last_job_alone_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_LATEST", {})
    first, second = (pickle.dumps(workers._Job(partial(use, Heavy()))) for _ in range(2))
    job = pickle.loads(first)  # noqa: S301
    assert pickle.loads(first) is job  # noqa: S301
    assert [job(0), job(0)] == [1, 2]
    assert pickle.loads(second) is not job  # noqa: S301
    assert list(workers._LATEST.values()) != [job]
    assert len(workers._LATEST) == 1
    assert pickle.loads(first)(0) == 1  # noqa: S301


@pytest.mark.slow
def test_work_whose_results_nobody_wants_ends_at_once() -> None:
    """Both processes are at work for an hour when the manager's block is left by Ctrl-C."""
    pool = processes(2)
    with pytest.raises(KeyboardInterrupt), pool:
        pool.submit(sleep, 0.0).result()
        futures = [pool.submit(sleep, 3600.0) for _ in range(5)]
        started = list(pool._processes.values())
        raise KeyboardInterrupt
    assert [process.is_alive() for process in started] == [False, False]
    assert all(future.done() for future in futures)
