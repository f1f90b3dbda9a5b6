"""`imuarray paper`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.atomic import write_text
from imuarray.commands.options import PathName, force_option, json_option, prepare_folder, print_json, progress

if TYPE_CHECKING:
    from imuarray.studies.paper.replica.simulation import ExperimentData
    from imuarray.studies.paper.replica.statistic import Replica

_NO_FIGURES = "; no figures, they need matplotlib: pip install 'imuarray[report]'"
_REPLICA_FILES = ("replica.json", "paper.html")
_GAP_FILE = "gap.json"

_output = click.option(
    "-o",
    "--output",
    type=PathName(file_okay=False),
    metavar="DIR",
    help="write paper.json, one CSV file per table and, with matplotlib, figures (--replica: replica.json and the page "
    "paper.html; --gap: gap.json) into DIR",
)


@click.command("paper")
@_output
@click.option(
    "--replica", is_flag=True, help="simulate the experiments of the paper and compare every statistic, with z scores"
)
@click.option(
    "--gap", is_flag=True, help="list what the data sheets do not predict in its tables, with probable causes"
)
@click.option("--seed", type=click.IntRange(0, 2**63), default=1, show_default=True, help="seed of the replica")
@json_option
@force_option
def command(output: Path | None, replica: bool, gap: bool, seed: int, as_json: bool, force: bool) -> None:
    """Recompute the paper's tables and conclusions from its published data.

    Uses the tables of Martin, Groves, Newman and Faragher (ION GNSS+ 2013), which come with the package. Prints which
    figures agree to the printed digits, which do not, and which conclusions hold.

    \b
    imuarray paper --replica -o replica
    """
    if replica and gap:
        raise click.UsageError("give either --replica or --gap")
    if replica:
        _replica(seed, output, as_json, force)
        return
    if gap:
        _gap(output, as_json, force)
        return
    from imuarray.figures import can_draw
    from imuarray.studies.paper import recompute, render_text
    from imuarray.studies.paper.results import as_json as to_json
    from imuarray.studies.paper.results import write

    result = recompute()
    paths = write(result, output, force=force) if output else ()
    click.echo(to_json(result) if as_json else render_text(result), nl=False)
    if output:
        click.echo(f"{output}: {len(paths)} files written{'' if can_draw() else _NO_FIGURES}", err=True)


def _replica(seed: int, output: Path | None, as_json: bool, force: bool) -> None:
    """Simulate the experiments of the paper, and compare the results with its tables."""
    from imuarray.studies.paper.replica.comparison import compare
    from imuarray.studies.paper.replica.simulation import observe
    from imuarray.studies.paper.replica.statistic import Replica, render_text

    if output:
        prepare_folder(output, _REPLICA_FILES, force)
    with progress(100, "replica") as set_progress:
        observed = observe(seed, progress=lambda so_far, total, what: set_progress(round(100 * so_far / total)))
    replica = Replica(seed, tuple(compare(observed)))
    if output:
        _write_replica(output, replica, observed)
    if as_json:
        print_json(replica.as_json())
    else:
        click.echo(render_text(replica), nl=False)


def _gap(output: Path | None, as_json: bool, force: bool) -> None:
    """Print the statistics of the paper's tables that the data sheets do not predict."""
    from imuarray.studies.paper import findings

    if output:
        prepare_folder(output, (_GAP_FILE,), force)
    result = findings.as_json()
    if output:
        text = json.dumps(result, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        write_text(output / _GAP_FILE, text, force=True)
    if as_json:
        print_json(result)
    else:
        click.echo(findings.render_text(), nl=False)
    if output:
        click.echo(f"{output}: {_GAP_FILE} written", err=True)


def _write_replica(folder: Path, replica: Replica, observed: ExperimentData) -> None:
    """Write the numbers, and the page as far as optional packages allow."""
    from imuarray.errors import MissingExtraError
    from imuarray.figures import can_draw
    from imuarray.studies.paper.page import write_paper_page

    numbers, page = (folder / name for name in _REPLICA_FILES)
    write_text(numbers, json.dumps(replica.as_json(), indent=1, allow_nan=False) + "\n", force=True)
    try:
        write_paper_page(page, replica, observed if can_draw() else None, force=True)
    except MissingExtraError as error:
        click.echo(f"{folder}: replica.json written; no page: {error}", err=True)
        return
    click.echo(f"{folder}: 2 files written{'' if can_draw() else _NO_FIGURES}", err=True)
