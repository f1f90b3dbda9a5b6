"""One job for many items: results do not depend on workers, and a process keeps its fixed data."""

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
    """Counts its uses."""

    def __init__(self) -> None:
        self.used = 0


def power(base: int, exponent: int) -> int:
    return int(base**exponent)


def use(heavy: Heavy, item: int) -> int:
    heavy.used += 1
    return heavy.used


def test_results_are_in_order_for_any_workers() -> None:
    wanted = [1, 3, 9, 27, 81]
    assert runner(3)(power, range(5)) == wanted
    with ThreadPoolExecutor(3) as threads:
        assert runner(3, threads)(power, range(5)) == wanted


def test_a_progress_bar_is_updated_with_the_number_done() -> None:
    heard: list[int] = []

    @contextmanager
    def bar(length: int) -> Iterator[Callable[[int], None]]:
        heard.append(length)
        yield heard.append

    assert runner(2, bar=bar)(power, [5, 6, 7]) == [32, 64, 128]
    assert heard == [3, 1, 2, 3]


@pytest.mark.slow
def test_a_process_keeps_fixed_data() -> None:
    """An existing generator continues; unpickled for every item it would repeat its first number. Another runner has
    its own.
    """
    generator = Random(1)
    wanted = [generator.getrandbits(32) for _ in range(4)]
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        run = runner(Random(1), pool)
        assert run(Random.getrandbits, [32] * 3) == wanted[:3]
        assert run(Random.getrandbits, [32]) == wanted[3:]
        assert runner(Random(1), pool)(Random.getrandbits, [32] * 2) == wanted[:2]


@pytest.mark.slow
def test_processes_have_one_thread_each_and_the_environment_is_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    """By their environment from the start, for any environment of the parent."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with processes(2) as pool:
        for name, value in (("OMP_NUM_THREADS", "1"), ("OPENBLAS_NUM_THREADS", "1"), ("HOME", os.environ["HOME"])):
            assert runner(name, pool)(os.getenv, ["nothing"] * 4) == [value] * 4
        assert [os.getenv(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")] == ["7", None]


def test_a_pool_of_zero_processes_is_refused() -> None:
    with pytest.raises(ValueError, match="max_workers"):
        processes(0)


def test_only_the_last_job_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_an_interrupt_ends_running_work_at_once() -> None:
    """Both processes would run for an hour when Ctrl-C ends the block of the context manager."""
    pool = processes(2)
    with pytest.raises(KeyboardInterrupt), pool:
        pool.submit(sleep, 0.0).result()
        futures = [pool.submit(sleep, 3600.0) for _ in range(5)]
        started = list(pool._processes.values())
        raise KeyboardInterrupt
    assert [process.is_alive() for process in started] == [False, False]
    assert all(future.done() for future in futures)
