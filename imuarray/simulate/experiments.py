"""The experiments by name, each a motion and environment of the box with a configurable length.

They are the five experiments of the paper's section 4 and the following ones: a box at rest, tumbled, heated, switched
on repeatedly, moved. Without a length, each has the default length of its motion.

A simulation writes one log, a log for each boot of a turn-on series, or one like a recorded log.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from imuarray.array import ArrayConfig, parse_array
from imuarray.errors import ConfigError, LogError, SourceError
from imuarray.log import Log
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.model import Model
from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.motion.trajectory import load_trajectory
from imuarray.simulate.motion.tumble import ORDER, Tumble
from imuarray.simulate.motion.vehicle import Vehicle
from imuarray.simulate.simulation import Plan, in_physical_order, plan_like, plan_of
from imuarray.spelling import guess, guess_file

TURN_ON_S = 300.0
"""Duration of a run of a turn-on series (section 4)."""

_STATIC_S = 600.0
_TURN_S = 5.0
_REST_SHARE = 1 / 6
"""Share of the experiment's length during which the box is at rest at the beginning, and again at the end."""


@dataclass(frozen=True)
class ExperimentOptions:
    """The options of an experiment: its length in s (None: its own), the box axis that points up, the temperature, what
    moves the box ("hand", "vehicle" or a trajectory file), and which run of a series it is (1, 2, ...).
    """

    seconds: float | None = None
    up: str = "+Z"
    temperature_degc: float = 25.0
    drive: str = "hand"
    run: int = 1


def static(options: ExperimentOptions) -> Motion:
    """Return a box at rest."""
    return Still(options.up, options.seconds or _STATIC_S, options.temperature_degc)


def tumble(options: ExperimentOptions) -> Motion:
    """Return a tumble over seven faces; if the time is short, the turns are shortened, too."""
    faces = len(ORDER)
    temperatures = (options.temperature_degc,) * faces
    if options.seconds is None:
        return Tumble(temperatures_degc=temperatures)
    turn_s = min(_TURN_S, options.seconds / (4 * faces))
    return Tumble((options.seconds - (faces - 1) * turn_s) / faces, turn_s, temperatures)


def heating(options: ExperimentOptions) -> Motion:
    """Return the paper's temperature profile, all times scaled."""
    whole = Heating(up=options.up)
    return Heating(scale=options.seconds / whole.seconds, up=options.up) if options.seconds else whole


def turn_on(options: ExperimentOptions) -> Motion:
    """Return one run of a turn-on series."""
    return turn_on_run(options.run, options.seconds or TURN_ON_S, options.temperature_degc)


def motion(options: ExperimentOptions) -> Motion:
    """Return a box at rest, moved, and at rest again; or the motion that a file describes. SourceError for a file that
    can't be read.
    """
    if options.drive not in DRIVES:
        if not Path(options.drive).exists():
            near = guess(options.drive, DRIVES) or guess_file(options.drive)
            raise SourceError(
                f"{options.drive}: no such file; allowed are {', '.join(DRIVES)} and a trajectory file{near}"
            )
        moved = load_trajectory(Path(options.drive))
        if options.seconds is not None and options.seconds > moved.seconds + 1e-9:
            raise SourceError(f"{options.drive}: lasts {moved.seconds:g} s; {options.seconds:g} s are required")
        return moved
    return DRIVES[options.drive](options)


def hand(options: ExperimentOptions) -> Motion:
    """Return a box that is shaken by hand."""
    if options.seconds is None:
        return HandShake(temperature_degc=options.temperature_degc)
    still_s = options.seconds * _REST_SHARE
    return HandShake(still_s=still_s, motion_s=options.seconds - 2 * still_s, temperature_degc=options.temperature_degc)


def vehicle(options: ExperimentOptions) -> Motion:
    """Return a drive with bends."""
    if options.seconds is None:
        return Vehicle(temperature_degc=options.temperature_degc)
    still_s = options.seconds * _REST_SHARE
    return Vehicle(still_s=still_s, drive_s=options.seconds - 2 * still_s, temperature_degc=options.temperature_degc)


DRIVES: Mapping[str, Callable[[ExperimentOptions], Motion]] = MappingProxyType({"hand": hand, "vehicle": vehicle})
"""The motions of the box in the experiment "motion"."""

