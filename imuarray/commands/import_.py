"""`imuarray import`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.commands.options import force_option, json_option, print_json, progress, refuse_existing
from imuarray.importers import FORMATS

if TYPE_CHECKING:
    from imuarray.importers import Summary


@click.command("import")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--map",
    "map_path",
    type=click.Path(path_type=Path),
    metavar="MAP.toml",
    help="which column of a text table is what",
)
@click.option("--format", "format_name", type=click.Choice(tuple(FORMATS)), help="a format that needs no map")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), metavar="RUN.h5", help="the log to write"
)
@force_option
@json_option
def command(
    source: Path, map_path: Path | None, format_name: str | None, output: Path, force: bool, as_json: bool
) -> None:
    """Turn a recording made by another program into a log: a known format, or any table of numbers by its map.

    What `imuarray export` wrote of raw counts, run.npz or run.csv, needs neither and comes back as it was.

    \b
    imuarray import run.npz -o run2.h5
    """
    from imuarray.importers import importer
    from imuarray.importers.exported import importer_of
    from imuarray.importers.table import import_table

    ours = importer_of(source) if map_path is None and format_name is None else None
    if ours is None and (map_path is None) == (format_name is None):
        raise click.UsageError(f"say either --map MAP.toml or --format {'|'.join(FORMATS)}")
    refuse_existing(output, force)
    size = source.stat().st_size if source.is_file() else 0
    with progress(size, str(source)) as done:
        if map_path is not None:
            summary = import_table(source, map_path, output, force=force, progress=done)
        else:
            summary = (ours or importer(format_name or ""))(source, output, force=force, progress=done)
    _tell(summary, output, as_json)


def _tell(summary: Summary, output: Path, as_json: bool) -> None:
    """What was imported, for a person or a program."""
    if as_json:
        print_json(
            {
                "log": str(output),
                "sensors": list(summary.sensors),
                "rows": summary.rows,
                "lost": summary.lost,
                "seconds": summary.seconds,
                "events": dict(summary.events),
            }
        )
        return
    each = "each" if summary.same_rows else "at most"
    lost = "" if summary.lost is None else f", {summary.lost} lost"
    click.echo(
        f"{output}: {len(summary.sensors)} sensors, {summary.rows} rows {each} over {summary.seconds:.1f} s{lost}"
    )
    for kind, count in summary.events.items():
        click.echo(f"  {kind}: {count} (see events: imuarray info {output})")
