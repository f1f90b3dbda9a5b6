"""`imuarray paper`."""

from __future__ import annotations

from pathlib import Path

import click

from imuarray.commands.options import force_option, json_option

output_option = click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="write paper.json, one CSV file per table and, with matplotlib, figures into DIR",
)


@click.command("paper")
@output_option
@json_option
@force_option
def command(output: Path | None, as_json: bool, force: bool) -> None:
    """The paper's tables and conclusions, recomputed from its published data.

    Everything follows from the tables of Martin, Groves, Newman and Faragher (ION GNSS+ 2013), which come with this
    program: what agrees to the printed digits, what does not, and which conclusions hold.
    """
    from imuarray.paper import recompute, render_text
    from imuarray.paper.files import as_json as to_json
    from imuarray.paper.files import can_draw, write

    result = recompute()
    written = write(result, output, force=force) if output else ()
    click.echo(to_json(result) if as_json else render_text(result), nl=False)
    if output:
        figures = "" if can_draw() else "; no figures, they need matplotlib: pip install 'imuarray[report]'"
        click.echo(f"{output}: {len(written)} files written{figures}", err=True)