EXPERIMENTS: Mapping[str, Callable[[ExperimentOptions], Motion]] = MappingProxyType(
    {"static": static, "tumble": tumble, "heating": heating, "turn-on": turn_on, "motion": motion}
)
"""Every experiment by its name."""


@dataclass(frozen=True)
class BootRun:
    """One log to write: its path, its plan and motion, and the number of the boot of the units."""

    path: Path
    plan: Plan
    motion: Motion
    boot: int


def run_like(log: Log, path: Path, only: Collection[str], boot: int) -> BootRun:
    """Return a run with the sensors, times, faces and temperature of another log; LogError for a sensor that the log
    does not have.
    """
    return BootRun(path, plan_like(log, only), LikeLog(log), boot)


def array_like(log: Log, only: Collection[str]) -> ArrayConfig:
    """Return the array with which a log was recorded: the sensors that have readings, or `only` these.

    LogError for a sensor that the log does not have, and for a log without a configuration.
    """
    if not log.config:
        raise LogError(f"{log.path}: it has no configuration, which another experiment needs; omit --experiment")
    array = parse_array(log.config, f"{log.path}: config")
    recorded = {name for name, sensor in log.sensors.items() if len(sensor)}
    for name in only:
        log[name]
    chosen = tuple(sensor.name for sensor in array.sensors if sensor.name in (only or recorded))
    if not chosen:
        raise LogError(f"{log.path}: has no readings of a sensor of its configuration")
    return array.only(chosen)


def turn_on_series(
    array: ArrayConfig, path: Path, options: ExperimentOptions, rate_hz: float, boots: Sequence[int]
) -> list[BootRun]:
    """Return the logs of a turn-on series, one per boot: SIM_01.h5, SIM_02.h5, ... in the folder of `path`."""
    digits = max(2, len(str(len(boots))))
    listed = []
    for k, boot in enumerate(boots, 1):
        numbered = path.with_name(f"{path.stem}_{k:0{digits}}{path.suffix}")
        listed.append(run_of(array, numbered, "turn-on", replace(options, run=k), rate_hz=rate_hz, boot=boot))
    return listed


def run_of(
    array: ArrayConfig, path: Path, experiment: str, options: ExperimentOptions, *, rate_hz: float, boot: int
) -> BootRun:
    """Return one run of one of `EXPERIMENTS`; for a turn-on series, the run number `options.run`."""
    motion = EXPERIMENTS[experiment](options)
    return BootRun(path, plan_of(array, rate_hz, options.seconds or motion.seconds), motion, boot)


def with_effects(
    effects: Mapping[str, Sequence[Effect]], added: Mapping[str, Sequence[Effect]]
) -> dict[str, tuple[Effect, ...]]:
    """Return each sensor's effects including those `added`, in physical order; ConfigError for an unknown sensor."""
    for name in added:
        if name not in effects:
            raise ConfigError(f"effects of {name!r}: the array has {', '.join(effects)}{guess(name, effects)}")
        if isinstance(added[name], str) or not isinstance(added[name], Sequence):
            raise ConfigError(f"effects of {name}: {added[name]!r}: a list of effects is required")
        for effect in added[name]:
            if not isinstance(effect, tuple(EFFECTS.values())):
                hint = (
                    f'EFFECTS["{effect}"](...)' if str(effect) in EFFECTS else "an effect of imuarray.simulate.EFFECTS"
                )
                raise ConfigError(f"effects of {name}: {effect!r} is no effect; give {hint}")
    return {name: in_physical_order((*own_effects, *added.get(name, ()))) for name, own_effects in effects.items()}


def remarks_on(plan: Plan, model: Model, log: Log | None, *, population: bool) -> Iterator[str]:
    """Yield remarks on sensors without effects in the model, on parts of the model that apply to no sensor, and on a
    recorded log that does not state how the box moved.
    """
    triads = {name: header for name, (header, _) in plan.sensors.items() if header.quantity != "pressure"}
    ideal = [name for name, header in triads.items() if not model.parts(header, population=population)]
    if ideal:
        yield f"model {model.name} has no parameters for {', '.join(ideal)}: simulated as ideal"
    idle = sorted({part.name for part in model.sensors} - set(plan.sensors))
    if idle and len(idle) == len({part.name for part in model.sensors}):
        yield f"model {model.name}: its sensors {', '.join(idle)} are not in this array"
    if log is not None and log.motion_track is None:
        yield f"{log.path} does not say how the box moved: simulated at rest on the faces of its phases"
