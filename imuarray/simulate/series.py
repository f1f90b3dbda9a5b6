"""Which logs a simulation writes: one, a log for each boot of a turn-on series, or one like a recorded log."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

from imuarray.array import ArrayConfig
from imuarray.log import Log
from imuarray.simulate.experiments import EXPERIMENTS, ExperimentOptions
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.simulation import Plan, plan_like, plan_of


@dataclass(frozen=True)
class Run:
    """One log to write: where, of what, and which boot of the units it is."""

    path: Path
    plan: Plan
    motion: Motion
    boot: int


def run_like(log: Log, path: Path, only: Collection[str], boot: int) -> Run:
    """A log with the sensors, times, faces and temperature of another; LogError for a sensor that it does not have."""
    return Run(path, plan_like(log, only), LikeLog(log), boot)


def runs_of(
    array: ArrayConfig, path: Path, experiment: str, wanted: ExperimentOptions, *, rate_hz: float, boot: int, runs: int
) -> list[Run]:
    """The logs of one of `EXPERIMENTS`; `runs` of a turn-on series, SIM_01.h5, SIM_02.h5, ... beside `path`."""
    if experiment != "turn-on":
        return [_run(array, path, EXPERIMENTS[experiment](wanted), rate_hz, wanted.seconds, boot)]
    digits = max(2, len(str(runs)))
    listed = []
    for k in range(1, runs + 1):
        numbered = path.with_name(f"{path.stem}_{k:0{digits}}{path.suffix}")
        motion = EXPERIMENTS[experiment](replace(wanted, run=k))
        listed.append(_run(array, numbered, motion, rate_hz, wanted.seconds, boot + k - 1))
    return listed


def _run(array: ArrayConfig, path: Path, motion: Motion, rate_hz: float, seconds: float | None, boot: int) -> Run:
    return Run(path, plan_of(array, rate_hz, seconds or motion.seconds), motion, boot)
