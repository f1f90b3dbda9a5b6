"""`imuarray study`."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.commands.options import (
    force_option,
    json_option,
    names_option,
    option,
    output_option,
    parameter,
    prepare_folder,
    print_json,
    progress,
    takes,
    workers_option,
)
from imuarray.spelling import guess

if TYPE_CHECKING:
    from imuarray.studies.fusion_gain.gain_study import Study

EXPERIMENTS = ("static", "tumble", "heating", "turn-on", "motion", "shaking")
"""Experiments of `imuarray.studies.fusion_gain`, repeated here because that module imports NumPy."""

FILES = ("study.json", "study.html", "ratios.png", "bound.png", "coasting.png", "heating.png")


@dataclass(frozen=True)
class StudyOptions:
    """The options of `imuarray study`."""

    output: Path | None = output_option(
        folder=True,
        metavar="DIR",
        help="write study.json and, with matplotlib, figures and the page study.html into DIR",
    )
    seeds: int | None = option(
        type=click.IntRange(1, 1000), help="number of simulated arrays for each experiment (default: 6)"
    )
    experiments: tuple[str, ...] = parameter(
        names_option(
            "--experiments",
            metavar="NAME,...",
            default=",".join(EXPERIMENTS),
            show_default=True,
            help="the experiments to run; motion is a drive, shaking is done by hand",
        )
    )
    array: Path | None = option(
        metavar="CONFIG",
        help=("print what the number and the mounting of this array's gyroscopes gain, instead of the experiments"),
    )
    quick: bool = option(help="two seeds of short logs: enough to see what it does, but not for conclusions")
    workers: int = parameter(workers_option)
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)


@click.command("study")
@takes(StudyOptions)
def command(options: StudyOptions) -> None:
    """Determine what each fusion technique gains on simulated experiments of the paper's array.

    Compares errors with those of the simple average of the same sensors, using calibrations made from simulated logs.
    Also compares them with the Cramer-Rao bound, the smallest error of any unbiased estimator, using the true
    parameters and the correct model. Evaluates heading and velocity after coasting for a minute. Takes two minutes on
    two cores.

    \b
    imuarray study --experiments static,heating -o study
    imuarray study --array icm42688x8
    """
    if options.array is not None:
        _run_numbers(options)
        return
    from imuarray.gap.model.workers import processes
    from imuarray.studies.fusion_gain.gain_study import QUICK_S, QUICK_SEEDS, SEEDS, render_text, study

    names = tuple(dict.fromkeys(options.experiments))
    if not names or set(names) - set(EXPERIMENTS):
        strange = next((name for name in names if name not in EXPERIMENTS), "")
        allowed_text = f"allowed are {', '.join(EXPERIMENTS)}{guess(strange, EXPERIMENTS)}"
        raise click.UsageError(f"--experiments {','.join(options.experiments)!r}: {allowed_text}")
    if options.output:
        prepare_folder(options.output, FILES, options.force)
    count = options.seeds or (QUICK_SEEDS if options.quick else SEEDS)
    with ExitStack() as stack:
        set_progress = stack.enter_context(progress(len(names) * count, "study"))
        executor = stack.enter_context(processes(options.workers)) if options.workers > 1 else None
        seconds = QUICK_S if options.quick else None
        result = study(
            names, count, seconds=seconds, executor=executor, progress=lambda so_far, *_: set_progress(so_far)
        )
    if options.output:
        _write(options.output, result)
    if options.as_json:
        print_json(result.as_json())
    else:
        click.echo(render_text(result), nl=False)


def _run_numbers(options: StudyOptions) -> None:
    """Study the gain from the number and the mounting of an array's gyroscopes, and print the result."""
    from imuarray.array import load_array
    from imuarray.shipped import find_config
    from imuarray.studies.fusion_gain.chip_number import render_numbers, study_numbers
    from imuarray.studies.fusion_gain.gain_study import QUICK_SEEDS, SEEDS

    if options.output is not None:
        raise click.UsageError("--output can't be combined with --array, whose result is printed (--json: as JSON)")
    count = options.seeds or (QUICK_SEEDS if options.quick else SEEDS)
    with progress(count, "study") as set_progress:
        result = study_numbers(load_array(find_config(options.array or Path())), count, set_progress)
    if options.as_json:
        print_json(result.as_json())
    else:
        click.echo(render_numbers(result), nl=False)


def _write(folder: Path, result: Study) -> None:
    """Write the numbers, and figures and the page as far as optional packages allow."""
    from imuarray.atomic import write_text
    from imuarray.errors import MissingExtraError
    from imuarray.studies.fusion_gain.page import drawings_of, simulate_heating, write_study_page

    text = json.dumps(result.as_json(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_text(folder / "study.json", text, force=True)
    try:
        warm = simulate_heating(result.seeds[0], result.seconds) if result.of(experiment="heating") else None
        drawings = drawings_of(result, warm)
        for name, drawing in drawings.items():
            drawing.savefig(folder / name, dpi=150, metadata={"Software": None})
        write_study_page(folder / "study.html", result, drawings, force=True)
    except MissingExtraError as error:
        click.echo(f"{folder}: study.json written; no figures and no page: {error}", err=True)
