"""`imuarray gap validate`: the diagnosis on cases whose truth is withheld."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from imuarray.atomic import save_figure, write_text
from imuarray.commands.options import (
    PathName,
    json_option,
    names_option,
    option,
    output_option,
    parameter,
    print_json,
    progress,
    takes,
    workers_option,
)

if TYPE_CHECKING:
    from imuarray.validation.case import Case, Half
    from imuarray.validation.scoring import Figures

_SIZES = ("none", "glance", "reduced", "bench", "short", "medium", "full")
"""The keys of `imuarray.validation.plans.SIZES`, whose import would be slow; a test compares them."""


@dataclass(frozen=True)
class ValidateOptions:
    """The options of `imuarray gap validate`."""

    output: Path | None = output_option(
        folder=True,
        metavar="DIR",
        help=(
            "folder for outcomes, sealed truth and results; repeating the command continues an interrupted run"
            " (default: a new folder validation-DATE in the working directory)"
        ),
    )
    size: str = option(
        type=click.Choice(_SIZES),
        default="reduced",
        show_default=True,
        help=(
            "number of cases: short, medium and full use random worlds; glance, reduced and bench use fixed"
            " plans; none uses only --cases"
        ),
    )
    effects: tuple[str, ...] = parameter(
        names_option(
            "--effects",
            metavar="EFFECT,...",
            help=(
                "only mechanisms that show as one of these effects, and cases without a mechanism (default: all of the"
                " size)"
            ),
            may_be_empty=False,
        )
    )
    severities: tuple[str, ...] = parameter(
        names_option(
            "--severities",
            metavar="LIMITS,...",
            help="sizes of single mechanisms in detection limits, from 0.5, 1, 2, 5, 20 (default: those of the size)",
            may_be_empty=False,
        )
    )
    repeats: int | None = option(
        type=click.IntRange(1, 1000),
        metavar="N",
        help=(
            "number of cases of each mechanism at each severity; all other numbers change in proportion (default: that"
            " of the size)"
        ),
    )
    folders: tuple[Path, ...] = option(
        "--cases",
        multiple=True,
        type=PathName(exists=True, file_okay=False),
        metavar="FOLDER",
        help="cases from other generators, scored separately (python -m pydoc imuarray.validation.case_folder)",
    )
    half: str = option(
        type=click.Choice(["development", "sealed"]),
        default="development",
        show_default=True,
        help="development seeds are for trying changes; sealed seeds are used once, for final figures",
    )
    seed: int = option(
        type=click.IntRange(0, 99), default=0, show_default=True, help="number of the set of cases within the half"
    )
    where: str = option(
        "--executor",
        default="processes",
        show_default=True,
        metavar="processes|tcp://HOST:PORT",
        help="where to run: processes on this machine, or the Dask cluster of a scheduler",
    )
    workers: int = parameter(workers_option)
    again: bool = option(help="retry the cases that failed")
    score_only: bool = option(help="score the existing outcomes; run nothing")
    as_json: bool = parameter(json_option)


@click.command("validate", short_help="score the diagnosis on cases whose cause is withheld")
@takes(ValidateOptions)
def validate(options: ValidateOptions) -> None:
    """Diagnose cases whose cause is withheld, and score the answers.

    The logs come from emulated arrays in which physical mechanisms act; the emulator shares no code with the simulator
    that the diagnosis uses. Each case has a different array, plan and environment. FOLDERs hold cases from other
    generators or from real recordings. The truth of each case is written to DIR/sealed, which is opened only after all
    cases are done. Exits 1 if a figure misses its target by more than chance.

    \b
    imuarray gap validate --size glance -o checked
    imuarray gap validate --effects tone,popcorn_noise --severities 2,5 --repeats 3
    """
    from imuarray.validation.case_folder import cases_in
    from imuarray.validation.plans import SIZES, cases, restrict, shuffle

    severities = [_severity(text) for text in options.severities]
    size = restrict(SIZES[options.size], options.effects, severities, options.repeats)
    planned = cases(cast("Half", options.half), size, options.seed)
    planned = shuffle([*planned, *cases_in(options.folders, cast("Half", options.half), len(planned))], options.seed)
    if not planned:
        raise click.UsageError("--size none requires --cases FOLDER")
    plan = _plan_of(options)
    if not options.score_only:
        folder = _run(options, planned, plan)
    elif options.output is not None:
        folder = options.output
    else:
        raise click.UsageError("--score-only requires the folder of a run: -o DIR")
    figures = _score(folder, planned)
    _write(folder, figures, f"imuarray gap validate {_words(plan)} -o {folder.name}")
    _print_figures(figures, options.as_json)
    if any(row.is_refuted for row in figures.failed):
        raise click.exceptions.Exit(1)


def _severity(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a number", param_hint="--severities") from None


def _plan_of(options: ValidateOptions) -> dict[str, Any]:
    """Return the options that determine the cases, without those that keep their default."""
    plan = {
        "half": options.half,
        "size": options.size,
        "seed": options.seed,
        "effects": list(options.effects),
        "severities": list(options.severities),
        "repeats": options.repeats,
        "folders": [folder.name for folder in options.folders],
    }
    return {key: value for key, value in plan.items() if value not in ([], None)}


def _words(plan: dict[str, Any]) -> str:
    words = list[str]()
    for key, value in plan.items():
        if key == "folders":
            words += [f"--cases {name}" for name in value]
        else:
            words.append(f"--{key} {','.join(value) if isinstance(value, list) else value}")
    return " ".join(words)


def _new_folder() -> Path:
    """Make a folder in the working directory that did not exist, and print its name."""
    name = f"validation-{date.today().isoformat()}"
    folder, number = Path(name), 1
    while True:
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
            folder = Path(f"{name}-{number}")
        else:
            click.echo(f"{folder}: the folder of this run; -o {folder} continues it", err=True)
            return folder


_PLAN_NAMES = {
    "frozen": "set of thresholds",
    "effects": "choice of effects",
    "severities": "choice of severities",
    "repeats": "number of repeats",
    "folders": "choice of --cases",
    "cases": "number of cases",
}
"""What an error calls the entries of a plan, where not by their own names."""


def _prepare_folder(folder: Path, plan: dict[str, Any]) -> None:
    """Record the plan and the thresholds of a new run; ConfigError if the folder belongs to another run."""
    from imuarray.errors import ConfigError
    from imuarray.validation.case import write_json
    from imuarray.validation.trial import frozen_thresholds

    frozen_plan = {**plan, "frozen": frozen_thresholds()}
    path = folder / "plan.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_json(path, frozen_plan)
        return
    noted = json.loads(path.read_text(encoding="utf-8"))
    for key in sorted({**frozen_plan, **noted}, key="cases".__eq__):  # the reason before the number of cases
        if noted.get(key) != frozen_plan.get(key):
            name = _PLAN_NAMES.get(key, key)
            raise ConfigError(f"{path}: the run began with another {name}; use the same {name}, or another folder")


def _run(options: ValidateOptions, planned: list[Case], plan: dict[str, Any]) -> Path:
    from imuarray.validation.running import executor_of, run_cases
    from imuarray.validation.trial import diagnose_case

    with executor_of(options.where, options.workers) as executor:
        folder = _new_folder() if options.output is None else options.output
        _prepare_folder(folder, {**plan, "cases": len(planned)})
        with progress(len(planned), "cases") as tell:
            ran = run_cases(planned, folder, diagnose_case, executor, again=options.again, progress=tell)
    for name in (*ran.failed, *ran.lost):
        click.echo(f"{folder}/outcomes/{name}.json: failed; --again retries it", err=True)
    return folder


def _score(folder: Path, planned: list[Any]) -> Figures:
    from imuarray.validation.bench import CHIPS, HIDDEN
    from imuarray.validation.scoring import score_folder

    return score_folder(folder, hidden=HIDDEN, planned=planned, sensors=CHIPS)


def _write(folder: Path, figures: Figures, command: str) -> None:
    from imuarray.errors import MissingExtraError
    from imuarray.figures import can_draw
    from imuarray.report.validation_figures import plots_of
    from imuarray.report.validation_page import markdown, write_validation_page
    from imuarray.validation.case import write_json
    from imuarray.validation.scoring import as_json

    write_json(folder / "figures.json", as_json(figures))
    plots = plots_of(figures) if can_draw() else {}
    for name, plot in plots.items():
        save_figure(folder / f"{name}.svg", plot, metadata={"Date": None})
    files = {name.replace("-", " "): f"{name}.svg" for name in plots}
    write_text(folder / "results.md", markdown(figures, date.today().isoformat(), command, files), force=True)
    try:
        write_validation_page(folder / "results.html", figures, command=command, plots=plots, force=True)
    except MissingExtraError as error:
        click.echo(f"{folder}: figures.json and results.md written; no page: {error}", err=True)


def _print_figures(figures: Figures, as_json: bool) -> None:
    from imuarray.validation.scoring import as_json as table_of
    from imuarray.validation.scoring import format_text

    if as_json:
        print_json(table_of(figures))
    else:
        click.echo(format_text(figures), nl=False)
