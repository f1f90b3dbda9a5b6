"""Allan deviation of 1e7 readings beside allantools.oadev: processor time, in turn, and memory beyond the series.

Processor time and not wall time, so that neither side gains by threads or loses by what else runs; the best of five
rounds, each of which takes both sides. Memory is the peak of what NumPy allocates, by tracemalloc.
"""

from __future__ import annotations

import time
import tracemalloc
import warnings
from collections.abc import Callable

import numpy as np
from compare import Row, row

from imuarray.characterise import allan_deviation
from imuarray.characterise.allan_curve import octaves

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # allantools warns of its own dependencies when it is imported
    import allantools

READINGS = 10_000_000
ROUNDS = 5

Run = Callable[[], object]


def seconds(runs: dict[str, Run]) -> dict[str, float]:
    """Least processor time of each run over all rounds."""
    best = dict.fromkeys(runs, float("inf"))
    for _ in range(ROUNDS):
        for name, run in runs.items():
            start = time.process_time()
            run()
            best[name] = min(best[name], time.process_time() - start)
    return best


def mebibytes(run: Run) -> float:
    """Peak of what is allocated meanwhile."""
    tracemalloc.start()
    run()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 2**20


def grid_rows(name: str, series: np.ndarray, factors: list[int]) -> list[Row]:
    """Time of both estimators on one series and one grid of averaging factors."""
    taus = np.array(factors, float)
    runs: dict[str, Run] = {
        "allantools": lambda: allantools.oadev(series, rate=1.0, data_type="freq", taus=taus),
        "overlapping": lambda: allan_deviation(series, 1.0, factors),
        "decimated": lambda: allan_deviation(series, 1.0, factors, estimator="decimated"),
    }
    best = seconds(runs)
    peer = best["allantools"]
    return [
        row(f"Allan deviation of 1e7 {name}, overlapping", best["overlapping"], peer, "CPU s", 1 / 3, "lower"),
        row(f"Allan deviation of 1e7 {name}, decimated", best["decimated"], peer, "CPU s", 1 / 8, "lower"),
    ]


def memory_rows(series: np.ndarray) -> list[Row]:
    """Memory of both estimators."""
    factors = list(octaves(len(series)))
    taus = np.array(factors, float)
    peer = mebibytes(lambda: allantools.oadev(series, rate=1.0, data_type="freq", taus=taus))
    exact = mebibytes(lambda: allan_deviation(series, 1.0, factors))
    decimated = mebibytes(lambda: allan_deviation(series, 1.0, factors, estimator="decimated"))
    return [
        row("memory for the Allan deviation of 1e7 floats, overlapping", exact, peer, "MiB", 0.5, "lower"),
        row("memory for the Allan deviation of 1e7 floats, decimated", decimated, peer, "MiB", 0.05, "lower"),
    ]


def rows() -> list[Row]:
    """Times on octaves and on 1, 2, 4 to a decade, for floats and for counts, and memory."""
    noise = np.random.default_rng(1).normal(0.0, 20.0, READINGS)
    counts = np.rint(noise).astype(np.int16)
    factors = list(octaves(READINGS))
    decades = [step * 10**power for power in range(7) for step in (1, 2, 4) if step * 10**power <= READINGS // 3]
    allan_deviation(noise[:1000], 1.0)  # what is imported when first needed
    return [
        *grid_rows("floats, octaves", noise, factors),
        *grid_rows("floats, decades", noise, decades),
        *grid_rows("counts, octaves", counts, factors),
        *memory_rows(noise),
    ]
