"""Cases: series of logs of an emulated array with active mechanisms, and a separate sealed file with the truth.

A case resembles a user's data from a bench: units that were never measured, a log for each experiment, no truth. The
real drivers poll it, and the real acquisition writes it. Neither the names nor the attributes of its logs reveal the
mechanism, its severity or the seed.

::

    python -m firmware_emulator.cases martin2013 -o case --truth sealed.json --mechanism mains_ripple \\
        --severity 2 --sensor Gyro2 --seed 7 --experiments static,tumble,heating,turn-on,motion

Every log begins with a power-up; the units stay the same, the noise differs. Time is emulated. `/reference` of a log
contains the commanded force, rate and temperature of the bench, not those of the sensors.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Self, cast

import click
import h5py
import numpy as np

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.mechanisms import MECHANISMS
from firmware_emulator.mechanisms.experiments import EXPERIMENTS, BenchExperiment, known_experiment
from firmware_emulator.mechanisms.host import HostClock
from firmware_emulator.mechanisms.mechanism import FittedBoard, Fitting
from firmware_emulator.mechanisms.query import fitting_of, split
from firmware_emulator.sessions import Course, Recorder, Room, of_table, sessions
from firmware_emulator.world import World, WorldPhase, WorldStimulus
from imuarray.acquire import record
from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.atomic import write_text
from imuarray.bus.protocol import OpenBus
from imuarray.commands.program import run
from imuarray.errors import OutputExistsError
from imuarray.shipped import find_config

PROGRAM = "firmware_emulator.cases"
RATE_HZ = 64.0
"""Frames per second. The mains frequency then has its alias at 14 Hz, its harmonics have theirs at 28 and 22 Hz."""
FIRST_LOG = datetime(2013, 9, 16, 9, 0, tzinfo=UTC)
BETWEEN_LOGS = timedelta(minutes=20)
_NAMES = {kind: name for name, kind in MECHANISMS.items()}


@dataclass(frozen=True)
class BenchCase:
    """`experiments` (keys of `EXPERIMENTS`, or the caller's own) with the mechanisms `fittings` active on the array;
    without fittings there is no fault.

    `seed` draws units, noise and the random parameters of mechanisms. `severities`, one for each fitting, are stored in
    the truth. With `reference` the logs contain the commanded motion of the bench; without, only its phases and the
    barometer. `recorder` describes the recording program, None if it is never late; with a recorder, parts are
    toleranced.
    """

    array: ArrayConfig
    experiments: tuple[BenchExperiment, ...]
    fittings: tuple[Fitting, ...] = ()
    severities: tuple[float, ...] = ()
    seed: int = 0
    rate_hz: float = RATE_HZ
    reference: bool = True
    recorder: Recorder | None = None

    @classmethod
    def of(
        cls,
        array: ArrayConfig,
        experiments: Sequence[str | BenchExperiment],
        *mechanisms: tuple[str, float, tuple[str, ...]],
        seed: int = 0,
        rate_hz: float = RATE_HZ,
        reference: bool = True,
    ) -> Self:
        """Create a case by names: `mechanisms` are (name, severity, sensors), no sensors means all on which the
        mechanism can act.

        ValueError, one line, for an impossible name, severity or sensor.
        """
        selected = [
            experiment if isinstance(experiment, BenchExperiment) else known_experiment(experiment)
            for experiment in experiments
        ]
        fittings = [fitting_of(array, *mechanism) for mechanism in mechanisms]
        severities = tuple(severity for _, severity, _ in mechanisms)
        return cls(array, tuple(selected), tuple(fittings), severities, seed, rate_hz, reference)

    @classmethod
    def of_world(cls, world: Mapping[str, Any], *mechanisms: tuple[str, float, tuple[str, ...]], seed: int = 0) -> Self:
        """Create a case in a world that was drawn by another program: a table with the `array` (TOML text), its
        `sessions`, `room` and `recorder` (`firmware_emulator.sessions`). ValueError, one line, for an unknown entry.
        """
        if missing := sorted({"array", "sessions", "room", "recorder"} - set(world)):
            raise ValueError(f"world: {missing[0]} is missing")
        array, recorder = parse_array(world["array"], "world"), of_table(Recorder, world["recorder"])
        experiments = sessions(world["sessions"], Room.of_table(world["room"]), seed)
        plain = cls.of(
            array, experiments, *mechanisms, seed=seed, rate_hz=recorder.rate_hz, reference=recorder.reference
        )
        return replace(plain, recorder=recorder)

    def write(self, folder: Path, truth: Path, *, force: bool = False) -> list[Path]:
        """Record every log into `folder` and seal the truth in another place; return the logs' paths.

        ValueError if `truth` would be in the folder of the logs, OutputExistsError for an existing file.
        """
        if folder.resolve() == truth.resolve().parent:
            raise ValueError(f"{truth}: the truth is in the folder of the logs; choose another folder")
        if truth.exists() and not force:
            raise OutputExistsError(truth)
        folder.mkdir(parents=True, exist_ok=True)
        truth.parent.mkdir(parents=True, exist_ok=True)
        paths: list[Path] = []
        entries: list[dict[str, Any]] = []
        for experiment in self.experiments:
            for index in range(experiment.logs):
                path = folder / experiment.file(index)
                entries.append(self._log(path, experiment, index, run=len(paths), force=force))
                paths.append(path)
        write_text(truth, json.dumps(self.truth(entries), indent=1) + "\n", force=True)
        return paths

    def truth(self, logs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the contents of the sealed file; `logs` contain the events in each log, and the affected sensors where
        a mechanism chose them at random.
        """
        return {
            "array": self.array.name,
            "seed": self.seed,
            "rate_hz": self.rate_hz,
            "mechanisms": [
                {
                    "mechanism": _NAMES[type(fitting.mechanism)],
                    "severity": severity,
                    "sensors": _affected_sensors(_NAMES[type(fitting.mechanism)], fitting, logs),
                    "parameters": asdict(fitting.mechanism),
                    "resembles": list(fitting.mechanism.resembles),
                }
                for fitting, severity in zip(self.fittings, self.severities, strict=True)
            ],
            "logs": list(logs),
        }

    def _log(self, path: Path, experiment: BenchExperiment, index: int, *, run: int, force: bool) -> dict[str, Any]:
        boards: list[FittedBoard] = []

        def board(name: str, world: World, seed: int) -> FittedBoard:
            units = "toleranced" if self.recorder else "drawn"
            fitted_board = FittedBoard(self.array, world, seed, self.fittings, run=run, units=units)
            if self.recorder:
                per_s = self.rate_hz * len(self.array.sensors)
                fitted_board.host.waits_ns.append(self.recorder.waits_ns(seed, run, per_s))
            boards.append(fitted_board)
            return fitted_board

        bus = open_array(self.array, world=experiment.world, seed=self.seed, board=board)
        if isinstance(experiment.world, Course):
            bus.truth = experiment.world.commanded
        log_begin = _LogBegin(bus.truth)
        bus.truth = log_begin
        if not self.reference:
            del bus.truth  # the logs of a case do not contain the truth
        record(
            self.array,
            cast(OpenBus, bus),
            path,
            rate_hz=self.rate_hz,
            seconds=experiment.seconds,
            phases=cast(Any, as_shown(experiment.phases(index), bus)),
            wall_time=FIRST_LOG + run * BETWEEN_LOGS,
            force=force,
        )
        if self.recorder and not self.recorder.thermometers:
            leave_thermometers_out(path)
        if self.reference:
            call_it_reference(path)
        if self.reference and experiment.reference_hz:
            read_reference(path, experiment, log_begin.at_ns)
        touched = {_NAMES[type(mechanism)]: sorted(sensors) for mechanism, sensors in boards[0].touched.items()}
        return {"log": path.name, "run": run, "notes": boards[0].notes, "touched": touched}


class _LogBegin:
    """A world that keeps the time of the first query: the beginning of a log, after the sensors were set up."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.at_ns = 0
        self._is_asked = False

    def __call__(self, at_ns: int) -> WorldStimulus:
        if not self._is_asked:
            self.at_ns, self._is_asked = at_ns, True
        return self._world(at_ns)


def _affected_sensors(mechanism: str, fitting: Fitting, logs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the sensors on which a mechanism is put; only those that it affected in a log, if the logs state any."""
    touched = {name for log in logs for name in log["touched"].get(mechanism, ())}
    return [name for name in fitting.sensors if name in touched] or list(fitting.sensors)


def as_shown(phases: Sequence[WorldPhase], bus: EmulatedBus) -> tuple[WorldPhase, ...]:
    """Return the phases in times of the host's clock, because they are noted by this clock."""
    clock = bus.clock
    if not isinstance(clock, HostClock):
        return tuple(phases)
    return tuple(
        phase._replace(start_ns=clock.shown(phase.start_ns), end_ns=clock.shown(phase.end_ns)) for phase in phases
    )


def leave_thermometers_out(path: Path) -> None:
    """Rewrite the log without the temperatures of the chips, like a log of a program that does not read them."""
    with h5py.File(path, "r+") as file:
        for group in file["sensors"].values():
            if "temperature_counts" in group:
                del group["temperature_counts"]


def call_it_reference(path: Path) -> None:
    """Rename the truth of the emulated world to the reference, which is the commanded motion of the bench."""
    with h5py.File(path, "r+") as file:
        file.move("truth", "reference")


def read_reference(path: Path, experiment: BenchExperiment, begun_ns: int) -> None:
    """Rewrite the reference of a log at its own rate, with times of a separate, exact clock, from `begun_ns` of the
    world on.
    """
    times = np.arange(0, round(experiment.seconds * 1e9), round(1e9 / experiment.reference_hz))
    world = experiment.world.commanded if isinstance(experiment.world, Course) else experiment.world
    stimuli = [world(begun_ns + at_ns) for at_ns in times.tolist()]
    columns = {
        "time": times,
        "specific_force": np.array([stimulus.force_box for stimulus in stimuli]),
        "angular_rate": np.array([stimulus.rate_box for stimulus in stimuli]),
        "temperature": np.array([stimulus.temperature_degc for stimulus in stimuli]),
    }
    with h5py.File(path, "r+") as file:
        for name, values in columns.items():
            dataset = file["reference"][name]
            dataset.resize(len(values), axis=0)
            dataset[:] = values


def asked(
    names: Sequence[str], severities: Sequence[float], sensors: Sequence[str]
) -> list[tuple[str, float, tuple[str, ...]]]:
    """Return the options of each mechanism; ValueError if one is not given once for each of them or not at all."""
    severities, sensors = severities or (1.0,) * len(names), sensors or ("",) * len(names)
    if not len(names) == len(severities) == len(sensors):
        raise ValueError("give --severity and --sensor as often as --mechanism, or not at all")
    return [
        (name, severity, tuple(split(group, ",")))
        for name, severity, group in zip(names, severities, sensors, strict=True)
    ]


def described() -> dict[str, dict[str, Any]]:
    """Return a description of every mechanism: the chips that it `touches`, the number of sensors that it needs
    (`place`), the effects that it `resembles`, and whether it is `graded`: of variable size, not merely present or
    absent.
    """
    return {
        name: {
            "touches": list(kind.touches),
            "place": kind.place,
            "resembles": list(kind.resembles),
            "graded": kind.at(1.0) != kind.at(2.0),
        }
        for name, kind in MECHANISMS.items()
    }


def _describe(context: click.Context, _: click.Parameter, is_asked: bool) -> None:
    if is_asked and not context.resilient_parsing:
        click.echo(json.dumps(described(), indent=1))
        context.exit()


@click.command(PROGRAM, context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("config", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="folder for the logs")
@click.option(
    "--truth", required=True, type=click.Path(path_type=Path), help="file for the truth of the case, in another folder"
)
@click.option(
    "--mechanism",
    multiple=True,
    type=click.Choice(list(MECHANISMS)),
    metavar="NAME",
    help="a physical mechanism (--mechanisms lists them); may be repeated; without it, nothing is wrong",
)
@click.option(
    "--severity", multiple=True, type=float, help="size of each mechanism, in its reference sizes  [default: 1]"
)
@click.option(
    "--sensor",
    multiple=True,
    metavar="NAME,...",
    help="the sensors on which each mechanism acts  [default: all that it can act on]",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="seed of all random draws")
@click.option(
    "--experiments", default=",".join(EXPERIMENTS), show_default=True, help="the experiments, in the order of recording"
)
@click.option("--rate-hz", type=float, default=RATE_HZ, show_default=True, help="frames per second")
@click.option("--only", metavar="NAME,...", help="read only these sensors")
@click.option("--reference/--no-reference", default=True, help="whether the logs contain the commanded motion")
@click.option("--force", is_flag=True, help="overwrite existing files")
@click.option(
    "--mechanisms",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_describe,
    help="list all mechanisms as JSON, and exit",
)
def program(  # noqa: PLR0913
    config: Path,
    output: Path,
    truth: Path,
    mechanism: tuple[str, ...],
    severity: tuple[float, ...],
    sensor: tuple[str, ...],
    seed: int,
    experiments: str,
    rate_hz: float,
    only: str | None,
    reference: bool,
    force: bool,
) -> None:
    """Write the logs of one case of the emulated array of CONFIG, and what is wrong with it to a separate file.

    A CONFIG that ends in .json describes a whole world: array, sessions, room and recorder.

    \b
    python -m firmware_emulator.cases martin2013 -o case --truth sealed.json --mechanism mains_ripple --sensor Gyro2
    """
    try:
        mechanisms = asked(mechanism, severity, sensor)
        if config.suffix == ".json":
            case = BenchCase.of_world(json.loads(config.read_text(encoding="utf-8")), *mechanisms, seed=seed)
        else:
            array = load_array(find_config(config))
            array = array.only(tuple(only.split(","))) if only else array
            names = experiments.split(",")
            case = BenchCase.of(array, names, *mechanisms, seed=seed, rate_hz=rate_hz, reference=reference)
        paths = case.write(output, truth, force=force)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    for path in paths:
        click.echo(path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code: 2 for invalid input, with one line."""
    return run(program, PROGRAM, arguments)


if __name__ == "__main__":
    sys.exit(main())
