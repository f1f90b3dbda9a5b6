"""`imuarray simulate`."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.axes import UP_AXES
from imuarray.commands.options import (
    Duration,
    NumberRange,
    argument,
    force_option,
    json_option,
    names_option,
    only_option,
    option,
    output_option,
    parameter,
    print_json,
    progress,
    rate_option,
    refuse_existing,
    refuse_other_suffix,
    report_doubts,
    seed_option,
    takes,
)
from imuarray.shipped import find_config, find_model

if TYPE_CHECKING:
    from imuarray.log import Log
    from imuarray.simulate import Model, Plan, Simulation, Written
    from imuarray.simulate.experiments import BootRun

EXPERIMENTS = ("static", "tumble", "heating", "turn-on", "motion")
"""Experiments of `imuarray.simulate.experiments`, repeated here because that module imports NumPy."""


def _list_effects(as_json: bool) -> None:
    """Print the effects that a model may contain, with their parameters."""
    from imuarray.simulate.effect import spelled
    from imuarray.simulate.effects import EFFECTS, meaning

    if as_json:
        parameters = {name: list(spelled(kind, "UNIT")) for name, kind in EFFECTS.items()}
        print_json({"effects": {name: {"meaning": meaning(name), "parameters": parameters[name]} for name in EFFECTS}})
        return
    for name, kind in EFFECTS.items():
        click.echo(f"{name:17} {meaning(name)}\n{'':17}   {', '.join(spelled(kind, 'UNIT'))}")
    click.echo(
        "UNIT is the unit of the sensor: g, dps or gauss. The class of each effect documents its equation,"
        " source and appearance in data."
    )


@dataclass(frozen=True)
class SimulateOptions:
    """The options of `imuarray simulate`."""

    config: Path | None = argument(required=False)
    like: Path | None = option(
        metavar="RUN.h5",
        help=(
            "take sensors, times, faces and temperature from this log; with --experiment only its sensors and frame"
            " rate"
        ),
    )
    output: Path | None = output_option(
        metavar="SIM.h5",
        help="the log to write (required without --effects); a turn-on series adds the number of each run",
    )
    experiment: str = option(type=click.Choice(EXPERIMENTS), default="static", show_default=True)
    drive: str = option(
        "--motion",
        metavar="hand|vehicle|T.csv",
        default="hand",
        show_default=True,
        help="motion of the box in --experiment motion; T.csv holds a trajectory, or force and rate",
    )
    seconds: float | None = option(
        type=Duration(),
        metavar="60s",
        help="length of the log: 90, 90s, 10min, 8h (default: depends on the experiment)",
    )
    runs: int = option(
        type=click.IntRange(1, 999),
        default=15,
        show_default=True,
        help="number of boots in a turn-on series, one log each",
    )
    rate_hz: float = parameter(rate_option)
    up: str = option(
        type=click.Choice(UP_AXES), default="+Z", show_default=True, help="the box axis that points up in a static log"
    )
    temperature_degc: float = option(
        "--temperature",
        type=NumberRange(-40, 85),
        default=25.0,
        show_default=True,
        help="temperature in degC, if the experiment has no temperature profile",
    )
    model_name: str = option(
        "--model",
        metavar="MODEL",
        default="datasheet",
        show_default=True,
        help="a model file, or one that comes with the package: datasheet, martin2013",
    )
    calibration: Path | None = option(
        metavar="CAL.toml", help="take the parameters of the units from this calibration and the rest from the model"
    )
    population: bool = option(help="draw all units at random from their designs, even units that the model knows")
    without: tuple[str, ...] = parameter(
        names_option(
            "--without", metavar="EFFECT,...", help="leave these effects out; other random draws do not change"
        )
    )
    only: tuple[str, ...] = parameter(only_option("simulate only these sensors"))
    seed: int = parameter(seed_option)
    boot: int = option(
        type=click.IntRange(0), default=0, show_default=True, help="number of the boot: another run of the same units"
    )
    single: bool = option(help="compute in single precision (float32), which is faster")
    workers: int = option(
        type=click.IntRange(1, 64),
        default=1,
        show_default=True,
        help="number of threads; it does not change the result",
    )
    list_effects: bool = option("--effects", help="list the effects and their parameters")
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)


@click.command("simulate")
@takes(SimulateOptions)
def command(options: SimulateOptions) -> None:
    """Simulate the array of CONFIG, or the recording RUN.h5, with a model of the sensors, and write a log.

    The model defines the effects between truth and counts for every unit. /truth in the log holds the true motion. The
    same seed gives the same log. With both --like and --experiment, another experiment of RUN.h5's array is simulated.

    \b
    imuarray simulate martin2013 --experiment tumble -o simulated.h5
    imuarray simulate --like run.h5 --calibration cal.toml -o twin.h5
    """
    if options.list_effects:
        _list_effects(options.as_json)
        return
    if options.output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    from imuarray.simulate import Simulation, effects_of
    from imuarray.simulate.effect import to_table
    from imuarray.simulate.experiments import remarks_on

    if (options.config is None) == (options.like is None):
        raise click.UsageError("give either a CONFIG or --like RUN.h5")
    _refuse_idle(click.get_current_context(), options)
    seed, left_out, population = options.seed, options.without, options.population
    with ExitStack() as stack:
        log, runs = _runs(stack, options, options.output)
        model = _model(options.model_name, options.calibration, runs[0].plan)
        for run in runs:
            refuse_other_suffix(run.path, "a log")
            refuse_existing(run.path, options.force, source=options.like)
        for sentence in remarks_on(runs[0].plan, model, log, population=population):
            click.echo(f"imuarray: {sentence}", err=True)
        effects = effects_of(runs[0].plan, model, seed, population=population, without=left_out)  # of all boots
        reports: list[dict[str, Any]] = []
        population_text = ", units drawn" if population else ""
        without_text = f", without {', '.join(left_out)}" if left_out else ""
        for run in runs:
            dtype = "float32" if options.single else "float64"
            simulation = Simulation(run.plan, run.motion, effects, seed=seed, boot=run.boot, dtype=dtype)
            note = f"model {model.name}{population_text}, seed {seed}, boot {run.boot}{without_text}"
            totals = _write(simulation, run.path, log, note, options)
            reports.append(
                {
                    "log": str(run.path),
                    "model": model.name,
                    "seed": seed,
                    "boot": run.boot,
                    "frames": totals.frames,
                    "seconds": totals.seconds,
                    "rows": totals.rows,
                    "lost": {name: count for name, count in totals.lost.items() if count},
                }
            )
    if options.as_json:
        units = {name: header.unit for name, (header, _) in runs[0].plan.sensors.items()}
        spelled = {
            name: [{"effect": effect.name, **to_table(effect, units[name])} for effect in of_unit]
            for name, of_unit in effects.items()
        }
        print_json({"logs": reports, "effects": spelled})
        return
    for report in reports:
        dropped, most = sum(report["lost"].values()), max(report["rows"].values())
        click.echo(
            f"{report['log']}: simulated, {most} rows a sensor in {report['seconds']:.1f} s, model {report['model']},"
            f" seed {report['seed']}, boot {report['boot']}" + (f", {dropped} readings dropped" if dropped else "")
        )


_FOR = {
    "drive": ("--motion", ("motion",)),
    "runs": ("--runs", ("turn-on",)),
    "up": ("--up", ("static", "heating")),
    "temperature_degc": ("--temperature", ("static", "tumble", "turn-on", "motion")),
}
"""Options that apply only to some experiments."""


def _is_given(context: click.Context, name: str) -> bool:
    return context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT


def _refuse_idle(context: click.Context, options: SimulateOptions) -> None:
    """Raise click.UsageError for an option that would have no effect."""
    is_like_alone = options.like is not None and not _is_given(context, "experiment")
    for name in (*_FOR, "seconds", "rate_hz"):
        if not _is_given(context, name):
            continue
        option, experiments = _FOR.get(name, (f"--{name.replace('_', '-')}", (options.experiment,)))
        if is_like_alone:
            raise click.UsageError(f"{option}: with --like it comes from the log, unless an --experiment is given")
        if options.experiment not in experiments:
            raise click.UsageError(f"{option} is for --experiment {' or '.join(experiments)}, not {options.experiment}")


def _runs(stack: ExitStack, options: SimulateOptions, output: Path) -> tuple[Log | None, list[BootRun]]:
    """Return the log whose motion is simulated, if there is one, and the runs to simulate."""
    from imuarray.array import load_array
    from imuarray.errors import ConfigError
    from imuarray.log import open_log
    from imuarray.simulate.experiments import ExperimentOptions, array_like, run_like, run_of, turn_on_series

    rate_hz = options.rate_hz
    if options.like is None:
        array = load_array(find_config(options.config or Path()))
        array = array.only(options.only) if options.only else array
    else:
        log = stack.enter_context(open_log(options.like))
        report_doubts(log)
        context = click.get_current_context()
        if not _is_given(context, "experiment"):
            return log, [run_like(log, output, options.only, options.boot)]
        array = array_like(log, options.only)
        rate_hz = rate_hz if _is_given(context, "rate_hz") or not log.frame_rate_hz else log.frame_rate_hz
    for sensor in array.sensors:
        if sensor.on_iio and not sensor.sensitivity:
            raise ConfigError(
                f"{options.config or options.like}: sensor {sensor.name}: only the kernel knows the scale of its"
                " counts; record it and use --like RUN.h5 alone, or configure a chip with a data sheet, and its range"
            )
    experiment = ExperimentOptions(options.seconds, options.up, options.temperature_degc, options.drive)
    if options.experiment == "turn-on":
        boots = range(options.boot, options.boot + options.runs)
        return None, turn_on_series(array, output, experiment, rate_hz, boots)
    return None, [run_of(array, output, options.experiment, experiment, rate_hz=rate_hz, boot=options.boot)]


def _model(name: str, calibration: Path | None, plan: Plan) -> Model:
    from imuarray.simulate import load_model

    model = load_model(find_model(Path(name)))
    if calibration is None:
        return model
    from imuarray.calibrate import load_calibration
    from imuarray.simulate.from_calibration import calibrated

    parameters = load_calibration(calibration)
    if not set(parameters.sensors) & set(plan.sensors):
        names = ", ".join(parameters.sensors) or "no sensor"
        raise click.UsageError(f"{calibration}: contains {names}, but none of {', '.join(plan.sensors)}")
    return calibrated(model, parameters, [header for header, _ in plan.sensors.values()])


def _write(simulation: Simulation, path: Path, log: Log | None, note: str, options: SimulateOptions) -> Written:
    from imuarray.simulate import total_rows, write_log
    from imuarray.simulate.record import EPOCH, Division, Origin

    with ExitStack() as stack:
        set_progress = stack.enter_context(progress(total_rows(simulation), str(path)))
        workers = options.workers
        threads = stack.enter_context(ThreadPoolExecutor(workers)) if workers > 1 else None
        return write_log(
            simulation,
            path,
            origin=Origin(log.epoch if log else EPOCH, note),
            division=Division(executor=threads, workers=workers),
            progress=set_progress,
            force=options.force,
        )
