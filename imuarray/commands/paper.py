"""`imuarray paper`."""

from __future__ import annotations

from pathlib import Path

import click

from imuarray.commands.options import force_option, json_option, print_json, progress, refuse_existing

output_option = click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="write paper.json, one CSV file per table and, with matplotlib, figures (or replica.json) into DIR",
)


@click.command("paper")
@output_option
@click.option("--replica", is_flag=True, help="simulate its experiments and compare every statistic, with z scores")
@click.option("--seed", type=click.IntRange(0, 2**63), default=1, show_default=True, help="of the replica")
@json_option
@force_option
def command(output: Path | None, replica: bool, seed: int, as_json: bool, force: bool) -> None:
    """The paper's tables and conclusions, recomputed from its published data.

    Everything follows from the tables of Martin, Groves, Newman and Faragher (ION GNSS+ 2013), which come with this
    program: what agrees to the printed digits, what does not, and which conclusions hold.
    """
    if replica:
        _replica(seed, output, as_json, force)
        return
    from imuarray.paper import recompute, render_text
    from imuarray.paper.files import as_json as to_json
    from imuarray.paper.files import can_draw, write

    result = recompute()
    written = write(result, output, force=force) if output else ()
    click.echo(to_json(result) if as_json else render_text(result), nl=False)
    if output:
        figures = "" if can_draw() else "; no figures, they need matplotlib: pip install 'imuarray[report]'"
        click.echo(f"{output}: {len(written)} files written{figures}", err=True)


def _replica(seed: int, output: Path | None, as_json: bool, force: bool) -> None:
    """The paper's experiments on the simulated array beside its tables."""
    import json

    from imuarray.paper.replica import render_text, replicate

    path = output / "replica.json" if output else None
    if path:
        refuse_existing(path, force, in_new_folder=True)
    with progress(100, "replica") as done:
        found = replicate(seed, progress=lambda so_far, total, what: done(round(100 * so_far / total)))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found.as_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if as_json:
        print_json(found.as_json())
    else:
        click.echo(render_text(found), nl=False)
