"""`imuarray import`."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.axes import UP_AXES
from imuarray.commands.options import (
    argument,
    force_option,
    json_option,
    option,
    output_option,
    parameter,
    print_json,
    progress,
    refuse_existing,
    refuse_other_suffix,
    takes,
)
from imuarray.errors import NOTHING_RECORDED, DiskFullError, LogError
from imuarray.importers import FORMATS
from imuarray.printable import counted, printable
from imuarray.shipped import find_map

if TYPE_CHECKING:
    from imuarray.importers import ImportSummary

_WIDTH = 110
_IS_LOG = "{}: is a log already; all commands can read it"


@dataclass(frozen=True)
class ImportOptions:
    """The options of `imuarray import`."""

    source: Path = argument()
    map_path: Path | None = option(
        "--map",
        metavar="MAP.toml",
        help=(
            "map that describes the columns of SOURCE, required unless its format is known: a file, or the name of a"
            " map of the package"
        ),
    )
    format_name: str | None = option("--format", type=click.Choice(tuple(FORMATS)), help="a format that needs no map")
    guess: bool = option(help="propose a map for editing and list what is uncertain; -o MAP.toml writes it")
    up: str | None = option(
        type=click.Choice(UP_AXES), default=None, help="the box axis that pointed up during the whole recording"
    )
    output: Path | None = output_option(metavar="RUN.h5", help="the log to write")
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)


@click.command("import")
@takes(ImportOptions)
def command(options: ImportOptions) -> None:
    """Convert a recording made by other software into a log: a known format, or any table of numbers with a map.

    SOURCE is a text file (also .gz, or a folder or zip file with one per sensor), JSON, .npz, .npy, .mat, .parquet,
    a ROS bag or an MCAP file. Files of raw counts that `imuarray export` wrote (run.npz, run.csv) need no map, and are
    restored without loss. After every import a short report describes the recording (~) and lists what is doubtful (?):
    units, range, rate, clipping, stalls, times in bursts. `--guess` examines a recording and proposes a map.

    \b
    imuarray import data.csv --guess -o map.toml
    imuarray import data.csv --map map.toml -o run.h5
    imuarray import run.npz -o run2.h5
    """
    from imuarray.importers import importer, importer_of
    from imuarray.importers.table import import_table

    if options.guess:
        if options.map_path is not None or options.format_name is not None or options.up is not None or options.as_json:
            raise click.UsageError("--guess proposes a map; the only other arguments are a recording and -o MAP.toml")
        _guess(options.source, options.output, options.force)
        return
    if options.output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    exported = None
    if options.map_path is None and options.format_name is None and not options.source.is_dir():
        exported = importer_of(options.source)
    if exported is None and (options.map_path is None) == (options.format_name is None):
        if _is_log(options.source):
            raise click.UsageError(_IS_LOG.format(options.source))
        raise click.UsageError(f"give either --map MAP.toml or --format {'|'.join(FORMATS)}; --guess proposes a map")
    if options.up is not None and options.map_path is None:
        raise click.UsageError("--up requires --map")
    refuse_other_suffix(options.output, "a log")
    refuse_existing(options.output, options.force)
    size = options.source.stat().st_size if options.source.is_file() else 0
    with progress(size, str(options.source)) as set_progress, _disk_errors():
        if options.map_path is not None:
            map_file = find_map(options.map_path)
            summary = import_table(
                options.source,
                map_file,
                options.output,
                force=options.force,
                progress=set_progress,
                up=options.up or "",
            )
        else:
            summary = (exported or importer(options.format_name or ""))(
                options.source, options.output, force=options.force, progress=set_progress
            )
    _print_result(summary, options.output, options.as_json)


@contextmanager
def _disk_errors() -> Iterator[None]:
    """Let the error of a full disk say that nothing was "imported"; the writer of the log says "recorded"."""
    try:
        yield
    except DiskFullError as error:
        if error.kept != NOTHING_RECORDED:
            raise
        kept = NOTHING_RECORDED.replace("recorded", "imported")
        raise DiskFullError(error.path, error.why, kept) from error


def _is_log(source: Path) -> bool:
    from imuarray.log import Log

    if source.suffix != ".h5" or not source.is_file():
        return False
    try:
        with Log(source):
            return True
    except LogError:
        return False


def _guess(source: Path, output: Path | None, force: bool) -> None:
    from imuarray.atomic import write_text
    from imuarray.importers.guess import guess_map

    if output is not None:
        refuse_existing(output, force, source)
    if _is_log(source):
        raise click.UsageError(_IS_LOG.format(source))
    text = guess_map(source)
    if output is None:
        click.echo(text, nl=False)
        return
    write_text(output, text, force=force)
    count = sum(line.startswith("# ? ") for line in text.splitlines())
    doubts = f", with {counted(count, 'doubt')} at its top" if count else ""
    click.echo(
        f"imuarray: wrote {output}{doubts}; read its comments, then imuarray import {source} --map {output} -o RUN.h5",
        err=True,
    )


def _print_result(summary: ImportSummary, output: Path, as_json: bool) -> None:
    from imuarray.importers.plausibility import store_report
    from imuarray.log import open_log

    report = store_report(output, summary.remarks, summary.doubts)
    with open_log(output) as log:
        messages = {event.kind: event.message for event in log.events}
    if as_json:
        print_json(
            {
                "log": str(output),
                "sensors": list(summary.sensors),
                "rows": summary.rows,
                "lost": summary.lost,
                "seconds": summary.seconds,
                "events": dict(summary.events),
                "remarks": list(summary.remarks),
                "facts": list(report.facts),
                "quirks": list(report.quirks),
                "doubts": list(report.doubts),
            }
        )
        return
    per_sensor = "each" if summary.same_rows else "at most"
    lost_text = "" if summary.lost is None else f", {summary.lost} lost"
    size = f"{counted(len(summary.sensors), 'sensor')}, {counted(summary.rows, 'row')} {per_sensor}"
    click.echo(f"{output}: {size} over {summary.seconds:.1f} s{lost_text}")
    for kind, count in summary.events.items():
        if count == 1 and kind in messages:
            click.echo(f"  {printable(messages[kind])}")
        else:
            click.echo(f"  {kind}: {count} events; `imuarray info {output}` lists them")
    for mark, sentences in (("~", (*report.facts, *summary.remarks, *report.quirks)), ("?", report.doubts)):
        for text in sentences:
            for line in textwrap.wrap(printable(text), _WIDTH, initial_indent=f"  {mark} ", subsequent_indent="    "):
                click.echo(line)
