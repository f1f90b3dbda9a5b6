"""Logs that a simulation writes: one, a log for each boot of a turn-on series, or one like a recorded log."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from imuarray.array import ArrayConfig
from imuarray.errors import ConfigError
from imuarray.log import Log
from imuarray.simulate.effect import Effect
from imuarray.simulate.experiments import EXPERIMENTS, ExperimentOptions
from imuarray.simulate.model import Model
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.simulation import Plan, in_physical_order, plan_like, plan_of
from imuarray.spelling import guess


@dataclass(frozen=True)
class BootRun:
    """One log to write: where, of what, and which boot of the units it is."""

    path: Path
    plan: Plan
    motion: Motion
    boot: int


def run_like(log: Log, path: Path, only: Collection[str], boot: int) -> BootRun:
    """A log with the sensors, times, faces and temperature of another; LogError for a sensor that it does not have."""
    return BootRun(path, plan_like(log, only), LikeLog(log), boot)


def turn_on_series(
    array: ArrayConfig, path: Path, wanted: ExperimentOptions, rate_hz: float, boots: Sequence[int]
) -> list[BootRun]:
    """The logs of a turn-on series, one for each of the `boots`: SIM_01.h5, SIM_02.h5, ... in the folder of `path`."""
    digits = max(2, len(str(len(boots))))
    listed = []
    for k, boot in enumerate(boots, 1):
        numbered = path.with_name(f"{path.stem}_{k:0{digits}}{path.suffix}")
        listed.append(run_of(array, numbered, "turn-on", replace(wanted, run=k), rate_hz=rate_hz, boot=boot))
    return listed


def run_of(
    array: ArrayConfig, path: Path, experiment: str, wanted: ExperimentOptions, *, rate_hz: float, boot: int
) -> BootRun:
    """One log of one of `EXPERIMENTS`; of a turn-on series the run `wanted.run`."""
    motion = EXPERIMENTS[experiment](wanted)
    return BootRun(path, plan_of(array, rate_hz, wanted.seconds or motion.seconds), motion, boot)


def with_effects(
    effects: Mapping[str, Sequence[Effect]], added: Mapping[str, Sequence[Effect]]
) -> dict[str, tuple[Effect, ...]]:
    """The effects of each sensor with those `added`, in physical order; ConfigError for a sensor that there is not."""
    for name in added:
        if name not in effects:
            raise ConfigError(f"effects of {name!r}: the array has {', '.join(effects)}{guess(name, effects)}")
    return {name: in_physical_order((*known, *added.get(name, ()))) for name, known in effects.items()}


def remarks_on(plan: Plan, model: Model, log: Log | None, *, population: bool) -> Iterator[str]:
    """Sentences on what a model leaves out, what of it is for nobody, and a recorded log that does not say how the box
    moved.
    """
    triads = {name: header for name, (header, _) in plan.sensors.items() if header.quantity != "pressure"}
    ideal = [name for name, header in triads.items() if not model.parts(header, population=population)]
    if ideal:
        yield f"model {model.name} has no parameters for {', '.join(ideal)}: simulated as ideal"
    idle = sorted({part.name for part in model.sensors} - set(plan.sensors))
    if idle and len(idle) == len({part.name for part in model.sensors}):
        yield f"model {model.name}: its sensors {', '.join(idle)} are not in this array"
    if log is not None and log.truth is None and log.reference is None:
        yield f"{log.path} does not say how the box moved: simulated at rest on the faces of its phases"
