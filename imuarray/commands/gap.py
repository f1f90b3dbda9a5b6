"""`imuarray gap`: the sim-to-real gap."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.atomic import write_text
from imuarray.commands.gap_validate import validate
from imuarray.commands.options import (
    find_model,
    force_option,
    json_option,
    prepare_folder,
    print_json,
    progress,
    workers_option,
)

if TYPE_CHECKING:
    from imuarray.gap.findings.diagnosis import Diagnosis
    from imuarray.simulate.model import Model

FILES = ("gap.json", "repaired.toml", "report.html")
"""What is written into the output's folder."""


@click.group("gap")
def command() -> None:
    """Where recordings and simulations differ, and why."""


command.add_command(validate)


@command.command("diagnose")
@click.argument("logs", nargs=-1, required=True, metavar="REAL.h5...", type=click.Path(path_type=Path))
@click.option(
    "--model",
    "model_name",
    metavar="MODEL",
    help="what the simulator has: a model file, or one that comes with the package: datasheet, martin2013 (default: "
    "what the data sheets of the log's chips say)",
)
@click.option(
    "--without",
    default="",
    metavar="EFFECT,...",
    help="take these effects out of the library of causes (imuarray simulate --effects lists them)",
)
@click.option("--only", default="", metavar="SENSOR,...", help="diagnose only these sensors")
@click.option("--seed", type=click.IntRange(0, 2**63), default=0, show_default=True, help="keys every draw")
@click.option(
    "--replicates",
    type=click.IntRange(40, 10_000),
    default=100,
    show_default=True,
    help="simulations by which chance is told from a gap; 40 do where nothing is strange",
)
@workers_option
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="write report.html, gap.json and the repaired model, repaired.toml, into DIR",
)
@force_option
@json_option
def diagnose(
    logs: tuple[Path, ...],
    model_name: str | None,
    without: str,
    only: str,
    seed: int,
    replicates: int,
    workers: int,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Compare recorded logs with what the simulator says such logs should look like, and name the causes.

    Logs of one array, of any experiments: static, tumble, heating, turn-on, motion. Parameters are fitted to one part
    of them; what is said of causes is judged on the rest. Without --model the simulator has what the data sheets of the
    chips in the log's configuration say, with noise, bias and temperature slope as fitted.

    \b
    imuarray gap diagnose static.h5 tumble.h5 -o gap
    """
    from imuarray.gap.diagnose import diagnose as diagnosed
    from imuarray.gap.diagnose import library
    from imuarray.gap.model.workers import processes, runner
    from imuarray.gap.recording.recordings import recordings_of
    from imuarray.log import open_log

    left_out = _names(without)
    library(left_out)
    if output is not None:
        prepare_folder(output, FILES, force)
    model = _model(model_name)
    with ExitStack() as stack:
        opened = [stack.enter_context(open_log(path)) for path in dict.fromkeys(logs)]
        recordings = recordings_of(opened, _names(only))
        executor = stack.enter_context(processes(workers)) if workers > 1 else None
        stages = _Stages()
        found = diagnosed(
            recordings,
            lambda bench: runner(bench, executor, stages.bar),
            model=model,
            without=left_out,
            seed=seed,
            replicates=replicates,
            progress=stages.begin,
        )
    if output is not None:
        _write(output, found)
    _say(found, as_json)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _model(name: str | None) -> Model | None:
    from imuarray.simulate import load_model

    return None if name is None else load_model(find_model(Path(name)))


class _Stages:
    """What is going on, for who watches."""

    def __init__(self) -> None:
        self._name = ""

    def begin(self, name: str) -> None:
        """The next stage."""
        self._name = name

    def bar(self, length: int) -> AbstractContextManager[Callable[[int], None]]:
        """Its bar."""
        return progress(length, f"{self._name:<46.46}")


def _write(folder: Path, found: Diagnosis) -> None:
    """The numbers, the repaired model, and the page with as much as the optional packages allow."""
    import json

    from imuarray.errors import MissingExtraError
    from imuarray.report.gap_page import write_gap_page

    numbers, model, page = (folder / name for name in FILES)
    write_text(numbers, json.dumps(found.as_json(), indent=1, allow_nan=False) + "\n", force=True)
    if found.repaired is not None:
        write_text(model, found.repaired.to_toml(), force=True)
    try:
        write_gap_page(page, found, force=True)
    except MissingExtraError as error:
        click.echo(f"{folder}: gap.json and repaired.toml only; the page: {error}", err=True)
        return
    click.echo(f"{folder}: report.html, gap.json, repaired.toml written", err=True)


def _say(found: Diagnosis, as_json: bool) -> None:
    from imuarray.gap.findings.text import text_of

    if as_json:
        print_json(found.as_json())
    else:
        click.echo(text_of(found), nl=False)
