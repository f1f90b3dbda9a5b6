"""All runs of the study and what they tell together: ratios with intervals over the seeds."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from imuarray.fuse.fuse import AVERAGE
from imuarray.fuse.gains import Ratio, ratio_of
from imuarray.study.runs import EXPERIMENTS, Measured, run

Progress = Callable[[int, int, str], None]
"""Told how many runs are done, of how many, and which one was."""

SEEDS = 6
QUICK_SEEDS, QUICK_S = 2, 80.0

Job = tuple[str, int, float | None]


@dataclass(frozen=True)
class Row:
    """One measure of one technique, over all seeds.

    `value`: root mean square in SI (degrees of heading, m/s of velocity). `over_mean`: over that of the simple average
    of the same sensors; `over_bound`: over the bound ("rms" with the true calibration alone), the smoothed one for what
    sees the whole log, else the causal one. `normalised`: the
    mean error squared by the claimed covariance, and in what share of the runs that was in its interval ("rms").
    """

    experiment: str
    calibration: str
    sensors: str
    technique: str
    quantity: str
    measure: str
    box_axis: str
    value: float
    over_mean: Ratio
    over_bound: Ratio | None = None
    normalised: float | None = None
    consistent: float | None = None

    def as_json(self) -> dict[str, Any]:
        """JSON-ready; None for an end of an interval that one seed alone can't tell."""
        ratios = {name: _known(getattr(self, name)) for name in ("over_mean", "over_bound")}
        return {**vars(self), **ratios}


@dataclass(frozen=True)
class Study:
    """The rows, the seeds that they are over, and the length that was asked for (None: each experiment's own)."""

    rows: tuple[Row, ...]
    seeds: tuple[int, ...]
    seconds: float | None = None

    def of(self, **wanted: str) -> list[Row]:
        """The rows with these properties."""
        return [row for row in self.rows if all(getattr(row, name) == value for name, value in wanted.items())]

    def as_json(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "seeds": list(self.seeds),
            "experiments": {name: vars(EXPERIMENTS[name]) for name in dict.fromkeys(r.experiment for r in self.rows)},
            "seconds": self.seconds,
            "rows": [row.as_json() for row in self.rows],
        }


def study(
    experiments: Sequence[str] = tuple(EXPERIMENTS),
    seeds: int = SEEDS,
    *,
    seconds: float | None = None,
    executor: Executor | None = None,
    progress: Progress = lambda done, total, what: None,
) -> Study:
    """Every technique in these experiments with seeds 1 ... `seeds`; `executor` shares the runs out, and changes
    nothing else. `seconds`: of every log instead of its own length.
    """
    jobs: list[Job] = [(name, seed, seconds) for seed in range(1, seeds + 1) for name in experiments]
    measured: list[Measured] = []
    for done, (job, rows) in enumerate(zip(jobs, (executor.map if executor else map)(_ran, jobs), strict=True), 1):
        measured += rows
        progress(done, len(jobs), f"{job[0]}, seed {job[1]}")
    return Study(tuple(rows_of(measured)), tuple(range(1, seeds + 1)), seconds)


def _ran(job: Job) -> list[Measured]:
    """One job, where a process can find it."""
    return run(*job)


def rows_of(measured: Iterable[Measured]) -> list[Row]:
    """What runs tell together; boots of one seed share their calibration and count as one."""
    groups: dict[tuple[str, ...], list[Measured]] = defaultdict(list)
    for one in measured:
        groups[one.experiment, one.calibration, one.sensors, one.technique, one.quantity].append(one)
    rows = []
    for (experiment, calibration, sensors, technique, quantity), runs in groups.items():
        average = groups[experiment, calibration, sensors, AVERAGE, quantity]
        for measure, axis in runs[0].squares:
            before, after = (
                _by_seed(several, [one.squares[measure, axis] for one in several]) for several in (average, runs)
            )
            told = measure == "rms"
            least = _by_seed(runs, [one.bound[axis] for one in runs]) if told and runs[0].bound else None
            rows.append(
                Row(
                    experiment, calibration, sensors, technique, quantity, measure, axis,
                    value=math.sqrt(after.mean()),
                    over_mean=ratio_of(before, after),
                    over_bound=None if least is None else ratio_of(least, after),
                    normalised=_mean([one.normalised for one in runs]) if told else None,
                    consistent=_mean([one.holds for one in runs]) if told else None,
                )
            )  # fmt: skip
    return rows


def _by_seed(runs: Sequence[Measured], squares: Sequence[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Means of the runs' squares, one a seed."""
    found: dict[int, list[float]] = defaultdict(list)
    for one, square in zip(runs, squares, strict=True):
        found[one.replicate[0]].append(square)
    return np.array([np.mean(several) for several in found.values()])


def _mean(values: Sequence[float | None]) -> float | None:
    known = [float(value) for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _known(ratio: Ratio | None) -> dict[str, float | None] | None:
    if ratio is None:
        return None
    return {name: value if math.isfinite(value) else None for name, value in vars(ratio).items()}
