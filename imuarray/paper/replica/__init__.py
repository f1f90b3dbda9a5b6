"""The paper's experiments once more, on the simulated array: does the model repeat the tables to which it was fitted?

`replicate` simulates every experiment of section 4 and compares each printed statistic with its twin; columns that give
the same number in another unit (mg, dps) are compared once. No statistic is left out because it does not agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor

from imuarray.paper.replica import faces, others, runs
from imuarray.paper.replica.curves import Curves, curves_of
from imuarray.paper.replica.experiments import Observed, Progress, observe
from imuarray.paper.replica.page import render_text
from imuarray.paper.replica.statistic import Replica, Statistic, Summary
from imuarray.paper.replica.tabulate import tabulate

__all__ = [
    "Curves",
    "Observed",
    "Replica",
    "Statistic",
    "Summary",
    "compare",
    "curves_of",
    "observe",
    "render_text",
    "replicate",
]


def replicate(seed: int = 1, executor: Executor | None = None, progress: Progress | None = None) -> Replica:
    """All experiments with this seed, compared; `executor` shares them out, `progress` is told (done, all, what).

    The result depends on the seed alone.
    """
    return Replica(seed, tuple(compare(observe(seed, executor, progress))))


def compare(observed: Observed) -> Iterator[Statistic]:
    """Every statistic, table by table."""
    simulated = tabulate(observed)
    yield from others.nine(2, simulated[2])
    yield from faces.accelerometers(simulated[3])
    yield from faces.gyroscopes(simulated[4])
    yield from runs.five(simulated[5])
    yield from runs.by_run(6, "BMA1", simulated[6])
    yield from runs.by_run(7, "Gyro3", simulated[7])
    yield from others.eight(simulated[8])
    yield from others.nine(9, simulated[9])
    yield from faces.faces(simulated[10])
    yield from runs.eleven(simulated[11])
    yield from others.figures(observed)
    yield from others.text(observed, simulated[10], simulated[6])
