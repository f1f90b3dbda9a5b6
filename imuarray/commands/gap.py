"""`imuarray gap`: differences between recordings and simulations."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING

import click

from imuarray.atomic import write_text
from imuarray.commands.gap_validate import validate
from imuarray.commands.options import (
    Steps,
    argument,
    ended_by_signals,
    force_option,
    json_option,
    names_option,
    only_option,
    option,
    output_folder,
    output_option,
    parameter,
    print_json,
    report_doubts_of,
    seed_option,
    takes,
    workers_option,
)
from imuarray.shipped import find_model

if TYPE_CHECKING:
    from imuarray.gap.findings.diagnosis import Diagnosis

FILES = ("gap.json", "repaired.toml", "report.html")
"""The files that are written into the output folder."""


@click.group("gap", invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Show where recordings and simulations differ, and why.

    \b
    imuarray gap diagnose bench.h5 -o gap
    """
    if context.invoked_subcommand is None:
        raise click.UsageError(f"choose what to do: {', '.join(command.commands)}")


command.add_command(validate)


@dataclass(frozen=True)
class DiagnoseOptions:
    """The options of `imuarray gap diagnose`."""

    logs: tuple[Path, ...] = argument(nargs=-1, required=True, metavar="REAL.h5...")
    model_name: str | None = option(
        "--model",
        metavar="MODEL",
        help=(
            "the simulator's model: a file, or one that comes with the package: datasheet, martin2013 (default: the"
            " data sheets of the log's chips)"
        ),
    )
    without: tuple[str, ...] = parameter(
        names_option(
            "--without",
            metavar="EFFECT,...",
            help="remove these effects from the library of causes (imuarray simulate --effects lists them)",
        )
    )
    only: tuple[str, ...] = parameter(only_option("diagnose only these sensors"))
    against: tuple[Path, ...] = option(
        multiple=True,
        metavar="EARLIER.h5",
        help="an earlier log of the same array, to find what has changed since then (may be repeated)",
    )
    seed: int = parameter(seed_option)
    replicates: int = option(
        type=click.IntRange(40, 10_000),
        default=128,
        show_default=True,
        help="most simulated replicates, which separate a gap from chance; fewer are used where the result is clear",
    )
    workers: int = parameter(workers_option)
    output: Path | None = output_option(
        folder=True,
        metavar="DIR",
        help="write report.html, gap.json and the repaired model, repaired.toml, into DIR",
    )
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)


@command.command("diagnose", short_help="name the effects that the simulator of recorded logs lacks")
@takes(DiagnoseOptions)
def diagnose(options: DiagnoseOptions) -> None:
    """Compare recorded logs with simulated replicates of them, and name the causes of the differences.

    The logs come from one array and from any experiments: static, tumble, heating, turn-on, motion. Parameters are
    fitted to one part of the logs, and causes are verified on the rest. Without --model the simulator uses the data
    sheets of the chips in the log's configuration, with fitted noise, bias and temperature slope. With --against,
    parameters are fitted to an earlier log, and only differences from that log are reported.

    \b
    imuarray gap diagnose static.h5 tumble.h5 -o gap
    imuarray gap diagnose today.h5 --against last_year.h5
    """
    from imuarray import diagnose as diagnose_logs
    from imuarray.gap.diagnose import library
    from imuarray.simulate import load_model

    library(options.without)
    output = options.output
    folder = nullcontext() if output is None else output_folder(output, FILES, options.force)
    with ended_by_signals(), folder, Steps() as steps:
        steps.begin("opening the logs")
        diagnosis = diagnose_logs(
            options.logs,
            model=None if options.model_name is None else load_model(find_model(Path(options.model_name))),
            only=options.only,
            against=options.against,
            without=options.without,
            seed=options.seed,
            replicates=options.replicates,
            workers=options.workers,
            progress=steps.begin,
            bar=steps.bar,
        )
    if output is not None:
        _write(output, diagnosis)
    report_doubts_of(*options.logs, *options.against)
    _print_diagnosis(diagnosis, options.as_json)


def _write(folder: Path, diagnosis: Diagnosis) -> None:
    """Write the numbers, the repaired model, and the page as far as optional packages allow."""
    from imuarray.errors import MissingExtraError
    from imuarray.report.gap_page import write_gap_page

    numbers, model, page = (folder / name for name in FILES)
    write_text(numbers, json.dumps(diagnosis.as_json(), indent=1, allow_nan=False) + "\n", force=True)
    if diagnosis.repaired is not None:
        write_text(model, diagnosis.repaired.to_toml(), force=True)
    try:
        write_gap_page(page, diagnosis, force=True)
    except MissingExtraError as error:
        click.echo(f"{folder}: gap.json and repaired.toml written; no page: {error}", err=True)
        return
    click.echo(f"{folder}: report.html, gap.json, repaired.toml written", err=True)


def _print_diagnosis(diagnosis: Diagnosis, as_json: bool) -> None:
    """Print to the width of the terminal; to the full width where there is none."""
    from imuarray.gap.findings.text import WIDTH, text_of

    if as_json:
        print_json(diagnosis.as_json())
    else:
        click.echo(text_of(diagnosis, get_terminal_size((WIDTH, 24)).columns), nl=False)
