"""`imuarray characterise`."""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.atomic import save_figure, write_text
from imuarray.commands.options import (
    force_option,
    json_option,
    log_argument,
    only_option,
    option,
    output_option,
    parameter,
    print_json,
    progress,
    refuse_existing,
    report_doubts,
    takes,
)
from imuarray.errors import ImuArrayError, MissingExtraError, OutputError, OutputExistsError

if TYPE_CHECKING:
    from imuarray.characterise.allan import Estimator
    from imuarray.log import Log

RESULT = "characterise.json"


@dataclass(frozen=True)
class CharacteriseOptions:
    """The options of `imuarray characterise`."""

    run: Path = parameter(log_argument)
    output: Path | None = output_option(
        folder=True,
        metavar="DIR",
        help=f"write {RESULT} and, with matplotlib, figures into DIR",
    )
    phase: str | None = option(metavar="NAME", help="the phase to evaluate (default: the longest phase at rest)")
    only: tuple[str, ...] = parameter(only_option("only these sensors (default: all with three axes)"))
    estimator: Estimator | None = option(
        type=click.Choice(("overlapping", "decimated")),
        help=(
            "estimator of the Allan deviation (default: overlapping; beyond 4 million rows decimated, which is as"
            " precise and needs less memory)"
        ),
    )
    calibration: Path | None = option(
        metavar="CAL.toml", help="scale factors for converting counts to units (default: those of the data sheet)"
    )
    as_json: bool = parameter(json_option)
    force: bool = parameter(force_option)


@click.command("characterise")
@takes(CharacteriseOptions)
def command(options: CharacteriseOptions) -> None:
    """Determine Allan deviation, spectrum, correlation, codes and noise of the sensors in a log at rest.

    Prints for every axis the mean, the spread, and the white noise, bias instability and random walk that fit its Allan
    deviation, with intervals and goodness of fit. Also prints anomalies (lines, missing codes, gaps, ...) and the
    stretch of the log that was evaluated. DIR also gets a Kalibr file (imu_NAME.yaml) for each accelerometer and
    gyroscope.

    \b
    imuarray characterise run.h5 --phase z_up -o noise
    """
    from imuarray.characterise import render_text
    from imuarray.log import open_log

    for name in _files() if options.output else ():
        refuse_existing(Path(options.output or "") / name, options.force, in_new_folder=True)
    if options.output and not options.force and (existing := sorted(options.output.glob("imu_*.yaml"))):
        raise OutputExistsError(existing[0])
    with open_log(options.run) as log:
        report_doubts(log)
        result = _characterise(log, options)
    paths = [*_write(result, options.output), *_write_kalibr(result, options.output)] if options.output else []
    if options.as_json:
        print_json(result)
    else:
        click.echo(render_text(result), nl=False)
    for path in paths:
        click.echo(f"imuarray: wrote {path}", err=True)


def _characterise(log: Log, options: CharacteriseOptions) -> dict[str, Any]:
    from imuarray.calibrate.motion import longest_rest
    from imuarray.characterise import characterise_log

    sensors = options.only or None
    selected = [log[name] for name in options.only] or [item for item in log.sensors.values() if item.is_triad]
    columns = sum(int(sensor.counts.shape[1]) for sensor in selected)
    count = itertools.count(1)
    with progress(columns, str(log.path)) as set_progress:
        return characterise_log(
            log,
            longest_rest(log, options.phase) or options.phase,
            sensors,
            lambda: set_progress(next(count)),
            options.estimator,
            _scales(log, options.calibration),
        )


def _scales(log: Log, calibration: Path | None) -> dict[str, list[float]]:
    """Return the counts per unit of the sensors in a calibration file."""
    if calibration is None:
        return {}
    from imuarray.calibrate import load_calibration

    return load_calibration(calibration).scales(log.sensors.values())


def _files() -> list[str]:
    from imuarray.characterise.plots import FIGURES

    return [RESULT, *FIGURES]


def _write(result: dict[str, Any], output: Path) -> list[Path]:
    """Write the result and its figures into `output`, and return the files; without matplotlib, print that there are no
    figures. The error of a figure that cannot be written names those that are missing.
    """
    from imuarray.characterise.plots import FIGURES

    paths = [output / RESULT]
    try:
        output.mkdir(parents=True, exist_ok=True)
        write_text(paths[0], json_text(result) + "\n", force=True)
        for name, draw in FIGURES.items():
            figure = draw(result)
            try:
                save_figure(output / name, figure, metadata={"Software": None})
            except OutputError as error:
                missing = ", ".join(list(FIGURES)[len(paths) - 1 :])
                remark = f"{RESULT} is written, but not {missing} and the Kalibr files"
                raise OutputError(error.path, error.error, remark) from None
            paths.append(output / name)
    except MissingExtraError as error:
        click.echo(f"imuarray: no figures: {error}", err=True)
    except OSError as error:
        raise ImuArrayError(f"{error.filename or output}: {error.strerror or error}") from None
    return paths


def json_text(value: Any, depth: int = 0) -> str:
    """Return JSON with one line for each entry of an object and for each list of numbers. The encoder of the standard
    library would put each number of the long curves on a line of its own, and is slower.
    """
    margin = "\n" + " " * (depth + 1)
    if isinstance(value, dict) and value:
        entries = (f"{json.dumps(name)}: {json_text(item, depth + 1)}" for name, item in value.items())
        return "{" + margin + f",{margin}".join(entries) + margin[:-1] + "}"
    if isinstance(value, list) and not {dict, list}.isdisjoint(map(type, value)):
        return "[" + margin + f",{margin}".join(json_text(item, depth + 1) for item in value) + margin[:-1] + "]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _write_kalibr(result: dict[str, Any], output: Path) -> list[Path]:
    """Write the noise figures for Kalibr, one file for each IMU, and return the files."""
    from imuarray.characterise.imu_noise import imu_files

    paths = []
    for name, text in imu_files(result).items():
        write_text(output / name, text, force=True)
        paths.append(output / name)
    return paths
